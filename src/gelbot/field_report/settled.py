"""What of a field is nothing but rounding, and whether a current flows at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelbot.field.operating_point import Excess, OperatingPoint

Floats = NDArray[np.float64]

ROUNDING = 1e-9
"""What is smaller than this share of the largest value of its kind is zero."""
IDLE = "idle"


def without_rounding(values: Floats, largest: float) -> Floats:
    """`values` with 0 where they are less than rounding of `largest`."""
    return np.where(np.abs(values) <= ROUNDING * largest, 0.0, values)


def settled(point: OperatingPoint) -> OperatingPoint:
    """`point` with zeros for voltages, currents and current densities that are but rounding."""
    voltages = without_rounding(point.voltages, np.abs(point.voltages).max())
    # Where no current flows at all, the largest current is rounding too.
    most = np.abs(point.solution.conductance).max() * np.abs(voltages).max() if flows(voltages) else np.inf
    currents = without_rounding(point.currents, most)
    density = np.where(currents == 0.0, 0.0, point.mean_density)
    return replace(point, voltages=voltages, currents=currents, mean_density=density)


def flows(voltages: Floats) -> bool:
    """Whether electrodes with these voltages [V], (e,), drive a current: two of them differ."""
    return bool(np.ptp(voltages) > ROUNDING * np.abs(voltages).max())


def idle(point: OperatingPoint) -> list[Excess]:
    """A warning where no current can flow; its value is the voltage [V] that all electrodes share."""
    if flows(point.voltages):
        return []
    connected = [n for n, state in enumerate(point.states) if state in ("driven", "grounded")]
    return [Excess(IDLE, float(point.voltages[connected[0]]), 0.0, tuple(connected))]
