"""Body and electrodes together: what they share about the robot's place, and which directions one solution serves."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from gelbot.body.lattice import build_body
from gelbot.body.symmetry import SymmetryGroup, carried_into_itself
from gelbot.directions_report.subject import Subject
from gelbot.errors import BadInput
from gelbot.field.array_symmetry import Setting, array_group
from gelbot.mechanics.obstacles import Obstacles, gaps
from gelbot.plan.directions import Direction
from gelbot.plan.equivalence import Laid, Shared, laid_elsewhere, orbits, shared_operations
from gelbot.scenario.build import electrode_array, field_tank
from gelbot.scenario.schema import Scenario
from gelbot.scenario.surroundings import obstacles

MESH_SLACK = 1e-6
"""Nodes that miss their image by less than this share of the body's reach are carried onto it."""
ASKED_WAY = np.radians(10.0)
"""The direction that is solved is one whose angle differs from the given one by less [rad]."""
PROBES = 200
"""Places at which obstacles are compared with their images."""


class Common(NamedTuple):
    """What body and electrodes share in the robot's pose.

    `array`: the group of the electrodes about the robot's place, None where they are round about it. `shared`: the
    operations that carry body, electrodes, tank and obstacles into themselves, the identity first. `orbits`: directions
    that they carry into each other. `solved`: the direction whose solution is known. `elsewhere`: where else the robot
    can be laid for the same motion. `mesh`: the number of the body's operations that its mesh follows.
    """

    setting: Setting
    array: SymmetryGroup | None
    shared: list[Shared]
    orbits: list[list[int]]
    solved: int
    elsewhere: list[Laid]
    mesh: int


def common_to(
    subject: Subject,
    scenario: Scenario,
    group: SymmetryGroup,
    found: list[Direction],
    tolerance: float,
    solved: float | None,
) -> Common:
    """What `subject`, the body of `scenario` with its `group` and the directions `found`, shares with the electrodes.

    `solved` [rad]: the angle of the direction whose solution is known, that of the heading if None. Raises `BadInput`
    where no direction is there, and for a mesh too coarse.
    """
    setting = Setting(electrode_array(scenario), scenario.electrodes.states, field_tank(scenario), subject.place)
    around = obstacles(scenario)
    shared = [
        one
        for one in shared_operations(subject.outline, group, subject.heading, found, setting, tolerance)
        if keeps(around, one.operation.matrix, subject.place, subject.outline.reach)
    ]
    number = _solved(found, subject.heading, solved)
    middle = (setting.array.centres[:2].max(axis=1) + setting.array.centres[:2].min(axis=1)) / 2.0
    elsewhere = [
        one
        for one in laid_elsewhere(setting, subject.heading, group, found[number], middle)
        if keeps(around, one.operation.matrix, middle, subject.outline.reach)
    ]
    body = scenario.body
    nodes = build_body(subject.outline, body.thickness, body.mesh_size, body.layers).nodes
    followed = carried_into_itself(nodes, group, MESH_SLACK * subject.outline.reach)
    return Common(
        setting,
        array_group(setting),
        shared,
        orbits([one.directions for one in shared], len(found)),
        number,
        elsewhere,
        int(followed.sum()),
    )


def keeps(around: Obstacles, matrix: NDArray[np.float64], place: NDArray[np.float64], size: float) -> bool:
    """Whether obstacles look the same after the operation `matrix`, (2, 2), about `place` [m], (2,).

    They do if at every place they are as far away as at its image; `PROBES` of them are tried, some `size` [m] apart.
    """
    rng = np.random.default_rng(1)
    spread = 3.0 * size * rng.normal(size=(3, PROBES))
    spread[2] = np.abs(spread[2])
    pivot = np.array([*place, 0.0])[:, None]
    image = np.concatenate([matrix @ spread[:2], spread[2:]])
    here, there = (np.asarray(gaps(around, jnp.asarray(points + pivot))[0]) for points in (spread, image))
    slip = np.asarray(around.friction)
    # Of what is equally slippery, in whatever order it is told.
    return all(
        np.allclose(
            np.sort(here[slip == value], axis=0), np.sort(there[slip == value], axis=0), rtol=0.0, atol=1e-5 * size
        )
        for value in np.unique(slip)
    )


def _solved(found: list[Direction], heading: float, asked: float | None) -> int:
    """The number of the direction at the angle that is asked for, or nearest to the heading."""
    angles = np.array([one.angle for one in found]) + heading
    apart = np.abs((angles - (heading if asked is None else asked) + np.pi) % (2.0 * np.pi) - np.pi)
    best = int(np.argmin(apart))
    if asked is not None and apart[best] > ASKED_WAY:
        known = ", ".join(f"{angle:.4g}" for angle in np.sort(np.degrees(angles) % 360.0))
        raise BadInput("--solved", f"{np.degrees(asked):.4g} deg", f"a direction of this body: {known} deg")
    return best
