"""Electrodes as polygons: how they look from a direction, and what of them lies in a picture's window."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]


class Outline(NamedTuple):
    """An electrode: `corners` (3, p), whose hull is its outline from any side, and those of a `hole` in it, (3, h)."""

    corners: Floats
    hole: Floats


def electrode_outlines(run: xr.Dataset) -> list[Outline]:
    """The electrodes of a run [m]. Early runs have square plates and know their side."""
    if "electrode_outline" not in run:
        half = float(run.attrs["electrode_side"]) / 2.0
        square = half * np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
        centres = run["electrode_centre"].transpose("electrode", "space").values
        return [Outline(centre[:, None] + square, np.zeros((3, 0))) for centre in centres]
    return [split(points) for points in run["electrode_outline"].transpose("electrode", "space", ...).values]


def split(points: Floats) -> Outline:
    """The corners before the first column of NaN, and those after it."""
    given = np.isfinite(points[0])
    first = len(given) if given.all() else int(np.argmin(given))
    rest = points[:, first:]
    return Outline(points[:, :first], rest[:, np.isfinite(rest[0])])


def seen_from(outline: Outline, towards: Floats) -> Outline:
    """The corners that make the outline seen from the direction `towards` (3,), anticlockwise; a hole's clockwise."""
    right, up = _across(towards)
    corners = outline.corners[:, _hull(right @ outline.corners, up @ outline.corners)]
    x, y = right @ outline.hole, up @ outline.hole
    is_anticlockwise = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0
    return Outline(corners, outline.hole[:, ::-1] if is_anticlockwise else outline.hole)


def joined(outline: Outline) -> Floats:
    """The outline as one loop, (3, k): a hole hangs on it by a seam. Has to go the other way round, see `seen_from`."""
    outer, hole = outline
    if hole.shape[1] == 0:
        return outer
    return np.concatenate([outer, outer[:, :1], hole, hole[:, :1]], axis=1)


def is_flat(outline: Outline) -> bool:
    """Whether all corners lie in one plane: a plate, not a rod or a block."""
    from_middle = outline.corners - outline.corners.mean(axis=1, keepdims=True)
    return bool(np.linalg.matrix_rank(from_middle, tol=1e-6 * np.abs(from_middle).max()) < 3)


def clipped(outline: Outline, low: Floats, high: Floats) -> Outline:
    """What of an outline lies between `low` and `high` (2,) in x and y (Sutherland and Hodgman 1974)."""

    def inside(loop: Floats) -> Floats:
        for axis in (0, 1):
            loop = _cut(loop, loop[axis] - low[axis])
            loop = _cut(loop, high[axis] - loop[axis])
        return loop

    return Outline(inside(outline.corners), inside(outline.hole))


def _cut(loop: Floats, depth: Floats) -> Floats:
    """The part of a loop where `depth`, one for each of its corners, is not negative."""
    kept: list[Floats] = []
    for k, (corner, d) in enumerate(zip(loop.T, depth, strict=True)):
        before, d_before = loop.T[k - 1], depth[k - 1]
        if (d < 0.0) != (d_before < 0.0):
            kept.append(before + (corner - before) * (d_before / (d_before - d)))
        if d >= 0.0:
            kept.append(corner)
    return np.array(kept).T if kept else np.zeros((3, 0))


def _across(towards: Floats) -> tuple[Floats, Floats]:
    """Two directions, (3,) each, to the right and upwards for who looks from `towards`."""
    reference = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(reference, towards)
    right /= np.linalg.norm(right)
    return right, np.cross(towards, right)


def _hull(x: Floats, y: Floats) -> list[int]:
    """Numbers of the points that are corners of the convex hull, anticlockwise (Andrew 1979)."""

    def half(order: NDArray[np.int64]) -> list[int]:
        chain: list[int] = []
        for n in order:
            while len(chain) > 1:
                a, b = chain[-2:]
                if (x[b] - x[a]) * (y[n] - y[a]) - (y[b] - y[a]) * (x[n] - x[a]) > 1e-12 * (np.ptp(x) + np.ptp(y)) ** 2:
                    break
                chain.pop()
            chain.append(int(n))
        return chain[:-1]

    order = np.lexsort((y, x))
    return half(order) + half(order[::-1])
