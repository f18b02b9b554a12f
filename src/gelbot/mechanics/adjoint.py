"""How the end of an implicit step depends on its beginning: the implicit function theorem.

A step's displacement u makes the forces vanish, f(u, theta) = 0, with theta all that the step starts from. Then

    du/dtheta = -(df/du)^-1 df/dtheta,

and what comes back from u to theta is lambda^T df/dtheta, with (-df/du) lambda = dL/du: one linear system with the
stiffness of the step, contact and friction included. It is symmetric and positive definite where the step found a
minimum, and is solved by conjugate gradients with the step's own kind of preconditioner.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.implicit import (
    Beginning,
    Mechanics,
    Preconditioner,
    apply_inverse,
    balance,
    build_preconditioner,
)

ACCURACY = 1e-9
"""Residual of the linear system, relative to its right-hand side."""
ENOUGH = 12
"""Iterations above which a new preconditioner is made for the steps that follow."""
MOST = 400
"""Iterations after which the system counts as unsolved."""


class Adjoint(NamedTuple):
    """`force` lambda [m per unit of L] (3, n), not a number where the system was not solved; `iterations`."""

    force: Array
    iterations: Array


class _Iterate(NamedTuple):
    x: Array
    residual: Array
    direction: Array
    product: Array
    iterations: Array


def solve_adjoint(
    mech: Mechanics, begin: Beginning, u: Array, wanted: Array, near: Preconditioner, frame: Array
) -> Adjoint:
    """lambda for `wanted` dL/du (3, n), in a step from `begin` whose displacement was `u` [m], (3, n)."""
    _, change = jax.linearize(lambda u: balance(mech, begin, u)[1], u)
    size = jnp.sqrt(jnp.sum(wanted**2))

    def unfinished(it: _Iterate) -> Array:
        return (jnp.sqrt(jnp.sum(it.residual**2)) > ACCURACY * size) & (it.iterations < MOST)

    def advance(it: _Iterate) -> _Iterate:
        stiff = -change(it.direction)
        length = it.product / jnp.sum(it.direction * stiff)
        residual = it.residual - length * stiff
        # Polak and Ribiere's form: the preconditioner is in single precision, and so never quite symmetric.
        scaled = apply_inverse(mech, near, frame, residual)
        product = jnp.sum(residual * scaled)
        share = jnp.maximum(0.0, (product - jnp.sum(it.residual * scaled)) / it.product)
        return _Iterate(
            it.x + length * it.direction, residual, scaled + share * it.direction, product, it.iterations + 1
        )

    first = apply_inverse(mech, near, frame, wanted)
    start = _Iterate(jnp.zeros_like(wanted), wanted, first, jnp.sum(wanted * first), jnp.asarray(0))
    last = jax.lax.while_loop(unfinished, advance, start)
    solved = jnp.sqrt(jnp.sum(last.residual**2)) <= 1e3 * ACCURACY * size
    return Adjoint(jnp.where(solved, last.x, jnp.nan), last.iterations)


def renewed(
    mech: Mechanics, begin: Beginning, u: Array, rest: Array, near: Preconditioner, frame: Array, is_old: Array
) -> Preconditioner:
    """`near`, or where it `is_old` one made for the end of this step."""
    return jax.lax.cond(is_old, lambda: build_preconditioner(mech, begin, u, rest, frame), lambda: near)
