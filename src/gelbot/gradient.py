"""Derivatives of a whole motion: where the body goes, by voltages, material and start.

    x = trajectory(model, start, voltages, dt, steps)

is the rollout of `simulate` for given voltages, and can be differentiated: jax.grad of any function of it runs the
steps backwards, each by the implicit function theorem (`mechanics.adjoint`). Never by unrolling the iterations: what is
kept is the state at each step, and nothing else.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, dtypes

from gelbot.adsorption import adsorb
from gelbot.mechanics.adjoint import ENOUGH, renewed, solve_adjoint
from gelbot.mechanics.elastic import Elastic, rest_shape
from gelbot.mechanics.implicit import Mechanics, balance, begin_step, no_preconditioner
from gelbot.mechanics.self_contact import find_pairs, refreshed
from gelbot.mechanics.springs import Lattice
from gelbot.points import body_frame
from gelbot.simulate import AppliedField, Gel, Model, State, apply, start, step, surface_inflow

Tree = TypeVar("Tree")


class Passed(NamedTuple):
    """What is kept of each step: `x0` [m], `v0` [m/s], `displacement` [m] (3, n) and `ads` (f,) at its beginning."""

    x0: Array
    v0: Array
    displacement: Array
    ads: Array


@partial(jax.custom_vjp, nondiff_argnums=(4,))
def trajectory(model: Model, positions: Array, voltages: Array, dt: Array, steps_per_period: int) -> Array:
    """Positions [m], shape (k, 3, n), at the end of `k` control periods, from rest at `positions` [m], (3, n).

    `voltages` [V], shape (k, e), are held for a control period of `steps_per_period` steps `dt` [s]. Derivatives are
    taken by `model` (all but the field's table), `positions` and `voltages`; they are not numbers (NaN) where a step's
    linear system could not be solved. The step's tolerance bounds their accuracy: 1e-8 gives about six digits.
    """
    return _march(model, positions, voltages, dt, steps_per_period)[0]


@partial(jax.jit, static_argnums=(4,))
def _march(model: Model, positions: Array, voltages: Array, dt: Array, steps_per_period: int) -> tuple[Array, Passed]:
    def one(state: State, field: AppliedField) -> tuple[State, Passed]:
        after, _ = step(model, state, field, dt)
        return after, Passed(state.positions, state.velocities, after.positions - state.positions, state.ads)

    def period(state: State, volts: Array) -> tuple[State, tuple[Array, Passed]]:
        field = apply(model, volts)
        state, passed = jax.lax.scan(lambda s, _: one(s, field), state, None, length=steps_per_period)
        return state, (state.positions, passed)

    return jax.lax.scan(period, start(model, positions), voltages)[1]


def _forward(
    model: Model, positions: Array, voltages: Array, dt: Array, steps_per_period: int
) -> tuple[Array, tuple[Model, Array, Array, Passed]]:
    ends, passed = _march(model, positions, voltages, dt, steps_per_period)
    return ends, (model, voltages, dt, passed)


def _backward(steps_per_period: int, kept: tuple[Model, Array, Array, Passed], slope: Array) -> tuple[Any, ...]:
    model, voltages, dt, passed = kept
    slopes = _pull_back(model, voltages, dt, passed, slope)
    (gel, mechanics), at_start, by_voltages = slopes
    zero = _zeros(model)
    by_model = zero._replace(gel=_merge(zero.gel, gel), mechanics=_merge(zero.mechanics, mechanics))
    return by_model, at_start, by_voltages, jnp.zeros_like(dt)


trajectory.defvjp(_forward, _backward)


class _Slopes(NamedTuple):
    """dL by what is ahead of a step: positions, velocities, adsorption; by constants, lists of arrays."""

    x: Array
    v: Array
    ads: Array
    gel: list[Array]
    mechanics: list[Array]


@jax.jit
def _pull_back(
    model: Model, voltages: Array, dt: Array, passed: Passed, slope: Array
) -> tuple[tuple[list[Array], list[Array]], Array, Array]:
    """dL by the constants (floats of gel and mechanics), the start and the voltages, for `slope` dL/dx (k, 3, n)."""
    gel, mech = model.gel, model.mechanics
    last = jax.tree.map(lambda a: a[-1, -1], passed)
    x, f = last.x0, last.ads
    frame = body_frame(model.points, x)
    pairs = None if mech.surface is None else find_pairs(mech.surface, x, frame)
    nothing = _Slopes(
        jnp.zeros_like(x),
        jnp.zeros_like(x),
        jnp.zeros_like(f),
        [jnp.zeros_like(a) for a in _floats(gel)],
        [jnp.zeros_like(a) for a in _floats(mech)],
    )
    solver = (no_preconditioner(mech, ()), jnp.asarray(True), pairs)

    def one(carry: tuple[Any, ...], past: Passed, field: AppliedField) -> tuple[Any, ...]:
        after, (near, is_old, pairs), by_field = carry
        x0, v0, u, ads0 = past

        def shape(x0: Array, ads0: Array, gel: Gel, elastic: Elastic, field: AppliedField) -> tuple[Array, Array]:
            inflow = surface_inflow(model, x0, field)
            ads = adsorb(ads0, inflow, gel.p_ele, gel.p_ads, dt, gel.adsorption_step)
            return ads, rest_shape(elastic, gel.p_l, ads)

        (_, rest), back_shape = jax.vjp(shape, x0, ads0, gel, mech.elastic, field)
        frame = body_frame(model.points, x0)
        if mech.surface is not None:
            pairs = refreshed(mech.surface, pairs, x0, frame)
        begin = begin_step(mech, x0, v0, rest, dt, pairs)
        near = renewed(mech, begin, u, rest, near, frame, is_old)
        adjoint = solve_adjoint(mech, begin, u, after.x + after.v / dt, near, frame)

        def forces(mech: Mechanics, x0: Array, v0: Array, rest: Array) -> Array:
            return balance(mech, begin_step(mech, x0, v0, rest, dt, pairs), u)[1]

        by_mech, by_x0, by_v0, by_rest = jax.vjp(forces, mech, x0, v0, rest)[1](adjoint.force)
        more_x0, by_ads0, by_gel, by_elastic, more_field = back_shape((after.ads, by_rest))
        by_mech = _floats(by_mech._replace(elastic=_sum(by_mech.elastic, by_elastic)))
        before = _Slopes(
            x=after.x + by_x0 + more_x0,
            v=by_v0,
            ads=by_ads0,
            gel=_sum(after.gel, _floats(by_gel)),
            mechanics=_sum(after.mechanics, by_mech),
        )
        return before, (near, adjoint.iterations > ENOUGH, pairs), _sum(by_field, more_field)

    def period(carry: tuple[Any, ...], each: tuple[Array, Array, Passed]) -> tuple[tuple[Any, ...], Array]:
        slopes, solver = carry
        at_end, volts, passed = each
        field, back_field = jax.vjp(lambda volts: apply(model, volts), volts)
        zero = jax.tree.map(jnp.zeros_like, field)
        (slopes, solver, by_field), _ = jax.lax.scan(
            lambda c, past: (one(c, past, field), None),
            (slopes._replace(x=slopes.x + at_end), solver, zero),
            passed,
            reverse=True,
        )
        return (slopes, solver), back_field(by_field)[0]

    (slopes, _), by_voltages = jax.lax.scan(period, (nothing, solver), (slope, voltages, passed), reverse=True)
    return (slopes.gel, slopes.mechanics), slopes.x, by_voltages


def _is_float(leaf: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(leaf), jnp.floating)


def _floats(tree: Any) -> list[Array]:
    """The leaves that have a derivative: numbers, and not indices."""
    return [leaf for leaf in jax.tree.leaves(tree) if leaf.dtype != dtypes.float0 and _is_float(leaf)]


def _sum(one: Tree, other: Tree) -> Tree:
    """Slopes added up; what has no derivative stays as it is."""
    return jax.tree.map(lambda a, b: a if a.dtype == dtypes.float0 else a + b, one, other)


def _zeros(tree: Tree) -> Tree:
    """The slopes of a function that does not depend on `tree`."""
    return jax.tree.map(lambda a: jnp.zeros_like(a) if _is_float(a) else np.zeros(jnp.shape(a), dtypes.float0), tree)


def _merge(zeros: Tree, floats: list[Array]) -> Tree:
    """`zeros` with `floats` in the places of its numbers."""
    left = iter(floats)
    return jax.tree.map(lambda a: a if a.dtype == dtypes.float0 else next(left), zeros)


def stiffened(elastic: Elastic, factor: Array) -> Elastic:
    """The same body with a Young's modulus `factor` times as large: () or (b,)."""
    if isinstance(elastic, Lattice):
        return elastic._replace(
            stiffness=elastic.stiffness[..., None] * factor if jnp.ndim(factor) else elastic.stiffness * factor
        )
    return elastic._replace(lame=elastic.lame * factor, shear=elastic.shear * factor)
