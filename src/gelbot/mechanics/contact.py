"""Contact and Coulomb friction: what a surface does to a point at a signed distance from it, its gap g.

A surface pushes with a force that begins in a thin layer d above it and grows with the depth p = d - g,

    f_n = k p^2 / (2 d)  for 0 < p < d,    f_n = k (p - d/2)  for p >= d,

smooth, so that a resting sheet does not chatter. Friction opposes the displacement u along the surface in a step dt,

    f_t = -mu f_n u / sqrt(|u|^2 + (v_s dt)^2),

Coulomb's law with sticking smoothed to a creep below v_s; f_n in it is taken at the beginning of the step, so that the
step stays the minimum of an energy.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.batch import dot


def normal_forces(gap: Array, stiffness: Array, layer: Array) -> Array:
    """f_n [N] at `gap` [m], of the same shape; `stiffness` k [N/m], `layer` d [m]."""
    depth = jnp.maximum(0.0, layer - gap)
    return stiffness * jnp.where(depth < layer, depth**2 / (2.0 * layer), depth - layer / 2.0)


def resting_depth(force: Array, stiffness: Array, layer: Array) -> Array:
    """How deep [m] in the layer a point presses with `force` [N]: the depth p of `normal_forces`, inverted."""
    return jnp.where(
        force < 0.5 * stiffness * layer,
        jnp.sqrt(2.0 * layer * jnp.maximum(0.0, force) / stiffness),
        force / stiffness + layer / 2.0,
    )


def normal_energy(gap: Array, stiffness: Array, layer: Array) -> Array:
    """Energy of the pressed surface [J], one for each gap: -d/dg of it is `normal_forces`."""
    depth = jnp.maximum(0.0, layer - gap)
    inside = depth**3 / (6.0 * layer)
    beyond = layer**2 / 6.0 + (depth - layer) * depth / 2.0
    return stiffness * jnp.where(depth < layer, inside, beyond)


def normal_stiffness(gap: Array, stiffness: Array, layer: Array) -> Array:
    """-d f_n / dg [N/m], of the shape of `gap`."""
    return stiffness * jnp.clip((layer - gap) / layer, 0.0, 1.0)


def along_surface(displacement: Array, normal: Array) -> Array:
    """The part of `displacement` along a surface with unit `normal`, space first in both."""
    return displacement - normal * dot(normal, displacement)


def friction_energy(slip: Array, normal_force: Array, friction: Array, stick_speed: Array, dt: Array) -> Array:
    """The energy [J] whose gradient in `slip` is the friction: mu f_n sqrt(|u|^2 + (v_s dt)^2), one for each slip."""
    return friction * normal_force * jnp.sqrt(dot(slip, slip) + (stick_speed * dt) ** 2)


def friction_grip(slip: Array, normal_force: Array, friction: Array, stick_speed: Array, dt: Array) -> Array:
    """mu f_n / sqrt(|u|^2 + (v_s dt)^2) [N/m] for `slip` u [m], space first, and normal forces [N]."""
    return friction * normal_force / jnp.sqrt(dot(slip, slip) + (stick_speed * dt) ** 2)
