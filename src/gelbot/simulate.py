"""Voltages in, motion out: the model of Sections II and III as pure functions.

One step follows the chain: voltages -> current density -> adsorption -> rest lengths -> forces -> motion.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jax import Array

from gelbot.adsorption import adsorb
from gelbot.field.lead_field import LeadField, current_density, potential_coefficients
from gelbot.mechanics.batch import dot
from gelbot.mechanics.elastic import rest_shape
from gelbot.mechanics.implicit import Mechanics, Preconditioner, no_preconditioner, solve_step
from gelbot.mechanics.self_contact import ContactPairs, find_pairs
from gelbot.points import EssentialPoints, Observation, body_frame, observe

FRESH = 4
"""Iterations that a step takes with a new preconditioner."""
STALE = 30
"""Iterations beyond `FRESH`, added up over the steps, after which a new preconditioner pays for itself; the mean of a
batch, all of which get theirs at once."""
HALVINGS_MOST = 10
"""A control period is divided by 2 to this, at most: a step that is still too far off then is taken as it is."""


class Gel(NamedTuple):
    """The active surface: its `faces` (3, f) and the constants of Eqs. (2) and (6).

    `p_ele` [m^2/A] per `adsorption_step` [s], `p_ads` per the same step, `p_l`. In a batch each may be (b,).
    """

    faces: Array
    p_ele: Array
    p_ads: Array
    p_l: Array
    adsorption_step: Array


class Model(NamedTuple):
    """All that stays constant during a run.

    `disturbance` [A/m^2/V], shape (f, e): how a gel of another conductivity changes the inflow through its faces, as
    long as its shape is about what it was when that was computed; None: the gel conducts as the solution.
    """

    gel: Gel
    mechanics: Mechanics
    lead: LeadField
    points: EssentialPoints
    disturbance: Array | None = None


class State(NamedTuple):
    """All that changes: `time` [s], `positions` [m] and `velocities` [m/s] (3, n), `ads` (f,).

    `halvings`: where time steps adapt, a control period divided by 2 to this is the next one's try.
    `near` is the solver's warm start, and `strain` the iterations it has cost by being old; `pairs` lists the parts of
    the body that may soon meet, None where it cannot meet itself. They change how fast a step is solved, not its
    solution.
    """

    time: Array
    positions: Array
    velocities: Array
    ads: Array
    near: Preconditioner
    strain: Array
    pairs: ContactPairs | None
    halvings: Array


class StepReport(NamedTuple):
    """How the implicit step was solved: `iterations`, and the `residual` relative to the body's net weight.

    `missed`: contacts of the body with itself for which there was no room; 0, or the step is not to be trusted.
    """

    iterations: Array
    residual: Array
    missed: Array


class Frame(NamedTuple):
    """What is recorded once per control period, at its end; the voltages [V] (e,) held during it.

    `command` is what the controller says of itself (phase, reference, amplitude); `report` is the worst of the period's
    `steps`.
    """

    time: Array
    positions: Array
    ads: Array
    voltages: Array
    observation: Observation
    command: Any
    report: StepReport
    steps: Array


def face_geometry(positions: Array, faces: Array) -> tuple[Array, Array]:
    """Centroids [m] and outward unit normals of surface faces, shape (3, f) each."""
    a, b, c = (positions[:, faces[k]] for k in range(3))
    normal = jnp.cross(b - a, c - a, axis=0)
    return (a + b + c) / 3.0, normal / jnp.maximum(jnp.sqrt(jnp.sum(normal**2, axis=0)), 1e-30)


class AppliedField(NamedTuple):
    """`voltages` [V] (e,) and the potential's coefficients for them: the field of a control period."""

    voltages: Array
    coefficients: Array


def apply(model: Model, voltages: Array) -> AppliedField:
    """The field of `voltages` [V], shape (e,) or (e, b): the superposition of the electrodes' fields."""
    return AppliedField(voltages, potential_coefficients(model.lead, voltages))


def surface_inflow(model: Model, positions: Array, field: AppliedField) -> Array:
    """-i . n [A/m^2] on every surface face, shape (f,): positive where the current enters the gel."""
    centroids, normals = face_geometry(positions, model.gel.faces)
    i = current_density(model.lead, field.coefficients, centroids)
    inflow = -dot(i, normals)
    return inflow if model.disturbance is None else inflow + model.disturbance @ field.voltages


def step(model: Model, state: State, field: AppliedField, dt: Array) -> tuple[State, StepReport]:
    """One time step: the `field` of `apply` is held for `dt` [s]."""
    gel = model.gel
    inflow = surface_inflow(model, state.positions, field)
    ads = adsorb(state.ads, inflow, gel.p_ele, gel.p_ads, dt, gel.adsorption_step)
    rest = rest_shape(model.mechanics.elastic, gel.p_l, ads)
    frame, is_old = body_frame(model.points, state.positions), jnp.mean(state.strain) > STALE
    found, near, pairs = solve_step(
        model.mechanics, state.positions, state.velocities, rest, dt, state.near, frame, is_old, state.pairs
    )
    strain = jnp.where(is_old, 0, state.strain) + jnp.maximum(found.iterations - FRESH, 0)
    velocities = (found.x - state.positions) / dt
    after = State(state.time + dt, found.x, velocities, ads, near, strain, pairs, state.halvings)
    missed = jnp.zeros_like(found.iterations) if pairs is None else pairs.missed
    return after, StepReport(found.iterations, found.residual, missed)


