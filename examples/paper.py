"""The paper's results beside gelbot's, each from a study of many runs: a table in Markdown.

    .venv/bin/python examples/paper.py                 # 300 robots with each controller: half an hour on two cores
    .venv/bin/python examples/paper.py -n 20           # a quick look
    .venv/bin/python examples/paper.py --directions    # also all ten directions, 100 robots each

It can be stopped and started again: studies go on where they were, in the folder runs/paper.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from gelbot.errors import GelbotError
from gelbot.scenario import load
from gelbot.study.campaign import Request, asked_in, begin_study, prepare_study, run_study
from gelbot.study.compare import compare
from gelbot.study.report import Report

SEED = 1
CONTROLLERS = ("template", "servo", "planned", "predictive")
PREDICTED = 60
"""The predictive controller simulates many futures of each robot: so many robots are enough to compare it on."""
DIRECTIONS = [round(9.0 + 36.0 * k) for k in range(10)]
"""All directions of the starfish as it lies in turn-over [deg]."""


def study(folder: Path, runs: int, controller: str, direction: str | None = None) -> Report:
    """A study of turn-over in `folder`: begun, gone on with, or read."""
    if not (folder / "request.json").exists():
        asked = Request(runs, SEED, (), controller)
        begin_study(prepare_study(load("turn-over"), asked, direction=direction), asked, folder)
    _, asked = asked_in(folder)
    if asked.runs != runs:
        raise GelbotError(f"{folder} holds a study of {asked.runs} runs. Try: another --out, or remove it")
    done = 0

    def tell(rows: list[dict[str, Any]]) -> None:
        nonlocal done
        done += len(rows)
        print(f"\r{folder.name}: {done} of {runs}", end="", file=sys.stderr, flush=True)

    made = run_study(folder, on_rows=tell)
    print(file=sys.stderr)
    return made


def rate(made: Report) -> str:
    """Successes with the interval of their rate."""
    found = made.study
    return f"{found['successes']} of {found['n']} ({100 * found['ci_low']:.1f} - {100 * found['ci_high']:.1f} %)"


def spread(made: Report, key: str, form: str = ".1f") -> str:
    """Median and the middle 90 % of a number over the runs that turned over."""
    found = made.study["distributions"][key]
    return "-" if found is None else f"{found['median']:{form}} ({found['q05']:{form}} - {found['q95']:{form}})"


ROWS = (
    ("preparation, until the switch [s]", "40", "t_switch_s", ".1f"),
    ("height of the centre at the switch [mm]", "6.5", "z_switch_mm", ".2f"),
    ("transition [s]", "6 - 10", "t_transition_s", ".1f"),
    ("whole motion [s]", "46 - 50", "t_motion_s", ".1f"),
    ("peak voltage [V]", "-", "peak_voltage_V", ".1f"),
    ("charge [C]", "-", "charge_C", ".1f"),
)


def table(made: dict[str, Report]) -> str:
    """Paper and controllers side by side."""
    heads = ["", "paper", *made]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    lines.append("| turned over and stayed so | 5 of 5 (47.8 - 100 %) | " + " | ".join(map(rate, made.values())) + " |")
    for label, paper, key, form in ROWS:
        lines.append(f"| {label} | {paper} | " + " | ".join(spread(one, key, form) for one in made.values()) + " |")
    return "\n".join(lines)


def pairs(made: list[Report]) -> str:
    """What sets the controllers apart on the same robots."""
    lines = [
        "| second against first | only the second | only the first | p | time [s] | charge [C] |",
        "|---|---|---|---|---|---|",
    ]
    for pair in compare(made)["pairs"]:
        less = pair["second_less_first"]
        said = [
            "-" if less[key] is None else "{value:+.1f} ({low:+.1f} to {high:+.1f})".format(**less[key])
            for key in ("t_motion_s", "charge_C")
        ]
        lines.append(
            f"| {pair['second']} against {pair['first']} | {pair['only_second_met']} | {pair['only_first_met']} | "
            f"{pair['p']:.2g} | " + " | ".join(said) + " |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=300, help="robots for each controller")
    parser.add_argument("--directions", action="store_true", help="also all ten directions, 100 robots each")
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), choices=CONTROLLERS)
    parser.add_argument("--out", type=Path, default=Path("runs/paper"))
    given = parser.parse_args()
    try:
        made = {
            name: study(given.out / name, min(given.n, PREDICTED) if name == "predictive" else given.n, name)
            for name in given.controllers
        }
        print(table(made))
        print()
        # Runs are alike by their number: a shorter study is compared with the first runs of a longer one.
        least = min(len(one.rows) for one in made.values())
        print(f"On the same {least} robots:\n")
        print(pairs([one._replace(rows=one.rows[:least]) for one in made.values()]))
        if given.directions:
            print("\n| direction [deg] | turned over and stayed so | whole motion [s] |\n|---|---|---|")
            for angle in DIRECTIONS:
                one = study(given.out / f"direction-{angle}", 100, "planned", f"{angle} deg")
                print(f"| {angle} | {rate(one)} | {spread(one, 't_motion_s')} |", flush=True)
    except GelbotError as error:
        sys.exit(f"paper.py: {error}")
