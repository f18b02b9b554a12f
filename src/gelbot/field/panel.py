"""The potential of a square panel with constant charge, in closed form, and of the same charge at a point.

A unit charge spread over a square of side `a` in the plane z = 0 has, without the factor 1/(4 pi sigma),

    phi(x, y, z) = 1/a^2 * int int dx' dy' / r
                 = 1/a^2 * [ [ X asinh(Y / sqrt(X^2 + z^2)) + Y asinh(X / sqrt(Y^2 + z^2)) - z atan(X Y / (z r)) ] ]

with X = x - x', Y = y - y', r = sqrt(X^2 + Y^2 + z^2), and the double bracket the alternating sum over the corners
x' = -a/2, a/2 and y' = -a/2, a/2 (Durand, Electrostatique I, 1964; Hess and Smith 1967). Two asinh that differ in Y
only are one logarithm, ln((Y_1 + r_1) / (Y_2 + r_2)); the four arctangents are the solid angle of the panel, one
argument of a product of complex numbers.
"""

from __future__ import annotations

from typing import TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

Offset: TypeAlias = Array | tuple[Array, Array, Array]
"""From the panel's centre to the point [m]: x, y and z, each of any shape; three arrays are faster than one."""

TINY = 1e-30
"""Keeps 0/0 out where a term vanishes with its own factor."""


def square_potential(offset: Offset, side: float | Array) -> Array:
    """Potential [1/m] of a unit charge on a square panel; `offset` [m] from its centre to the point."""
    x, y, z = offset[0], offset[1], jnp.abs(offset[2])  # even in z
    right, left, above, below = x + side / 2.0, x - side / 2.0, y + side / 2.0, y - side / 2.0
    r = {
        (i, j): jnp.sqrt(X**2 + Y**2 + z**2) for i, X in enumerate((right, left)) for j, Y in enumerate((above, below))
    }
    edges = (
        right * _log_ratio(above, r[0, 0], below, r[0, 1])
        - left * _log_ratio(above, r[1, 0], below, r[1, 1])
        + above * _log_ratio(right, r[0, 0], left, r[1, 0])
        - below * _log_ratio(right, r[0, 1], left, r[1, 1])
    )
    return (edges - z * _solid_angle(right, left, above, below, z, r)) / side**2


def _log_ratio(p: Array, r_p: Array, q: Array, r_q: Array) -> Array:
    """ln((p + r_p) / (q + r_q)), by its equal ln((r_q - q) / (r_p - p)) where p + r_p would cancel."""
    positive = p + q > 0.0
    upper = jnp.where(positive, p + r_p, r_q - q)
    lower = jnp.where(positive, q + r_q, r_p - p)
    return jnp.log((upper + TINY) / (lower + TINY))


def _solid_angle(
    right: Array, left: Array, above: Array, below: Array, z: Array, r: dict[tuple[int, int], Array]
) -> Array:
    """atan(X Y / (z r)) summed over the corners with alternating signs: the panel's solid angle, 0 to 2 pi."""
    # Argument of the product of (z r + i X Y) over the corners, conjugated where the sign is minus.
    real_1, imaginary_1 = _times(z * r[0, 0], right * above, z * r[1, 1], left * below)
    real_2, imaginary_2 = _times(z * r[0, 1], -right * below, z * r[1, 0], -left * above)
    real, imaginary = _times(real_1, imaginary_1, real_2, imaginary_2)
    angle = jnp.arctan2(imaginary, real)
    return jnp.where(angle < 0.0, angle + 2.0 * jnp.pi, angle)


def _times(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """(a + i b) (c + i d)."""
    return a * c - b * d, a * d + b * c


def point_potential(offset: Offset) -> Array:
    """Potential [1/m] of a unit charge at a point; `offset` [m]."""
    x, y, z = offset
    return jax.lax.rsqrt(x**2 + y**2 + z**2)
