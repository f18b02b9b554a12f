"""`gelbot plan`: a search from what was asked for to a programme file, or to what limits it."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit
from rich.console import Console
from rich.progress import TextColumn
from rich.text import Text

from gelbot.ensemble import scenario_of, workers
from gelbot.errors import BadInput
from gelbot.motion.reach import check_has_motion, worded
from gelbot.planner.descent import Descent, can_descend, descend
from gelbot.planner.limits import impossible, limited_by
from gelbot.planner.objective import Score, score
from gelbot.planner.search import Candidate, Search, generations, optimiser, values_of
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.scenario.overrides import with_changes
from gelbot.scenario.ranges import overridden, spread
from gelbot.show.plan_search import draw_search
from gelbot.show.progress import runs_bar
from gelbot.study.request_file import read_request, write_request
from gelbot.study.scatter import checked_spreads, draw, spreads
from gelbot.study.statistics import clopper_pearson, mean_of

ASKED, START, GENERATIONS = "asked.json", "start.json", "generations"
PLAN, PROGRAMME, ATTEMPT = "plan.json", "programme.toml", "best-attempt.toml"
CHECK_SEED = 10_000
"""Added to the seed for the robots on which the best is tried: none that the search has seen."""
OFTEN = 0.5
"""A programme that works on fewer than this share of the robots has not met the motion."""


class Asked(NamedTuple):
    """A search as it was asked for."""

    choose: tuple[str, ...]
    vary: tuple[str, ...] = ()
    robots: int = 6
    generations: int = 20
    rounds: int = 2
    population: int | None = None
    check: int = 50
    seed: int = 1
    gradients: int = 20


def seek(folder: Path, loaded: Loaded | None, asked: Asked | None, progress: bool) -> dict[str, Any]:
    """Search in `folder`, or go on with what was `asked` for there; returns the content of plan.json.

    A motion that is met gives programme.toml, which `gelbot run` plays. One that is not gives no programme, but
    best-attempt.toml and what limits it. Raises `BadInput` for what cannot be searched.
    """
    console = Console(stderr=True, quiet=not progress)
    if asked is None or loaded is None:
        loaded, asked = _asked_in(folder)
        search = _search(loaded, asked)
    else:
        search = _search(loaded, asked)
        write_request(folder / ASKED, loaded, asked._asdict())
    reason = impossible(loaded)
    if reason:
        found = {"met": False, "asked": _goals(loaded), "best": None, "limited_by": [reason]}
        return _ended(folder, found, console)
    begun = _begun(search, asked, folder, console)
    if begun is not None:
        search = search._replace(start=begun.shares)
    with workers(os.cpu_count() or 1) as pool:
        history, best, checked = _rounds(search, asked, folder, pool, console)
    draw_search([[_told(one) for one in made] for made in history], folder / "search.png")
    found = _found(search, asked, folder, best, checked, len(history))
    if begun is not None:
        found["gradients"] = _plain(begun)
    return _ended(folder, found, console)


def _begun(search: Search, asked: Asked, folder: Path, console: Console) -> Descent | None:
    """Where the motion's derivatives lead: computed once, since its last digits depend on the machine."""
    if asked.gradients == 0 or not can_descend(search):
        return None
    file = folder / START
    if file.exists():
        kept = json.loads(file.read_text(encoding="utf-8"))
        missing = {key: np.inf for key in ("before", "after") if kept[key] is None}
        return Descent(**{**kept, **missing, "shares": np.array(kept["shares"])})
    console.print(f"following derivatives of the motion by {search.dimension} choices", highlight=False)
    made = descend(search, asked.gradients)
    write_text(file, json.dumps({**_plain(made), "shares": made.shares.tolist()}))
    said = f"mean square miss {made.before:.3g} -> {made.after:.3g} in {made.motions} motions and their derivatives"
    console.print(said, highlight=False)
    return made


def _plain(begun: Descent) -> dict[str, Any]:
    """What a descent came to, as JSON has it: None for what is not finite."""
    misses = {"before": begun.before, "after": begun.after}
    return {"motions": begun.motions, **{key: v if np.isfinite(v) else None for key, v in misses.items()}}


