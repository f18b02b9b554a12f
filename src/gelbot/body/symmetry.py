"""The symmetry group of an outline: the rotations and reflections about its centroid that carry it into itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from gelbot.body.outline import Outline

MOST_ROTATIONS = 48
"""More rotations than this are not looked for."""
SAMPLES = 720
"""Points along an outline where it is compared with its image, beside its corners."""
SCAN = 180
"""Directions in a half turn that are tried for mirror lines, before the best are refined."""
ALIKE, WITH_CARE = 3.0, 0.01
"""Mirror images may miss by so many times as much as turned ones, or by this share of the reach, if that is more."""
DENSE = 4
"""So many times as many points are looked among for the one nearest to a point's image."""
NOTICED = 0.25
"""What is symmetric to within this part of its own corners and notches has more than the symmetry of a circle."""


@dataclass(frozen=True)
class SymmetryGroup:
    """A cyclic group (no mirrors) or a dihedral group (as many mirrors as rotations).

    `rotation_count`: rotations, the identity included. `mirror_angle` [rad]: the direction of one mirror line, or None.
    """

    rotation_count: int
    mirror_angle: float | None

    @property
    def order(self) -> int:
        return self.rotation_count * (1 if self.mirror_angle is None else 2)

    @property
    def mirror_angles(self) -> NDArray[np.float64]:
        """Directions of all mirror lines [rad], in [0, pi)."""
        if self.mirror_angle is None:
            return np.zeros(0)
        return np.sort((self.mirror_angle + np.arange(self.rotation_count) * np.pi / self.rotation_count) % np.pi)

    def operations(self) -> NDArray[np.float64]:
        """All operations as matrices, shape (order, 2, 2): the rotations first, the identity at index 0."""
        angles = 2.0 * np.pi * np.arange(self.rotation_count) / self.rotation_count
        matrices = [rotation(a) for a in angles]
        if self.mirror_angle is not None:
            matrices += [rotation(a) @ reflection(self.mirror_angle) for a in angles]
        return np.array(matrices)


def rotation(angle: float) -> NDArray[np.float64]:
    """Rotation by `angle` [rad] about the origin, shape (2, 2)."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def reflection(angle: float) -> NDArray[np.float64]:
    """Reflection in the line through the origin with direction `angle` [rad], shape (2, 2)."""
    return np.array([[np.cos(2 * angle), np.sin(2 * angle)], [np.sin(2 * angle), -np.cos(2 * angle)]])


def symmetry_group(outline: Outline, tolerance: float = 1e-6) -> SymmetryGroup:
    """Find the symmetry group of `outline`; points may miss their image by `tolerance` times the outline's reach.

    The corners of a polygon are carried into corners, so it is enough to try the operations that carry one chosen
    corner into any other.
    """
    points = _corners(outline)
    radii = np.linalg.norm(points, axis=1)
    angles = np.arctan2(points[:, 1], points[:, 0])
    slack = tolerance * outline.reach

    def carries(matrix: NDArray[np.float64]) -> bool:
        image = points @ matrix.T
        there, back = cKDTree(points).query(image)[0], cKDTree(image).query(points)[0]
        return bool(there.max() < slack and back.max() < slack)

    first = int(np.argmax(radii))
    targets = np.flatnonzero(np.abs(radii - radii[first]) < slack)
    rotations = sum(carries(rotation(float(angles[t] - angles[first]))) for t in targets)
    mirrors = [
        float((angles[t] + angles[first]) / 2.0 % np.pi)
        for t in targets
        if carries(reflection(float((angles[t] + angles[first]) / 2.0)))
    ]
    return SymmetryGroup(rotations, _lowest(mirrors))


def group_of(turns: Sequence[float], mirrors: Sequence[float]) -> SymmetryGroup:
    """The group that has rotations by `turns` and reflections in lines of the directions `mirrors` [rad], all of them.

    Each may be named more than once.
    """
    count = len({round(turn / (2.0 * np.pi) * 1e6) % 1_000_000 for turn in turns})
    return SymmetryGroup(max(count, 1), _lowest([mirror % np.pi for mirror in mirrors]))


def _lowest(mirrors: list[float]) -> float | None:
    """The first of the directions in [0, pi); one just below pi is the line at 0 seen through rounding."""
    return min((0.0 if np.pi - mirror < 1e-9 else mirror for mirror in mirrors), default=None)


def symmetry_within(outline: Outline, tolerance: float) -> SymmetryGroup:
    """The largest group whose operations carry `outline` into itself but for `tolerance` times its reach.

    For what was drawn by hand: not corners are compared but the curves, see `miss`. No operation may miss by more than
    a `NOTICED` part of what the outline is from round, or an octagon would have the symmetry of a circle; and no mirror
    image by much more than the rotations, or a pinwheel that was drawn with care would have mirrors. Mirror lines lie
    where the outline misses its image by least; one that is exact is taken as it is.
    """
    slack = max(min(tolerance, NOTICED * out_of_round(outline)), 1e-6)
    exact = symmetry_group(outline)

    def turns(count: int) -> Iterator[float]:
        # The other half of the rotations are inverses of these, and miss by as much.
        return (miss(outline, rotation(2.0 * np.pi * k / count)) for k in range(1, count // 2 + 1))

    most = max(MOST_ROTATIONS, exact.rotation_count)
    count = next(n for n in range(most, 0, -1) if all(missed <= slack for missed in turns(n)))
    if count > 1:
        slack = min(slack, max(ALIKE * max(turns(count)), WITH_CARE))
    mirror = _best_mirror(outline, count) if exact.mirror_angle is None else exact.mirror_angle
    group = SymmetryGroup(count, mirror % (np.pi / count))
    mirrored = all(miss(outline, reflection(float(angle))) <= slack for angle in group.mirror_angles)
    return group if mirrored else SymmetryGroup(count, None)


def out_of_round(outline: Outline) -> float:
    """How much less the outline's least distance from its centroid is than its reach, as a share of the reach."""
    return 1.0 - float(outline.polygon.exterior.distance(shapely.Point(0.0, 0.0))) / outline.reach


