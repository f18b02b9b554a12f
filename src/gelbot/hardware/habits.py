"""How a body usually looks: examples, from which is taken what a silhouette leaves open.

Examples are poses of an umbrella, laid through node positions of simulated runs by Gauss-Newton. Those whose silhouette
resembles the one that is seen give a mean and a covariance of how the body is turned and bent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.hardware.open_cv import cv2_of
from gelbot.hardware.umbrella import ORDERS, Pose, Umbrella

Floats = NDArray[np.float64]

CELLS, CELL = (52, 30), 0.4e-3
"""Silhouettes are compared as pictures of so many cells (across, upwards) of this size [m]."""
FEW = 16
"""So many examples, the most similar ones, are looked at closely."""
LEAST_TURN = (0.06, 0.06, 0.1)
"""What a real body may differ from the examples in its turn about the axes of the picture [rad]."""
LEAST_SPREAD = (0.25, 0.35, 0.25)
"""What a real body may differ from the examples in its bends [rad], by their order: a standard deviation."""
LEAST_SWING, LEAST_SHRINK = 0.08, 0.02
LIKE_ITS_IMAGE = 0.08
"""How far a point of a mesh may lie from the mirror image of another, as a share of the reach."""
ITERATIONS = 8
DAMPING = 0.03
"""Weight of a change of the numbers against a millimetre of a node: keeps what the nodes do not tell near the last."""


class Habits(NamedTuple):
    """Examples: `numbers` (d, s), `rotation` (3, 3, s), `centre` [m] (3, s), `rest` [m] (3, n + marks, s)."""

    numbers: Floats
    rotation: Floats
    centre: Floats
    rest: Floats

    def pose(self, k: int) -> Pose:
        """Example `k`."""
        return Pose(self.numbers[:, k], self.rotation[:, :, k], self.centre[:, k], self.rest[:, :, k])


def rotation_by(turn: Floats) -> Floats:
    """The matrix (3, 3) that turns by the vector `turn` [rad] (3,), Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.eye(3) + skew
    return np.eye(3) + np.sin(angle) / angle * skew + (1.0 - np.cos(angle)) / angle**2 * skew @ skew


def habits_of(sheet: Umbrella, positions: Floats, start: Pose) -> Habits:
    """Examples from a run: `positions` [m] (t, 3, n) of the points of the sheet's mesh, first near the pose `start`."""
    to_marks = _interpolation(sheet)
    poses, pose = [], start
    for moment in positions:
        pose = laid_through(sheet, moment, pose._replace(rest=sheet.no_rest))
        surface = pose.rotation.T @ (moment - pose.centre[:, None])
        middle = np.stack([np.bincount(sheet.foot, v, sheet.mid_count) for v in surface]) / np.bincount(sheet.foot)
        pose = pose._replace(rest=np.concatenate([
            surface - sheet.surface(pose.numbers, pose.rest),
            middle @ to_marks.T - sheet.marks(pose.numbers, pose.rest),
        ], axis=1))  # fmt: skip
        poses.append(pose)
    return Habits(*(np.stack(values, axis=-1) for values in zip(*poses, strict=True)))


def _interpolation(sheet: Umbrella) -> Floats:
    """Weights (marks, mid) of the points that carry the surface, linear in the triangles between them."""
    from scipy.spatial import Delaunay

    feet, marks = sheet.flat[:, : sheet.mid_count].T, sheet.flat[:, sheet.mid_count :].T
    inside = marks * (1.0 - 1e-9)
    found = Delaunay(feet)
    triangle = found.find_simplex(inside, tol=1e-6)
    weights = np.zeros((len(marks), len(feet)))
    for k, (t, point) in enumerate(zip(triangle, inside, strict=True)):
        if t < 0:
            weights[k, np.argmin(np.linalg.norm(feet - point, axis=1))] = 1.0
            continue
        two = found.transform[t, :2] @ (point - found.transform[t, 2])
        weights[k, found.simplices[t]] = [*two, 1.0 - two.sum()]
    return weights


