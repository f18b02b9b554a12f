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


FIRMEST = 48
"""Contacts, at most, that the preconditioner knows of."""


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


def contact_room(surface: ContactSurface | None) -> int:
    """How many contacts a `PairStiffness` of this surface holds."""
    return 0 if surface is None else min(FIRMEST, surface.node_face_places[2].shape[0] + surface.edge_edge_places[2].shape[0])


class PairStiffness(NamedTuple):
    """The stiffness sum_m N_m d_m N_m^T of the firmest contacts, m of them times three directions.

    `nodes` (4, m) and `weights` (4, m) of the contacts, `axes` (3, 3, m): normal and two along the surface, one a row;
    `size` d [N/m] (3, m). N_m has w_k axis at node k.
    """

    nodes: Array
    weights: Array
    axes: Array
    size: Array


def pair_stiffness(touching: Touching, law: PairLaw, dt: Array, x: Array, v: Array) -> PairStiffness:
    """What the body's contact with itself adds to its stiffness at `x` [m], (3, n), moving with `v` [m/s]."""
    if x.ndim == 3:
        return jax.vmap(pair_stiffness, (-1, None, None, -1, -1), -1)(touching, law, dt, x, v)
    pairs = touching.pairs
    gap, weights, normal = pair_gaps(pairs, x)
    slip = along_surface(dt * _spread(touching.weights, v, pairs.nodes), touching.normal)
    grip = friction_grip(slip, touching.pressed, law.friction, law.stick_speed, dt)
    stiff = pairs.share * normal_stiffness(gap, law.stiffness, law.layer)
    _, firmest = jax.lax.top_k(stiff + grip, min(FIRMEST, stiff.shape[0]))
    gap, weights, normal, stiff, grip = (part[..., firmest] for part in (gap, weights, normal, stiff, grip))
    weights = jnp.where(gap < law.layer, weights, touching.weights[:, firmest])
    normal = jnp.where(gap < law.layer, normal, touching.normal[:, firmest])
    across = _across(normal)
    third = jnp.cross(normal, across, axis=0)
    return PairStiffness(pairs.nodes[:, firmest], weights, jnp.stack([normal, across, third]), jnp.stack([stiff, grip, grip]))


def contact_forces(stiffness: PairStiffness, count: int) -> Array:
    """The columns N_m as forces on `count` nodes, shape (3 m, n, 3)."""
    m = stiffness.weights.shape[-1]
    pull = stiffness.weights[:, None, None] * stiffness.axes  # (4, axis, xyz, m)
    pull = pull.transpose(1, 3, 0, 2).reshape(3 * m, 4, 3)
    place = jnp.tile(stiffness.nodes.T, (3, 1))
    return jnp.zeros((3 * m, count, 3), pull.dtype).at[jnp.arange(3 * m)[:, None], place].add(pull)


def _across(normal: Array) -> Array:
    """A unit vector across each unit `normal` (3, m)."""
    x, y, z = normal
    flat = jnp.abs(z) > 0.7
    across = jnp.where(flat, jnp.stack([z, jnp.zeros_like(x), -x]), jnp.stack([-y, x, jnp.zeros_like(x)]))
    return across / jnp.sqrt(jnp.maximum(jnp.sum(across**2, axis=0), 1e-30))


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