@jax.jit
def start(model: Model, positions: Array) -> State:
    """A body at rest without adsorption at `positions` [m], shape (3, n), or a batch of them, (3, n, b)."""
    batch, surface = positions.shape[2:], model.mechanics.surface
    # The first step makes the preconditioner: it finds the empty one too old.
    return State(
        time=jnp.zeros((), positions.dtype),
        positions=positions,
        velocities=jnp.zeros_like(positions),
        ads=jnp.zeros((model.gel.faces.shape[1], *batch), positions.dtype),
        near=no_preconditioner(model.mechanics, batch),
        strain=jnp.full(batch, STALE + 1),
        pairs=None if surface is None else find_pairs(surface, positions, body_frame(model.points, positions)),
        halvings=jnp.asarray(0),
    )


Controller: TypeAlias = Callable[[Any, Array, Observation], tuple[Any, Array, Any]]
"""(memory, time [s], observation) -> (memory, voltages [V] (e,), what to record of it)."""


def _equal_steps(model: Model, state: State, field: AppliedField, dt: Array, count: int) -> tuple[State, StepReport]:
    """`count` steps `dt` [s], and the worst of their reports."""
    state, report = jax.lax.scan(lambda s, _: step(model, s, field, dt), state, None, length=count)
    return state, jax.tree.map(lambda values: jnp.max(values, axis=0), report)


class _Period(NamedTuple):
    """A control period on the way: `ticks` of its 2^HALVINGS_MOST are over, after `steps` steps; their worst report."""

    state: State
    ticks: Array
    steps: Array
    worst: StepReport


def step_errors(before: State, after: State, dt: Array) -> Array:
    """How far off a step `dt` [s] is, at most, of any node [m]; shape () or (b,).

    Implicit Euler's own error is x" dt^2 / 2 (Hairer and Wanner, Solving Ordinary Differential Equations II, IV.8),
    with the change of the velocity for x" dt.
    """
    change = after.velocities - before.velocities
    return 0.5 * dt * jnp.sqrt(jnp.max(dot(change, change), axis=0))


def _adapted_steps(
    model: Model, state: State, field: AppliedField, period: Array, allowed: Array
) -> tuple[State, StepReport, Array]:
    """A whole `period` [s] in steps whose `step_errors` are `allowed` [m]: a step that is not is tried again, halved.

    They are the period divided by powers of two, at most `HALVINGS_MOST`, and end where twice as long ones would: so
    that the period's end is always met. The longest step follows from the last one, also into the next period.
    """
    whole = 2**HALVINGS_MOST
    size, count = state.positions.shape[2:], jnp.asarray(0)
    none = StepReport(jnp.zeros(size, int), jnp.zeros(size, state.positions.dtype), jnp.zeros(size, int))

    def advance(at: _Period) -> _Period:
        before, halvings = at.state, at.state.halvings
        dt = period / 2.0**halvings
        after, report = step(model, before, field, dt.astype(before.positions.dtype))
        error = jnp.max(step_errors(before, after, dt))
        solved = jnp.all(report.residual <= model.mechanics.tolerance)
        good = ((error <= allowed) & solved) | (halvings >= HALVINGS_MOST)
        ticks = jnp.where(good, at.ticks + whole // 2**halvings, at.ticks)
        # Twice as long has four times the error, and must begin where such a step may.
        longer = (error <= 0.25 * allowed) & (halvings > 0) & (ticks % jnp.maximum(1, 2 * whole // 2**halvings) == 0)
        halvings = jnp.where(good, halvings - longer, halvings + 1)
        # What has been learned of the solver is kept in any case.
        chosen = jax.tree.map(lambda new, old: jnp.where(good, new, old), after, before)
        chosen = chosen._replace(near=after.near, strain=after.strain, pairs=after.pairs, halvings=halvings)
        worst = jax.tree.map(lambda new, old: jnp.where(good, jnp.maximum(new, old), old), report, at.worst)
        return _Period(chosen, ticks, at.steps + good, worst)

    end = jax.lax.while_loop(lambda at: at.ticks < whole, advance, _Period(state, count, count, none))
    # Added up from parts, the time would not be the same as with equal steps.
    return end.state._replace(time=state.time + period), end.worst, end.steps


@partial(jax.jit, static_argnames=("controller", "periods", "steps_per_period"))
def rollout(
    model: Model,
    state: State,
    controller: Controller,
    memory: Any,
    dt: Array,
    periods: int,
    steps_per_period: int,
    step_error: Array | None = None,
) -> tuple[State, Any, Frame]:
    """`periods` control periods of `steps_per_period` steps `dt` [s], compiled as one scan.

    With a `step_error` [m], each period is divided so that no step is farther off than that (`step_errors`) instead.
    The controller sees the body at the beginning of each period, and its voltages are held to the end of it. Returns
    the last state, the controller's memory and the frames, period first.
    """

    def period(carry: tuple[State, Any], _: None) -> tuple[tuple[State, Any], Frame]:
        state, memory = carry
        memory, voltages, command = controller(memory, state.time, observe(model.points, state.positions))
        field = apply(model, voltages)
        if step_error is None:
            (state, worst), steps = _equal_steps(model, state, field, dt, steps_per_period), steps_per_period
        else:
            state, worst, steps = _adapted_steps(model, state, field, dt * steps_per_period, step_error)
        seen = observe(model.points, state.positions)
        frame = Frame(state.time, state.positions, state.ads, voltages, seen, command, worst, jnp.asarray(steps))
        return (state, memory), frame

    (state, memory), frames = jax.lax.scan(period, (state, memory), None, length=periods)
    return state, memory, frames
