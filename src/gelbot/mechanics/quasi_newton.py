"""Limited-memory BFGS with a given approximate inverse Hessian: how an implicit step is solved.

The preconditioner is the inverse of the true stiffness in some nearby shape of the body; the pairs of the two-loop
recursion (Nocedal and Wright, Algorithm 7.4) learn what has changed since, contacts included. A step is taken when it
lowers the energy (Armijo) and does not overshoot; else it is shortened to where the slopes at its ends, or the parabola
through its energies, put the minimum.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

MEMORY = 8
"""Pairs kept."""
SUFFICIENT_DECREASE = 1e-4
"""Share of the decrease promised by the slope that a step must bring."""
LONGEST_OVERSHOOT = 0.5
"""A step is too long when the slope at its end exceeds this share of the slope at its start, with the other sign."""

SHORTEST = 1e-3
"""Share of the quasi-Newton step below which it is not shortened further."""


class Solution(NamedTuple):
    """Where the iteration stopped: `x`, its `residual` (norm of the gradient) and the `iterations` (gradients)."""

    x: Array
    residual: Array
    iterations: Array


Objective: TypeAlias = Callable[[Array], tuple[Array, Array]]
"""x -> (energy, gradient)."""


class _Iterate(NamedTuple):
    x: Array
    energy: Array
    gradient: Array
    direction: Array
    length: Array
    steps: Array  # (MEMORY, ...) differences of x
    changes: Array  # (MEMORY, ...) differences of the gradient
    inverse_products: Array  # (MEMORY,) 1 / (s . y), zero for an empty place
    iterations: Array


def minimise(
    objective: Objective,
    precondition: Callable[[Array], Array],
    x: Array,
    tolerance: Array,
    max_iterations: Array,
) -> Solution:
    """Find a minimum of `objective` where its gradient vanishes to `tolerance` (2-norm), beginning at `x`.

    `precondition` applies a symmetric positive definite approximate inverse Hessian. A non-finite gradient ends the
    iteration: the residual says so.
    """
    energy, g = objective(x)
    empty = jnp.zeros((MEMORY, *x.shape), x.dtype)
    first = _Iterate(
        x, energy, g, -precondition(g), jnp.ones((), x.dtype), empty, empty, jnp.zeros(MEMORY, x.dtype), jnp.asarray(1)
    )

    def unfinished(it: _Iterate) -> Array:
        norm = jnp.sqrt(jnp.sum(it.gradient**2))
        return (norm > tolerance) & (it.iterations < max_iterations)

    last = jax.lax.while_loop(unfinished, lambda it: _advance(it, objective, precondition), first)
    return Solution(last.x, jnp.sqrt(jnp.sum(last.gradient**2)), last.iterations)


def _advance(it: _Iterate, objective: Objective, precondition: Callable[[Array], Array]) -> _Iterate:
    s = it.length * it.direction
    x = it.x + s
    energy, g = objective(x)
    slope_before, slope_after = jnp.sum(it.gradient * it.direction), jnp.sum(g * it.direction)
    rounding = 10.0 * jnp.finfo(x.dtype).eps * jnp.abs(it.energy)
    uphill = ~(energy <= it.energy + SUFFICIENT_DECREASE * it.length * slope_before + rounding)
    overshoot = slope_after > -LONGEST_OVERSHOOT * slope_before
    too_long = (uphill | overshoot) & (it.length > SHORTEST)

    y = g - it.gradient
    product = jnp.sum(s * y)
    useful = product > 1e-14 * jnp.sqrt(jnp.sum(s**2)) * jnp.sqrt(jnp.sum(y**2))
    keep = useful & ~too_long
    steps = jnp.where(keep, jnp.roll(it.steps, -1, axis=0).at[-1].set(s), it.steps)
    changes = jnp.where(keep, jnp.roll(it.changes, -1, axis=0).at[-1].set(y), it.changes)
    inverse = jnp.where(useful, 1.0 / jnp.where(useful, product, 1.0), 0.0)
    inverses = jnp.where(keep, jnp.roll(it.inverse_products, -1).at[-1].set(inverse), it.inverse_products)

    # Where the slope vanishes by the secant, or where the parabola through both energies has its bottom.
    promised = it.length * slope_before
    by_slope = slope_before / (slope_before - slope_after)
    by_energy = -0.5 * promised / (energy - it.energy - promised)
    share = jnp.where(overshoot, by_slope, by_energy)
    shorter = it.length * jnp.clip(jnp.where(jnp.isfinite(share), share, 0.1), 0.1, 0.8)
    return _Iterate(
        x=jnp.where(too_long, it.x, x),
        energy=jnp.where(too_long, it.energy, energy),
        gradient=jnp.where(too_long, it.gradient, g),
        direction=jnp.where(too_long, it.direction, -_two_loops(g, steps, changes, inverses, precondition)),
        length=jnp.where(too_long, shorter, jnp.ones_like(it.length)),
        steps=steps,
        changes=changes,
        inverse_products=inverses,
        iterations=it.iterations + 1,
    )


def _two_loops(
    q: Array, steps: Array, changes: Array, inverses: Array, precondition: Callable[[Array], Array]
) -> Array:
    alphas = []
    for k in reversed(range(MEMORY)):
        alpha = inverses[k] * jnp.sum(steps[k] * q)
        q = q - alpha * changes[k]
        alphas.insert(0, alpha)
    r = precondition(q)
    for k in range(MEMORY):
        beta = inverses[k] * jnp.sum(changes[k] * r)
        r = r + (alphas[k] - beta) * steps[k]
    return r
