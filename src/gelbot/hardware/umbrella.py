"""A sheet that bends like an umbrella: few numbers say how each of its arms bends, and where all its points then are.

The body lies flat about its middle, its tips at azimuths `phi_k`. Along the axis of arm k, at the distance u from the
middle, the mid-surface leans down by the angle

    theta_k(u) = sum_m K_mk F_m(u / L),    F_0 = t,  F_1 = t^2 - t,  F_2 = 2 t^3 - 3 t^2 + t

with L the reach of the tips: integrals of Legendre polynomials, K_0k the angle at the tip. A line across the arm stays
straight. Between arms the K are blended; each arm may also swing in the plane of the body, and all of them shrink, for
a gel bends by shrinking on one side, and loses length where it bends. That a circle about the middle becomes shorter
when its points come nearer to the axis holds as far as the arms are joined; further out an arm keeps its width.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput

Floats = NDArray[np.float64]

ORDERS = 3
"""How many numbers say how an arm bends along its axis."""
RINGS = 5
"""Points on the line from the middle to a point of the outline."""
PIECE = 0.16
"""How long an edge of the mesh's rim may be, as a share of the reach."""
BLEND = 3.0
"""How fast the bend of one arm becomes that of the next: `exp(BLEND cos(phi - phi_k))` is the share of arm k."""
RELEASE = 2.0
"""The distance over which an arm regains its width beyond its root, in distances of the root from the middle."""
TIP_PART, HUB_PART = 0.75, 0.17
"""Where a tip's base lies on the line to the tip, and the ring that carries the normal, as shares of the reach."""
ALL = slice(None)
GAUSS = np.polynomial.legendre.leggauss(5)


class Bent(NamedTuple):
    """Points [m] and unit normals (3, p) of the mid-surface, and what gives their derivatives (3, p, d)."""

    points: Floats
    normals: Floats
    slopes: Callable[[], tuple[Floats, Floats]]


class Mesh(NamedTuple):
    """Points of a body's surface: where they lie in the flat sheet, `flat` [m] (2, n), how high above its middle,
    `side` [m] (n,), and the closed surface's `triangles` (3, f), counter-clockwise seen from outside."""

    flat: Floats
    side: Floats
    triangles: NDArray[np.int64]


class Essential(NamedTuple):
    """The essential points of a posed sheet, as in `gelbot.points.Observation`: lengths [m], angles [rad]."""

    centre: Floats
    normal: Floats
    tips: Floats
    tip_angles: Floats


class Pose(NamedTuple):
    """How an umbrella is bent and where it is: `numbers` (d,), `rotation` (3, 3), `centre` [m] (3,), and `rest` [m]
    (3, n + marks): by how much its points lie elsewhere, in the body's frame, for it is no umbrella."""

    numbers: Floats
    rotation: Floats
    centre: Floats
    rest: Floats


