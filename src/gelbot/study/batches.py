"""A study's runs, a batch at a time: here or on a cluster, each batch's file whole or not there.

A batch is a range of run numbers; what becomes of a run depends on its number alone. So a study that was killed goes on
with the batches whose files are missing, and ends with the same numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gelbot.controllers.choice import outcome_with
from gelbot.ensemble import Changes, Outcome, as_ready
from gelbot.errors import BadInput
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.study.scatter import draw, spreads

SERIES_EVERY = 0.5
"""The centre's height is kept this often [s], for pictures."""


class Task(NamedTuple):
    """What serves all batches: the scenario with its programme, what scatters, the seed, and the controller."""

    loaded: Loaded
    vary: tuple[str, ...]
    seed: int
    controller: str


def run_batch(task: Task, first: int, last: int) -> list[dict[str, Any]]:
    """The rows of runs `first` to `last` - 1. A run that cannot begin is a failed run, with the reason."""
    scattered = spreads(task.loaded, task.vary)
    return [
        {"run": run, "seed": [task.seed, run], **run_one(task, run, draw(scattered, task.seed, run))}
        for run in range(first, last)
    ]


def run_one(task: Task, run: int, changes: Changes) -> dict[str, Any]:
    """What became of one robot, and what it `changes`."""
    try:
        return {"changes": dict(changes), **_row(outcome_with(task.controller, task.loaded, run, changes))}
    except BadInput as error:
        return {"changes": dict(changes), **_failed(str(error))}


NUMBERS = (
    *("t_switch_s", "z_switch_mm", "t_transition_s", "stayed_over_s", "peak_voltage_V", "peak_current_A", "charge_C"),
    *("max_height_mm", "final_normal_z", "final_height_mm", "simulated_s"),
)
"""What a row has of a run's summary."""


def _row(one: Outcome) -> dict[str, Any]:
    assert one.reached is not None  # a study has a motion
    met = one.reached.met and one.converged
    reason = "" if met else "a step did not converge" if not one.converged else one.reached.reason
    every = max(1, round(SERIES_EVERY / float(one.frames["time"][0])))
    return {
        "met": met,
        "reason": reason,
        "t_motion_s": one.reached.times[-1] if met else None,
        "shortfall": float(one.reached.shortfall) if np.isfinite(one.reached.shortfall) else None,
        **{key: one.summary[key] for key in NUMBERS},
        "late_ticks": one.summary.get("late_ticks"),
        "times_s": one.frames["time"].values[every - 1 :: every].tolist(),
        "heights_mm": np.round(one.frames["centre"].values[every - 1 :: every, 2] * 1e3, 4).tolist(),
    }


def _failed(reason: str) -> dict[str, Any]:
    empty = dict.fromkeys(("t_motion_s", "shortfall", *NUMBERS, "late_ticks"))
    return {"met": False, "reason": reason, **empty, "times_s": [], "heights_mm": []}


class Batch(NamedTuple):
    """Runs `first` to `last` - 1, whose rows are in `file`."""

    first: int
    last: int
    file: Path


def batches(folder: Path, count: int, size: int) -> list[Batch]:
    """The batches of a study of `count` runs."""
    starts = range(0, count, size)
    return [Batch(k, min(k + size, count), folder / "batches" / f"{k:06d}.json") for k in starts]


def rows_of(batch: Batch) -> list[dict[str, Any]]:
    """The rows of a batch that is done."""
    return json.loads(batch.file.read_text(encoding="utf-8"))


def run_batches(task: Task, open_ones: list[Batch], executor: Executor) -> Iterator[list[dict[str, Any]]]:
    """Compute the batches and write their files; their rows come as they are ready."""
    futures = {}
    for batch in open_ones:
        futures[executor.submit(run_batch, task, batch.first, batch.last)] = batch
    for rows in as_ready(set(futures)):
        batch = next(b for b in open_ones if b.first == rows[0]["run"])
        batch.file.parent.mkdir(parents=True, exist_ok=True)
        write_text(batch.file, json.dumps(rows))
        yield rows
