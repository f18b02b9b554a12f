"""The potential of a square panel with constant charge, in closed form, and of the same charge at a point.

A unit charge spread over a square of side `a` in the plane z = 0 has, without the factor 1/(4 pi sigma),

    phi(x, y, z) = 1/a^2 * int int dx' dy' / r
                 = 1/a^2 * [ [ X asinh(Y / sqrt(X^2 + z^2)) + Y asinh(X / sqrt(Y^2 + z^2)) - z atan(X Y / (z r)) ] ]

with X = x - x', Y = y - y', r = sqrt(X^2 + Y^2 + z^2), and the double bracket the alternating sum over the corners
x' = -a/2, a/2 and y' = -a/2, a/2 (Durand, Electrostatique I, 1964; Hess and Smith 1967).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def square_potential(offset: Array, side: float) -> Array:
    """Potential [1/m] of a unit charge on a square panel; `offset` [m], shape (3, ...), from its centre to the point."""
    x, y, z = offset
    half = side / 2.0
    total = jnp.zeros_like(x)
    for sx in (1.0, -1.0):
        for sy in (1.0, -1.0):
            total = total + sx * sy * _corner(x + sx * half, y + sy * half, z)
    return total / side**2


def _corner(x: Array, y: Array, z: Array) -> Array:
    # The smallest number keeps 0/0 out; every term vanishes with its own factor.
    tiny = 1e-30
    z = jnp.abs(z)  # the potential is even in z; below the panel arctan2 would leave the principal branch
    r = jnp.sqrt(x**2 + y**2 + z**2)
    along_x = x * jnp.arcsinh(y / jnp.sqrt(x**2 + z**2 + tiny))
    along_y = y * jnp.arcsinh(x / jnp.sqrt(y**2 + z**2 + tiny))
    return along_x + along_y - z * jnp.arctan2(x * y, z * r + tiny)


def point_potential(offset: Array) -> Array:
    """Potential [1/m] of a unit charge at a point; `offset` [m], shape (3, ...)."""
    return 1.0 / jnp.sqrt(jnp.sum(offset**2, axis=0))
