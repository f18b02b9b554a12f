"""The servo controller, equation (7)."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def servo(z: Array, z_dot: Array, reference: Array, kp: Array, kv: Array, sign: Array) -> Array:
    """E = sign Kp (z_d - z) - Kv zdot, Eq. (7) [V]; `z`, `reference` [m], `z_dot` [m/s], `kp` [V/m], `kv` [V s/m].

    The paper prints Kp (z - z_d), `sign` = -1. With E > 0 lifting the centre that drives it away from its reference;
    the stable law has `sign` = +1.
    """
    return sign * kp * (reference - z) - kv * z_dot  # Eq. (7).


def saturate(amplitude: Array, limit: Array) -> Array:
    """What the supply can give of `amplitude` [V]: at most `limit` [V] either way."""
    return jnp.clip(amplitude, -limit, limit)
