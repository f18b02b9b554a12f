"""One set of voltages on solved electrodes: what they take, give and draw, and where the numbers need a second look."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gelbot.field.charge import FieldProblem, FieldSolution
from gelbot.field.circuit import connection, power
from gelbot.field.electrodes import THIN, Block, Disc, Electrode, ElectrodeArray, Rectangle, Ring, Rod, Shape
from gelbot.field.gel import GEL
from gelbot.field.images import Tank
from gelbot.field.winding import inside

Floats = NDArray[np.float64]

ROUNDING = 1e-9
"""A value that exceeds its threshold by less than this share is at the threshold, not above it."""
COARSE = 0.5
"""Largest diameter of a panel, in distances to the gel: beyond it the gel sees single panels."""
INACCURATE = 0.01
"""Largest error of the field that goes without a word."""
IN_PLANE = 1e-9
"""A plate nearer than this [m] to a boundary of the tank lies in it."""

VOLTAGE, CURRENT, BUBBLING, PANELS, ERROR = "voltage", "current", "bubbling", "panels", "error"


class Limits(NamedTuple):
    """What the supply can give: `voltage` [V] either way, `current` [A] in all; mean `density` [A/m^2] without gas."""

    voltage: float
    current: float | None
    density: float


class Excess(NamedTuple):
    """A `value` above its `threshold`, in the SI unit of their `kind`; numbers of the electrodes, the worst first."""

    kind: str
    value: float
    threshold: float
    electrodes: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """Electrodes at their voltages. Arrays have the shape (e,).

    `asked` [V]: of the supply; `voltages` [V]: those that all electrodes take; `currents` [A]: from them into the tank;
    `mean_density` [A/m^2]: those over the `conducting_area`.
    """

    solution: FieldSolution
    states: tuple[str, ...]
    asked: Floats
    voltages: Floats
    currents: Floats
    mean_density: Floats

    @property
    def total_current(self) -> float:
        """What the supply gives [A]: the sum of the positive currents."""
        return float(self.currents[self.currents > 0.0].sum())

    @property
    def net_current(self) -> float:
        """Sum of all currents [A]: zero, but for rounding."""
        return float(self.currents.sum())

    @property
    def power(self) -> float:
        """What the electrodes feed into the tank [W]."""
        return power(self.solution.conductance, self.voltages)

    @property
    def bulk_potential(self) -> float:
        """Potential of the bulk [V], which floats."""
        return float(self.solution.bulk_potential @ self.voltages)

    def potential(self, points: Floats) -> Floats:
        """Potential [V], shape (p,), at `points` [m], shape (3, p)."""
        return self.solution.potential(points, self.voltages[:, None])[0]

    def current_density(self, points: Floats) -> Floats:
        """i = -sigma grad phi [A/m^2], shape (3, p), at `points` [m], shape (3, p); in a gel with the gel's sigma."""
        panels = self.solution.problem.panels
        density = self.solution.current_density(points, self.voltages[:, None])[0]
        gel = np.flatnonzero(panels.owner == GEL)
        if len(gel):
            contrast = panels.contrast[gel[0]]
            density[:, inside(points, panels.corners[:, :3, gel])] *= (1.0 - contrast) / (1.0 + contrast)
        return density


def operating_point(solution: FieldSolution, asked: Floats, states: Sequence[str]) -> OperatingPoint:
    """What happens when driven electrodes get the voltages `asked` [V], shape (e,); the others are as `states` says."""
    voltages = connection(solution.conductance, states) @ asked
    currents = solution.conductance @ voltages
    density = currents / conducting_area(solution.problem.array, solution.problem.tank)
    return OperatingPoint(solution, tuple(states), asked, voltages, currents, density)


def conducting_area(array: ElectrodeArray, tank: Tank) -> Floats:
    """Area [m^2] through which each electrode gives its current, shape (e,): both sides of a plate that has two.

    A backing covers one side of a plate, and so does a boundary of the tank in which it lies.
    """
    return np.array([_sides(electrode, tank) * _area(electrode.shape) for electrode in array.electrodes])


def _area(shape: Shape) -> float:
    """One side of a thin shape, or all of the surface of another [m^2]."""
    match shape:
        case Rectangle(size=(a, b)):
            return a * b
        case Disc(diameter=d):
            return np.pi / 4.0 * d**2
        case Ring(diameter=d, inner_diameter=inner):
            return np.pi / 4.0 * (d**2 - inner**2)
        case Rod(diameter=d, length=length):
            return np.pi * d * (length + d / 2.0)
        case Block(size=(a, b, c)):
            return 2.0 * (a * b + b * c + c * a)


def _sides(electrode: Electrode, tank: Tank) -> int:
    if not isinstance(electrode.shape, THIN) or electrode.backing > 0.0:
        return 1
    lies_in_boundary = any(
        plane is not None
        and abs(electrode.frame[axis, 2]) > 1.0 - IN_PLANE
        and abs(electrode.centre[axis] - plane) < IN_PLANE
        for axis, planes in enumerate(tank.planes)
        for plane in planes
    )
    return 1 if lies_in_boundary else 2


def excesses(point: OperatingPoint, limits: Limits, body: Floats, error: float | None) -> list[Excess]:
    """Everything that is above its threshold; `body` [m], shape (3, n): nodes of the gel; `error` of the field."""
    driven = np.array([state == "driven" for state in point.states])
    asked, density = np.abs(point.asked) * driven, np.abs(point.mean_density)
    size = _panel_size(point.solution.problem, body)
    found = [
        _above(VOLTAGE, asked, limits.voltage),
        None if limits.current is None else _above(CURRENT, np.array([point.total_current]), limits.current),
        _above(BUBBLING, density, limits.density),
        _above(PANELS, size, COARSE),
        None if error is None else _above(ERROR, np.array([error]), INACCURATE),
    ]
    whole_tank = (CURRENT, ERROR)
    return [e._replace(electrodes=()) if e.kind in whole_tank else e for e in found if e is not None]


def _above(kind: str, values: Floats, threshold: float) -> Excess | None:
    worst = np.argsort(-values, kind="stable")
    above = worst[values[worst] > threshold * (1.0 + ROUNDING)]
    return Excess(kind, float(values[worst[0]]), threshold, tuple(above.tolist())) if len(above) else None


def _panel_size(problem: FieldProblem, body: Floats) -> Floats:
    """The largest ratio of a panel's diameter to its distance from the gel's nodes, for each electrode, shape (e,)."""
    panels = problem.panels
    distance = cKDTree(body.T).query(panels.centre.T)[0]
    ratio = 2.0 * panels.radius / np.maximum(distance, 1e-12)
    size = np.zeros(problem.array.count)
    mine = panels.owner >= 0
    np.maximum.at(size, panels.owner[mine], ratio[mine])
    return size