def _rounds(
    search: Search, asked: Asked, folder: Path, pool: Any, console: Console
) -> tuple[list[list[Candidate]], Candidate, list[Score]]:
    """All rounds: their generations, the best candidate of the last one, and its scores on robots that no search saw.

    What a round fails on is what the next one has to learn: these robots are added to its own.
    """
    history: list[list[Candidate]] = []
    number = 0
    while True:
        made = _searched(search, asked, folder, number, pool, console)
        history += made
        best = min((one for each in made for one in each), key=lambda one: one.worth)
        checked = _checked(search, asked, number, best, pool) if best.scores[0].met else []
        failed = [robot for robot, one in checked if not one.met]
        number += 1
        if number == asked.rounds or (checked and not failed):
            return history, best, [one for _, one in checked]
        console.print(f"round {number}: failed on {len(failed)} of {len(checked)} unseen robots", highlight=False)
        search = search._replace(robots=search.robots + tuple(failed[: asked.robots]), start=best.shares)


def _search(loaded: Loaded, asked: Asked) -> Search:
    check_has_motion(loaded)
    for option, value, least in (
        ("--robots", asked.robots, 1),
        ("--generations", asked.generations, 1),
        ("--rounds", asked.rounds, 1),
        ("--check", asked.check, 1),
        ("--gradients", asked.gradients, 0),
        ("--population", asked.population or 4, 4),
    ):
        if value < least:
            raise BadInput(option, value, f"{least} or more")
    data = tomllib.loads(loaded.text)
    where, example = f"{loaded.source}: search", 'programme.phases.0.drive="2 V .. 10 V"'
    texts = overridden(loaded.scenario.search, where, "--choose", asked.choose, example)
    choices = tuple(spread(key, text, data, where) for key, (text, where) in texts.items())
    if not choices:
        allowed = "a table [search] in the scenario, or --choose KEY=RANGE: what may be chosen"
        raise BadInput(where, "nothing", allowed, f"--choose {example}")
    # All at their middles is a scenario that is allowed, or a key or a unit is wrong.
    scenario_of(loaded, values_of(choices, np.full(sum(one.size for one in choices), 0.5)))
    scattered = checked_spreads(loaded, asked.vary)
    robots = tuple({} if k == 0 else draw(scattered, asked.seed, k) for k in range(asked.robots))
    return Search(loaded, choices, robots, asked.seed, asked.population)


def _asked_in(folder: Path) -> tuple[Loaded, Asked]:
    loaded, told = read_request(folder / ASKED, Asked._fields, "search")
    return loaded, Asked(**{**told, "choose": tuple(told["choose"]), "vary": tuple(told["vary"])})


def _searched(
    search: Search, asked: Asked, folder: Path, round_number: int, pool: Any, console: Console
) -> list[list[Candidate]]:
    """All generations of a round, with a bar that says how good the best is so far."""
    before = TextColumn("generation {task.fields[number]} of {task.fields[of]}")
    after = TextColumn("{task.completed:.0f} runs"), TextColumn("[bold]{task.fields[best]}")
    bar = runs_bar(console, not console.quiet, before, *after)
    runs = optimiser(search).population_size * len(search.robots) * asked.generations
    history: list[list[Candidate]] = []
    place = folder / GENERATIONS / str(round_number + 1)
    with bar:
        task = bar.add_task("", total=runs, number=1, of=asked.generations, best="")
        made = generations(search, place, asked.generations, pool, lambda runs: bar.update(task, advance=runs))
        for one in made:
            history.append(one)
            best = min((each for gone in history for each in gone), key=lambda each: each.worth)
            met = sum(each.met for each in best.scores)
            said = f"met {met} of {len(best.scores)}, cost {best.worth:.1f}"
            bar.update(task, number=min(len(history) + 1, asked.generations), best=said)
            if not console.is_terminal:
                console.print(f"generation {len(history)}: {said}", highlight=False)
    return history


