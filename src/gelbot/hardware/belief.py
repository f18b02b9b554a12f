"""Which examples a body may resemble now: a share of belief for each, carried on from picture to picture.

A silhouette is also that of the mirror image, and often of quite another pose. What was seen before tells them apart:
from one picture to the next a body becomes only what is near it, and belief spreads over examples accordingly; then
each picture takes belief from those that do not resemble it. Several poses may be believed in at once, until one of
them fits no more: a body that topples falls to the left or to the right, and which of them shows only later.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.hardware.habits import Habits
from gelbot.hardware.umbrella import Pose, Umbrella

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

BECOMES = 0.06e-3
"""How far [m] the points of a body move within `TICK` [s]: belief falls by a factor e with each such distance."""
TICK, MOST_TICKS = 1.0 / 30.0, 4
LEAK = 1e-4
"""Belief that is spread evenly over all examples in each tick: nothing is impossible."""
FORGETS = 0.5
"""In so many seconds without a picture what was believed is forgotten, but for a share 1 / e."""
SAME = 0.5e-3
"""Examples within this distance [m] of each other are one pose."""
AREA_NEAR, AREA_MEMORY, AREA_SHARE = 0.15e-6, 0.3e-6, 0.25
"""Area [m^2] by which silhouettes of a body differ that are nearly alike: for what is believed now, and for what is
carried on; and what is added to both, as a share of that by which the most similar example differs."""
RATE = 6.0
"""How often a second a picture tells something new: two that follow at once are wrong in the same way."""
STICKS, SPEED = 0.5e-3, 20e-3
"""How far [m], and how much further with time [m/s], a pose may be from the last one to be taken as readily."""
ALONE = 0.1
"""How much of the doubt is what a picture says by itself, whatever was believed before."""
LEAST = 1e-3
"""Chances below this are left out of the sparse matrices."""


class Kin(NamedTuple):
    """Which examples are near each other.

    `points` [m] (s, 3 m) of each, about its centre, turned as it is; `normals` (3, s); sparse matrices (s, s):
    `becomes`, the chance that the second becomes the first within a tick, and `same`, whether both are one pose.
    """

    points: Singles
    normals: Floats
    becomes: Any
    same: Any


class Thought(NamedTuple):
    """What is believed after a picture: `belief` (s,) to be carried on, `now` (s,) with all that this picture says, and
    `alone` (s,) what it says by itself; `weight` (s,): of that, what belongs to the pose that is believed most."""

    belief: Singles
    now: Singles
    alone: Singles
    weight: Singles


def marks_of(sheet: Umbrella, pose: Pose) -> Singles:
    """Tips, their bases and the hub's ring about the centre [m], (3 m,), turned as the body is."""
    marks = pose.rotation @ sheet.marks(pose.numbers, pose.rest)
    return (marks[:, 1:] - marks[:, :1]).ravel().astype(np.float32)


def kin_of(sheet: Umbrella, habits: Habits) -> Kin:
    """How near the examples are to each other."""
    points = np.stack([marks_of(sheet, habits.pose(k)) for k in range(habits.numbers.shape[1])])
    apart = apart_of(points, points)
    becomes = np.exp(-apart / BECOMES)
    # Where examples lie close together belief must not gather for that reason alone.
    crowd = becomes.sum(axis=0)
    becomes = becomes / crowd[:, None]
    same = np.exp(-((apart / SAME) ** 2))
    return Kin(points, habits.rotation[:, 2], _sparse(becomes / becomes.sum(axis=0)), _sparse(same))


def _sparse(matrix: Singles) -> Any:
    from scipy.sparse import csr_array

    return csr_array(np.where(matrix > LEAST, matrix, np.float32(0.0)))


def apart_of(some: Singles, others: Singles) -> Singles:
    """Root mean square distances [m] (s, t) of the points of examples."""
    squares = np.sum(some**2, axis=1)[:, None] + np.sum(others**2, axis=1) - 2.0 * some @ others.T
    return np.sqrt(np.maximum(squares, 0.0) * (3.0 / some.shape[1]))


def begun(kin: Kin, sheet: Umbrella, pose: Pose) -> Singles:
    """Belief (s,) in the examples near a `pose` that is known."""
    apart = apart_of(kin.points, marks_of(sheet, pose)[None])[:, 0]
    belief = np.exp(-(apart - apart.min()) / BECOMES)
    return belief / belief.sum()


def thought(kin: Kin, belief: Singles, differs: Singles, last: Singles, elapsed: float) -> Thought:
    """What is believed of a body `elapsed` [s] after there was `belief` (s,) in the examples and its points were `last`
    (3 m,) [m]; its silhouette now `differs` (s,) [m^2] from theirs."""
    for _ in range(int(np.clip(round(elapsed / TICK), 1, MOST_TICKS))):
        belief = kin.becomes @ belief
    forgotten = max(LEAK * elapsed / TICK, 1.0 - np.exp(-max(0.0, elapsed - MOST_TICKS * TICK) / FORGETS))
    belief = belief * (1.0 - forgotten) + forgotten / len(belief)
    unlike, least = differs - differs.min(), AREA_SHARE * differs.min()
    alone = np.exp(-unlike / (AREA_NEAR + least))
    now = np.maximum(belief * alone, np.float32(1e-20))
    belief = belief * np.exp(-unlike / (AREA_MEMORY + least) * min(1.0, RATE * elapsed))
    now, belief, alone = now / now.sum(), belief / belief.sum(), alone / alone.sum()
    apart = apart_of(kin.points, last[None])[:, 0]
    best = int(np.argmax(kin.same @ (now * np.exp(-(apart - apart.min()) / (STICKS + SPEED * elapsed)))))
    return Thought(belief, now, alone, now * kin.same[[best]].toarray()[0])


def doubt(kin: Kin, thinks: Thought, tip_count: int) -> tuple[Floats, float]:
    """How far the tips (a,) [m] and the normal [rad] of what else may be seen lie from those of what is believed most:
    root mean squares, over all examples that are not that pose."""
    others = 1.0 - thinks.weight / np.maximum(thinks.now, 1e-30)
    share = ((1.0 - ALONE) * thinks.now + ALONE * thinks.alone) * others
    middle = thinks.weight / thinks.weight.sum()
    marks = kin.points.reshape(len(share), 3, -1)[:, :, :tip_count]
    away = np.sum((marks - np.einsum("s,sia->ia", middle, marks)) ** 2, axis=1)
    normal = kin.normals @ middle
    cosine = np.clip(normal @ kin.normals / np.linalg.norm(normal), -1.0, 1.0)
    return np.sqrt(share @ away), float(np.sqrt(share @ np.arccos(cosine) ** 2))