@dataclass(frozen=True)
class Umbrella:
    """A flat sheet, ready to be bent; made by `umbrella_of`. Lengths in m, in the body's own plane.

    `along`, `across` (p,): the points of the mid-surface in the frame of their arm; `arm` (p,) its number; `shares`
    (p, a): the shares of the arms in a point's bend. The first `mid_count` carry the surface, whose points lie `side`
    (n,) above those that `foot` (n,) names, with `triangles` (3, f); then come middle, tips, their bases and the hub's
    ring, in all `mark_count`. `flat` (2, p) are all of them before the sheet is bent. `azimuths` (a,) of the tips,
    their `reach`, `root`: where the arms begin; `thickness`.
    """

    along: Floats
    across: Floats
    arm: NDArray[np.int64]
    shares: Floats
    mid_count: int
    foot: NDArray[np.int64]
    side: Floats
    triangles: NDArray[np.int64]
    flat: Floats
    azimuths: Floats
    reach: float
    root: float
    thickness: float

    @property
    def tip_count(self) -> int:
        return len(self.azimuths)

    @property
    def number_count(self) -> int:
        """How many numbers say how the sheet is bent: three and a swing for each arm, two for the shrinkage."""
        return (ORDERS + 1) * self.tip_count + 2

    @property
    def mark_count(self) -> int:
        return len(self.along) - self.mid_count

    @property
    def no_rest(self) -> Floats:
        """Nothing that the umbrella cannot do: zeros, (3, n + marks)."""
        return np.zeros((3, len(self.side) + self.mark_count))

    @cached_property
    def _nodes(self) -> Floats:
        """Gauss points of the integrals, (2, p, g), as shares of the reach: up to a point, and up to the root."""
        inner = np.stack([self.along, np.minimum(self.along, self.root)])
        return inner[:, :, None] * (GAUSS[0] + 1.0) / 2.0 / self.reach

    def bent(self, numbers: Floats, at: NDArray[np.int64] | slice = ALL) -> Bent:
        """The mid-surface at points `at` (q,), bent by `numbers` (d,): K_0k, K_1k, K_2k, swings [rad], shrinkage."""
        a = self.tip_count
        shares, along, t = self.shares[at], self.along[at], self.along[at] / self.reach
        bends = numbers[: ORDERS * a].reshape(ORDERS, a) @ shares.T
        swing, shrink = shares @ numbers[ORDERS * a : (ORDERS + 1) * a], numbers[-2:]

        nodes = self._nodes[:, at]
        lean = _lean(nodes, bends[:, None, :, None])
        length = GAUSS[1] / 2.0 * np.stack([along, np.minimum(along, self.root)])[:, :, None]
        cos, sin = length * np.cos(lean), length * np.sin(lean)
        stretch = _stretch(nodes, shrink)
        outward, down = np.sum(stretch * cos, axis=-1), np.sum(stretch * sin, axis=-1)
        free = np.clip((along / self.root - 1.0) / RELEASE, 0.0, 1.0)
        joined = np.maximum(np.minimum(along, self.root), 1e-12)
        across = self.across[at] * ((1.0 - free) * outward[1] / joined + free * _stretch(t, shrink))

        tip_lean = _lean(t, bends)
        azimuth = self.azimuths[self.arm[at]] + swing * t
        zero, one = np.zeros_like(t), np.ones_like(t)
        radial = np.stack([np.cos(azimuth), np.sin(azimuth), zero])
        tangent = np.stack([-radial[1], radial[0], zero])
        vertical = np.stack([zero, zero, one])
        points = outward[0] * radial + across * tangent - down[0] * vertical
        normals = np.sin(tip_lean) * radial + np.cos(tip_lean) * vertical

        def slopes() -> tuple[Floats, Floats]:
            by_bend = np.stack(_by_bend(nodes))
            by_shrink = np.stack([np.ones_like(nodes), 2.0 * nodes - 1.0])
            # Axis 0: the three bends of the point's own blend, then the two shrinkages.
            out = np.concatenate([-np.sum(stretch * sin * by_bend, axis=-1), -np.sum(by_shrink * cos, axis=-1)])
            low = np.concatenate([np.sum(stretch * cos * by_bend, axis=-1), -np.sum(by_shrink * sin, axis=-1)])
            wide = (1.0 - free) * out[:, 1] / joined
            wide[ORDERS:] -= free * np.stack([one, 2.0 * t - 1.0])
            wide *= self.across[at]
            moved = out[:, None, 0] * radial + wide[:, None] * tangent - low[:, None, 0] * vertical
            turned = np.stack(_by_bend(t))[:, None] * (np.cos(tip_lean) * radial - np.sin(tip_lean) * vertical)
            swung = t * (outward[0] * tangent - across * radial)
            own = np.concatenate([moved[:ORDERS], swung[None]])[:, None] * shares.T[:, None]
            leaned = np.concatenate([turned, (t * np.sin(tip_lean) * tangent)[None]])[:, None] * shares.T[:, None]
            q = len(t)
            return (
                np.concatenate([own.reshape(-1, 3, q), moved[ORDERS:]]).transpose(1, 2, 0),
                np.concatenate([leaned.reshape(-1, 3, q), np.zeros((2, 3, q))]).transpose(1, 2, 0),
            )

        return Bent(points, normals, slopes)

    def surface(self, numbers: Floats, rest: Floats) -> Floats:
        """The points of the surface [m], (3, n), in the body's frame, for `numbers` (d,) and with what the umbrella
        cannot do, `rest` [m] (3, n + marks)."""
        bent = self.bent(numbers, slice(0, self.mid_count))
        return bent.points[:, self.foot] + bent.normals[:, self.foot] * self.side + rest[:, : len(self.side)]

    def slopes(self, numbers: Floats, at: NDArray[np.int64]) -> Floats:
        """Derivatives of the surface's points `at` (q,) by the numbers, (3, q, d)."""
        points, normals = self.bent(numbers, self.foot[at]).slopes()
        return points + normals * self.side[at, None]

    def marks(self, numbers: Floats, rest: Floats) -> Floats:
        """Middle, tips, bases and the hub's ring [m] (3, marks), in the body's frame."""
        return self.bent(numbers, slice(self.mid_count, None)).points + rest[:, len(self.side) :]

    def essential(self, pose: Pose) -> Essential:
        """The essential points of the sheet."""
        a = self.tip_count
        points = pose.rotation @ self.marks(pose.numbers, pose.rest) + pose.centre[:, None]
        centre, tips, bases, ring = (
            points[:, 0],
            points[:, 1 : 1 + a],
            points[:, 1 + a : 1 + 2 * a],
            points[:, 1 + 2 * a :],
        )
        spokes = ring - ring.mean(axis=1, keepdims=True)
        normal = np.cross(spokes, np.roll(spokes, -1, axis=1), axis=0).sum(axis=1)
        return Essential(
            centre, normal / max(float(np.linalg.norm(normal)), 1e-30), tips, tip_angles(centre, tips, bases)
        )