def together(*habits: Habits) -> Habits:
    """The examples of several runs."""
    return Habits(*(np.concatenate(values, axis=-1) for values in zip(*habits, strict=True)))


def mirrored(sheet: Umbrella, habits: Habits, towards: Floats) -> Habits:
    """The mirror images of the examples in the upright plane across the line of sight `towards` (3,), where they are.

    A body has the same silhouette as its mirror image, and is as likely to lean towards the camera as away from it. A
    sheet whose outline is not its own mirror image about an arm has no such images: they are none then.
    """
    level = towards * np.array([1.0, 1.0, 0.0])
    level = level / max(float(np.linalg.norm(level)), 1e-12)
    across = np.eye(3) - 2.0 * np.outer(level, level)
    swaps = [swap for swap in (_swap(sheet, azimuth) for azimuth in sheet.azimuths) if swap is not None]
    images = []
    for k in range(habits.numbers.shape[1] if swaps else 0):
        pose, a = habits.pose(k), sheet.tip_count
        rotations = [across @ pose.rotation @ swap.flip for swap in swaps]
        best = int(np.argmax([np.sum(rotation * pose.rotation) for rotation in rotations]))
        flip, arms, points = swaps[best]
        numbers = pose.numbers.copy()
        numbers[: (ORDERS + 1) * a] = numbers[: (ORDERS + 1) * a].reshape(-1, a)[:, arms].ravel()
        numbers[ORDERS * a : (ORDERS + 1) * a] *= -1.0
        images.append(Pose(numbers, rotations[best], pose.centre, flip @ pose.rest[:, points]))
    if not images:
        return Habits(*(values[..., :0] for values in habits))
    return Habits(*(np.stack(values, axis=-1) for values in zip(*images, strict=True)))


class _Swap(NamedTuple):
    """How a flat sheet is its own mirror image: the reflection `flip` (3, 3), and for each arm and for each point of
    surface and marks the one that is in its place then, `arms` (a,), `points` (n + marks,)."""

    flip: Floats
    arms: NDArray[np.int64]
    points: NDArray[np.int64]


def _swap(sheet: Umbrella, azimuth: float) -> _Swap | None:
    from scipy.spatial import KDTree

    c, s = np.cos(2.0 * azimuth), np.sin(2.0 * azimuth)
    flip = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]])
    away = (2.0 * azimuth - sheet.azimuths[:, None] - sheet.azimuths + np.pi) % (2.0 * np.pi) - np.pi
    surface, marks = sheet.flat[:, sheet.foot], sheet.flat[:, sheet.mid_count :]
    # Upper side, lower side and marks are kept apart by a height of their own.
    height = np.concatenate([np.sign(sheet.side), np.zeros(sheet.mark_count)]) * sheet.reach
    where = np.concatenate([np.concatenate([surface, marks], axis=1), height[None]])
    apart, points = KDTree(where.T).query((flip @ where).T)
    if np.abs(away).min(axis=1).max() > 0.02 or apart.max() > LIKE_ITS_IMAGE * sheet.reach:
        return None
    return _Swap(flip, np.argmin(np.abs(away), axis=1), np.asarray(points))


