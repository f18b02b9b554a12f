"""What a gel that conducts otherwise than the solution does to the current through its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelbot.field.gel import GEL, gel_inflow, undisturbed_inflow
from gelbot.field.operating_point import OperatingPoint

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GelEffect:
    """-i . n on the gel's faces [A/m^2], shape (f,), with the gel's conductivity and `without`.

    `area` [m^2], shape (f,), of the faces; `conductance_change`: largest change of the electrodes' conductance matrix,
    relative to its largest element.
    """

    inflow: Floats
    without: Floats
    area: Floats
    conductance_change: float

    @property
    def rms_change(self) -> float:
        """Root mean square, over the gel's area, of what the gel changes, relative to that of the inflow without it."""
        return float(np.sqrt(self.area @ np.square(self.inflow - self.without) / (self.area @ np.square(self.without))))

    @property
    def largest_change(self) -> float:
        """Largest change on a face, relative to the largest inflow without the gel."""
        return float(np.abs(self.inflow - self.without).max() / np.abs(self.without).max())


def gel_effect(point: OperatingPoint, undisturbed: OperatingPoint) -> GelEffect:
    """Compare `point`, whose field knows the gel, with the `undisturbed` one, of the same electrodes without it."""
    problem, before = point.solution.problem, undisturbed.solution
    change = np.abs(point.solution.conductance - before.conductance).max() / np.abs(before.conductance).max()
    return GelEffect(
        inflow=gel_inflow(point.solution) @ point.voltages,
        without=undisturbed_inflow(problem, before) @ undisturbed.voltages,
        area=problem.panels.area[problem.panels.owner == GEL],
        conductance_change=float(change),
    )