def tip_angles(centre: Floats, tips: Floats, bases: Floats) -> Floats:
    """How far each tip points below its own outward direction [rad] (a,), as in `gelbot.points.observe`."""
    outward = (bases - centre[:, None]) * np.array([[1.0], [1.0], [0.0]])
    outward = outward / np.maximum(np.linalg.norm(outward, axis=0), 1e-12)
    along = tips - bases
    return np.arctan2(-along[2], np.sum(along * outward, axis=0))


def _lean(t: Floats, bends: Floats) -> Floats:
    """theta at the shares `t` of the reach, for `bends` with the orders on axis 0."""
    return t * (bends[0] + (t - 1.0) * (bends[1] + (2.0 * t - 1.0) * bends[2]))


def _by_bend(t: Floats) -> tuple[Floats, Floats, Floats]:
    """The derivatives of theta by K_0, K_1, K_2."""
    return t, t * (t - 1.0), t * (t - 1.0) * (2.0 * t - 1.0)


def _stretch(t: Floats, shrink: Floats) -> Floats:
    """Length over length at rest, at the shares `t` of the reach."""
    return 1.0 - shrink[0] - shrink[1] * (2.0 * t - 1.0)


def umbrella_of(outline: Floats, thickness: float, tips: Floats, mesh: Mesh | None = None) -> Umbrella:
    """The umbrella of a flat sheet.

    `outline` [m] (2, k): a closed polygon about its middle, the origin, counter-clockwise, last point not repeated.
    `tips` [m] (2, a): where it reaches out furthest. `mesh` of its surface, or one is made. Raises `BadInput` when a
    line from the middle meets the outline twice, or when there is no tip.
    """
    if tips.ndim != 2 or len(tips) != 2 or tips.shape[1] < 1:
        raise BadInput("tracker: tips", f"an array of shape {tips.shape}", "x and y of one tip or more, shape (2, a)")
    reach = float(np.linalg.norm(tips, axis=0).max())
    rim = _rim(outline, PIECE * reach)
    turned = rim[0] * np.roll(rim[1], -1) - rim[1] * np.roll(rim[0], -1)
    if np.any(turned <= 0.0):
        given = "an outline that turns back, seen from its middle"
        raise BadInput("tracker: outline", given, "one that each line from its middle meets once, counter-clockwise")
    mesh = _mesh(rim, thickness) if mesh is None else mesh
    _, first, foot = np.unique(np.round(mesh.flat / (1e-6 * reach)), axis=1, return_index=True, return_inverse=True)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    ring = HUB_PART * reach * np.stack([np.cos(turn), np.sin(turn)])
    flat = np.concatenate([mesh.flat[:, first], np.zeros((2, 1)), tips, TIP_PART * tips, ring], axis=1)

    azimuths, distance = np.arctan2(tips[1], tips[0]), np.linalg.norm(flat, axis=0)
    away = np.arctan2(flat[1], flat[0])[:, None] - azimuths
    arm = np.argmax(np.cos(away), axis=1)
    shares = np.exp(BLEND * (np.cos(away) - 1.0))
    shares[distance < 1e-3 * reach] = 1.0  # the middle belongs to all
    off = away[np.arange(len(arm)), arm]
    return Umbrella(
        along=distance * np.cos(off),
        across=distance * np.sin(off),
        arm=arm,
        shares=shares / shares.sum(axis=1, keepdims=True),
        mid_count=len(first),
        foot=foot.ravel(),
        side=mesh.side,
        triangles=mesh.triangles,
        flat=flat,
        azimuths=azimuths,
        reach=reach,
        root=float(np.linalg.norm(rim, axis=0).min()) * float(np.cos(np.pi / max(3, len(azimuths)))),
        thickness=thickness,
    )


