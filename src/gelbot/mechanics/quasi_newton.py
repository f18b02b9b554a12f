"""Limited-memory BFGS with a given approximate inverse Hessian: how an implicit step is solved.

The preconditioner is the inverse of the true stiffness in some nearby shape of the body; the pairs of the two-loop
recursion (Nocedal and Wright, Algorithm 7.4) learn what has changed since, contacts included. A step is taken when it
lowers the energy (Armijo) and does not overshoot; else it is shortened to where the slopes at its ends, or the parabola
through its energies, put the minimum.

A batch of robots, (3, n, b), is iterated until the last of them has converged; those that have keep still meanwhile.
What a robot does depends on its companions within its tolerance only: the pairs of all are stored in step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

MEMORY = 4
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
Longest: TypeAlias = Callable[[Array, Array], Array]
"""(x, direction) -> how much of the direction may be gone at once, at most 1; 0 ends the iteration."""


class _Iterate(NamedTuple):
    x: Array
    energy: Array
    gradient: Array
    norm: Array  # of the gradient
    direction: Array
    length: Array
    shortest: Array  # length that is not shortened further
    rejected: Array  # whether the way of this length was too long
    steps: Array  # (MEMORY, ...) differences of x
    changes: Array  # (MEMORY, ...) differences of the gradient
    inverse_products: Array  # (MEMORY,) 1 / (s . y), zero for an empty place
    iterations: Array
    tried: Array
    newest: Array  # place of the newest pair


def minimise(
    objective: Objective,
    precondition: Callable[[Array], Array],
    x: Array,
    tolerance: Array,
    max_iterations: Array,
    longest: Longest | None = None,
) -> Solution:
    """Find a minimum of `objective` where its gradient vanishes to `tolerance` (2-norm), beginning at `x`.

    `precondition` applies a symmetric positive definite approximate inverse Hessian; no step is longer than `longest`.
    `x` has two dimensions, or three for a batch; then energies, norms and iterations are (b,). A non-finite gradient
    ends the iteration: the residual says so.
    """
    # The first gradient is taken for zero: no way leads from there, and all that happens is that the true one is found.
    empty, far = jnp.zeros((MEMORY, *x.shape), x.dtype), jnp.full(x.shape[2:], jnp.inf, x.dtype)
    first = _Iterate(
        x=x,
        energy=far,
        gradient=jnp.zeros_like(x),
        norm=far,
        direction=jnp.zeros_like(x),
        length=jnp.ones_like(far),
        shortest=jnp.ones_like(far),
        rejected=jnp.zeros(far.shape, bool),
        steps=empty,
        changes=empty,
        inverse_products=jnp.zeros((MEMORY, *far.shape), x.dtype),
        iterations=jnp.zeros(far.shape, int),
        tried=jnp.asarray(0),
        newest=jnp.asarray(0),
    )

    def unfinished(it: _Iterate) -> Array:
        return jnp.any((it.norm > tolerance) & (it.length > 0.0)) & (it.tried < max_iterations)

    last = jax.lax.while_loop(unfinished, lambda it: _advance(it, objective, precondition, tolerance, longest), first)
    return Solution(last.x, last.norm, last.iterations)


def _product(a: Array, b: Array) -> Array:
    """The scalar product over nodes and space, for each robot of a batch."""
    return jnp.sum(a * b, axis=(0, 1))


def _advance(
    it: _Iterate,
    objective: Objective,
    precondition: Callable[[Array], Array],
    tolerance: Array,
    longest: Longest | None = None,
) -> _Iterate:
    running = it.norm > tolerance
    # A new direction only now: who has converged needs none, and who goes less far along the last one, neither.
    found = jax.lax.cond(
        (it.tried > 0) & ~jnp.all(it.rejected),
        lambda: -two_loops(it.gradient, it.steps, it.changes, it.inverse_products, it.newest, precondition),
        lambda: it.direction,
    )
    direction = jnp.where(it.rejected, it.direction, found)
    whole = jnp.ones_like(it.length) if longest is None else longest(it.x, direction)
    length = jnp.where(it.rejected, it.length, whole)
    shortest = jnp.where(it.rejected, it.shortest, SHORTEST * whole)
    s = length * direction
    x = it.x + s
    energy, g = objective(x)
    slope_before, slope_after = _product(it.gradient, direction), _product(g, direction)
    rounding = 10.0 * jnp.finfo(x.dtype).eps * jnp.abs(it.energy)
    uphill = ~(energy <= it.energy + SUFFICIENT_DECREASE * length * slope_before + rounding)
    overshoot = slope_after > -LONGEST_OVERSHOOT * slope_before
    too_long = (uphill | overshoot) & (length > shortest)
    taken = running & ~too_long

    y = g - it.gradient
    product = _product(s, y)
    useful = product > 1e-14 * jnp.sqrt(_product(s, s) * _product(y, y))
    keep = useful & taken
    # What was tried and not taken is no reason to forget a pair.
    some = jnp.any(keep)
    place = (it.newest + some) % MEMORY
    inverse = jnp.where(keep, 1.0 / jnp.where(useful, product, 1.0), 0.0)
    steps, changes, inverses = (
        jax.lax.dynamic_update_index_in_dim(
            old, jnp.where(some, new, jax.lax.dynamic_index_in_dim(old, place, keepdims=False)), place, 0
        )
        for old, new in ((it.steps, s), (it.changes, y), (it.inverse_products, inverse))
    )

    # Where the slope vanishes by the secant, or where the parabola through both energies has its bottom.
    promised = length * slope_before
    by_slope = slope_before / (slope_before - slope_after)
    by_energy = -0.5 * promised / (energy - it.energy - promised)
    share = jnp.where(overshoot, by_slope, by_energy)
    shorter = length * jnp.clip(jnp.where(jnp.isfinite(share), share, 0.1), 0.1, 0.8)
    return _Iterate(
        x=jnp.where(taken, x, it.x),
        energy=jnp.where(taken, energy, it.energy),
        gradient=jnp.where(taken, g, it.gradient),
        norm=jnp.where(taken, jnp.sqrt(_product(g, g)), it.norm),
        direction=direction,
        length=jnp.where(too_long, shorter, length),
        shortest=shortest,
        rejected=too_long,
        steps=steps,
        changes=changes,
        inverse_products=inverses,
        iterations=it.iterations + running,
        tried=it.tried + 1,
        newest=place,
    )


def two_loops(
    q: Array, steps: Array, changes: Array, inverses: Array, newest: Array, precondition: Callable[[Array], Array]
) -> Array:
    """The inverse Hessian times `q`: Algorithm 7.4, with what `precondition` does for its first matrix.

    `steps`, `changes` (MEMORY, ...) and `inverses` (MEMORY[, b]) are the kept pairs, the newest at the place `newest`.
    """
    pairs = [
        tuple(jax.lax.dynamic_index_in_dim(kept, (newest - k) % MEMORY, keepdims=False) for kept in
              (steps, changes, inverses))
        for k in range(MEMORY)
    ]  # fmt: skip
    alphas = []
    for s, y, inverse in pairs:
        alpha = inverse * _product(s, q)
        q = q - alpha * y
        alphas.append(alpha)
    r = precondition(q)
    for (s, y, inverse), alpha in zip(pairs[::-1], alphas[::-1], strict=True):
        beta = inverse * _product(y, r)
        r = r + (alpha - beta) * s
    return r
