"""The implicit Euler step of the body: the positions at its end make all forces balance.

    m (x - x_0 - v_0 dt) / dt^2 = f_elastic(x) + f_contact(x) + f_weight + f_drag(x),    v = (x - x_0) / dt

They are where the incremental energy is least:

    W(x) = sum m |x - x_0 - v_0 dt|^2 / (2 dt^2) + c m |x - x_0|^2 / (2 dt) + w z + W_elastic + W_contact + W_friction

Everything that stays the same during a step is computed once, in `begin_step`. One robot's nodes are (3, n); a batch of
b robots has (3, n, b), and their numbers (b,).
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.batch import dot, wide
from gelbot.mechanics.block_inverse import block_inverse
from gelbot.mechanics.contact import (
    along_surface,
    friction_energy,
    friction_grip,
    normal_energy,
    normal_forces,
    normal_stiffness,
)
from gelbot.mechanics.dissection import Dissection
from gelbot.mechanics.elastic import Elastic, Strained, elastic_at, elastic_balance, elastic_blocks
from gelbot.mechanics.medium import drag_forces, gravity_forces
from gelbot.mechanics.multifrontal import Factor, factorise, solve
from gelbot.mechanics.obstacles import Obstacles, gaps
from gelbot.mechanics.pair_contact import (
    PairLaw,
    Touching,
    contact_room,
    first_way,
    longest_way,
    pair_balance,
    pair_stiffness,
    touch,
)
from gelbot.mechanics.quasi_newton import Solution, minimise
from gelbot.mechanics.self_contact import ContactPairs, ContactSurface, changed, refreshed

PATIENCE = 30
"""Iterations after which a step replaces the preconditioner that it was given."""
LONGER = 60
"""The same for one made within the step, which costs as much as some forty iterations."""
NEARLY = 1e-9
"""Share of the firmest contact that is as good as nothing."""


class Mechanics(NamedTuple):
    """Constants of the body and its surroundings, SI units; index letters n nodes, k obstacles.

    `elastic`: what the body is made of; `dissection`: in which order its stiffness is inverted. `node_mass` [kg] and
    `weight` less buoyancy [N] (n,); `obstacles`, the floor among them, with their friction; `surface`, None for a body
    that cannot meet itself, and its `self_friction`; `contact_stiffness` [N/m], `contact_layer` [m], `stick_speed`
    [m/s], `drag` [1/s]; `tolerance` (times `force_scale` [N]) and `max_iterations` of the step.
    """

    elastic: Elastic
    dissection: Dissection
    node_mass: Array
    weight: Array
    obstacles: Obstacles
    surface: ContactSurface | None
    self_friction: Array
    contact_stiffness: Array
    contact_layer: Array
    stick_speed: Array
    drag: Array
    tolerance: Array
    max_iterations: Array
    force_scale: Array


class Correction(NamedTuple):
    """What the body's contacts with itself change in the inverse A^-1 of its stiffness (Woodbury's formula),

        (A + N N^T)^-1 = A^-1 - Z K Z^T,    Z = A^-1 N,    K = (1 + N^T Z)^-1,

    where N N^T is the stiffness of contacts between some m nodes. A column of N is a load of contacts, in balance: no
    rigid motion, which is soft and would drown the rest in single precision, answers to it.

    `responses` Z (3 m, n, 3), `kernel` K (3 m, 3 m); `present`: whether there are any.
    """

    responses: Array
    kernel: Array
    present: Array


class Preconditioner(NamedTuple):
    """Inverse of the stiffness, front by front, in single precision, and the frame (3, 3) it was made in.

    `correction` for a body that can meet itself, else None.
    """

    factor: Factor
    frame: Array
    correction: Correction | None


class Beginning(NamedTuple):
    """A step's beginning: positions [m] and velocities [m/s] (3, n), `dt` [s], the elastic body there, and for each
    obstacle the unit `normal` (k, 3, n) and the normal force `pressed` [N] (k, n) that its friction goes by; where the
    body touches itself, `touching`."""

    x: Array
    v: Array
    dt: Array
    elastic: Strained
    normal: Array
    pressed: Array
    touching: Touching | None


def begin_step(
    mech: Mechanics,
    x0: Array,
    v0: Array,
    rest: Array,
    dt: Array,
    pairs: ContactPairs | None = None,
) -> Beginning:
    """What a step `dt` [s] from `x0` [m], `v0` [m/s], shape (3, n), with the body's `rest` shape, starts from.

    `pairs` of the body's surface that may meet, None where it has none.
    """
    gap, normal = gaps(mech.obstacles, x0)
    pressed = normal_forces(gap, mech.contact_stiffness, mech.contact_layer)
    touching = None if mech.surface is None or pairs is None else touch(mech.surface, pairs, _pair_law(mech), x0)
    return Beginning(x0, v0, dt, elastic_at(mech.elastic, x0, rest), normal, pressed, touching)


def _pair_law(mech: Mechanics) -> PairLaw:
    """The body's own law of contact: as firm as an obstacle's, in a layer of its own."""
    assert mech.surface is not None
    layer = mech.surface.layer
    return PairLaw(mech.contact_stiffness * mech.contact_layer / layer, layer, mech.self_friction, mech.stick_speed)


def balance(mech: Mechanics, begin: Beginning, u: Array) -> tuple[Array, Array]:
    """W(x0 + u) [J] and the sum of all forces, inertia included [N], shape (3, n), which is minus its gradient.

    `u` [m] is what the nodes have moved in the step. The forces vanish at the end of it.
    """
    dt, mass, weight = begin.dt, wide(mech.node_mass, u[0], 1), wide(mech.weight, u[0], 1)
    elastic, forces = elastic_balance(mech.elastic, begin.elastic, u)
    ahead = u / dt - begin.v
    energy = elastic + jnp.sum(0.5 * mass * (dot(ahead, ahead) + mech.drag / dt * dot(u, u)) + weight * u[2], axis=0)
    forces = forces + drag_forces(u, mass, mech.drag, dt) - mass * ahead / dt + gravity_forces(weight)
    touching = gaps(mech.obstacles, begin.x + u)
    for k, friction in enumerate(mech.obstacles.friction):
        gap, normal, pressed = touching[0][k], touching[1][k], begin.pressed[k]
        slip = along_surface(u, begin.normal[k])
        energy = energy + jnp.sum(
            normal_energy(gap, mech.contact_stiffness, mech.contact_layer)
            + friction_energy(slip, pressed, friction, mech.stick_speed, dt),
            axis=0,
        )
        push = normal_forces(gap, mech.contact_stiffness, mech.contact_layer)
        forces = forces + push * normal - friction_grip(slip, pressed, friction, mech.stick_speed, dt) * slip
    if begin.touching is not None:
        own = pair_balance(begin.touching, _pair_law(mech), dt, u)
        energy, forces = energy + own[0], forces + own[1]
    return energy, forces


def solve_step(
    mech: Mechanics,
    x0: Array,
    v0: Array,
    rest: Array,
    dt: Array,
    near: Preconditioner,
    frame: Array,
    is_old: Array | bool = False,
    pairs: ContactPairs | None = None,
) -> tuple[Solution, Preconditioner, ContactPairs | None]:
    """Solve for the positions at the end of a step `dt` [s]; the solution's residual is relative to `force_scale`.

    `x0` [m], `v0` [m/s], shape (3, n); the elastic body's `rest` shape; `frame` (3, 3) the body's frame now: the
    preconditioner is turned with the body. One that `is_old` is replaced at once, and where the iteration is slow a new
    one is made on the way; the last one comes back with the solution. So do `pairs`, as for `begin_step`: they are
    renewed where the body has changed its shape since they were found, also within the step.
    """
    plain = begin_step(mech, x0, v0, rest, dt)
    allowed, surface = mech.tolerance * mech.force_scale, mech.surface

    def unfinished(carry: tuple[Solution, Preconditioner, Array, ContactPairs | None]) -> Array:
        found, *_ = carry
        return jnp.any(found.residual > allowed) & jnp.all(found.iterations < mech.max_iterations)

    def attempt(
        carry: tuple[Solution, Preconditioner, Array, ContactPairs | None],
    ) -> tuple[Solution, Preconditioner, Array, ContactPairs | None]:
        before, near, is_old, pairs = carry
        begin, u, longest = plain, before.x, None
        if surface is not None and pairs is not None:
            pairs = refreshed(surface, pairs, x0 + u, frame)
            touching = touch(surface, pairs, _pair_law(mech), x0)
            begin = plain._replace(touching=touching)
            shift = changed(pairs, x0, frame)
            longest = partial(longest_way, surface, touching, shift)
            # The first guess, that all moves on, must not let the body pass through itself either.
            ahead = jnp.where(before.iterations > 0, 0.0, dt * v0)
            u = u + first_way(surface, touching, shift, ahead) * ahead

        # The unknown is the displacement, which single precision holds far more finely than the positions.
        def objective(u: Array) -> tuple[Array, Array]:
            energy, forces = balance(mech, begin, u)
            return energy, -forces

        near = jax.lax.cond(is_old, lambda: build_preconditioner(mech, begin, u, rest, frame), lambda: near)
        found = minimise(
            objective=objective,
            precondition=lambda g: apply_inverse(mech, near, frame, g),
            x=u,
            tolerance=allowed,
            max_iterations=jnp.minimum(jnp.where(is_old, LONGER, PATIENCE), mech.max_iterations),
            longest=longest,
        )
        return found._replace(iterations=found.iterations + before.iterations), near, jnp.asarray(True), pairs

    batch = x0.shape[2:]
    # That all moves on is a good first guess, but not into an obstacle.
    free = jnp.all(gaps(mech.obstacles, x0 + dt * v0)[0] > -mech.contact_layer, axis=(0, 1))
    guess = jnp.where(free, dt * v0, 0.0) if pairs is None else jnp.zeros_like(x0)
    first = Solution(guess, jnp.full(batch, jnp.inf, x0.dtype), jnp.zeros(batch, int))
    found, near, _, pairs = jax.lax.while_loop(unfinished, attempt, (first, near, jnp.asarray(is_old), pairs))
    return Solution(x0 + found.x, found.residual / mech.force_scale, found.iterations), near, pairs


def apply_inverse(mech: Mechanics, near: Preconditioner, frame: Array, g: Array) -> Array:
    """The preconditioner times `g` [N], shape (3, n): displacements [m]."""
    single = near.frame.dtype
    turn = jnp.einsum("ij...,kj...->ik...", frame.astype(single), near.frame)
    # Scaled to order one: single precision has no room for forces of 1e-9 N times compliances of 1e3 m/N.
    local = jnp.einsum("ji...,jn...->ni...", turn, (g / mech.force_scale).astype(single))
    found = _inverse_times(mech.dissection, near, local)
    return jnp.einsum("ij...,nj...->in...", turn, found).astype(g.dtype) * mech.force_scale


def _inverse_times(dissection: Dissection, near: Preconditioner, local: Array) -> Array:
    """Displacements (n, 3) for forces `local` (n, 3), both in the frame of the preconditioner."""
    if local.ndim == 3:
        axes: Any = Preconditioner(0, -1, None if near.correction is None else Correction(0, 0, 0))  # pyright: ignore[reportArgumentType] - axes stand where arrays would
        return jax.vmap(_inverse_times, (None, axes, -1), -1)(dissection, near, local)
    found = solve(dissection, near.factor, local)
    if near.correction is None:
        return found
    responses, kernel, present = near.correction

    def corrected() -> Array:
        flat = responses.reshape(responses.shape[0], -1)
        return found - ((kernel @ (flat @ local.ravel())) @ flat).reshape(found.shape)

    return jax.lax.cond(present, corrected, lambda: found)


def build_preconditioner(mech: Mechanics, begin: Beginning, u: Array, rest: Array, frame: Array) -> Preconditioner:
    """Invert the stiffness of a step that began at `begin`, after a displacement `u` [m], (3, n), without what would
    make it indefinite.

    In double precision: the rigid motions of the body are a million times softer than its springs.
    """
    x, v, rest = (a.astype(jnp.float64) for a in (begin.x + u, u / begin.dt, rest))
    dt = begin.dt
    own, between = elastic_blocks(mech.elastic, x, rest)
    mass = wide(mech.node_mass, x[0], 1)
    inertia = mass / dt**2 + mech.drag * mass / dt
    gap, normal = gaps(mech.obstacles, x)
    for axis in range(3):
        own = own.at[axis, axis].add(inertia)
    for k, friction in enumerate(mech.obstacles.friction):
        pressed = normal_forces(gap[k], mech.contact_stiffness, mech.contact_layer)
        slip = along_surface(dt * v, normal[k])
        grip = friction_grip(slip, pressed, friction, mech.stick_speed, dt)
        stiff = normal_stiffness(gap[k], mech.contact_stiffness, mech.contact_layer)
        own = own + (stiff - grip) * normal[k][:, None] * normal[k][None]
        for axis in range(3):
            own = own.at[axis, axis].add(grip)
    one = partial(factorise, mech.dissection, dtype=jnp.float32)
    own, between = jnp.moveaxis(own, 2, 0), jnp.moveaxis(between, 2, 0)
    factor = one(own, between) if x.ndim == 2 else jax.vmap(one, -1)(own, between)
    correction = None if begin.touching is None else _correction(mech, factor, begin, u)
    return Preconditioner(factor, frame.astype(jnp.float32), correction)


def _correction(mech: Mechanics, factor: Factor, begin: Beginning, u: Array) -> Correction:
    touching, law = begin.touching, _pair_law(mech)
    assert touching is not None
    present = jnp.any(touching.pairs.found > 0)

    def one(factor: Factor, touching: Touching, u: Array) -> Correction:
        assert mech.surface is not None
        nodes, blocks = pair_stiffness(mech.surface, touching, law, begin.dt, u)
        m = 3 * len(nodes)
        stiffness = blocks.reshape(m, m).astype(jnp.float64)
        present = jnp.any(stiffness != 0.0)
        # Contacts hold fewer directions than nodes have: a little more makes their stiffness definite.
        loads = jnp.linalg.cholesky(stiffness + (NEARLY * jnp.max(stiffness) + ~present) * jnp.eye(m))
        forces = jnp.zeros((m, u.shape[1], 3), jnp.float32)
        forces = forces.at[:, nodes].set(loads.T.reshape(m, -1, 3).astype(jnp.float32))
        responses = jax.vmap(lambda f: solve(mech.dissection, factor, f))(forces)
        inner = responses[:, nodes].reshape(m, m).astype(jnp.float64) @ loads
        kernel = block_inverse(jnp.eye(m) + 0.5 * (inner + inner.T))
        return Correction(responses, kernel.astype(jnp.float32), present)

    def found() -> Correction:
        if u.ndim == 2:
            return one(factor, touching, u)
        return jax.vmap(one, (0, -1, -1))(factor, touching, u)

    return jax.lax.cond(present, found, lambda: _no_correction(mech, u.shape[1], u.shape[2:]))


def _no_correction(mech: Mechanics, count: int, batch: tuple[int, ...]) -> Correction:
    room = contact_room(mech.surface)
    return Correction(
        jnp.zeros((*batch, 3 * room, count, 3), jnp.float32),
        jnp.zeros((*batch, 3 * room, 3 * room), jnp.float32),
        jnp.zeros(batch, bool),
    )


def no_preconditioner(mech: Mechanics, batch: tuple[int, ...]) -> Preconditioner:
    """An empty one for a body of `mech`, or for a `batch` of (b,): it is to be replaced before it is used."""
    inverses, transfers = [], []
    for level in mech.dissection.levels:
        fronts, s = level.pivots.shape
        t = level.outputs.shape[1]
        inverses.append(jnp.zeros((*batch, fronts, 3 * s, 3 * s), jnp.float32))
        transfers.append(jnp.zeros((*batch, fronts, 3 * t, 3 * s), jnp.float32))
    frame = jnp.eye(3, dtype=jnp.float32).reshape(3, 3, *(1 for _ in batch))
    none = None if mech.surface is None else _no_correction(mech, mech.node_mass.shape[0], batch)
    return Preconditioner(Factor(tuple(inverses), tuple(transfers)), jnp.broadcast_to(frame, (3, 3, *batch)), none)
