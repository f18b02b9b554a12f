"""Potential directions of locomotion, from the symmetry of a shape alone (Section IV-C).

The paper's argument, for a pentagram: the centre moves along a mirror line, because nothing that is symmetric about the
line pushes it off. The body slides on three tips, the fewest that carry a body in a plane: tip 1, which lies on the
line, and tips 2 and 3, which face it across the centre. The centre can move above tip 1, or above tips 2 and 3: two
directions for each mirror line, ten in all.

For any shape this becomes: the tips span a polygon, their convex hull; the body rests on it, and to turn over its
centre has to leave it.

- *Directions.* Both ways along each mirror line. A shape without mirrors has no way that symmetry keeps straight, but
  its centre can still move above a tip: one direction for each corner of the polygon. Rotations carry them into each
  other; in a shape without any symmetry each stands alone.
- *Over what.* Through a corner of the polygon the centre leaves over one tip, through a side over two tips, the side's
  ends. A tip inside the polygon, that of a short arm, carries nothing.
- *Supports.* What the centre moves over, and what faces that across the centre: what a motion the other way would move
  over. A tip that faces a tip would leave the body on a line: there the two tips beside it are taken, so that three
  carry the body (a cross along an arm: tip 1 and, beside the centre, 2 and 4). A side that faces a side gives four
  supports (a cross between its arms), since no three of them are symmetric about the line. A body with two tips has no
  others: the ends of a strip, each an edge with two corners.
- *Stable.* The supports carry the body if the centre, once it has begun to move, lies inside what the supports' corners
  span. That of a strip is as wide as its ends; two points carry nothing, and the direction is marked so.

An n-armed star so has 2 n directions, n over one tip and n over two; a rectangle four; a strip four, over its ends and
over its long sides. A round body has no tips and all directions: it is refused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from gelbot.body.outline import Outline
from gelbot.body.symmetry import SymmetryGroup, miss, out_of_round, rotation
from gelbot.body.tips import LEAST, Tips, symmetrised, tips_of
from gelbot.errors import BadInput

Floats = NDArray[np.float64]

ROUND = 0.01
"""An outline whose distance from its centroid varies by less than this share of its reach is round."""
JOINED = (3.0, 0.2)
"""Images of a tip are one if they are no further apart than so many times what the outline misses by, and at most this
share of its reach."""
BEGUN, CLEAR = 0.02, 1e-3
"""Shares of the reach: how far the centre has gone once it moves, and how far inside its supports it has to be then."""


class Direction(NamedTuple):
    """A direction of locomotion; tips are numbered from 0.

    `angle` [rad] in the body's frame, in [0, 2 pi). `over`: the one or two tips above which the centre moves,
    `supports`: all tips on which the body slides. `axis` [rad]: the mirror line, or None where no mirror keeps the
    centre on its way. `travel` [m]: from the centre of the flat body to where it leaves its supports. `stable`: whether
    the supports carry the body.
    """

    angle: float
    over: tuple[int, ...]
    supports: tuple[int, ...]
    axis: float | None
    travel: float
    stable: bool


def check_has_directions(outline: Outline) -> None:
    """Raise `BadInput` for a round outline: to it all directions are alike."""
    out = out_of_round(outline)
    if out < ROUND:
        allowed = f"a shape with tips: one that is out of round by {ROUND:.0%} of its reach at least"
        raise BadInput("outline", f"an outline that is round to {out:.2%}", allowed)


def find_tips(outline: Outline, group: SymmetryGroup, least: float = LEAST) -> Tips:
    """The tips of `outline`, made exactly symmetric under `group`, counter-clockwise from its +x.

    What reaches out by less than the outline misses its images by, or by less than the share `least` of its reach, is
    no tip.
    """
    missed = largest_miss(outline, group)
    slack = min(JOINED[0] * missed, JOINED[1]) * outline.reach
    return symmetrised(tips_of(outline, max(missed, least)), group, slack)


def largest_miss(outline: Outline, group: SymmetryGroup) -> float:
    """How far `outline` and its images under `group` are apart at most, as a share of its reach."""
    return max(miss(outline, matrix) for matrix in group.operations())


def directions(tips: Tips, group: SymmetryGroup) -> list[Direction]:
    """The potential directions of a body with these `tips`, which `group` carries into each other, in order of angle.

    See the module for the rule.
    """
    points, reach = tips.points, float(np.linalg.norm(tips.points, axis=1).max())
    hull = _hull(points)
    if group.mirror_angle is None:
        ways = [(float(np.arctan2(points[i, 1], points[i, 0])), None) for i in hull]
    else:
        ways = [(angle + turn, angle) for angle in map(float, group.mirror_angles) for turn in (0.0, np.pi)]
    found = []
    for angle, axis in ways:
        over = _left_through(points, hull, angle, reach)
        if not over:
            continue  # no tip lies that way
        supports = tuple(sorted({*over, *_facing(points, hull, angle, over, reach)}))
        travel, stable = _carried(tips, supports, angle, reach)
        found.append(Direction(_whole_turn(angle), over, supports, axis, travel, stable))
    return sorted(found, key=lambda one: one.angle)


def _whole_turn(angle: float) -> float:
    """The angle [rad] in [0, 2 pi); one just below is 0 seen through rounding."""
    angle %= 2.0 * np.pi
    return 0.0 if 2.0 * np.pi - angle < 1e-9 else angle


def _hull(points: Floats) -> list[int]:
    """Numbers of the points that are corners of their convex hull, counter-clockwise; the two ends of a line."""
    if len(points) < 3:
        return list(range(len(points)))
    try:
        return [int(i) for i in ConvexHull(points).vertices]
    except QhullError:  # all on one line
        along = points @ (points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0])
        return [int(np.argmin(along)), int(np.argmax(along))]


def _left_through(points: Floats, hull: list[int], angle: float, reach: float) -> tuple[int, ...]:
    """The corner or the two ends of the side through which a point that moves from the origin along `angle` leaves.

    Nothing where the hull lies behind.
    """
    ahead, aside = rotation(-angle) @ points.T
    slack = LEAST * reach
    corners = [i for i in hull if abs(aside[i]) < slack and ahead[i] > slack]
    if corners:
        return (max(corners, key=lambda i: float(ahead[i])),)
    for i, j in zip(hull, [*hull[1:], *hull[:1]], strict=True):
        if aside[i] < -slack and aside[j] > slack:
            share = -aside[i] / (aside[j] - aside[i])
            if ahead[i] + share * (ahead[j] - ahead[i]) > -slack:
                return tuple(sorted((i, j)))
    return ()


def _facing(points: Floats, hull: list[int], angle: float, over: tuple[int, ...], reach: float) -> tuple[int, ...]:
    """The tips that face those the centre moves `over`, across the centre."""
    back = _left_through(points, hull, angle + np.pi, reach)
    if len(over) == 1 and len(back) == 1:
        k = hull.index(back[0])
        beside = {hull[k - 1], hull[(k + 1) % len(hull)]} - {*over, *back}
        return tuple(beside) or back
    return back


def _carried(tips: Tips, supports: tuple[int, ...], angle: float, reach: float) -> tuple[float, bool]:
    """How far the centre can go [m] before it leaves the corners of the supports, and whether they carry the body."""
    points, widths = tips.points[list(supports)], tips.widths[list(supports)]
    radius = np.linalg.norm(points, axis=1)
    across = np.column_stack([-points[:, 1], points[:, 0]]) / np.maximum(radius, LEAST * reach)[:, None]
    half = 0.5 * widths[:, None] * across
    base = shapely.MultiPoint(np.concatenate([points + half, points - half])).convex_hull
    way = np.array([np.cos(angle), np.sin(angle)])
    begun = shapely.Point(BEGUN * reach * way)
    stable = base.contains(begun) and base.boundary.distance(begun) > CLEAR * reach
    # A ray that only touches a line or a corner misses it by rounding.
    path = shapely.LineString([-LEAST * reach * way, 4.0 * reach * way]).intersection(base.buffer(LEAST * reach))
    travel = 0.0 if path.is_empty else float((shapely.get_coordinates(path) @ way).max())
    return travel, bool(stable)
