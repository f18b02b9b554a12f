"""Where a search may begin: voltages found by the derivatives of the motion, on the nominal robot.

A programme whose phases end by time alone, without a servo, is a table V of voltages, periods by electrodes, whatever
the body does. With the shares s in [0, 1] of what may be chosen, and the motion's shortfall L,

    dL/ds = (dV/ds)^T dL/dV,

where dL/dV comes from the motion run backwards (`gradient.trajectory`), all its thousands of numbers for the price of a
few runs; a search without derivatives pays by the number of choices instead. L is the mean square of how far each goal
is missed, over the frames in which it would best be reached. L-BFGS-B (Byrd and others 1995) follows it downhill.

A body that topples makes L rough; a path that ends in a hollow is why this is a beginning and not an end.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.optimize import minimize

from gelbot.control.programme import Playing, play
from gelbot.engine import keep_compiled, prepare_engine
from gelbot.ensemble import scenario_of
from gelbot.errors import BadInput
from gelbot.gradient import trajectory
from gelbot.motion.reach import Seen, outside, quantity_of, windows
from gelbot.planner.search import Search, values_of
from gelbot.points import EssentialPoints, Observation, essential, observe
from gelbot.scenario.build import Experiment, begun, build, disturbed
from gelbot.scenario.schema import Scenario

Floats = NDArray[np.float64]

TOLERANCE = 1e-5
"""Residual of a step: derivatives are as exact as the steps that they belong to."""
STEP = 1e-4
"""Difference of a share by which a voltage's dependence on it is found; in most choices voltages are linear."""
PENALTY = 10.0
"""By how much a place where nothing can be computed is worse than the worst so far."""


class Descent(NamedTuple):
    """Where it ended: `shares`, the mean square miss L `before` and `after`, infinite where it could not be computed,
    and how many `motions` were differentiated."""

    shares: Floats
    before: float
    after: float
    motions: int


class _Enough(Exception):
    """So many motions as were wanted have been differentiated."""


def can_descend(search: Search) -> bool:
    """Whether the voltages depend on what may be chosen, smoothly, and on nothing that the body does."""
    scenario = search.loaded.scenario
    assert scenario.motion is not None
    ranges = all("|" not in one.text for one in search.choices)
    drives = all(
        parts[:2] == ["programme", "phases"] and parts[3] in ("drive", "pattern")
        for parts in (one.key.split(".") for one in search.choices)
    )
    timed = all(
        phase.drive != "servo" and (phase.until is None or not phase.until.has_event)
        for phase in scenario.programme.phases
    )
    return ranges and drives and timed and all(goal.quantity != "wrap" for goal in scenario.motion.goals)


def descend(search: Search, motions: int) -> Descent:
    """From the search's start downhill, for at most so many `motions`, 1 or more; the best place on the way."""
    prepare_engine()
    keep_compiled()
    loaded = search.loaded
    base = build(_exact(loaded.scenario))
    model = disturbed(base, base.model, base.state.positions)
    period, dt = loaded.scenario.programme.control_period, jnp.asarray(loaded.scenario.simulation.time_step)
    steps = round(period / loaded.scenario.simulation.time_step)
    started = np.asarray(essential(observe(model.points, base.state.positions)))[:2]
    tried: list[tuple[float, Floats]] = []

    def voltages(shares: Floats) -> Floats:
        changed = scenario_of(loaded, values_of(search.choices, shares))
        return schedule(build(_exact(changed), base))

    def value_and_slope(shares: Floats) -> tuple[float, Floats]:
        if len(tried) >= motions:
            raise _Enough
        loss, slope = np.inf, np.zeros_like(shares)
        # A place that the scenario does not allow is a bad one.
        with suppress(BadInput):
            volts = voltages(shares)
            beside = _beside(shares)
            places_beside = np.where(np.eye(len(shares), dtype=bool), beside, shares)
            by_share = np.array([voltages(place) - volts for place in places_beside]) / (beside - shares)[:, None, None]
            differentiated: tuple[Any, Any] = jax.vjp(
                lambda v: trajectory(model, base.state.positions, v, dt, steps), jnp.asarray(volts)
            )
            positions, back = differentiated
            loss, by_positions = _missed(loaded.scenario, model.points, started, positions, period)
            (by_volts,) = back(by_positions)
            slope = np.einsum("ske,ke->s", by_share, np.asarray(by_volts, float))
        tried.append((loss if np.isfinite(loss) else np.inf, np.array(shares)))
        if np.isfinite(loss) and np.isfinite(slope).all():
            return loss, slope
        # Infinity would end the descent; a value high above all others makes its next step shorter.
        finite = [value for value, _ in tried if np.isfinite(value)]
        return PENALTY * (1.0 + max(finite, default=0.0)), np.zeros_like(shares)

    with suppress(_Enough):
        minimize(
            value_and_slope,
            np.clip(search.first, STEP, 1.0 - STEP),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * search.dimension,
            options={"ftol": 1e-6, "gtol": 1e-6},
        )
    best = min(tried, key=lambda one: one[0])
    return Descent(best[1], tried[0][0], best[0], len(tried))


def _beside(shares: Floats) -> Floats:
    """Shares a little further towards the middle."""
    return np.where(shares < 0.5, shares + STEP, shares - STEP)


def _exact(scenario: Scenario) -> Scenario:
    exact = {"tolerance": min(TOLERANCE, scenario.simulation.tolerance), "precision": "float64", "step_error": None}
    return scenario.model_copy(update={"simulation": scenario.simulation.model_copy(update=exact)})


def schedule(experiment: Experiment) -> Floats:
    """The voltages [V] of a programme that goes by time alone, control period by control period, shape (k, e)."""
    scenario = experiment.scenario
    period = scenario.programme.control_period
    times = period * np.arange(round(scenario.simulation.duration / period))
    seen = observe(experiment.model.points, experiment.state.positions)
    return np.asarray(_played(begun(experiment, experiment.state), jnp.asarray(times), seen))


@jax.jit
def _played(memory: Playing, times: Array, seen: Observation) -> Array:
    def tick(memory: Playing, time: Array) -> tuple[Playing, Array]:
        memory, volts, _ = play(memory, time, seen)
        return memory, volts

    return jax.lax.scan(tick, memory, times)[1]


def _missed(
    scenario: Scenario, points: EssentialPoints, places: Floats, positions: Array, period: float
) -> tuple[float, Array]:
    """L of the `positions` (k, 3, n) [m], and its slope by them; `places` (2, 1 + a) [m] where the points began."""
    assert scenario.motion is not None
    goals = scenario.motion.goals

    def quantities(positions: Array) -> list[Any]:
        seen: Any = jax.vmap(lambda x: observe(points, x))(positions)
        return [quantity_of(goal, Seen(*seen), scenario, places) for goal in goals]

    frames = windows(scenario, [np.asarray(one, float) for one in quantities(positions)], period)

    def loss(positions: Array) -> Array:
        total = jnp.zeros(())
        for goal, value, window in zip(goals, quantities(positions), frames, strict=True):
            total = total + jnp.mean(outside(goal, value)[window] ** 2)
        return total

    value, slope = jax.value_and_grad(loss)(positions)
    return float(value), slope
