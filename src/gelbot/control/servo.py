"""The servo controller, equation (7), and what a real one needs beside it: limits on the command, a filtered rate."""

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


def slew(amplitude: Array, last: Array, rate: Array, period: Array) -> Array:
    """`amplitude` [V] or as near to it as the command may come from its `last` value at `rate` [V/s] in a `period` [s].

    An infinite `rate` is no limit.
    """
    return jnp.clip(amplitude, last - rate * period, last + rate * period)


def filtered_rate(rate: Array, last_rate: Array, time_constant: Array, period: Array) -> Array:
    """The rate after one `period` [s] of a first-order low pass: a camera's noise is not to be multiplied by Kv.

    dr/dt = (rate - r) / `time_constant`, by backward differences: exact for a `time_constant` [s] of 0, no filter.
    """
    return last_rate + (rate - last_rate) * period / (time_constant + period)
