"""What the body does to itself where it touches itself: the law of `contact` for the gaps of `self_contact`.

A pair of energy share * W(gap) pushes its nodes by share * f_n(gap) w_k n. Its friction opposes the slip sum_k w_k u_k
along the surface, with weights, normal and force of the step's beginning. Mostly there are no pairs: then nothing is
computed.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.contact import (
    along_surface,
    friction_energy,
    friction_grip,
    normal_energy,
    normal_forces,
    normal_stiffness,
)
from gelbot.mechanics.self_contact import ContactPairs, ContactSurface, pair_gaps, settle


class Touching(NamedTuple):
    """Pairs at a step's beginning: `pairs` settled there, `weights` (4, c), `normal` (3, c), force `pressed` [N] (c,)."""

    pairs: ContactPairs
    weights: Array
    normal: Array
    pressed: Array


class PairLaw(NamedTuple):
    """Constants of contact: `stiffness` [N/m], `layer` [m], `friction`, `stick_speed` [m/s]."""

    stiffness: Array
    layer: Array
    friction: Array
    stick_speed: Array


def touch(surface: ContactSurface, pairs: ContactPairs, law: PairLaw, x0: Array) -> Touching:
    """Which of `pairs` are contacts in a step that begins at `x0` [m], (3, n)."""

    def look() -> Touching:
        here = settle(surface, pairs, x0)
        gap, weights, normal = pair_gaps(here, x0)
        return Touching(here, weights, normal, here.share * normal_forces(gap, law.stiffness, law.layer))

    def nothing() -> Touching:
        c, batch = pairs.valid.shape[0], x0.shape[2:]
        none = jnp.zeros((4, c, *batch), x0.dtype)
        return Touching(pairs, none, none[:3], none[0])

    return jax.lax.cond(jnp.any(pairs.found > 0), look, nothing)


def pair_balance(touching: Touching, law: PairLaw, dt: Array, x: Array, u: Array) -> tuple[Array, Array]:
    """Energy [J] and forces [N] (3, n) of the body's contact with itself at `x` [m], after a displacement `u` [m]."""
    pairs = touching.pairs

    def act() -> tuple[Array, Array]:
        gap, weights, normal = pair_gaps(pairs, x)
        slip = along_surface(_spread(touching.weights, u, pairs.nodes), touching.normal)
        energy = pairs.share * normal_energy(gap, law.stiffness, law.layer) + friction_energy(
            slip, touching.pressed, law.friction, law.stick_speed, dt
        )
        push = pairs.share * normal_forces(gap, law.stiffness, law.layer) * normal
        grip = -friction_grip(slip, touching.pressed, law.friction, law.stick_speed, dt) * slip
        pulls = push[:, None] * weights + grip[:, None] * touching.weights
        return jnp.sum(energy, axis=0), _gathered(pulls, pairs.nodes, x)

    def nothing() -> tuple[Array, Array]:
        return jnp.zeros(x.shape[2:], x.dtype), jnp.zeros_like(x)

    return jax.lax.cond(jnp.any(pairs.found > 0), act, nothing)


def pair_blocks(touching: Touching, law: PairLaw, dt: Array, x: Array, v: Array) -> Array:
    """The nodes' own stiffness [N/m] (3, 3, n) from the body's contact with itself, at `x` [m], moving with `v` [m/s].

    A bound: two nodes that move against each other are held by both, and what is between them is left out.
    """
    pairs = touching.pairs

    def act() -> Array:
        gap, weights, normal = pair_gaps(pairs, x)
        slip = along_surface(dt * _spread(touching.weights, v, pairs.nodes), touching.normal)
        grip = friction_grip(slip, touching.pressed, law.friction, law.stick_speed, dt)
        stiff = pairs.share * normal_stiffness(gap, law.stiffness, law.layer)
        one = jnp.eye(3, dtype=x.dtype).reshape(3, 3, *(1,) * gap.ndim)
        block = (stiff - grip) * normal[:, None] * normal[None] + grip * one
        # sum_k |w_k| = 2 bounds what the other nodes of the pair add.
        scale = 2.0 * jnp.abs(weights)
        blocks = (block[:, :, None] * scale).reshape(9, *scale.shape)
        return _gathered(blocks, pairs.nodes, x).reshape(3, 3, *x.shape[1:])

    return jax.lax.cond(jnp.any(pairs.found > 0), act, lambda: jnp.zeros((3, *x.shape), x.dtype))


def _spread(weights: Array, u: Array, nodes: Array) -> Array:
    """sum_k w_k u_k (3, c)."""
    if u.ndim == 3:
        return jax.vmap(_spread, -1, -1)(weights, u, nodes)
    return jnp.sum(weights * u[:, nodes], axis=1)


def _gathered(pulls: Array, nodes: Array, like: Array) -> Array:
    """Sums over pairs of `pulls` (m, 4, c) on their nodes, (m, n)."""
    if like.ndim == 3:
        return jax.vmap(_gathered, -1, -1)(pulls, nodes, like)
    count = like.shape[1]
    return jnp.zeros((pulls.shape[0], count), pulls.dtype).at[:, nodes].add(pulls)
