"""Floor contact with Coulomb friction.

The floor z = 0 pushes with a force that begins in a thin layer d above it and grows with the depth p = d - z,

    f_n = k p^2 / (2 d)  for 0 < p < d,    f_n = k (p - d/2)  for p >= d,

smooth, so that a resting sheet does not chatter. A gel weighs so little in its solution that k need not be large: the
whole net weight on one node brings it to z = 0 when k = 2 W / d. Friction opposes the displacement u in the floor's
plane during a step dt,

    f_t = -mu f_n u / sqrt(|u|^2 + (v_s dt)^2),

Coulomb's law with sticking smoothed to a creep below v_s; f_n in it is taken at the beginning of the step, so that the
step stays the minimum of an energy.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array


def normal_forces(positions: Array, stiffness: Array, layer: Array) -> Array:
    """f_n [N], shape (n,), at `positions` [m], shape (3, n); `stiffness` k [N/m], `layer` d [m]."""
    depth = jnp.maximum(0.0, layer - positions[2])
    return stiffness * jnp.where(depth < layer, depth**2 / (2.0 * layer), depth - layer / 2.0)


def normal_energy(positions: Array, stiffness: Array, layer: Array) -> Array:
    """Energy of the pressed floor [J], summed over the nodes: -d/dz of it is `normal_forces`."""
    depth = jnp.maximum(0.0, layer - positions[2])
    inside = depth**3 / (6.0 * layer)
    beyond = layer**2 / 6.0 + (depth - layer) * depth / 2.0
    return stiffness * jnp.sum(jnp.where(depth < layer, inside, beyond))


def normal_stiffness(positions: Array, stiffness: Array, layer: Array) -> Array:
    """-d f_n / dz [N/m], shape (n,)."""
    return stiffness * jnp.clip((layer - positions[2]) / layer, 0.0, 1.0)


def friction_energy(slip: Array, normal: Array, friction: Array, stick_speed: Array, dt: Array) -> Array:
    """The energy [J] whose gradient in `slip` is the friction: sum mu f_n sqrt(|u|^2 + (v_s dt)^2)."""
    return jnp.sum(friction * normal * jnp.sqrt(jnp.sum(slip**2, axis=0) + (stick_speed * dt) ** 2))


def friction_grip(slip: Array, normal: Array, friction: Array, stick_speed: Array, dt: Array) -> Array:
    """mu f_n / sqrt(|u|^2 + (v_s dt)^2) [N/m], shape (n,), for `slip` u [m], shape (2, n), and normal forces [N]."""
    return friction * normal / jnp.sqrt(jnp.sum(slip**2, axis=0) + (stick_speed * dt) ** 2)
