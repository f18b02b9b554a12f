"""The numbers of a run: what the paper reports of the turn-over, and what the supply had to give."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

OVER = -0.8
"""A body whose normal's z lies below this is turned over."""
VERTICAL = 2
"""The place of z on the dimension `space`."""

MEASURED = (
    "turned_over",
    "t_switch_s",
    "z_switch_mm",
    "tip_angle_at_switch_deg",
    "t_transition_s",
    "stayed_over_s",
    "simulated_s",
    "peak_voltage_V",
    "peak_current_A",
    "charge_C",
    "max_height_mm",
    "final_normal_z",
    "final_height_mm",
    "iterations_mean",
    "iterations_max",
    "left_working_volume_s",
)
"""What is read from the frames; a run without frames has None there."""


def summarise(run: xr.Dataset, wall_s: float | None, compile_s: float | None) -> dict[str, Any]:
    """The content of summary.json: plain numbers with their unit in the name, None where one does not apply.

    `run`: a run data set, `wall_s` and `compile_s` [s]: what it took to compute. The switch is the first frame of
    phase 1; the transition ends when the normal's z first falls below -0.8; `stayed_over_s` is the length of the final
    stretch in which it stays there; the charge is the time integral of half the sum of the electrodes' |currents|.
    `left_working_volume_s` is when the body first left the box in which the field is tabulated: from then on it is
    taken from the box's nearest point. `field_table_error` is that of the table on the body's faces at the start,
    relative to the largest current density there. Frames that are not finite do not count.
    """
    names = {
        "scenario": run.attrs.get("scenario_name"),
        "status": run.attrs.get("status"),
        "precision": run.attrs.get("precision"),
        "wall_s": wall_s,
        "compile_s": compile_s,
        "field_table_error": run.attrs.get("table_error"),
    }
    if "centre" in run:
        run = run.isel(time=np.flatnonzero(np.isfinite(_values(run, "centre")).all(axis=1)))
    if run.sizes.get("time", 0) == 0:
        return {**names, **dict.fromkeys(MEASURED), "turned_over": False, "simulated_s": 0.0}

    time = _values(run, "time")
    height = _values(run, "centre")[:, VERTICAL]
    normal = _values(run, "normal")[:, VERTICAL]
    current = _values(run, "electrode_current")
    iterations = _values(run, "iterations")
    over = normal < OVER

    switch = _first(_values(run, "phase") >= 1)
    fallen = None if switch is None else _first(over[switch:])
    tips = _values(run, "tip_angle")
    return {
        **names,
        "turned_over": bool(over.any()),
        "t_switch_s": _number(time, switch),
        "z_switch_mm": _number(height * 1e3, switch),
        "tip_angle_at_switch_deg": None if tips.size == 0 else _number(np.degrees(tips.max(axis=1)), switch),
        "t_transition_s": None if switch is None or fallen is None else float(time[switch + fallen] - time[switch]),
        "stayed_over_s": _final_stretch(time, over),
        "simulated_s": float(time[-1]),
        "peak_voltage_V": float(np.abs(_values(run, "voltage")).max()),
        "peak_current_A": float(np.abs(current).max()),
        "charge_C": float(np.trapezoid(0.5 * np.abs(current).sum(axis=1), time)),
        "max_height_mm": float(height.max() * 1e3),
        "final_normal_z": float(normal[-1]),
        "final_height_mm": float(height[-1] * 1e3),
        "iterations_mean": float(iterations.mean()),
        "iterations_max": int(iterations.max()),
        "left_working_volume_s": _number(time, _first(_outside(run))),
    }


def _values(run: xr.Dataset, name: str) -> NDArray[Any]:
    """A variable with time first and the other dimensions in the order of the data set's description."""
    return run[name].transpose("time", ...).values


def _outside(run: xr.Dataset) -> NDArray[np.bool_]:
    """At which frames a part of the body is beyond the sides or the top of the box in which the field is known.

    Below it, the field hardly differs from that at its bottom: a resting body presses a little into the floor.
    """
    if "working_volume" not in run.attrs:
        return np.zeros(run.sizes["time"], dtype=bool)
    position = _values(run, "position")
    low, high = np.array(run.attrs["working_volume"])
    low[VERTICAL] = -np.inf
    beyond = (position < low[:, None]) | (position > high[:, None])
    return np.any(beyond, axis=(1, 2))


def _first(condition: NDArray[np.bool_]) -> int | None:
    return int(np.argmax(condition)) if condition.any() else None


def _number(values: NDArray[Any], index: int | None) -> float | None:
    return None if index is None else float(values[index])


def _final_stretch(time: NDArray[np.float64], condition: NDArray[np.bool_]) -> float:
    """Length [s] of the stretch at the end throughout which `condition` holds; 0 when it does not hold at the end."""
    if not condition[-1]:
        return 0.0
    broken = np.flatnonzero(~condition)
    return float(time[-1] - time[broken[-1] + 1 if broken.size else 0])
