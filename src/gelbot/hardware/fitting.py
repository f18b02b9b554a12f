"""Which bend and pose of an umbrella has the silhouette that is seen: Gauss-Newton on the distances of two outlines.

Analysis by synthesis: the umbrella is drawn; points of its outline are points of its surface, and near an outline the
outline moves, across itself, as its points do. Distances are taken both ways, across the outline that is seen: from
each point that is seen to the nearest one drawn, and back. What a silhouette cannot tell is left to expectations:
how fast a gel moves, how much its arms differ, that it is its own mirror image where the camera cannot see otherwise,
and that it rests on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.hardware.calibration import Calibration
from gelbot.hardware.habits import Likely, rotation_by, turn_between
from gelbot.hardware.open_cv import cv2_of
from gelbot.hardware.segment import Silhouette, outward_normals
from gelbot.hardware.umbrella import ORDERS, Pose, Umbrella

Floats = NDArray[np.float64]

SAMPLES = 110
"""Points of each outline that are compared."""
EDGE_NOISE = 3.0
"""Standard deviation [px] given to a distance: neighbours are wrong together, and the umbrella is not the gel."""
OUTLIER = 4.0
"""Distance [px] from which on a point counts less and less."""
FLOOR_NOISE = 0.08e-3
"""How deep a point may stand in the floor, and how high the lowest above it [m]: a standard deviation."""
AGREEING = 0.2
"""Cosine of the angle between the normals of two points that may be the same."""


@dataclass(frozen=True)
class Expected:
    """What is expected of a body before it is seen; standard deviations.

    Over a second: `seen_turn`, `hidden_turn` [rad] about the line of sight and about the others; `seen_move`,
    `hidden_move` [m] across and along it; `bend` (3,) [rad] of the orders, `swing` [rad], `shrink`. At any time:
    `usual_bend`, `usual_swing`, `usual_shrink` about `mean_shrink`; how much the bends of the arms differ from their
    mean, `uneven` (3,), and from that of their mirror image, `lopsided` (3,).
    """

    seen_turn: float = 1.2
    hidden_turn: float = 0.05
    seen_move: float = 5e-3
    hidden_move: float = 0.03e-3
    bend: tuple[float, float, float] = (0.8, 0.8, 0.4)
    swing: float = 0.15
    shrink: float = 0.02
    usual_bend: tuple[float, float, float] = (3.0, 4.0, 1.5)
    usual_swing: float = 0.3
    usual_shrink: tuple[float, float] = (0.15, 0.06)
    mean_shrink: tuple[float, float] = (0.1, -0.05)
    uneven: tuple[float, float, float] = (1.5, 1.5, 1.0)
    lopsided: tuple[float, float, float] = (0.06, 0.06, 0.04)
    lopsided_swing: float = 0.03


class Drawn(NamedTuple):
    """The umbrella's outline: `edge` [px] (2, k), `outward` (2, k), the surface points it consists of as three
    `corners` (3, k) with `weights` (3, k), and the `mask` from pixel `corner` on."""

    edge: Floats
    outward: Floats
    corners: NDArray[np.int64]
    weights: Floats
    mask: NDArray[np.uint8]
    corner: tuple[int, int]


class Fit(NamedTuple):
    """The `pose` found; root mean square distance `misfit` [px] of the outlines, `overlap` (intersection over union) of
    the silhouettes, `covariance` of turn, move (axes of the picture) and numbers; what was `drawn` last; the
    `cost` of misfit and unlikelihood, without that of moving there."""

    pose: Pose
    misfit: float
    overlap: float
    covariance: Floats
    drawn: Drawn
    cost: float


def draw(sheet: Umbrella, calibration: Calibration, pose: Pose, body: Floats | None = None) -> Drawn | None:
    """The outline of the umbrella in the picture, or None where it is not in it.

    `body` [m] (3, n): its surface in its own frame, if that is known already.
    """
    cv2 = cv2_of("a camera")
    body = sheet.surface(pose.numbers, pose.rest) if body is None else body
    surface = pose.rotation @ body + pose.centre[:, None]
    pixels = calibration.project(surface)
    low, high = np.floor(pixels.min(axis=1)) - 4, np.ceil(pixels.max(axis=1)) + 5
    if not np.all(np.isfinite(pixels)) or max(high - low) > 4 * max(calibration.width, calibration.height):
        return None
    corner = (int(low[0]), int(low[1]))
    local = pixels - low[:, None]
    a, b, c = (local[:, sheet.triangles[k]] for k in range(3))
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    facing = np.flatnonzero(area < -1e-6)  # counter-clockwise from outside; pixels count downwards
    image = np.zeros((int(high[1] - low[1]), int(high[0] - low[0])), np.int32)
    shapes = np.round(local.T[sheet.triangles[:, facing].T] * 16.0).astype(np.int32)
    for k, shape in zip(facing.tolist(), shapes, strict=True):
        cv2.fillConvexPoly(image, shape, k + 1, shift=4)
    mask = (image > 0).astype(np.uint8)
    rims, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if tree is None:
        return None
    kept = [r[:, 0] for r, t in zip(rims, tree[0], strict=True) if t[3] < 0 or len(r) > 12]
    rim = np.concatenate(kept)
    rim = rim[:: max(1, len(rim) // SAMPLES)]
    triangle = image[rim[:, 1], rim[:, 0]] - 1
    on = triangle >= 0  # the rim of a hole lies outside
    rim, triangle = rim[on], triangle[on]
    point = rim.T.astype(float)
    weights = _weights(point, a[:, triangle], b[:, triangle], c[:, triangle], area[triangle])
    outward = outward_normals(mask, point.astype(np.float32))
    edge = np.einsum("ik,xik->xk", weights, local[:, sheet.triangles[:, triangle]]) + low[:, None]
    return Drawn(edge, outward, sheet.triangles[:, triangle], weights, mask, corner)


def _weights(point: Floats, a: Floats, b: Floats, c: Floats, area: Floats) -> Floats:
    """Shares (3, k) of the corners in `point` (2, k), or in a point of the triangle near it."""
    first = ((b[0] - point[0]) * (c[1] - point[1]) - (b[1] - point[1]) * (c[0] - point[0])) / area
    second = ((c[0] - point[0]) * (a[1] - point[1]) - (c[1] - point[1]) * (a[0] - point[0])) / area
    weights = np.clip(np.stack([first, second, 1.0 - first - second]), 0.0, 1.0)
    return weights / weights.sum(axis=0)


def fit(
    sheet: Umbrella,
    calibration: Calibration,
    seen: Silhouette,
    last: Pose,
    first: Pose,
    elapsed: float,
    expected: Expected,
    known: Likely | None = None,
    iterations: int = 4,
) -> Fit | None:
    """The pose whose silhouette is `seen`, `elapsed` [s] after the pose `last`, searched from `first` on.

    None where the umbrella leaves the picture.
    """
    step = max(1, seen.edge.shape[1] // SAMPLES)
    edge, outward = seen.edge[:, ::step], seen.outward[:, ::step]
    prior = _prior(sheet, calibration, last, elapsed, expected, known)
    first = first if known is None else first._replace(rest=known.rest)
    pose, moved = first, _between(calibration, last, first)
    information = np.eye(6 + sheet.number_count)
    for _ in range(iterations):
        body = sheet.surface(pose.numbers, pose.rest)
        drawn = draw(sheet, calibration, pose, body)
        if drawn is None:
            return None
        height = pose.rotation[2] @ body + pose.centre[2]
        standing = _standing(height)
        at, place = np.unique(np.append(drawn.corners.ravel(), standing), return_inverse=True)
        slopes = surface_slopes(sheet, calibration, pose, body, at)
        points = pose.rotation @ body[:, at] + pose.centre[:, None]
        pairs = _pairs(drawn, edge, outward)
        missed = _missed(pairs, drawn, edge, outward)
        of_edge = place[: drawn.corners.size].reshape(drawn.corners.shape)
        rows = _outline_rows(calibration, points, slopes, drawn.weights, of_edge, pairs, outward)
        scale = max(OUTLIER, 1.5 * float(np.median(np.abs(missed))))
        trust = 1.0 / (EDGE_NOISE * np.sqrt(1.0 + (missed / scale) ** 2))
        floor_rows = slopes[2, place[drawn.corners.size :]] / FLOOR_NOISE
        trusted = rows * trust[:, None]
        information = trusted.T @ trusted + floor_rows.T @ floor_rows
        force = trusted.T @ (trust * missed) - floor_rows.T @ (height[standing] / FLOOR_NOISE)
        prior_rows, prior_missed = prior.at(pose.numbers, moved)
        information += prior_rows.T @ prior_rows
        force += prior_rows.T @ prior_missed
        change = np.asarray(np.linalg.solve(information, force), np.float64)
        biggest = float(np.max(np.abs(change[:3])))
        if biggest > 0.4:
            change = change * (0.4 / biggest)
        pose, moved = _moved(calibration, pose, change), moved + change[:6]
        if np.max(np.abs(change[3:6])) < 4e-6 and biggest < 2e-3:
            break
    body = sheet.surface(pose.numbers, pose.rest)
    drawn = draw(sheet, calibration, pose, body)
    if drawn is None:
        return None
    missed = _missed(_pairs(drawn, edge, outward), drawn, edge, outward)
    misfit = float(np.sqrt(np.mean(missed**2)))
    scale = OUTLIER / EDGE_NOISE
    data = float(np.sum(scale**2 * np.log1p((missed / OUTLIER) ** 2)))
    _, unlikely = prior.at(pose.numbers, moved)
    height = pose.rotation[2] @ body + pose.centre[2]
    floor_missed = height[_standing(height)] / FLOOR_NOISE
    cost = data + float(np.sum(unlikely[len(moved) + len(pose.numbers) :] ** 2)) + float(np.sum(floor_missed**2))
    return Fit(pose, misfit, overlap(seen, drawn), np.asarray(np.linalg.inv(information), np.float64), drawn, cost)


def supposed(sheet: Umbrella, calibration: Calibration, seen: Silhouette, last: Pose, known: Likely) -> Pose | None:
    """The body as the examples have it, moved to where its silhouette is seen; None where it is out of the picture."""
    rotation = rotation_by(calibration.axes.T @ known.mean[:3]) @ last.rotation
    pose = Pose(known.mean[3:], rotation, last.centre, known.rest)
    drawn = draw(sheet, calibration, pose)
    if drawn is None:
        return None
    columns = np.flatnonzero(drawn.mask.any(axis=0)) + drawn.corner[0]
    rows = np.flatnonzero(drawn.mask.any(axis=1)) + drawn.corner[1]
    x0, _, x1, y1 = seen.box
    right, down = (x0 + x1 - 1 - columns[0] - columns[-1]) / 2.0, float(y1 - 1 - rows[-1])
    moved = (calibration.axes[0] * right - calibration.axes[1] * down) / calibration.scale
    return pose._replace(centre=pose.centre + moved)


def _between(calibration: Calibration, last: Pose, first: Pose) -> Floats:
    """Turn [rad] and move [m] (6,) from one pose to another, about the axes of the picture."""
    vector = turn_between(last.rotation, first.rotation)
    return np.concatenate([calibration.axes @ vector, calibration.axes @ (first.centre - last.centre)])


def _moved(calibration: Calibration, pose: Pose, change: Floats) -> Pose:
    turn = rotation_by(calibration.axes.T @ change[:3])
    u, _, v = np.linalg.svd(turn @ pose.rotation)
    return Pose(pose.numbers + change[6:], u @ v, pose.centre + calibration.axes.T @ change[3:6], pose.rest)


def surface_slopes(
    sheet: Umbrella, calibration: Calibration, pose: Pose, body: Floats, at: NDArray[np.int64]
) -> Floats:
    """Derivatives (3, q, 6 + d) of the places [m] of the points `at` (q,) of the surface `body` (3, n): by turn and
    move about the axes of the picture, and by the numbers."""
    arm = pose.rotation @ body[:, at]
    turn = np.cross(calibration.axes[:, :, None], arm[None], axisa=1, axisb=1, axisc=1)  # (axis, 3, q)
    move = np.broadcast_to(calibration.axes[:, :, None], turn.shape)
    slopes = sheet.slopes(pose.numbers, at)
    numbers = (pose.rotation @ slopes.reshape(3, -1)).reshape(slopes.shape)
    return np.concatenate([np.concatenate([turn, move]).transpose(1, 2, 0), numbers], axis=2)


def _pairs(drawn: Drawn, edge: Floats, outward: Floats) -> NDArray[np.int64]:
    """Which point seen belongs to which drawn, (2, r): to each of them the nearest of the others."""
    apart = np.sum(edge**2, axis=0)[:, None] - 2.0 * edge.T @ drawn.edge + np.sum(drawn.edge**2, axis=0)
    apart += 400.0 * (outward.T @ drawn.outward < AGREEING)
    seen, shown = np.arange(edge.shape[1]), np.arange(drawn.edge.shape[1])
    return np.stack([np.append(seen, np.argmin(apart, axis=0)), np.append(np.argmin(apart, axis=1), shown)])


def _missed(pairs: NDArray[np.int64], drawn: Drawn, edge: Floats, outward: Floats) -> Floats:
    """By how much [px] (r,) the drawn outline must move, across the one that is seen."""
    seen, shown = pairs
    return np.sum(outward[:, seen] * (edge[:, seen] - drawn.edge[:, shown]), axis=0)


def _outline_rows(
    calibration: Calibration,
    points: Floats,
    slopes: Floats,
    weights: Floats,
    corners: NDArray[np.int64],
    pairs: NDArray[np.int64],
    outward: Floats,
) -> Floats:
    """Derivatives (r, 6 + d) of the drawn outline's points across the outline that is seen."""
    seen, shown = pairs
    by_place = _picture_slopes(calibration, points)  # (2, 3, q)
    corner = corners[:, shown]  # (3, r)
    across = np.einsum("xr,xicr->icr", outward[:, seen], by_place[:, :, corner]) * weights[:, shown]
    return np.einsum("icr,icrd->rd", across, slopes[:, corner])


