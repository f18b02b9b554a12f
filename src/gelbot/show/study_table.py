"""A study, or several side by side, on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

ROWS = (
    ("switch [s]", "t_switch_s", ".1f"),
    ("height at the switch [mm]", "z_switch_mm", ".2f"),
    ("transition [s]", "t_transition_s", ".1f"),
    ("whole motion [s]", "t_motion_s", ".1f"),
    ("peak voltage [V]", "peak_voltage_V", ".2f"),
    ("charge [C]", "charge_C", ".2f"),
)
REASONS_MOST = 5
"""So many different reasons are told; all are in study.json."""


def print_study(study: Mapping[str, Any], console: Console | None = None) -> None:
    """Print a study's rate and distributions, and why runs failed."""
    console = console or Console()
    console.print(_table([study], f"{study['scenario']}: {study['n']} runs, seed {study['seed']}"))
    _print_failures(study, console)


def print_comparison(comparison: Mapping[str, Any], console: Console | None = None) -> None:
    """Print several studies of the same robots side by side, and what sets each two of them apart."""
    console = console or Console()
    studies = comparison["studies"]
    first = studies[0]
    console.print(_table(studies, f"{first['scenario']}: {first['n']} robots, seed {first['seed']}"))
    for pair in comparison["pairs"]:
        console.print(Text(_pair(pair)))
    for study in studies:
        _print_failures(study, console)


def _table(studies: list[Mapping[str, Any]], title: str) -> Table:
    table = Table(title=title)
    table.add_column("")
    for study in studies:
        table.add_column(str(study["controller"]), justify="right")
    table.add_row("met", *(f"{s['successes']} of {s['n']}" for s in studies))
    rates = (f"{s['rate']:.3f} ({s['ci_low']:.3f} - {s['ci_high']:.3f})" for s in studies)
    table.add_row("rate, 95 % interval", *rates)
    for label, key, form in ROWS:
        table.add_row(Text(label), *(_spread(s["distributions"][key], form) for s in studies))
    table.caption = "median (5 % - 95 %) of the runs that met the motion"
    return table


def _spread(found: Mapping[str, float] | None, form: str) -> str:
    return "-" if found is None else f"{found['median']:{form}} ({found['q05']:{form}} - {found['q95']:{form}})"


def _pair(pair: Mapping[str, Any]) -> str:
    time = pair["second_less_first"]["t_motion_s"]
    said = "" if time is None else (
        f"; where both met it, {pair['second']} took {time['value']:+.1f} s ({time['low']:+.1f} to {time['high']:+.1f})"
    )  # fmt: skip
    return (
        f"{pair['second']} against {pair['first']}: met on {pair['only_second_met']} robots where the other did not, "
        f"failed on {pair['only_first_met']} (p = {pair['p']:.2g}){said}"
    )


def _print_failures(study: Mapping[str, Any], console: Console) -> None:
    reasons = Counter(failure["reason"].split(": nearest")[0] for failure in study["failures"])
    for reason, count in reasons.most_common(REASONS_MOST):
        runs = [f["run"] for f in study["failures"] if f["reason"].startswith(reason)]
        shown = ", ".join(map(str, runs[:8])) + (", ..." if len(runs) > 8 else "")
        console.print(Text(f"{study['controller']}: {count} failed: {reason} (runs {shown})"))