def _best_mirror(outline: Outline, count: int) -> float:
    """The direction [rad] of a mirror line, in [0, pi/count), that misses by least with its `count` - 1 fellows."""
    samples, period = _samples(outline), np.pi / count
    tree = cKDTree(_samples(outline, DENSE * SAMPLES))
    lines = np.arange(count) * period

    def roughly(angle: float) -> float:
        return max(float(tree.query(samples @ reflection(angle + line).T)[0].max()) for line in lines)

    def exactly(angle: float) -> float:
        return max(miss(outline, reflection(angle + line)) for line in lines)

    def least(f: Callable[[float], float], angle: float, around: float, steps: int) -> float:
        options = {"maxiter": steps, "xatol": 1e-9}
        return float(minimize_scalar(f, bounds=(angle - around, angle + around), method="bounded", options=options).x)

    tried = np.linspace(0.0, period, max(4, SCAN // count), endpoint=False)
    best = tried[np.argsort([roughly(float(angle)) for angle in tried], kind="stable")[:3]]
    refined = [least(roughly, float(angle), float(tried[1]), 20) for angle in best]
    return least(exactly, min(refined, key=roughly), 0.003, 16) % period


def miss(outline: Outline, matrix: NDArray[np.float64]) -> float:
    """How far an outline and its image under `matrix`, shape (2, 2), are apart, as a share of the outline's reach.

    The Hausdorff distance: no point of either is further from the other.
    """
    samples, ring = _samples(outline), outline.polygon.exterior
    # The outline is as far from its image as the image under the inverse is from the outline.
    is_own_inverse = float(np.linalg.det(matrix)) < 0.0
    both = samples @ matrix.T if is_own_inverse else np.concatenate([samples @ matrix.T, samples @ matrix])
    return float(shapely.distance(shapely.points(both), ring).max()) / outline.reach


def _samples(outline: Outline, count: int = SAMPLES) -> NDArray[np.float64]:
    """Points along an outline, shape (p, 2): its corners and `count` at equal distances."""
    ring = outline.polygon.exterior
    places = np.linspace(0.0, 1.0, count, endpoint=False)
    between = shapely.get_coordinates(shapely.line_interpolate_point(ring, places, normalized=True))
    return np.concatenate([outline.points, between])


def images(points: NDArray[np.float64], matrix: NDArray[np.float64], slack: float) -> NDArray[np.int64] | None:
    """Where the operation `matrix` carries `points`, shape (2, n) or (3, n): point k to the place of point `images[k]`.

    In space it turns about the z axis or mirrors in an upright plane. None where a point comes to lie further than
    `slack` from all of them, or two come to one.
    """
    moved = np.concatenate([matrix @ points[:2], points[2:]])
    distance, image = cKDTree(points.T).query(moved.T)
    if distance.max() > slack or len(np.unique(image)) < points.shape[1]:
        return None
    return image


def carried_into_itself(nodes: NDArray[np.float64], group: SymmetryGroup, slack: float) -> NDArray[np.bool_]:
    """Which operations of `group` carry a mesh's `nodes` [m], shape (3, n), into each other but for `slack` [m].

    Shape (order,), as `group.operations()` has them. Where the mesh does not follow an operation, a simulated body
    decides otherwise than its mirror image would.
    """
    return np.array([images(nodes, matrix, slack) is not None for matrix in group.operations()])


def _corners(outline: Outline) -> NDArray[np.float64]:
    """The outline's points without those that lie on a straight edge."""
    p = outline.points
    before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
    sine = (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) / (
        np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    )
    corners = p[np.abs(sine) > 1e-9]
    return corners if len(corners) >= 3 else p
