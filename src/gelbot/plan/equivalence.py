"""Which directions are the same experiment: what body and electrodes have in common carries solutions over.

An operation about the robot's place that carries the body into itself and each electrode onto an electrode carries a
motion into a motion: done with the electrodes' voltages exchanged accordingly, the direction with its image. So one
solution, a programme of voltages, serves an orbit of directions, exactly. Where the array does not have the body's
symmetry the robot can be laid anew instead: with another heading another of its axes points the way that is solved, and
the same voltages move it the same way, over other tips.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.body.outline import Outline
from gelbot.body.symmetry import SymmetryGroup, miss, reflection, rotation
from gelbot.field.array_symmetry import Setting, array_group, electrode_images
from gelbot.plan.directions import Direction

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

SAME_WAY = 0.2
"""Directions that differ by less [rad] may be images of each other, if the outline is one of itself."""


class Operation(NamedTuple):
    """A rotation by `angle` [rad], or a reflection in the line of this direction; `matrix`, shape (2, 2)."""

    is_reflection: bool
    angle: float
    matrix: Floats


class Shared(NamedTuple):
    """An operation that body and electrodes share: what it makes of electrodes (e,) and directions (d,), by number.

    `miss`: how far the outline and its image are apart, as a share of its reach; the electrodes' images are exact.
    """

    operation: Operation
    electrodes: Numbers
    directions: Numbers
    miss: float


class Laid(NamedTuple):
    """Another place for the robot: `place` [m], (2,), and `heading` [rad], with the voltages of `electrodes` exchanged.

    The robot then moves along `angle` [rad], as it does along the solved direction in its own place.
    """

    operation: Operation
    place: Floats
    heading: float
    angle: float
    electrodes: Numbers


def operations_of(group: SymmetryGroup) -> list[Operation]:
    """All operations of `group`, the identity first."""
    turns = 2.0 * np.pi * np.arange(group.rotation_count) / group.rotation_count
    found = [Operation(False, float(angle), rotation(float(angle))) for angle in turns]
    return found + [Operation(True, float(angle), reflection(float(angle))) for angle in group.mirror_angles]


def turned(group: SymmetryGroup, heading: float) -> SymmetryGroup:
    """The group of a body that lies with `heading` [rad]."""
    if group.mirror_angle is None:
        return group
    return SymmetryGroup(group.rotation_count, (group.mirror_angle + heading) % (np.pi / group.rotation_count))


def images_of_directions(
    found: list[Direction], heading: float, matrix: Floats, tolerance: float = SAME_WAY
) -> Numbers | None:
    """What the operation `matrix`, shape (2, 2), makes of the directions of a body that lies with `heading` [rad].

    Direction k becomes direction `images[k]`, over as many tips on as many supports. None where one becomes no other.
    """
    ways = np.array([_way(one.angle + heading) for one in found])
    result = []
    for one, way in zip(found, ways, strict=True):
        aside = np.linalg.norm(ways - matrix @ way, axis=1)
        best = int(np.argmin(aside))
        same = len(found[best].over) == len(one.over) and len(found[best].supports) == len(one.supports)
        if aside[best] > tolerance or not same:
            return None
        result.append(best)
    return np.array(result) if len(set(result)) == len(result) else None


def _way(angle: float) -> Floats:
    return np.array([np.cos(angle), np.sin(angle)])


def shared_operations(
    outline: Outline, group: SymmetryGroup, heading: float, found: list[Direction], setting: Setting, tolerance: float
) -> list[Shared]:
    """The operations about the robot's place that carry electrodes, tank and body into themselves, the identity first.

    `outline` lies with `heading` [rad] and may miss its image by `tolerance` times its reach; `group` is its symmetry,
    `found` its directions.
    """
    common = array_group(setting)
    lying = Outline(outline.points @ rotation(heading).T)
    result = []
    for operation in operations_of(turned(group, heading) if common is None else common):
        missed = miss(lying, operation.matrix)
        electrodes = electrode_images(setting, operation.matrix)
        if missed > tolerance or electrodes is None:
            continue
        ways = images_of_directions(found, heading, operation.matrix)
        if ways is not None:
            result.append(Shared(operation, electrodes, ways, missed))
    return result


def orbits(permutations: list[Numbers], count: int) -> list[list[int]]:
    """The numbers 0 to `count` - 1 in groups that `permutations`, shape (count,) each, carry into each other."""
    label = np.arange(count)
    for _ in range(count):
        for image in permutations:
            lowest = np.minimum(label, label[image])
            label = lowest.copy()
            np.minimum.at(label, image, lowest)
    return [np.flatnonzero(label == one).tolist() for one in np.unique(label)]


def kinds(group: SymmetryGroup, found: list[Direction]) -> list[list[int]]:
    """The directions in groups that rotations of the body carry into each other: one solution serves each of them."""
    turns = (images_of_directions(found, 0.0, rotation(2.0 * np.pi * k / group.rotation_count), 1e-6)
             for k in range(group.rotation_count))  # fmt: skip
    return orbits([image for image in turns if image is not None], len(found))


def carried(pattern: Floats, electrodes: Numbers) -> Floats:
    """The voltages, shape (e,) or (e, ...), that do for the image of a direction what `pattern` does for the direction.

    `electrodes`, shape (e,), comes from the shared operation: electrode `electrodes[e]` gets what electrode e had.
    """
    result = np.empty_like(pattern)
    result[electrodes] = pattern
    return result


def laid_elsewhere(
    setting: Setting, heading: float, group: SymmetryGroup, solved: Direction, middle: Floats
) -> list[Laid]:
    """The places to which the symmetry of the array about its `middle` [m], (2,), carries the robot and its motion.

    The robot's own place comes first. A reflection would lay down the body's mirror image: where the body has a mirror
    line, that is the body itself, turned; where it has none, reflections are left out.
    """
    about = Setting(setting.array, setting.states, setting.tank, middle)
    common = array_group(about)
    found: list[Laid] = []
    for operation in operations_of(common) if common is not None else []:
        electrodes = electrode_images(about, operation.matrix)
        if electrodes is None or (operation.is_reflection and solved.axis is None):
            continue
        place = middle + operation.matrix @ (setting.place - middle)
        # The body's reflection in its own line, and then that of the tank: two reflections are a rotation.
        mirrored = 2.0 * (operation.angle - heading - (solved.axis or 0.0))
        turn = mirrored if operation.is_reflection else operation.angle
        way = operation.matrix @ _way(solved.angle + heading)
        angle = float(np.arctan2(way[1], way[0])) % (2.0 * np.pi)
        laid = Laid(operation, place, (heading + turn) % (2.0 * np.pi), angle, electrodes)
        if not any(_lies_alike(laid, other, group, setting.slack) for other in found):
            found.append(laid)
    return found


def _lies_alike(one: Laid, other: Laid, group: SymmetryGroup, slack: float) -> bool:
    """Whether the body, with its rotations, fills the same space in both places."""
    period = 2.0 * np.pi / group.rotation_count
    turn = (one.heading - other.heading + period / 2.0) % period - period / 2.0
    return bool(np.linalg.norm(one.place - other.place) < slack and abs(turn) < 1e-6)
