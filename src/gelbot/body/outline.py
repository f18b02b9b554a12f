"""Outlines: simple closed polygons in the plane, counter-clockwise, centred on their centroid."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from gelbot.errors import BadInput

MM_PER_INCH = 25.4
"""Pixels of an inch with which a drawing is read: then one of them is a millimetre."""
CHORDS = 200
"""Pieces of a curve as long as a drawing is wide."""


@dataclass(frozen=True)
class Outline:
    """A simple closed polygon.

    `points` [m], shape (p, 2): counter-clockwise, the last point is not repeated, the centroid lies at the origin.
    """

    points: NDArray[np.float64]

    @property
    def polygon(self) -> shapely.Polygon:
        return shapely.Polygon(self.points)

    @property
    def area(self) -> float:
        """Enclosed area [m^2]."""
        return float(self.polygon.area)

    @property
    def reach(self) -> float:
        """Largest distance of the outline from its centroid [m]."""
        return float(np.max(np.linalg.norm(self.points, axis=1)))


def outline_from_points(points: ArrayLike, where: str = "outline") -> Outline:
    """Check a list of points [m], shape (p, 2), and make an `Outline` of it.

    Raises `BadInput` when there are fewer than three points, a value is not finite, or the polygon crosses itself.
    """
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != 2 or len(array) < 3:
        raise BadInput(where, f"an array of shape {array.shape}", "a list of at least three [x, y] points")
    if not np.all(np.isfinite(array)):
        raise BadInput(where, "a coordinate that is not finite", "finite numbers")
    if np.array_equal(array[0], array[-1]):
        array = array[:-1]
    polygon = shapely.Polygon(array)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        raise BadInput(where, reason, "a simple closed outline that does not cross itself", "reorder the points")
    if polygon.area <= 0.0:
        raise BadInput(where, "a polygon without area", "a simple closed outline with a positive area")
    if not polygon.exterior.is_ccw:
        array = array[::-1]
    centroid = np.array([polygon.centroid.x, polygon.centroid.y])
    return Outline(array - centroid)


def starfish(
    width: float, arm_length: float, root_width: float | None, tip_width: float, arms: int = 5, where: str = "body"
) -> Outline:
    """The star of Fig. 3, arm 1 along +x.

    `width` [m] is the overall width: the distance between the two tips (middles of their ends) that lie furthest
    apart. `arm_length` [m] runs along an arm's axis from the
    chord of its root to its tip; `root_width` and `tip_width` [m] are the arm's width there. Neighbouring roots either
    meet (`root_width` None, or within 1 % of that width) or are joined by a straight edge. Raises `BadInput` when the
    roots would overlap.
    """
    if arms < 3 or min(width, arm_length) <= 0.0 or tip_width < 0.0:
        given = f"arms {arms}, width {width} m, arm_length {arm_length} m, tip_width {tip_width} m"
        raise BadInput(where, given, "three arms or more, and positive sizes")
    half = float(np.pi / arms)
    # The widest pair of tips of an odd star is not opposite: it misses the straight angle by half a sector.
    tip_axis = width / 2.0 if arms % 2 == 0 else width / (2.0 * float(np.cos(half / 2.0)))
    root_axis = tip_axis - arm_length
    if root_axis <= 0.0:
        raise BadInput(f"{where}.arm_length", f"{arm_length * 1e3:.4g} mm", f"less than {tip_axis * 1e3:.4g} mm")
    widest = 2.0 * root_axis * float(np.tan(half))
    root_width = widest if root_width is None else root_width
    if root_width > widest * 1.01:
        raise BadInput(
            f"{where}.root_width",
            f"{root_width * 1e3:.4g} mm",
            f"at most {widest * 1e3:.4g} mm, where neighbouring arms meet, for this width and arm_length",
            "a shorter arm_length or a larger width",
        )
    if tip_width > root_width:
        raise BadInput(f"{where}.tip_width", f"{tip_width * 1e3:.4g} mm", "at most root_width")
    # A shoulder of a few micrometres between two roots would only spoil the mesh.
    roots_meet = root_width > widest * 0.99
    root_width = widest if roots_meet else root_width
    corners = []
    for k in range(arms):
        turn = 2.0 * half * k
        along = np.array([np.cos(turn), np.sin(turn)])
        across = np.array([-np.sin(turn), np.cos(turn)])
        corners.append(root_axis * along - root_width / 2.0 * across)
        if tip_width > 1e-9:
            corners.append(tip_axis * along - tip_width / 2.0 * across)
            corners.append(tip_axis * along + tip_width / 2.0 * across)
        else:
            corners.append(tip_axis * along)
        if not roots_meet:
            corners.append(root_axis * along + root_width / 2.0 * across)
    return outline_from_points(corners, where)


def strip(length: float, width: float) -> Outline:
    """A rectangle, its length [m] along x and its width [m] along y."""
    a, b = length / 2.0, width / 2.0
    return Outline(np.array([[-a, -b], [a, -b], [a, b], [-a, b]]))


def outline_from_svg(path: Path, width: float | None, chord: float | None, where: str = "body.svg") -> Outline:
    """The longest closed path of an SVG file, scaled so that its extent in x is `width` [m].

    Without a `width` it has the drawing's own size: as its `width` in mm, cm or in says, or else 1 mm for each of its
    units. Curves are divided into pieces of about `chord` [m], or of a 200th of the width. The y axis is turned
    upwards. Raises `BadInput` when the file has no closed path.
    """
    from svgelements import SVG, Close, Line, Move, Shape
    from svgelements import Path as SvgPath

    try:
        elements = list(SVG.parse(str(path), ppi=MM_PER_INCH).elements())
    except Exception as error:  # svgelements raises whatever its XML parser raises
        raise BadInput(where, str(path), f"a readable SVG file ({error})") from error
    paths = [abs(SvgPath(e)) for e in elements if isinstance(e, Shape)]  # abs: with turns and scales carried out
    closed = [p for p in paths if any(isinstance(s, Close) for s in p)]
    if not closed:
        raise BadInput(where, str(path), "an SVG file with at least one closed path", "end the path with Z")
    longest = max(closed, key=lambda p: p.length(error=1e-3))
    box = longest.bbox()
    if box is None or not box[2] > box[0]:
        raise BadInput(where, str(path), "an SVG file with a closed path that has a width")
    scale = 1e-3 if width is None else width / (box[2] - box[0])
    chord = scale * (box[2] - box[0]) / CHORDS if chord is None else chord
    points: list[tuple[float, float]] = []
    for segment in longest:
        if isinstance(segment, Move):
            if points:
                break  # a second sub-path is a hole or another body: the first one is the outline
            points.append((segment.end.x, segment.end.y))
        elif isinstance(segment, Line | Close):
            points.append((segment.end.x, segment.end.y))
        else:
            count = max(2, int(np.ceil(segment.length(error=1e-3) * scale / chord)))
            points += [(q.x, q.y) for q in (segment.point(k / count) for k in range(1, count + 1))]
    array = np.array(points) * [scale, -scale]
    keep = np.linalg.norm(array - np.roll(array, 1, axis=0), axis=1) > 1e-9
    return outline_from_points(array[keep], where)
