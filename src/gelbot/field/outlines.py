"""Outlines of electrodes as polygons in space, for pictures and for what needs their corners."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gelbot.field.electrodes import THIN, Block, Electrode, ElectrodeArray, Rectangle, Ring, breadth

Floats: TypeAlias = NDArray[np.float64]


def outlines(array: ElectrodeArray, corners: int = 48) -> Floats:
    """Corners of all electrodes [m], shape (3, p, e), padded with NaN; a circle has `corners` of them.

    Of a plate they go round its rim, of a rod or a block round both ends: its outline from any side is the convex hull
    of their projection. Those of a ring's hole come after a gap, one column of NaN, and go round the other way.
    """
    found = [_with_hole(electrode, corners) for electrode in array.electrodes]
    padded = np.full((3, max(points.shape[1] for points in found), len(found)), np.nan)
    for e, points in enumerate(found):
        padded[:, : points.shape[1], e] = points
    return padded


def _with_hole(electrode: Electrode, corners: int) -> Floats:
    # Pictures show a plate, not the board behind it.
    heights = (0.0,) if isinstance(electrode.shape, THIN) else electrode.ends
    outer = in_tank(electrode, rim(electrode, corners), heights)
    if not isinstance(electrode.shape, Ring):
        return outer
    hole = in_tank(electrode, hole_rim(electrode.shape, corners), heights)
    return np.concatenate([outer, np.full((3, 1), np.nan), hole], axis=1)


def rim(electrode: Electrode, corners: int) -> Floats:
    """The outer edge of an electrode's cross-section in its own x-y plane [m], shape (2, p), anticlockwise."""
    a, b = breadth(electrode.shape)
    if isinstance(electrode.shape, Rectangle | Block):
        return np.array([[-a, a, a, -a], [-b, -b, b, b]]) / 2.0
    return _circle(a, corners)


def hole_rim(shape: Ring, corners: int) -> Floats:
    """The edge of a ring's hole in its own x-y plane [m], shape (2, p), clockwise."""
    return _circle(shape.inner_diameter, corners)[:, ::-1]


def in_tank(electrode: Electrode, points: Floats, heights: tuple[float, ...]) -> Floats:
    """`points` (2, p) [m] of an electrode's own x-y plane, lifted to each of `heights` [m], in the tank's frame."""
    lifted = [np.vstack([points, np.full((1, points.shape[1]), height)]) for height in heights]
    return electrode.frame @ np.concatenate(lifted, axis=1) + electrode.centre[:, None]


def _circle(diameter: float, corners: int) -> Floats:
    angle = 2.0 * np.pi * np.arange(corners) / corners
    return diameter / 2.0 * np.stack([np.cos(angle), np.sin(angle)])
