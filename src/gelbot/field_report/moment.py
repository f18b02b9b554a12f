"""The body where its field is wanted: at its start, or at a moment of a recorded run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.body.lattice import build_body
from gelbot.errors import BadInput
from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.outlines import outlines
from gelbot.record.run_store import open_run
from gelbot.scenario.build import posed
from gelbot.scenario.schema import Scenario
from gelbot.units import quantity, shown

Floats = NDArray[np.float64]

SAME = 1e-6
"""Electrodes whose middles and corners differ by less than this [m] stand in the same place."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A body: `positions` (3, n) [m], `faces` (3, f), `centre` (3,) [m]; `voltages` (e,) [V] of a run; its `source`."""

    positions: Floats
    faces: NDArray[np.int64]
    centre: Floats
    voltages: Floats | None
    source: str


def at_start(scenario: Scenario) -> Moment:
    """The body as it lies before anything happens."""
    shape = scenario.body
    body = build_body(shape.outline(), shape.thickness, shape.mesh_size, shape.layers)
    centre = np.array([*shape.pose.position, shape.pose.lift + shape.thickness / 2.0])
    return Moment(posed(scenario, body), body.faces, centre, None, "start")


def of_run(folder: Path, time: str | None, array: ElectrodeArray) -> Moment:
    """The body and its voltages in the frame of the run in `folder` that is nearest to `time`; without one the last."""
    run = open_run(folder if folder.suffix == ".zarr" else folder / "run.zarr")
    if run.sizes.get("time", 0) == 0:
        raise BadInput("--run", str(folder), "a run with at least one frame")
    if not _has_electrodes(run, array):
        raise BadInput("--run", str(folder), "a run with the electrodes of this scenario")
    times = run["time"].values
    wanted = float(times[-1]) if time is None else plain_or_with_unit(time, "s", "--time")
    if not 0.0 <= wanted <= times[-1]:
        raise BadInput("--time", time, f"a time of the run: 0 s to {shown(float(times[-1]), 's')}")
    frame = run.isel(time=int(np.argmin(np.abs(times - wanted)))).load()
    return Moment(
        positions=frame["position"].transpose("space", "node").values.astype(float),
        faces=frame["faces"].transpose("corner", "face").values,
        centre=frame["centre"].values.astype(float),
        voltages=frame["voltage"].values.astype(float),
        source=f"{folder} at {shown(float(frame['time']), 's')}",
    )


def _has_electrodes(run: xr.Dataset, array: ElectrodeArray) -> bool:
    """Whether the electrodes of `run` are those of `array`; early runs know their middles only."""
    stored = [(run["electrode_centre"].transpose("space", "electrode").values, array.centres)]
    if "electrode_outline" in run:
        corners = run["electrode_outline"].transpose("space", "outline_corner", "electrode").values
        stored.append((corners, outlines(array)))
    return all(
        one.shape == other.shape and np.allclose(one, other, rtol=0.0, atol=SAME, equal_nan=True)
        for one, other in stored
    )


def plain_or_with_unit(text: str, unit: str, where: str) -> float:
    """The value of `text` in the SI unit `unit`, in which a plain number is."""
    try:
        float(text)
    except ValueError:
        with_unit = text
    else:
        with_unit = f"{text} {unit}"
    try:
        return quantity(with_unit, unit, where)
    except BadInput as error:
        allowed = error.allowed.replace(", and finite", "") + f", or a number in {unit}"
        raise BadInput(where, text, allowed + (", finite" if "finite" in error.allowed else "")) from error