def _mesh(rim: Floats, thickness: float) -> Mesh:
    """Rings about the middle, and lines from it to the points of the `rim` (2, r)."""
    rings = np.arange(1, RINGS + 1) / RINGS
    flat = np.concatenate([np.zeros((2, 1)), (rim[:, None, :] * rings[:, None]).reshape(2, -1)], axis=1)
    side = np.repeat([thickness / 2.0, -thickness / 2.0], flat.shape[1])
    return Mesh(np.tile(flat, 2), side, _closed(rim.shape[1]))


def _rim(outline: Floats, piece: float) -> Floats:
    """Points (2, r) of the outline, corners among them, no further apart than `piece`."""
    after = np.roll(outline, -1, axis=1)
    counts = np.maximum(1, np.ceil(np.linalg.norm(after - outline, axis=0) / piece)).astype(int)
    return np.concatenate(
        [a[:, None] + (b - a)[:, None] * np.arange(n) / n for a, b, n in zip(outline.T, after.T, counts, strict=True)],
        axis=1,
    )


def _closed(rays: int) -> NDArray[np.int64]:
    """Triangles (3, f) of upper side, lower side and rim, counter-clockwise seen from outside."""
    here = np.arange(rays)
    there = np.roll(here, -1)
    inner = [(np.zeros_like(here), 1 + here, 1 + there)]
    for k in range(RINGS - 1):
        a, b = 1 + k * rays + here, 1 + k * rays + there
        inner += [(a, a + rays, b + rays), (a, b + rays, b)]
    upper = np.concatenate([np.stack(t) for t in inner], axis=1)
    below = 1 + RINGS * rays
    a, b = 1 + (RINGS - 1) * rays + here, 1 + (RINGS - 1) * rays + there
    rim = np.concatenate([np.stack([a, a + below, b]), np.stack([b, a + below, b + below])], axis=1)
    return np.concatenate([upper, upper[::-1] + below, rim], axis=1)
