"""Patterns for another direction: the voltages whose field, about the robot, is a given one turned.

Where the electrode array does not share a turn of the body, what was solved for one direction is solved again for the
other: by the voltages v whose current density at points x about the robot's place comes nearest to the turned field,

    minimise  sum_x | sum_e v_e g_e(x) - R i(R^-1 x) |^2,   |v_e| <= 1,

with the lead field g_e and the turn R. Where the array does share it, its electrodes change places and nothing is lost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from gelbot.body.symmetry import rotation
from gelbot.field.charge import FieldSolution

Floats = NDArray[np.float64]

RINGS, ANGLES, LEVELS = 3, 24, 4
"""How many points there are from the place outwards, around it, and upwards."""
SMALL = 1e-3
"""Share of the field by which voltages are kept from growing without use."""


class Carried(NamedTuple):
    """A pattern for a turned direction, shares in [-1, 1], shape (e,), and its `error`: the root mean square of what is
    left of the difference of the fields, as a share of that of the field."""

    pattern: Floats
    error: float


def sample_points(place: Floats, reach: float, height: float) -> Floats:
    """Points [m], shape (3, p), on rings about `place` (2,) up to `reach`, from the floor up to `height` [m]."""
    radius, angle = np.linspace(0.0, reach, RINGS + 1)[1:], 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    x = np.concatenate([[0.0], np.outer(radius, np.cos(angle)).ravel()])
    y = np.concatenate([[0.0], np.outer(radius, np.sin(angle)).ravel()])
    z = np.linspace(0.05, 1.0, LEVELS) * height
    flat = np.stack([x, y]) + place[:, None]
    return np.concatenate([np.vstack([flat, np.full(len(x), level)]) for level in z], axis=1)


def carried(
    solution: FieldSolution,
    connection: Floats,
    pattern: Floats,
    place: Floats,
    turn: float,
    reach: float,
    height: float,
) -> Carried:
    """`pattern` (e,) for the direction turned by `turn` [rad] about `place` [m] (2,); fields are compared within
    `reach` and `height` [m] of it. `connection` (e, e) takes voltages asked for to those of the electrodes."""
    points = sample_points(place, reach, height)
    matrix = rotation(turn)
    back = points.copy()
    back[:2] = matrix.T @ (points[:2] - place[:, None]) + place[:, None]
    wanted = solution.current_density(back, (connection @ pattern)[:, None])[0]
    wanted[:2] = matrix @ wanted[:2]
    lead = solution.current_density(points, connection)
    scale = np.linalg.norm(wanted)
    if scale == 0.0:
        return Carried(np.zeros_like(pattern), 0.0)
    rows = lead.reshape(len(pattern), -1).T / scale
    # A common voltage has no field: without this it would be anything.
    small = SMALL * np.linalg.norm(rows, ord=2) * np.eye(len(pattern))
    found = lsq_linear(
        np.vstack([rows, small]), np.concatenate([wanted.ravel() / scale, np.zeros(len(pattern))]), (-1.0, 1.0)
    )
    return Carried(found.x, float(np.linalg.norm(rows @ found.x - wanted.ravel() / scale)))
