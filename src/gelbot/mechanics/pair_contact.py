"""What the body does to itself where it touches itself: a barrier that no pair of `self_contact` can cross.

A pair at a distance d has the energy m W(d), which begins at d = h, the layer, and grows without bound (Li et al.,
Incremental Potential Contact, 2020, Eq. 6),

    W = -k (d - h)^2 ln(d / h),    f_n = -W' = k (h - d) (2 ln(h / d) + (h - d) / d),

and pushes its nodes by m f_n w_k n. m is 1 but for two edges: it fades to 0 as they become parallel, where their
closest points jump and nodes and faces take over (section 5 there),

    m = z (2 - z),    z = min(1, |u x v|^2 / (e |u_0|^2 |v_0|^2)),    u, v the edges, u_0, v_0 at the step's beginning.

Friction opposes the slip sum_k w_k u_k along the surface, with weights, normal and force of the step's beginning.
Mostly there are no pairs: then nothing is computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.batch import dot, settled
from gelbot.mechanics.contact import along_surface, friction_energy, friction_grip
from gelbot.mechanics.self_contact import TINY, ContactPairs, ContactSurface, closest_weights, from_middle

FIRMEST = 96
"""Surface nodes, at most, whose contacts with each other the preconditioner knows of: those held most firmly."""
PARALLEL = 1e-2
"""Square of the sine, e, of the angle between two edges above which they are a whole contact."""
CLOSEST = 1e-4
"""Pairs that begin a step nearer than this share of the layer have met before anyone looked: they do not count."""
FEW = 0.25
"""Where no more than this share of the places is taken, only so many are computed."""
KEPT = 0.2
"""Share of a pair's distance that one iteration must leave."""
LEAST = 1e-2
"""Share of an iteration's way; where what is not watched would allow less, it is time to look again."""


class PairLaw(NamedTuple):
    """Constants of contact: `stiffness` [N/m], `layer` [m], `friction`, `stick_speed` [m/s]."""

    stiffness: Array
    layer: Array
    friction: Array
    stick_speed: Array


class Touching(NamedTuple):
    """Pairs at a step's beginning: `corners` [m] (3, 4, c), seen from their first, and how they stand to each other.

    `parallel` [m^4] (c",) is e |u_0|^2 |v_0|^2 of two edges, `distance` [m] (c,) that of all; `weights` (4, c),
    `normal` (3, c) and force `pressed` [N] (c,) are what friction goes by.
    """

    pairs: ContactPairs
    corners: Array
    parallel: Array
    distance: Array
    weights: Array
    normal: Array
    pressed: Array


class PairGaps(NamedTuple):
    """`distance` [m] (c,), `weights` (4, c) of the nodes, unit `normal` (3, c) from the second side to the first."""

    distance: Array
    weights: Array
    normal: Array


def barrier(distance: Array, stiffness: Array, layer: Array) -> tuple[Array, Array, Array]:
    """W [J], f_n [N] and -d f_n / dd [N/m] at `distance` [m]; `stiffness` k [N/m], `layer` h [m]."""
    near = distance < layer
    d = jnp.where(near, jnp.maximum(distance, 1e-6 * layer), layer)
    depth, logarithm = layer - d, jnp.log(layer / d)
    ratio = depth / d
    force = stiffness * depth * (2.0 * logarithm + ratio)
    return stiffness * depth**2 * logarithm, force, stiffness * (2.0 * logarithm + (4.0 + ratio) * ratio)


def pair_gaps(pairs: ContactPairs, corners: Array) -> PairGaps:
    """Distances of `pairs` whose nodes are at `corners` [m] (3, 4, c)."""
    met = pairs.node_face.shape[1]
    weights = jnp.concatenate([closest_weights(corners[..., :met], 1), closest_weights(corners[..., met:], 2)], axis=1)
    away = jnp.sum(weights * corners, axis=1)
    square = dot(away, away)
    apart = square > TINY
    distance = jnp.sqrt(jnp.where(apart, square, TINY))
    return PairGaps(distance, weights, jnp.where(apart, away, 0.0) / distance)


