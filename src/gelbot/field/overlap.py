"""Which electrodes overlap: two that touch would be one.

An electrode is a prism: its cross-section, moved along its own z axis; a plate without a backing is one of no height.
Prisms with parallel axes overlap where their cross-sections do and their heights do, which is decided in the plane.
Others are put together from convex parts (a ring from sectors), and the distance of two convex polyhedra is a linear
programme: the smallest t for which two weighted means of their corners are no further than t apart along x, y and z.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from gelbot.field.electrodes import Electrode, ElectrodeArray, Ring
from gelbot.field.outlines import hole_rim, in_tank, rim

Floats: TypeAlias = NDArray[np.float64]

CLEARANCE = 1e-6
"""Electrodes closer than this [m] overlap."""
FINE, COARSE = 256, 64
"""Corners that stand for a circle in the plane, where they cost nothing, and in a linear programme."""


def overlaps(array: ElectrodeArray) -> Iterator[tuple[int, int]]:
    """Pairs of electrodes that overlap or touch, their backings included; the smaller number first."""
    middles = np.stack([(e.bounds[0] + e.bounds[1]) / 2.0 for e in array.electrodes], axis=1)
    radii = np.array([np.linalg.norm(e.bounds[1] - e.bounds[0]) / 2.0 for e in array.electrodes])
    for a in range(array.count):
        distance = np.linalg.norm(middles[:, a + 1 :] - middles[:, a, None], axis=0)
        near = a + 1 + np.flatnonzero(distance <= radii[a] + radii[a + 1 :] + CLEARANCE)
        yield from ((a, int(b)) for b in near if _touch(array.electrodes[a], array.electrodes[b]))


def reaches_into(electrode: Electrode, outline: Floats, low: float, high: float) -> bool:
    """Whether an electrode meets the upright prism over `outline` (p, 2) [m] from height `low` to `high` [m]."""
    if electrode.bounds[0][2] > high or electrode.bounds[1][2] < low:
        return False
    ground = shapely.Polygon(outline)
    slices = (_slice(part, low, high) for part in convex_parts(electrode))
    return any(part.size and ground.intersects(shapely.MultiPoint(part.T).convex_hull) for part in slices)


def _slice(part: Floats, low: float, high: float) -> Floats:
    """Points of the plane, (2, p), whose convex hull is what `part`'s hull has between two heights, seen from above."""
    corners = [part[:2, (part[2] >= low) & (part[2] <= high)]]
    for height in (low, high):
        # Where the lines between any two corners cross the height: all of its edges are among them.
        above, below = part[:, part[2] > height], part[:, part[2] < height]
        share = (height - below[2][:, None]) / (above[2] - below[2][:, None])
        crossing = below[:2, :, None] + share * (above[:2, None] - below[:2, :, None])
        corners.append(crossing.reshape(2, -1))
    return np.concatenate(corners, axis=1)


def convex_parts(electrode: Electrode) -> list[Floats]:
    """Corners [m], shape (3, p), of convex polyhedra that together are the electrode; plates have no height."""
    outer = rim(electrode, COARSE)
    if not isinstance(electrode.shape, Ring):
        return [in_tank(electrode, outer, electrode.ends)]
    inner = hole_rim(electrode.shape, COARSE)[:, ::-1]
    sectors = [np.concatenate([np.roll(r, -k, axis=1)[:, :2] for r in (outer, inner)], axis=1) for k in range(COARSE)]
    return [in_tank(electrode, sector, electrode.ends) for sector in sectors]


def _touch(a: Electrode, b: Electrode) -> bool:
    if np.linalg.norm(np.cross(a.frame[:, 2], b.frame[:, 2])) < 1e-9:
        return _parallel_touch(a, b)
    pairs = ((p, q) for p in convex_parts(a) for q in convex_parts(b) if _bounds_touch(p, q))
    return any(_separation(p, q) < CLEARANCE for p, q in pairs)


def _parallel_touch(a: Electrode, b: Electrode) -> bool:
    """Whether two prisms with parallel axes touch, seen in the frame of the first."""
    offset = a.frame.T @ (b.centre - a.centre)
    turn = a.frame.T @ b.frame
    low, high = sorted(offset[2] + turn[2, 2] * end for end in b.ends)
    if max(low - a.ends[1], a.ends[0] - high) >= CLEARANCE:
        return False
    return bool(shapely.distance(_section(a), _section(b, turn[:2, :2], offset[:2])) < CLEARANCE)


def _section(electrode: Electrode, turn: Floats | None = None, offset: Floats | None = None) -> shapely.Polygon:
    """The cross-section of an electrode in its own x-y plane, or turned (2, 2) and moved (2,) into another."""
    edges = [rim(electrode, FINE)]
    if isinstance(electrode.shape, Ring):
        edges.append(hole_rim(electrode.shape, FINE))
    if turn is not None and offset is not None:
        edges = [turn @ edge + offset[:, None] for edge in edges]
    return shapely.Polygon(edges[0].T, [edge.T for edge in edges[1:]])


def _bounds_touch(p: Floats, q: Floats) -> bool:
    apart = np.maximum(p.min(axis=1) - q.max(axis=1), q.min(axis=1) - p.max(axis=1))
    return bool(apart.max() < CLEARANCE)


def _separation(p: Floats, q: Floats) -> float:
    """Distance [m] of the convex hulls of `p` and `q`, (3, p) each: its largest component; 0 where they meet."""
    from scipy.optimize import linprog

    scale = float(np.ptp(np.concatenate([p, q], axis=1), axis=1).max())
    middle = p.mean(axis=1, keepdims=True)
    m, n = p.shape[1], q.shape[1]
    apart = np.concatenate([p - middle, middle - q], axis=1) / scale
    within = np.concatenate([np.concatenate([apart, -apart]), -np.ones((6, 1))], axis=1)
    means = np.zeros((2, m + n + 1))
    means[0, :m] = means[1, m:-1] = 1.0
    cost = np.zeros(m + n + 1)
    cost[-1] = 1.0
    found = linprog(cost, A_ub=within, b_ub=np.zeros(6), A_eq=means, b_eq=np.ones(2), bounds=(0.0, None))
    return float(found.fun) * scale
