"""What a study says: study.json, a table of its runs, what failed and why, pictures."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gelbot.ensemble import in_its_place
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.scenario.overrides import with_changes
from gelbot.show.study_view import draw_study
from gelbot.study.statistics import clopper_pearson, mean_of

STUDY, RUNS, FAILED = "study.json", "runs.csv", "failed"

DISTRIBUTIONS = ("t_switch_s", "t_transition_s", "t_motion_s", "z_switch_mm", "peak_voltage_V", "charge_C")
"""Of what distributions are told."""


class Report(NamedTuple):
    """`study`: the content of study.json. `rows`: one for each run, in their order. `loaded`: what was run."""

    study: dict[str, Any]
    rows: list[dict[str, Any]]
    loaded: Loaded


def report(
    loaded: Loaded, controller: str, seed: int, rows: list[dict[str, Any]], scatter: dict[str, str] | None = None
) -> Report:
    """Count the rows: success with its Clopper-Pearson interval, distributions over the runs that met the motion.

    `scatter`: the keys that were drawn, with their ranges.
    """
    count, successes = len(rows), sum(row["met"] for row in rows)
    rate = clopper_pearson(successes, count)
    study = {
        "scenario": loaded.scenario.name,
        "controller": controller,
        "seed": seed,
        "scatter": scatter or {},
        "precision": loaded.scenario.simulation.precision,
        "n": count,
        "successes": successes,
        "rate": rate.value,
        "ci_low": rate.low,
        "ci_high": rate.high,
        "confidence": 0.95,
        "distributions": {key: _distribution(rows, key) for key in DISTRIBUTIONS},
        "failures": [{key: row[key] for key in ("run", "seed", "reason")} for row in rows if not row["met"]],
    }
    return Report(study, rows, loaded)


def _distribution(rows: list[dict[str, Any]], key: str) -> dict[str, float] | None:
    values = np.array([row[key] for row in rows if row["met"] and row[key] is not None])
    mean = mean_of(values)
    if mean is None:
        return None
    low, middle, high = (float(q) for q in np.quantile(values, [0.05, 0.5, 0.95]))
    return {
        "mean": mean.value,
        "mean_low": mean.low,
        "mean_high": mean.high,
        "min": float(values.min()),
        "q05": low,
        "median": middle,
        "q95": high,
        "max": float(values.max()),
    }


SERIES = ("times_s", "heights_mm")
"""What of a row is for the pictures alone."""


def table_of(rows: list[dict[str, Any]]) -> str:
    """The rows as CSV, a column for each number of each key that scatters."""
    flat = []
    for row in rows:
        plain = {key: value for key, value in row.items() if key not in (*SERIES, "changes")}
        plain["seed"] = " ".join(map(str, row["seed"]))
        for key, value in row["changes"].items():
            parts = value if isinstance(value, list) else [value]
            for k, part in enumerate(parts):
                plain[f"{key}.{k}" if isinstance(value, list) else key] = part
        flat.append(plain)
    out = io.StringIO()
    writer = csv.DictWriter(out, list(flat[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return out.getvalue()


def write_report(made: Report, folder: Path) -> None:
    """Write study.json, runs.csv, the scenarios of failed runs (`gelbot run FILE` repeats one) and study.png."""
    write_text(folder / RUNS, table_of(made.rows))
    for row in made.rows:
        if not row["met"]:
            (folder / FAILED).mkdir(exist_ok=True)
            write_text(folder / FAILED / f"run-{row['run']:04d}.toml", _replay(made.loaded, row["changes"]))
    draw_study(made.study, made.rows, folder / "study.png")
    write_text(folder / STUDY, json.dumps(made.study, indent=2) + "\n")


def _replay(loaded: Loaded, changes: dict[str, Any]) -> str:
    """The scenario of one run, to be run alone."""
    everything = in_its_place(loaded.scenario, changes)
    return with_changes(loaded.text, [(key.split("."), value) for key, value in everything.items()])
