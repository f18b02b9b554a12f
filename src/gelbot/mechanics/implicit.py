"""The implicit Euler step of the body: the positions at its end make all forces balance.

    m (x - x_0 - v_0 dt) / dt^2 = f_springs(x) + f_contact(x) + f_weight + f_drag(x),    v = (x - x_0) / dt

They are where the incremental energy is least:

    W(x) = sum m |x - x_0 - v_0 dt|^2 / (2 dt^2) + c m |x - x_0|^2 / (2 dt) + w z + W_springs + W_floor + W_friction
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.block_inverse import block_inverse
from gelbot.mechanics.contact import (
    friction_energy,
    friction_grip,
    normal_energy,
    normal_forces,
    normal_stiffness,
)
from gelbot.mechanics.medium import drag_forces, gravity_forces
from gelbot.mechanics.quasi_newton import Solution, minimise
from gelbot.mechanics.springs import spring_balance

PATIENCE = 40
"""Iterations after which a step asks for a new preconditioner."""


class Mechanics(NamedTuple):
    """Constants of the body and its surroundings, SI units; index letters n nodes, s springs.

    `springs` (2, s), `incidence` (d, n) from `node_springs`, `stiffness` [N/m] and `spring_length` [m] (s,);
    `node_mass` [kg] and `weight` less buoyancy [N] (n,); `contact_stiffness` [N/m], `contact_layer` [m], `friction`,
    `stick_speed` [m/s], `drag` [1/s]; `tolerance` (times `force_scale` [N]) and `max_iterations` of the step.
    """

    springs: Array
    incidence: Array
    stiffness: Array
    spring_length: Array
    node_mass: Array
    weight: Array
    contact_stiffness: Array
    contact_layer: Array
    friction: Array
    stick_speed: Array
    drag: Array
    tolerance: Array
    max_iterations: Array
    force_scale: Array


class Preconditioner(NamedTuple):
    """Inverse of the stiffness [m/N], shape (3n, 3n), in single precision, and the frame (3, 3) it was made in."""

    inverse: Array
    frame: Array


def balance(mech: Mechanics, u: Array, x0: Array, v0: Array, rest: Array, dt: Array) -> tuple[Array, Array]:
    """W(x0 + u) [J] and the sum of all forces, inertia included [N], shape (3, n), which is minus its gradient.

    `u` [m] is what the nodes have moved in the step. The forces vanish at the end of it.
    """
    x = x0 + u
    pressed = normal_forces(x0, mech.contact_stiffness, mech.contact_layer)
    elastic, pull = spring_balance(x0, u, mech.springs, mech.stiffness, rest, mech.incidence)
    energy = (
        0.5 * jnp.sum(mech.node_mass * (u / dt - v0) ** 2)
        + 0.5 / dt * jnp.sum(mech.drag * mech.node_mass * u**2)
        + jnp.sum(mech.weight * u[2])
        + elastic
        + normal_energy(x, mech.contact_stiffness, mech.contact_layer)
        + friction_energy(u[:2], pressed, mech.friction, mech.stick_speed, dt)
    )
    grip = friction_grip(u[:2], pressed, mech.friction, mech.stick_speed, dt)
    push = normal_forces(x, mech.contact_stiffness, mech.contact_layer)
    forces = (
        pull
        + jnp.concatenate([-grip * u[:2], push[None]])
        + gravity_forces(mech.weight)
        + drag_forces(u, mech.node_mass, mech.drag, dt)
        - mech.node_mass * (u / dt - v0) / dt
    )
    return energy, forces


def solve_step(
    mech: Mechanics, x0: Array, v0: Array, rest: Array, dt: Array, near: Preconditioner, frame: Array
) -> tuple[Solution, Preconditioner]:
    """Solve for the positions at the end of a step `dt` [s]; the solution's residual is relative to `force_scale`.

    `x0` [m], `v0` [m/s], shape (3, n); `rest` lengths [m], shape (s,); `frame` (3, 3) the body's frame now: the
    preconditioner is turned with the body. Where the iteration is slow a new preconditioner is made on the way; the
    last one comes back with the solution.
    """

    # The unknown is the displacement, which single precision holds far more finely than the positions.
    def objective(u: Array) -> tuple[Array, Array]:
        energy, forces = balance(mech, u, x0, v0, rest, dt)
        return energy, -forces

    def attempt(u: Array, near: Preconditioner) -> Solution:
        return minimise(
            objective=objective,
            precondition=lambda g: _precondition(mech, near, frame, g),
            x=u,
            tolerance=mech.tolerance * mech.force_scale,
            max_iterations=jnp.minimum(PATIENCE, mech.max_iterations),
        )

    def unfinished(carry: tuple[Solution, Preconditioner]) -> Array:
        found, _ = carry
        finite = jnp.isfinite(found.residual)
        return finite & (found.residual > mech.tolerance * mech.force_scale) & (found.iterations < mech.max_iterations)

    def renew(carry: tuple[Solution, Preconditioner]) -> tuple[Solution, Preconditioner]:
        before, _ = carry
        fresh = build_preconditioner(mech, x0 + before.x, before.x / dt, rest, dt, frame)
        found = attempt(before.x, fresh)
        return Solution(found.x, found.residual, found.iterations + before.iterations), fresh

    found, near = jax.lax.while_loop(unfinished, renew, (attempt(dt * v0, near), near))
    return Solution(x0 + found.x, found.residual / mech.force_scale, found.iterations), near


def _precondition(mech: Mechanics, near: Preconditioner, frame: Array, g: Array) -> Array:
    single = near.inverse.dtype
    turn = (frame @ near.frame.T).astype(single)
    # Scaled to order one: single precision has no room for forces of 1e-9 N times compliances of 1e3 m/N.
    local = turn.T @ (g / mech.force_scale).astype(single)
    moved = turn @ (near.inverse @ local.ravel()).reshape(local.shape)
    return moved.astype(g.dtype) * mech.force_scale


def build_preconditioner(mech: Mechanics, x: Array, v: Array, rest: Array, dt: Array, frame: Array) -> Preconditioner:
    """Invert the stiffness of a step `dt` [s] in the shape `x` [m], with what would make it indefinite left out."""
    n = x.shape[1]
    # In double precision: the rigid motions of the body are a million times softer than its springs.
    x = x.astype(jnp.float64)
    along = x[:, mech.springs[1]] - x[:, mech.springs[0]]
    length = jnp.sqrt(jnp.sum(along**2, axis=0))
    unit = along / length
    across = jnp.maximum(0.0, 1.0 - rest / length)  # compression softens a spring across its line: left out
    dyad = unit[:, None] * unit[None, :]
    block = mech.stiffness * (dyad + across * (jnp.eye(3)[:, :, None] - dyad))
    i, j = mech.springs
    matrix = jnp.zeros((3, n, 3, n), x.dtype)
    a, b = jnp.meshgrid(jnp.arange(3), jnp.arange(3), indexing="ij")
    for first, second, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
        matrix = matrix.at[a[:, :, None], first, b[:, :, None], second].add(sign * block)
    pressed = normal_forces(x, mech.contact_stiffness, mech.contact_layer)
    grip = friction_grip(dt * v[:2], pressed, mech.friction, mech.stick_speed, dt)
    floor = normal_stiffness(x, mech.contact_stiffness, mech.contact_layer)
    inertia = mech.node_mass / dt**2 + mech.drag * mech.node_mass / dt
    diagonal = (inertia + jnp.stack([grip, grip, floor])).ravel()
    full = matrix.reshape(3 * n, 3 * n) + jnp.diag(diagonal)
    inverse = block_inverse(full)
    return Preconditioner(inverse.astype(jnp.float32), frame)
