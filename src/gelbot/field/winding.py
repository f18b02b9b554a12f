"""Inside or outside of a closed surface: by the solid angle under which a point sees it, 4 pi or nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

AT_ONCE = 1 << 21
"""Pairs of points and triangles that are computed at once."""


def inside(points: Floats, triangles: Floats) -> NDArray[np.bool_]:
    """Whether `points` [m], shape (3, p), lie inside; `triangles` [m], (3, 3, f): [component, corner, triangle]."""
    low, high = triangles.min(axis=(1, 2))[:, None], triangles.max(axis=(1, 2))[:, None]
    found = np.all((points >= low) & (points <= high), axis=0)
    near = np.flatnonzero(found)
    step = max(1, AT_ONCE // triangles.shape[2])
    for start in range(0, len(near), step):
        some = near[start : start + step]
        found[some] = np.abs(_solid_angle(points[:, some], triangles)) > 2.0 * np.pi
    return found


def _solid_angle(points: Floats, triangles: Floats) -> Floats:
    """Of the whole surface, shape (p,) (Van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983)."""
    a, b, c = (triangles[:, k, None, :] - points[:, :, None] for k in range(3))
    la, lb, lc = (np.sqrt(np.sum(v * v, axis=0)) for v in (a, b, c))
    volume = np.sum(a * np.cross(b, c, axis=0), axis=0)
    dots = [np.sum(u * v, axis=0) for u, v in ((a, b), (b, c), (c, a))]
    return 2.0 * np.arctan2(volume, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum(axis=1)
