"""The surfaces of obstacles as triangles, for pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelbot.field.electrodes import frame_of
from gelbot.scenario.obstacle_shapes import AnyObstacle, BoxObstacle, CylinderObstacle, SphereObstacle

Floats = NDArray[np.float64]

ROUND = 36
"""Corners of what is drawn for a circle."""
FINE, MOST = 0.25, 24
"""Edges are cut into parts of this share of the radius, or of a box's shortest edge, since a picture sorts triangles by
their distance; but not into more parts than this."""


def obstacle_triangles(obstacles: tuple[AnyObstacle, ...]) -> Floats:
    """Corners [m] of all surfaces, counter-clockwise from outside, shape (3, 3, m): space, corner, triangle.

    Planes have no end, and are left out.
    """
    parts = [np.zeros((3, 3, 0))]
    for obstacle in obstacles:
        if isinstance(obstacle, SphereObstacle):
            parts.append(_placed(_turned(*_half_circle(obstacle.diameter / 2.0)), np.eye(3), obstacle.position))
        elif isinstance(obstacle, CylinderObstacle):
            r, h = obstacle.diameter / 2.0, obstacle.length / 2.0
            side, end = _parts(-h, h, FINE * r), _parts(0.0, r, FINE * r)
            radius = np.concatenate([end[:-1], np.full(len(side), r), end[-2::-1]])
            height = np.concatenate([np.full(len(end) - 1, -h), side, np.full(len(end) - 1, h)])
            profile = radius, height
            parts.append(_placed(_turned(*profile), frame_of(obstacle.axis), obstacle.position))
        elif isinstance(obstacle, BoxObstacle):
            parts.append(_placed(_box(np.array(obstacle.size)), obstacle.turn, obstacle.position))
    return np.concatenate(parts, axis=2)


def _placed(triangles: Floats, turn: Floats, position: tuple[float, float, float]) -> Floats:
    return np.einsum("ij,jcm->icm", turn, triangles) + np.array(position)[:, None, None]


def _parts(low: float, high: float, size: float) -> Floats:
    return np.linspace(low, high, 1 + min(MOST, int(np.ceil((high - low) / size))))


def _half_circle(radius: float) -> tuple[Floats, Floats]:
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ROUND // 2 + 1)
    return radius * np.cos(angle), radius * np.sin(angle)


def _turned(radius: Floats, height: Floats) -> Floats:
    """The surface of revolution about z of a profile that runs upwards on its outer side, shape (3, 3, m)."""
    angle = 2.0 * np.pi * np.arange(ROUND + 1) / ROUND
    rings = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle)), _rows(height, ROUND + 1)])
    a, b, c, d = rings[:, :-1, :-1], rings[:, :-1, 1:], rings[:, 1:, 1:], rings[:, 1:, :-1]
    both = [np.stack(corners, axis=1).reshape(3, 3, -1) for corners in ((a, b, c), (a, c, d))]
    triangles = np.concatenate(both, axis=2)
    # On the axis a quadrilateral has one triangle only.
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0], axis=0), axis=0
    )
    return triangles[:, :, area > 1e-9 * area.max()]


def _rows(values: Floats, count: int) -> Floats:
    return np.repeat(values[:, None], count, axis=1)


def _box(size: Floats) -> Floats:
    triangles = []
    cut = [_parts(-0.5 * s, 0.5 * s, FINE * float(size.min())) for s in size]
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid = np.zeros((3, len(cut[u]), len(cut[v])))
        grid[u], grid[v] = np.meshgrid(cut[u], cut[v], indexing="ij")
        for side in (-0.5, 0.5):
            grid[axis] = side * size[axis]
            a, b, c, d = grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, 1:, 1:], grid[:, :-1, 1:]
            outside = slice(None, None, int(2 * side))
            triangles += [np.stack(t[outside], axis=1).reshape(3, 3, -1) for t in ((a, b, c), (a, c, d))]
    return np.concatenate(triangles, axis=2)