def laid_through(sheet: Umbrella, positions: Floats, start: Pose) -> Pose:
    """The pose that brings the points of the surface nearest to `positions` [m] (3, n)."""
    pose, n = start, len(sheet.side)
    for _ in range(ITERATIONS):
        body = sheet.surface(pose.numbers, pose.rest)
        arm = pose.rotation @ body
        turn = np.cross(np.eye(3)[:, :, None], arm[None], axisa=1, axisb=1, axisc=1)
        move = np.broadcast_to(np.eye(3)[:, :, None], turn.shape)
        numbers = np.einsum("ij,jqd->iqd", pose.rotation, sheet.slopes(pose.numbers, np.arange(n)))
        rows = np.concatenate([np.concatenate([turn, move]).transpose(1, 2, 0), numbers], axis=2).reshape(3 * n, -1)
        missed = (positions - arm - pose.centre[:, None]).ravel()
        weight = np.concatenate([np.full(6, 1e-9), np.full(sheet.number_count, (DAMPING * 1e-3) ** 2 * n)])
        pull = np.concatenate([np.zeros(6), weight[6:] * (start.numbers - pose.numbers)])
        change = np.asarray(np.linalg.solve(rows.T @ rows + np.diag(weight), rows.T @ missed + pull), np.float64)
        turned = rotation_by(change[:3]) @ pose.rotation
        pose = Pose(pose.numbers + change[6:], turned, pose.centre + change[3:6], pose.rest)
        if np.max(np.abs(change)) < 1e-4:
            break
    return pose


def turn_between(one: Floats, other: Floats) -> Floats:
    """The vector [rad] (3,) about which `one` (3, 3) must be turned to become `other`."""
    turn = other @ one.T
    twist = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    angle = float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    return twist * (angle / np.sin(angle)) if 1e-9 < angle < np.pi - 1e-6 else twist


def cells_of(mask: NDArray[np.uint8], pixels_per_metre: float) -> NDArray[np.float32]:
    """How much of each cell a silhouette covers, (cells,): about its middle column, upwards from its lowest row."""
    cv2 = cv2_of("a camera")
    across, up = (round(n * CELL * pixels_per_metre) for n in CELLS)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    window = np.zeros((up, across), np.float32)
    if rows.size:
        sums = mask.sum(axis=0)
        left = round(float(sums @ np.arange(len(sums))) / float(sums.sum())) - across // 2
        top = int(rows[-1]) + 1 - up
        x0, x1 = max(left, int(columns[0])), min(left + across, int(columns[-1]) + 1)
        y0, y1 = max(top, int(rows[0])), int(rows[-1]) + 1
        if x1 > x0:
            window[y0 - top : y1 - top, x0 - left : x1 - left] = mask[y0:y1, x0:x1]
    return cv2.resize(window, CELLS, interpolation=cv2.INTER_AREA).ravel()


class Likely(NamedTuple):
    """What the examples say: `mean` (3 + d,) and `covariance` of turn [rad] from the last pose about the axes of the
    picture and of the numbers; the mean `rest` [m]."""

    mean: Floats
    covariance: Floats
    rest: Floats


def differing(cells: NDArray[np.float32], seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """Areas [m^2] (s,) by which silhouettes with `cells` (s, c) differ from the one that is `seen` (c,)."""
    # The squares of the examples alone are the same for each picture, but cheap.
    return (np.einsum("sc,sc->s", cells, cells) - 2.0 * (cells @ seen) + seen @ seen) * CELL**2


def likely_of(habits: Habits, weight: NDArray[np.float32], last: Pose, axes: Floats) -> Likely:
    """What the examples say of a body, each with its `weight` (s,), that was at the pose `last`. `axes` (3, 3) of the
    picture, one a row."""
    few = np.argpartition(-weight, min(FEW, len(weight) - 1))[:FEW]
    share = np.asarray(weight[few], np.float64) / float(weight[few].sum())
    turns = np.stack([axes @ turn_between(last.rotation, habits.rotation[:, :, k]) for k in few], axis=1)
    values = np.concatenate([turns, habits.numbers[:, few]])
    mean = values @ share
    away = values - mean[:, None]
    arms = (len(mean) - 5) // (ORDERS + 1)
    least = np.concatenate([
        LEAST_TURN, np.repeat(LEAST_SPREAD, arms), np.full(arms, LEAST_SWING), np.full(2, LEAST_SHRINK)
    ])  # fmt: skip
    return Likely(mean, (away * share) @ away.T + np.diag(least**2), habits.rest[:, :, few] @ share)
