"""Where the field is sampled for a picture: a regular grid on a plane, over all electrodes and the body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.images import Tank
from gelbot.field.operating_point import OperatingPoint
from gelbot.field.panels import Panels
from gelbot.field_report.asked import Plane
from gelbot.field_report.settled import flows, without_rounding

Floats = NDArray[np.float64]

POINTS_MOST, POINTS_LEAST = 15_000, 5_000
"""Points of a grid, about: some 0.5 mm apart in a section of the paper's array."""
PAIRS = 3e8
"""Pairs of points and panels, mirror images counted, above which a grid has fewer points: that costs seconds."""
FEWEST = 24
"""Points of a grid in each direction, at least."""
TOUCHES = 1e-9
"""What is nearer to a panel than this [m] lies on it."""
MARGIN = 0.12
"""Room around electrodes and body, as a share of their breadth."""


class Sampled(NamedTuple):
    """The field on a `plane`: coordinates `right` (u,) and `up` (v,) [m] of its grid along its two axes (`across`).

    `potential` (v, u) [V]; `current_density` (3, v, u) [A/m^2].
    """

    plane: Plane
    right: Floats
    up: Floats
    potential: Floats
    current_density: Floats


def view(array: ElectrodeArray, body: Floats, tank: Tank) -> tuple[Floats, Floats]:
    """The lowest and the highest corner [m], shape (3,) each, of what pictures show; `body` (3, n): the gel's nodes."""
    low = np.min([*(electrode.bounds[0] for electrode in array.electrodes), body.min(axis=1)], axis=0)
    high = np.max([*(electrode.bounds[1] for electrode in array.electrodes), body.max(axis=1)], axis=0)
    room = MARGIN * (high - low)[:2].max()
    low, high = low - room, high + room
    for axis, (least, most) in enumerate(tank.planes):
        # Floor and surface are always in the picture, walls where they are near.
        low[axis] = low[axis] if least is None else least if axis == 2 else max(low[axis], least)
        high[axis] = high[axis] if most is None else most if axis == 2 else min(high[axis], most)
    return low, high


def grid(plane: Plane, low: Floats, high: Floats, most: int = POINTS_MOST) -> tuple[Floats, Floats, Floats]:
    """Coordinates to the right (u,) and upwards (v,) [m], and all points (3, v * u), about `most`, of the grid."""
    right, up = (axis for axis in range(3) if axis != plane.axis)
    width, height = high[right] - low[right], high[up] - low[up]
    spacing = np.sqrt(width * height / most)
    count = [int(np.clip(length / spacing, FEWEST, most / FEWEST)) for length in (width, height)]
    u, v = np.linspace(low[right], high[right], count[0]), np.linspace(low[up], high[up], count[1])
    points = np.empty((3, len(v), len(u)))
    points[plane.axis], points[right], points[up] = plane.value, u, v[:, None]
    return u, v, points.reshape(3, -1)


def sample(point: OperatingPoint, plane: Plane, low: Floats, high: Floats) -> Sampled:
    """The field on a grid over the part of `plane` that lies between `low` and `high` [m], (3,)."""
    problem = point.solution.problem
    images = np.prod([1 + sum(place is not None for place in planes) for planes in problem.tank.planes])
    most = int(np.clip(PAIRS / (images * problem.panels.count), POINTS_LEAST, POINTS_MOST))
    u, v, points = grid(plane, low, high, most)
    potential, density = field_at(point, points)
    return Sampled(plane, u, v, potential.reshape(len(v), len(u)), density.reshape(3, len(v), len(u)))


def on_electrode(places: Floats, panels: Panels) -> NDArray[np.bool_]:
    """Which of `places` (3, p) [m] lie on an electrode: within `TOUCHES` of one of its panels; shape (p,)."""
    found = np.zeros(places.shape[1], bool)
    near = cKDTree(places.T).query_ball_point(panels.centre.T, panels.radius + TOUCHES)
    for n in np.flatnonzero(panels.owner >= 0):
        if not near[n]:
            continue
        x, y, height = panels.frame[:, :, n].T @ (places[:, near[n]] - panels.centre[:, n, None])
        corner = panels.outline[:, :, n]
        edge = np.roll(corner, -1, axis=1) - corner
        # Corners go round anticlockwise: what is inside is to the left of all edges.
        left = edge[0] * (y[:, None] - corner[1]) - edge[1] * (x[:, None] - corner[0])
        inside = np.all(left >= -TOUCHES * np.linalg.norm(edge, axis=0), axis=1)
        found[near[n]] |= inside & (np.abs(height) <= TOUCHES)
    return found


def field_at(point: OperatingPoint, points: Floats) -> tuple[Floats, Floats]:
    """Potential (p,) [V] and current density (3, p) [A/m^2] at `points` (3, p) [m]."""
    largest = float(np.abs(point.voltages).max())
    if not flows(point.voltages):
        return np.full(points.shape[1], point.voltages[0]), np.zeros_like(points)
    return without_rounding(point.potential(points), largest), point.current_density(points)
