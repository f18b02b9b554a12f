"""What of electrodes and gel lies in a plane, and the outline of what does not, as lines in that plane."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gelbot.show.outlines import Outline

Floats: TypeAlias = NDArray[np.float64]

TOUCHES = 1e-9
"""What is nearer to a plane than this [m] lies in it."""


def across(axis: int) -> tuple[int, int]:
    """The axes of a plane whose normal is `axis`: to the right and upwards."""
    return {0: (1, 2), 1: (0, 2), 2: (0, 1)}[axis]


def cut(outline: Outline, axis: int, value: float) -> BaseGeometry:
    """What the plane where coordinate `axis` is `value` [m] cuts out of an electrode: nothing, a line or an area."""
    whole = _hull_cut(outline.corners, axis, value)
    if outline.hole.shape[1] == 0 or whole.is_empty:
        return whole
    return whole.difference(_hull_cut(outline.hole, axis, value).buffer(TOUCHES))


def _hull_cut(corners: Floats, axis: int, value: float) -> BaseGeometry:
    """The plane's cut through the convex hull of `corners`, (3, p): that of all lines between two of them."""
    height = corners[axis] - value
    i, j = np.triu_indices(len(height), 1)
    crosses = height[i] * height[j] < 0.0
    i, j = i[crosses], j[crosses]
    share = height[i] / (height[i] - height[j])
    found = np.concatenate(
        [corners[:, i] + share * (corners[:, j] - corners[:, i]), corners[:, np.abs(height) < TOUCHES]], axis=1
    )
    return shapely.MultiPoint(found[list(across(axis))].T).convex_hull


def loops(shape: BaseGeometry) -> list[list[Floats]]:
    """The parts of a cut: a line alone, or an area's outer edge and those of its holes; (k, 2) each."""
    parts = [part for part in getattr(shape, "geoms", [shape]) if not part.is_empty]
    edges = [[part.exterior, *part.interiors] if part.geom_type == "Polygon" else [part] for part in parts]
    return [[shapely.get_coordinates(line) for line in lines] for lines in edges]


def chained(segments: Floats) -> list[Floats]:
    """Segments (k, 2, 2) joined to lines, (m, 2) each, so that dashes run on from one to the next."""
    if not len(segments):
        return []
    merged = shapely.line_merge(shapely.MultiLineString(list(np.round(segments, 9))))
    return [shapely.get_coordinates(line) for line in getattr(merged, "geoms", [merged])]


def surface_cut(position: Floats, faces: NDArray[np.int64], axis: int, value: float) -> Floats:
    """The segments in which a plane cuts a surface, (k, 2, 2): nodes `position` (3, n), triangles `faces` (3, f)."""
    corners = position[:, faces]
    height = corners[axis] - value
    above = height >= 0.0
    ends = []
    for face in np.flatnonzero(above.any(axis=0) & ~above.all(axis=0)):
        # The corner that is alone on its side of the plane, and the two others.
        alone = int(np.argmax(above[:, face] == (above[:, face].sum() == 1)))
        p, h = corners[:, alone, face], height[alone, face]
        for other in ((alone + 1) % 3, (alone + 2) % 3):
            q, g = corners[:, other, face], height[other, face]
            ends.append((p + h / (h - g) * (q - p))[list(across(axis))])
    return np.array(ends).reshape(-1, 2, 2)


def silhouette(position: Floats, faces: NDArray[np.int64], axis: int) -> Floats:
    """The segments that outline a closed surface seen along `axis`, (k, 2, 2): edges where it turns away."""
    a, b, c = (position[:, faces[k]] for k in range(3))
    seen = np.cross(b - a, c - a, axis=0)[axis] > 1e-9 * np.ptp(position[0]) ** 2
    edges = np.sort(np.concatenate([faces[[0, 1]], faces[[1, 2]], faces[[2, 0]]], axis=1), axis=0)
    unique, number = np.unique(edges, axis=1, return_inverse=True)
    count = np.zeros(unique.shape[1])
    np.add.at(count, number.ravel(), np.tile(seen, 3))
    rim = unique[:, count == 1]
    return position[list(across(axis))][:, rim].transpose(2, 1, 0)