def _crossing(parallel: Array, corners: Array) -> tuple[Array, Array]:
    """The factors m of pairs of edges at `corners` [m] (3, 4, c"), and their gradients [1/m] (3, 4, c")."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 2]
    uu, uv, vv = dot(u, u), dot(u, v), dot(v, v)
    z = jnp.clip((uu * vv - uv**2) / parallel, 0.0, 1.0)
    slope = 4.0 * (1.0 - z) / parallel
    along_u, along_v = slope * (vv * u - uv * v), slope * (uu * v - uv * u)
    return z * (2.0 - z), jnp.stack([-along_u, along_u, -along_v, along_v], axis=1)


def touch(surface: ContactSurface, pairs: ContactPairs, law: PairLaw, x0: Array) -> Touching:
    """How `pairs` stand to each other in a step that begins at `x0` [m], (3, n[, b])."""

    def one(pairs: ContactPairs, x0: Array) -> Touching:
        nodes = _nodes(pairs)
        corners = x0[:, nodes] - x0[:, nodes[:1]]
        edges = corners[..., pairs.node_face.shape[1] :]
        u, v = edges[:, 1] - edges[:, 0], edges[:, 3] - edges[:, 2]
        parallel = jnp.maximum(PARALLEL * dot(u, u) * dot(v, v), TINY)
        distance, weights, normal = pair_gaps(pairs, corners)
        pairs = pairs._replace(valid=pairs.valid & (distance > CLOSEST * surface.layer))
        pressed = _factors(pairs, parallel, corners)[0] * barrier(distance, law.stiffness, law.layer)[1]
        return Touching(pairs, corners, parallel, distance, weights, normal, pressed)

    return _each(one, x0.ndim)(pairs, x0)


def _factors(pairs: ContactPairs, parallel: Array, corners: Array) -> tuple[Array, Array]:
    """m (c,) of all pairs, 0 for an empty place; gradients [1/m] (3, 4, c") of those of edges."""
    met = pairs.node_face.shape[1]
    crossing, slopes = _crossing(parallel, corners[..., met:])
    return jnp.where(pairs.valid, jnp.concatenate([jnp.ones_like(crossing, shape=met), crossing]), 0.0), slopes


def pair_balance(touching: Touching, law: PairLaw, dt: Array, u: Array) -> tuple[Array, Array]:
    """Energy [J] and forces [N] (3, n[, b]) of the body's contact with itself after a displacement `u` [m]."""

    def one(touching: Touching, u: Array) -> tuple[Array, Array]:
        pairs, nodes = touching.pairs, _nodes(touching.pairs)
        met = pairs.node_face.shape[1]
        moved = settled(u[:, nodes])
        # The displacement acts through its differences: single precision knows no distance of two positions.
        corners = settled(touching.corners + (moved - moved[:, :1]))
        distance, weights, normal = pair_gaps(pairs, corners)
        factor, slopes = _factors(pairs, touching.parallel, corners)
        energy, push, _ = barrier(distance, law.stiffness, law.layer)
        slip = along_surface(jnp.sum(touching.weights * moved, axis=1), touching.normal)
        grip = -friction_grip(slip, touching.pressed, law.friction, law.stick_speed, dt) * slip
        pulls = (factor * push * normal)[:, None] * weights + grip[:, None] * touching.weights
        pulls = pulls.at[..., met:].add(-jnp.where(pairs.valid, energy, 0.0)[met:] * slopes)
        rubbed = friction_energy(slip, touching.pressed, law.friction, law.stick_speed, dt)
        return jnp.sum(factor * energy + rubbed), jnp.zeros_like(u).at[:, nodes].add(pulls)

    return jax.lax.cond(
        jnp.any(touching.pairs.found > 0),
        lambda: _of_the_taken(lambda some: _each(one, u.ndim)(some, u), touching),
        lambda: (jnp.zeros(u.shape[2:], u.dtype), jnp.zeros_like(u)),
    )


def _of_the_taken(what: Callable[[Touching], Any], touching: Touching) -> Any:
    """`what` of `touching`, without the places at its end where they are empty: taken are the first ones of a kind."""
    met, crossed = (kind.shape[1] for kind in (touching.pairs.node_face, touching.pairs.edge_edge))
    few, few_crossed = (math.ceil(FEW * places) for places in (met, crossed))

    def first(part: Array, axis: int) -> Array:
        faced, edges = (slice(0, few), slice(met, met + few_crossed))
        every = (slice(None),) * axis
        return jnp.concatenate([part[(*every, faced)], part[(*every, edges)]], axis=axis)

    def shorter() -> Any:
        pairs = touching.pairs
        return what(
            Touching(
                pairs=pairs._replace(
                    node_face=pairs.node_face[:, :few],
                    edge_edge=pairs.edge_edge[:, :few_crossed],
                    valid=first(pairs.valid, 0),
                ),
                corners=first(touching.corners, 2),
                parallel=touching.parallel[:few_crossed],
                distance=first(touching.distance, 0),
                weights=first(touching.weights, 1),
                normal=first(touching.normal, 1),
                pressed=first(touching.pressed, 0),
            )
        )

    valid = touching.pairs.valid
    many = jnp.any(valid[few:met]) | jnp.any(valid[met + few_crossed :])
    return jax.lax.cond(many, lambda: what(touching), shorter)


def longest_way(surface: ContactSurface, touching: Touching, shift: Array, u: Array, direction: Array) -> Array:
    """The most of a `direction` [m] (3, n[, b]) that may follow a displacement `u`, at most 1, shape () or (b,).

    `shift` [m] (3, n[, b]): how far the body's shape had changed at the step's beginning since the pairs were found.

    No pair may lose more than 1 - KEPT of its distance. Where it is least, n separates both sides like two planes, each
    touching one: as long as the planes are apart, so are the sides, and sliding along them costs nothing. And no node
    may come near what is no pair: 0 where new pairs have to be looked for first.
    """

    def one(touching: Touching, u: Array, direction: Array) -> Array:
        moved = settled(u[:, _nodes(touching.pairs)])
        corners = settled(touching.corners + (moved - moved[:, :1]))
        distance, _, normal = pair_gaps(touching.pairs, corners)
        return _room(touching.pairs, corners, distance, normal, direction)

    between = jax.lax.cond(
        jnp.any(touching.pairs.found > 0),
        lambda: _of_the_taken(lambda some: _each(one, u.ndim)(some, u, direction), touching),
        lambda: jnp.ones(u.shape[2:], u.dtype),
    )
    return jnp.minimum(between, _unwatched(surface, shift + from_middle(u), direction))


def first_way(surface: ContactSurface, touching: Touching, shift: Array, direction: Array) -> Array:
    """The `longest_way` at the step's beginning, where all distances are known."""

    def one(touching: Touching, direction: Array) -> Array:
        return _room(touching.pairs, touching.corners, touching.distance, touching.normal, direction)

    return jnp.minimum(_each(one, direction.ndim)(touching, direction), _unwatched(surface, shift, direction))


def _room(pairs: ContactPairs, corners: Array, distance: Array, normal: Array, direction: Array) -> Array:
    ahead, met = settled(direction[:, _nodes(pairs)]), pairs.node_face.shape[1]
    height, climb = dot(normal[:, None], corners), dot(normal[:, None], ahead - ahead[:, :1])

    def room(first: int, some: slice) -> Array:
        apart = height[:first, None, some] - height[None, first:, some] - KEPT * distance[some]
        closing = climb[None, first:, some] - climb[:first, None, some]
        length = jnp.where(closing > 0.0, jnp.maximum(apart, 0.0) / jnp.where(closing > 0.0, closing, 1.0), 1.0)
        return jnp.min(jnp.where(pairs.valid[some], length, 1.0), initial=1.0)

    return jnp.minimum(room(1, slice(met)), room(2, slice(met, None)))


def _unwatched(surface: ContactSurface, moved: Array, direction: Array) -> Array:
    """How far nodes that have `moved` [m] since pairs were looked for may go before others can touch, () or (b,)."""
    ahead = from_middle(direction)
    speed, gain = dot(ahead, ahead) + TINY, dot(moved, ahead)
    left = jnp.maximum(0.0, (0.5 * surface.margin) ** 2 - dot(moved, moved))
    length = jnp.min((jnp.sqrt(gain**2 + speed * left) - gain) / speed, axis=0)
    # However long the way: only a body that has changed its shape since has a reason to look again.
    old = jnp.max(dot(moved, moved), axis=0) > (0.25 * surface.margin) ** 2
    return jnp.where(old & (length < LEAST), 0.0, jnp.minimum(length, 1.0))


def contact_room(surface: ContactSurface | None) -> int:
    """How many nodes a `PairStiffness` of this surface holds."""
    return 0 if surface is None else min(FIRMEST, surface.nodes.shape[1])


class PairStiffness(NamedTuple):
    """What contacts add to the stiffness of the `nodes` (m,) that they hold most firmly: `blocks` [N/m] (m, 3, m, 3).

    Faces that lie flat on each other have several times as many contacts as nodes.
    """

    nodes: Array
    blocks: Array


def pair_stiffness(surface: ContactSurface, touching: Touching, law: PairLaw, dt: Array, u: Array) -> PairStiffness:
    """What the body's contact with itself adds to its stiffness after a displacement `u` [m], (3, n).

    Without what would make it indefinite: that normals turn, and that edges become parallel.
    """
    nodes, room = _nodes(touching.pairs), contact_room(surface)
    moved = u[:, nodes]
    corners = touching.corners + (moved - moved[:, :1])
    distance, weights, normal = pair_gaps(touching.pairs, corners)
    slip = along_surface(jnp.sum(touching.weights * moved, axis=1), touching.normal)
    grip = friction_grip(slip, touching.pressed, law.friction, law.stick_speed, dt)
    stiff = _factors(touching.pairs, touching.parallel, corners)[0] * barrier(distance, law.stiffness, law.layer)[2]
    firmness = jnp.zeros_like(u[0]).at[nodes].add(weights**2 * stiff + touching.weights**2 * grip)
    _, firmest = jax.lax.top_k(firmness, room)
    place = jnp.full(u.shape[1], room).at[firmest].set(jnp.arange(room))[nodes]
    # A contact that is not known whole would tie the nodes that are known to a fixed point.
    whole = jnp.all((place < room) | ((weights == 0.0) & (touching.weights == 0.0)), axis=0)
    stiff, grip = (jnp.where(whole, part, 0.0) for part in (stiff, grip))
    along = jnp.eye(3)[..., None] - touching.normal[:, None] * touching.normal
    # (end, end, xyz, xyz, c)
    pushed = (weights[:, None] * weights)[:, :, None, None] * (stiff * normal[:, None] * normal)
    rubbed = (touching.weights[:, None] * touching.weights)[:, :, None, None] * (grip * along)
    added = pushed + rubbed
    axes, one, other = jnp.arange(3), place[:, None, None, None], place[None, :, None, None]
    blocks = jnp.zeros((room, 3, room, 3), added.dtype)
    blocks = blocks.at[one, axes[:, None, None], other, axes[:, None]].add(added, mode="drop")
    return PairStiffness(firmest, blocks)


def _nodes(pairs: ContactPairs) -> Array:
    return jnp.concatenate([pairs.node_face, pairs.edge_edge], axis=1)


def _each(one: Callable[..., Any], dims: int) -> Callable[..., Any]:
    """`one` for a single robot, whose nodes have two dimensions, or for each of a batch along the last axis."""
    return one if dims == 2 else jax.vmap(one, -1, -1)