def _picture_slopes(calibration: Calibration, points: Floats) -> Floats:
    """Derivatives (2, 3, q) of the pixels of `points` by where they are."""
    step = 1e-6
    shifted = points[:, None, :] + step * np.eye(3)[:, :, None]
    flat = np.concatenate([points, shifted.reshape(3, -1)], axis=1)
    pixels = calibration.project(flat).reshape(2, 4, -1)
    return (pixels[:, 1:] - pixels[:, :1]) / step


def _standing(height: Floats) -> NDArray[np.int64]:
    """The points that are deepest in the floor, and the lowest one, which should be neither in it nor above it."""
    lowest = np.argpartition(height, 12)[:12]
    return np.unique(np.append(lowest[height[lowest] < 0.0], np.argmin(height)))


class _Prior(NamedTuple):
    """Rows (r, 6 + d) and, for turn, move and numbers z, the targets: rows z should be `aims` (r,)."""

    rows: Floats
    aims: Floats

    def at(self, numbers: Floats, moved: Floats) -> tuple[Floats, Floats]:
        return self.rows, self.aims - self.rows @ np.concatenate([moved, numbers])


def _prior(
    sheet: Umbrella, calibration: Calibration, last: Pose, elapsed: float, expected: Expected, known: Likely | None
) -> _Prior:
    a, d = sheet.tip_count, sheet.number_count
    # A random walk: twice the deviation after four times as long.
    grown = float(np.sqrt(np.clip(elapsed, 1e-3, 10.0)))
    e = expected
    walk = np.concatenate([
        [e.hidden_turn, e.hidden_turn, e.seen_turn, e.seen_move, e.seen_move, e.hidden_move],
        np.repeat(e.bend, a), np.full(a, e.swing), np.full(2, e.shrink),
    ]) * grown  # fmt: skip
    blocks = [np.eye(6 + d) / walk[:, None]]
    aims = [np.concatenate([np.zeros(6), last.numbers]) / walk]
    if known is None:
        usual = np.concatenate([np.repeat(e.usual_bend, a), np.full(a, e.usual_swing), e.usual_shrink])
        means = np.concatenate([np.zeros(d - 2), e.mean_shrink])
        even = np.eye(a) - 1.0 / a
        partner = _mirror(sheet, calibration, last)
        mirrored = np.eye(a) - np.eye(a)[partner]
        is_pair = partner != np.arange(a)
        anti = (np.eye(a) + np.eye(a)[partner]) * is_pair[:, None]
        blocks.append(np.eye(6 + d)[6:] / usual[:, None])
        aims.append(means / usual)
        for m in range(ORDERS):
            for matrix, deviation in ((even, e.uneven[m]), (mirrored, e.lopsided[m])):
                row = np.zeros((a, 6 + d))
                row[:, 6 + m * a : 6 + (m + 1) * a] = matrix / deviation
                blocks.append(row)
                aims.append(np.zeros(a))
        row = np.zeros((a, 6 + d))
        row[:, 6 + ORDERS * a : 6 + (ORDERS + 1) * a] = anti / e.lopsided_swing
        blocks.append(row)
        aims.append(np.zeros(a))
    else:
        whitening = np.asarray(np.linalg.inv(np.linalg.cholesky(known.covariance)), np.float64)
        blocks.append(np.concatenate([whitening[:, :3], np.zeros((3 + d, 3)), whitening[:, 3:]], axis=1))
        aims.append(whitening @ known.mean)
    return _Prior(np.concatenate(blocks), np.concatenate(aims))