def _checked(
    search: Search, asked: Asked, round_number: int, best: Candidate, pool: Any
) -> list[tuple[dict[str, Any], Score]]:
    """The best candidate on robots that the search has not seen, with what became of them; others in each round."""
    scattered = spreads(search.loaded, asked.vary)
    first = round_number * asked.check
    robots = {k: draw(scattered, asked.seed + CHECK_SEED, k) for k in range(first, first + asked.check)}
    futures = {k: pool.submit(score, search.loaded, best.changes, k, robot) for k, robot in robots.items()}
    return [(robots[k], future.result()) for k, future in futures.items()]


def _found(
    search: Search, asked: Asked, folder: Path, best: Candidate, checked: list[Score], count: int
) -> dict[str, Any]:
    met = sum(one.met for one in checked)
    enough = bool(checked) and met >= OFTEN * len(checked)
    rate = clopper_pearson(met, len(checked)) if checked else None
    times = mean_of(np.array([one.time for one in checked if one.time is not None], float))
    charges = [one.charge for one in checked if one.met]
    found = {
        "met": enough,
        "asked": _goals(search.loaded),
        "generations": count,
        "robots": len(search.robots),
        "checked_on": len(checked),
        "checked_met": met,
        "rate": None if rate is None else rate._asdict(),
        "time_s": None if times is None else times._asdict(),
        "peak_voltage_V": max((one.peak for one in checked if one.met), default=None),
        "charge_C": sum(charges) / len(charges) if charges else None,
        "best": {
            "values": best.changes,
            "cost": best.worth,
            "met_in_search": sum(one.met for one in best.scores),
            "shortfall": max(one.shortfall for one in best.scores),
            "reasons": sorted({one.reason for one in best.scores if not one.met}),
        },
        "limited_by": limited_by(search, best),
    }
    text = with_changes(search.loaded.text, [(key.split("."), value) for key, value in best.changes.items()])
    data = tomllib.loads(text)
    programme = data["programme"]
    heads = [
        f"Found by gelbot plan {search.loaded.source}, seed {asked.seed}, in {count} generations; asked for:",
        *(f"  {goal}" for goal in found["asked"]),
        f"Met on {met} of {len(checked)} robots that the search had not seen."
        if enough
        else "NOT met: this is only the best that was found. Limited by: " + "; ".join(found["limited_by"]),
        "Play it: gelbot run NAME --programme FILE",
    ]
    comment = "".join(f"# {line}\n" for line in heads)
    tables = {"programme": programme, "motion": data["motion"]}
    write_text(folder / (PROGRAMME if enough else ATTEMPT), comment + "\n" + tomlkit.dumps(tables))
    return found


def _ended(folder: Path, found: dict[str, Any], console: Console) -> dict[str, Any]:
    write_text(folder / PLAN, json.dumps(found, indent=2) + "\n")
    lines = ["asked: " + "; ".join(found["asked"])]
    if found["met"]:
        rate = found["rate"]
        lines.append(
            f"met on {found['checked_met']} of {found['checked_on']} robots that the search had not seen "
            f"(95 % interval {rate['low']:.3f} to {rate['high']:.3f}), in {found['time_s']['value']:.1f} s on average"
        )
        lines.append(f"the programme: {folder / PROGRAMME}")
    else:
        lines.append("NOT MET: no programme was found that does this")
        if found["best"] is not None:
            lines.append(f"the best attempt, short by {found['best']['shortfall']:.3g}: {folder / ATTEMPT}")
        lines += [f"limited by: {reason}" for reason in found["limited_by"]]
    for line in lines:
        console.print(Text(line))
    return found


def _goals(loaded: Loaded) -> list[str]:
    assert loaded.scenario.motion is not None  # checked by `_search`
    return [worded(goal) for goal in loaded.scenario.motion.goals]


def _told(one: Candidate) -> tuple[float, float]:
    """Cost and share of the robots on which the motion was met, for the picture."""
    return one.worth, sum(each.met for each in one.scores) / len(one.scores)
