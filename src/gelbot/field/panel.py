"""The potential of a flat panel with constant charge: in closed form nearby, by its second moments far away.

A unit charge spread over a flat polygon of area S has, without the factor 1/(4 pi sigma),

    phi = 1/S * int dS' / r = 1/S * [ sum_k d_k L_k - |z| Omega ]
    L_k = ln((r_k + r_k+1 + l_k) / (r_k + r_k+1 - l_k))

over its edges k: l_k their lengths, r_k the distances of the point from their ends, d_k how far its foot in the panel's
plane lies inside the edge's line; z its height over the plane, Omega the solid angle under which it sees the panel
(Wilton and others, IEEE Trans. Antennas Propag. 32, 1984). The gradient is

    grad phi = 1/S * [ -sum_k m_k L_k - sign(z) Omega n ]

m_k the normals of the edges in the plane, outwards, n that of the panel.

Far away, with the moments M = 1/S int (x' - c)(x' - c)^T dS' about the centroid c and r = x - c,

    phi = 1/r + (3 r.M.r / r^2 - tr M) / (2 r^3) + O(size^4 / r^5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Vector: TypeAlias = Sequence[Floats] | Floats
"""Components, each of any shape."""

CORNERS = 4
"""A triangle is a quadrilateral whose last corner is its third one again."""
IN_PLANE = 1e-9
"""A point whose height over a panel's plane is smaller than this share of its distance lies in the plane."""


def panel_potential(point: Vector, x: Vector, y: Vector) -> Floats:
    """phi S [m] at `point` in a panel's own frame, z its height; `x`, `y`: the panel's corners, anticlockwise."""
    sides, distances, height = _seen(point, x, y)
    total = -np.abs(height) * _solid_angle(sides, distances, height)
    for k in range(CORNERS):
        inside, logarithm, _ = _edge(sides, distances, k)
        total += inside * logarithm
    return total


def panel_gradient(point: Vector, x: Vector, y: Vector) -> Floats:
    """S grad phi, three components in the panel's frame; in its plane the normal part, which jumps there, is zero."""
    sides, distances, height = _seen(point, x, y)
    sign = np.where(np.abs(height) > IN_PLANE * distances[0], np.sign(height), 0.0)
    total = [np.zeros_like(height), np.zeros_like(height), -sign * _solid_angle(sides, distances, height)]
    for k in range(CORNERS):
        _, logarithm, outwards = _edge(sides, distances, k)
        total[0] -= outwards[0] * logarithm
        total[1] -= outwards[1] * logarithm
    return np.stack(total)


def far_potential(r: Vector, moments: Vector, least: Floats, xp: Any = np) -> Floats:
    """phi [1/m] by `moments` (xx, yy, zz, xy, xz, yz of M [m^2]); `r` [m]; a distance below `least` counts as that.

    `xp` is the array library, that of the arrays.
    """
    inverse, quadrupole, trace = _moment_terms(r, moments, least, xp)
    square = inverse * inverse
    return inverse * (1.0 + square * (1.5 * quadrupole * square - 0.5 * trace))


def far_gradient(r: Vector, moments: Vector, least: Floats, xp: Any = np) -> Floats:
    """grad phi [1/m^2] of `far_potential`, shape (3, ...)."""
    inverse, quadrupole, trace = _moment_terms(r, moments, least, xp)
    square = inverse * inverse
    cube = inverse * square
    along = -cube * (1.0 + square * (7.5 * quadrupole * square - 1.5 * trace))
    x, y, z = r
    xx, yy, zz, xy, xz, yz = moments
    turned = (xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z)
    return xp.stack([along * component + 3.0 * cube * square * turn for component, turn in zip(r, turned, strict=True)])


def _moment_terms(r: Vector, moments: Vector, least: Floats, xp: Any) -> tuple[Floats, Floats, Floats]:
    """1/r, r.M.r and tr M."""
    x, y, z = r
    xx, yy, zz, xy, xz, yz = moments
    inverse = 1.0 / xp.sqrt(xp.maximum(x * x + y * y + z * z, least * least))
    quadrupole = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z
    return inverse, quadrupole, xx + yy + zz


def _seen(point: Vector, x: Vector, y: Vector) -> tuple[list[tuple[Floats, Floats]], list[Floats], Floats]:
    """From the point to the corners: components in the plane, distances; and the point's height."""
    height = point[2]
    sides = [(x[k] - point[0], y[k] - point[1]) for k in range(CORNERS)]
    square = height * height
    return sides, [np.sqrt(a * a + b * b + square) for a, b in sides], height


def _edge(
    sides: list[tuple[Floats, Floats]], distances: list[Floats], k: int
) -> tuple[Floats, Floats, tuple[Floats, Floats]]:
    """Of edge k: d_k, L_k, and its normal m_k in the plane, outwards."""
    (ax, ay), (bx, by) = sides[k], sides[(k + 1) % CORNERS]
    along, across = bx - ax, by - ay
    length = np.sqrt(along * along + across * across)
    inverse = 1.0 / np.maximum(length, 1e-300)
    both = distances[k] + distances[(k + 1) % CORNERS]
    # On the edge itself both = length; d_k vanishes there faster than the logarithm, kept finite, grows.
    logarithm = np.log((both + length) / np.maximum(both - length, 1e-17 * both + 1e-300))
    outwards = across * inverse, -along * inverse
    return ax * outwards[0] + ay * outwards[1], logarithm, outwards


def _solid_angle(sides: list[tuple[Floats, Floats]], distances: list[Floats], height: Floats) -> Floats:
    """Of the two triangles of a panel, as the argument of one product (Van Oosterom and Strackee 1983); 0 to 2 pi."""
    square = height * height

    def half(i: int, j: int, k: int) -> tuple[Floats, Floats]:
        """A complex number whose argument is half the solid angle of the triangle of corners i, j, k."""
        (ax, ay), (bx, by), (cx, cy) = sides[i], sides[j], sides[k]
        a, b, c = distances[i], distances[j], distances[k]
        doubled = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        real = (
            a * b * c
            + (ax * bx + ay * by + square) * c
            + (ax * cx + ay * cy + square) * b
            + (bx * cx + by * cy + square) * a
        )
        return real, np.abs(height) * doubled

    (p, q), (r, s) = half(0, 1, 2), half(0, 2, 3)
    return 2.0 * np.abs(np.arctan2(p * s + q * r, p * r - q * s))