def _mirror(sheet: Umbrella, calibration: Calibration, pose: Pose) -> NDArray[np.int64]:
    """Which arm (a,) each one is taken for in the mirror that the camera looks at square on; itself if none is."""
    # The mirror stands upright, however high the camera does.
    level = calibration.axes[2] * np.array([1.0, 1.0, 0.0])
    sight = pose.rotation.T @ level
    towards = float(np.arctan2(sight[1], sight[0]))
    images = 2.0 * towards + np.pi - sheet.azimuths
    away = np.abs((images[:, None] - sheet.azimuths + np.pi) % (2.0 * np.pi) - np.pi)
    partner = np.argmin(away, axis=1)
    near = away[np.arange(len(partner)), partner] < 0.5
    is_pair = near & (partner[partner] == np.arange(len(partner))) & (np.hypot(sight[0], sight[1]) > 0.5)
    return np.where(is_pair, partner, np.arange(len(partner)))


def overlap(seen: Silhouette, drawn: Drawn) -> float:
    """Intersection over union of two silhouettes."""
    height, width = drawn.mask.shape
    x, y = drawn.corner[0] - seen.corner[0], drawn.corner[1] - seen.corner[1]
    x0, y0 = max(0, x), max(0, y)
    x1, y1 = min(seen.mask.shape[1], x + width), min(seen.mask.shape[0], y + height)
    both = 0
    if x1 > x0 and y1 > y0:
        both = int(np.count_nonzero(seen.mask[y0:y1, x0:x1] & drawn.mask[y0 - y : y1 - y, x0 - x : x1 - x]))
    return both / max(1.0, seen.area + float(np.count_nonzero(drawn.mask)) - both)
