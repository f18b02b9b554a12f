"""A map: a scenario's motion over a grid of two of its values, where it is met and where not."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import TextColumn

from gelbot.controllers.choice import with_controller
from gelbot.ensemble import as_ready, scenario_of, workers
from gelbot.errors import BadInput
from gelbot.motion.reach import check_has_motion
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.scenario.ranges import BETWEEN, Spread, named, spread
from gelbot.show.progress import RUNS_OF, runs_bar
from gelbot.show.sweep_view import draw_sweep
from gelbot.study.batches import Task, run_one
from gelbot.study.report import table_of

MAP, POINTS = "map.json", "points.csv"


class Axes(NamedTuple):
    """The two values: `x` and `y` as KEY=LOW..HIGH, at `columns` and `rows` places, ends included."""

    x: str
    y: str
    columns: int
    rows: int


def sweep(
    loaded: Loaded, axes: Axes, controller: str, programme: Path | None, folder: Path, progress: bool
) -> dict[str, Any]:
    """Run the grid, write map.json, points.csv and map.png into `folder`; returns the content of map.json."""
    check_has_motion(loaded, ": a map shows where it does")
    prepared = with_controller(loaded, controller, programme)
    x, y = (_axis(option, text, prepared) for option, text in (("--x", axes.x), ("--y", axes.y)))
    for option, count in (("--columns", axes.columns), ("--rows", axes.rows)):
        if count < 2:
            raise BadInput(option, count, "2 or more")
    # The middle is a scenario that is allowed, or a key or a unit is wrong; other points need not be.
    scenario_of(prepared, {one.key: one.value(np.full(one.size, 0.5)) for one in (x, y)})
    shares = [np.linspace(0.0, 1.0, count) for count in (axes.columns, axes.rows)]
    points = [
        {x.key: x.value(np.full(x.size, a)), y.key: y.value(np.full(y.size, b))} for b in shares[1] for a in shares[0]
    ]
    rows = _run(Task(prepared, (), 0, controller), points, progress)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / POINTS, table_of(rows))
    made = {
        "scenario": loaded.scenario.name,
        "controller": controller,
        "n": len(rows),
        "met": sum(row["met"] for row in rows),
        "x": _told(x, axes.columns),
        "y": _told(y, axes.rows),
        "met_at": [[bool(row["met"]) for row in line] for line in _lines(rows, axes.columns)],
        "t_motion_s": [[row["t_motion_s"] for row in line] for line in _lines(rows, axes.columns)],
    }
    draw_sweep(made, folder / "map.png")
    write_text(folder / MAP, json.dumps(made, indent=2) + "\n")
    return made


def _axis(option: str, text: str, loaded: Loaded) -> Spread:
    read = named(text)
    if read is None or BETWEEN.fullmatch(read[1]) is None:
        raise BadInput(option, text, "KEY=LOW..HIGH with a unit", 'material.p_ele="1.5e-2 .. 2.5e-2 cm^2/mA"')
    key, values = read
    return spread(key, values, tomllib.loads(loaded.text), f"{option} {key}")


def _told(one: Spread, count: int) -> dict[str, Any]:
    between = BETWEEN.fullmatch(one.text)
    unit = "" if between is None else between[4]
    values = [one.value(np.full(one.size, share)) for share in np.linspace(0.0, 1.0, count)]
    first = [value[0] if isinstance(value, list) else value for value in values]
    numbers = [float(str(value).split()[0]) for value in first]
    return {"key": one.key, "unit": unit, "values": numbers}


def _lines(rows: list[dict[str, Any]], columns: int) -> list[list[dict[str, Any]]]:
    return [rows[k : k + columns] for k in range(0, len(rows), columns)]


def _run(task: Task, points: list[dict[str, Any]], progress: bool) -> list[dict[str, Any]]:
    bar = runs_bar(Console(stderr=True), progress, None, TextColumn(RUNS_OF))
    with bar, workers(min(len(points), os.cpu_count() or 1)) as pool:
        shown = bar.add_task("", total=len(points))
        futures = {pool.submit(_numbered, task, k, changes) for k, changes in enumerate(points)}
        found = {}
        for run, row in as_ready(futures):
            found[run] = row
            bar.update(shown, advance=1)
    return [found[k] for k in range(len(points))]


def _numbered(task: Task, run: int, changes: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    return run, {"run": run, "seed": [], **run_one(task, run, changes)}
