"""The symmetry of an electrode array about a place: which operations carry electrodes onto electrodes, and which onto
which.

An operation turns the tank about the upright axis through the place, or mirrors it in an upright plane through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gelbot.body.symmetry import SymmetryGroup, group_of, reflection, rotation
from gelbot.field.electrodes import THIN, Block, Electrode, ElectrodeArray, Rectangle, breadth
from gelbot.field.images import Tank

Floats = NDArray[np.float64]

ROUNDING = 1e-6
"""What misses by less than this share of the array's extent, or of a unit vector, is carried exactly."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What an operation has to carry into itself: the electrodes, what each is connected to, and the tank's walls.

    `states`: one word for each electrode; those that are carried into each other have the same. `place` [m], shape
    (2,): where the upright axis stands.
    """

    array: ElectrodeArray
    states: Sequence[str]
    tank: Tank
    place: Floats

    @property
    def slack(self) -> float:
        """Lengths that differ by less are equal [m]."""
        low, high = (np.array([e.bounds[k] for e in self.array.electrodes]) for k in (0, 1))
        return ROUNDING * float(np.max(high.max(axis=0) - low.min(axis=0)))


def electrode_images(setting: Setting, matrix: Floats) -> NDArray[np.int64] | None:
    """Where the operation `matrix`, shape (2, 2), carries the electrodes: e to the place of electrode `images[e]`.

    None where an electrode comes to lie on none of its kind and state, or a wall of the tank on none.
    """
    if not _keeps_walls(setting, matrix):
        return None
    array, slack = setting.array, setting.slack
    turned = np.eye(3)
    turned[:2, :2] = matrix
    pivot = np.array([*setting.place, 0.0])
    moved = turned @ (array.centres - pivot[:, None]) + pivot[:, None]
    near = cKDTree(array.centres.T).query_ball_point(moved.T, slack)
    images = []
    for e, electrode in enumerate(array.electrodes):
        alike = [
            f
            for f in near[e]
            if setting.states[f] == setting.states[e] and _alike(electrode, turned, array.electrodes[f], slack)
        ]
        if not alike:
            return None
        images.append(min(alike))
    found = np.array(images)
    return found if len(np.unique(found)) == array.count else None


def array_group(setting: Setting) -> SymmetryGroup | None:
    """The symmetry of the setting; None where it is round: every electrode is, and stands on the axis itself.

    Operations carry an electrode that is furthest from the axis into others as far away, so it is enough to try those.
    """
    array = setting.array
    offsets = array.centres[:2] - setting.place[:, None]
    radii, angles = np.linalg.norm(offsets, axis=0), np.arctan2(offsets[1], offsets[0])
    first = int(np.argmax(radii))
    if radii[first] > setting.slack:
        targets = np.flatnonzero(np.abs(radii - radii[first]) < setting.slack)
        turns, mirrors = angles[targets] - angles[first], (angles[targets] + angles[first]) / 2.0
    elif all(not _is_straight(e) and abs(e.frame[2, 2]) > 1.0 - ROUNDING for e in array.electrodes):
        if any(plane is not None for plane in (*setting.tank.planes[0], *setting.tank.planes[1])):
            turns, mirrors = np.arange(4) * np.pi / 2.0, np.arange(4) * np.pi / 4.0
        else:
            return None
    else:
        straight = next((e for e in array.electrodes if _is_straight(e)), array.electrodes[0])
        along = straight.frame[:2, 0] if np.linalg.norm(straight.frame[:2, 0]) > ROUNDING else straight.frame[:2, 2]
        start = float(np.arctan2(along[1], along[0]))
        turns, mirrors = np.arange(4) * np.pi / 2.0, start + np.arange(4) * np.pi / 4.0
    return group_of(
        [float(t) for t in turns if electrode_images(setting, rotation(float(t))) is not None],
        [float(m) for m in mirrors if electrode_images(setting, reflection(float(m))) is not None],
    )


def _keeps_walls(setting: Setting, matrix: Floats) -> bool:
    """Whether the tank's walls, each with its place and the direction in which it looks, come to lie on walls."""
    walls = [
        (sign * np.eye(2)[axis], sign * place)
        for axis in (0, 1)
        for sign, place in zip((-1.0, 1.0), setting.tank.planes[axis], strict=True)
        if place is not None
    ]
    for outward, distance in walls:
        moved = matrix @ outward
        moved_distance = distance - outward @ setting.place + moved @ setting.place
        if not any(
            np.abs(moved - other).max() < ROUNDING and abs(moved_distance - far) < setting.slack for other, far in walls
        ):
            return False
    return True


def _is_straight(electrode: Electrode) -> bool:
    return isinstance(electrode.shape, Rectangle | Block)


def _alike(electrode: Electrode, turned: Floats, other: Electrode, slack: float) -> bool:
    """Whether an electrode, its middle moved to that of `other` and itself `turned` (3, 3), fills the same space."""
    if type(electrode.shape) is not type(other.shape) or abs(electrode.backing - other.backing) > slack:
        return False
    along = float((turned @ electrode.frame[:, 2]) @ other.frame[:, 2])
    # A front that conducts and a back that does not are not the same; all else looks alike from both ends.
    if (along if electrode.backing > 0.0 else abs(along)) < 1.0 - ROUNDING and not isinstance(electrode.shape, Block):
        return False
    if not _is_straight(electrode):
        sizes = [np.ravel([getattr(e.shape, f.name) for f in fields(e.shape)]) for e in (electrode, other)]
        return bool(np.abs(sizes[0] - sizes[1]).max() < slack)
    moved, there = turned @ _corners(electrode), _corners(other)
    distance = cKDTree(there.T).query(moved.T)[0]
    return bool(distance.max() < slack)


def _corners(electrode: Electrode) -> Floats:
    """The corners of a rectangle or a block about its own middle, in the tank's frame [m], shape (3, 4) or (3, 8)."""
    a, b = breadth(electrode.shape)
    heights = (0.0,) if isinstance(electrode.shape, THIN) else electrode.ends
    own = [(x, y, z) for z in heights for x in (-a / 2.0, a / 2.0) for y in (-b / 2.0, b / 2.0)]
    return electrode.frame @ np.array(own).T
