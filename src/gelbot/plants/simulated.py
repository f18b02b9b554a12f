"""A simulated gel in real time: it moves on as its clock does, under whatever voltages its electrodes have."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.errors import SimulationFailed
from gelbot.plant import Sighting, as_seen
from gelbot.points import Observation, observe
from gelbot.scenario.build import Experiment, disturbed
from gelbot.simulate import Model, State, StepReport, apply, step

Floats = NDArray[np.float64]
SLACK = 1e-6
"""Times that are added up are off by less than this [s]."""
DISTURBED_EVERY = 1.0
"""A gel that conducts otherwise than its solution disturbs the field anew this often [s]."""


@partial(jax.jit, static_argnames=("count",))
def held(model: Model, state: State, voltages: Array, dt: Array, count: int) -> tuple[State, Observation, StepReport]:
    """`count` steps of `dt` [s] under `voltages` [V], (e,): the state, what is seen of it, the worst of the reports."""
    field = apply(model, voltages)
    state, reports = jax.lax.scan(lambda s, _: step(model, s, field, dt), state, None, length=count)
    return state, observe(model.points, state.positions), jax.tree.map(lambda v: jnp.max(v, axis=0), reports)


class SimulatedGel:
    """The gel of an `experiment`, fed by its electrodes: `voltages()` gives what they have [V], (e,).

    `state` and `seen` (the essential points) are those at `time` [s], on the clock of the loop.
    """

    def __init__(self, experiment: Experiment, voltages: Callable[[], Floats], time: float = 0.0) -> None:
        self.experiment, self.time, self._voltages, self._began = experiment, time, voltages, time
        simulation = experiment.scenario.simulation
        self._dt, self._tolerance = simulation.time_step, simulation.tolerance
        self.state = experiment.state
        self._model = disturbed(experiment, experiment.model, self.state.positions)
        self._disturbed = time
        self.seen = as_seen(*observe(self._model.points, self.state.positions))
        # Of the last steps: how well they were solved.
        self.report = StepReport(jnp.asarray(0), jnp.asarray(0.0), jnp.asarray(0))
        self.steps_each_period = round(experiment.scenario.programme.control_period / self._dt)
        self._steps = 0

    @property
    def step(self) -> float:
        """Its time step [s]."""
        return self._dt

    def compile(self) -> None:
        """Compile what `advance` needs, so that the first tick takes no longer than any other."""
        dtype = self.state.positions.dtype
        volts, dt = jnp.zeros(len(self._voltages()), dtype), jnp.asarray(self._dt, dtype)
        for count in {1, self.steps_each_period}:
            # The state that comes out of a step is another one to the compiler than the first, which came out of none.
            state = held(self._model, self.state, volts, dt, count)[0]
            jax.block_until_ready(held(self._model, state, volts, dt, count))

    def advance(self, now: float) -> None:
        """Move on to the last whole time step before `now` [s]. Raises `SimulationFailed`."""
        count = int((now - self.time + SLACK) / self._dt)
        while count > 0:
            # Two programs serve all counts.
            many = self.steps_each_period if count >= self.steps_each_period else 1
            self._advance(many)
            count -= many

    def _advance(self, count: int) -> None:
        dtype = self.state.positions.dtype
        volts, dt = jnp.asarray(self._voltages(), dtype), jnp.asarray(self._dt, dtype)
        state, seen, report = held(self._model, self.state, volts, dt, count)
        self._steps += count
        self.time = self._began + self._steps * self._dt
        residual, missed = float(report.residual), int(report.missed)
        if not (residual <= self._tolerance and missed == 0):
            raise SimulationFailed(self.time - self._began, residual, self._tolerance, np.isfinite(residual), missed)
        self.state, self.seen, self.report = state, as_seen(*seen), report
        if self.time - self._disturbed > DISTURBED_EVERY:
            self._model, self._disturbed = disturbed(self.experiment, self._model, state.positions), self.time


class Meanwhile:
    """The `clock` of a loop that drives `gel`: while the loop waits, the gel moves on, as a real one would, so that a
    tick need not make up for a whole period."""

    def __init__(self, clock: Clock, gel: SimulatedGel) -> None:
        self._clock, self._gel = clock, gel

    def now(self) -> float:
        """The time [s]."""
        return self._clock.now()

    def wait_until(self, time: float) -> None:
        """Wait for `time` [s]; the last step before it is left to the tick. Raises `SimulationFailed`."""
        while (due := self._gel.time + self._gel.step) < time - SLACK:
            self._clock.wait_until(due)
            if self._clock.now() < due - SLACK:  # it stands still
                return
            self._gel.advance(self._clock.now())
        self._clock.wait_until(time)


class Noise(NamedTuple):
    """How well a sensor sees, standard deviations: `position` [m] of each coordinate of a point, `angle` [rad] of each
    tip's angle and of each turn of the normal."""

    position: float
    angle: float


class SimulatedEye:
    """What a camera would see of a simulated gel: with `noise`, `delay` [s] late.

    `covered`: something stands in front of it, and nothing is seen.
    """

    def __init__(self, gel: SimulatedGel, noise: Noise, delay: float, seed: int = 0) -> None:
        self.gel, self.covered = gel, False
        self.on_seen: Callable[[], None] = lambda: None
        self._noise, self._delay, self._random = noise, delay, np.random.default_rng(seed)
        self._past: deque[Sighting] = deque([self._sighting(gel.time)])

    def look(self, now: float) -> Sighting:
        """The newest picture that has arrived by `now` [s]."""
        self.gel.advance(now)
        if self.covered:
            return self._past[0]._replace(confidence=0.0)
        if self.gel.time > self._past[-1].time:
            self._past.append(self._sighting(self.gel.time))
            self.on_seen()
        while len(self._past) > 1 and self._past[1].time <= now - self._delay + SLACK:
            self._past.popleft()
        return self._past[0]

    def _sighting(self, time: float) -> Sighting:
        seen, (position, angle), draw = self.gel.seen, self._noise, self._random.standard_normal
        normal = seen.normal + angle * np.cross(draw(3), seen.normal)
        noisy = as_seen(
            centre=seen.centre + position * draw(3),
            normal=normal / np.linalg.norm(normal),
            tips=seen.tips + position * draw(seen.tips.shape),
            tip_angles=seen.tip_angles + angle * draw(seen.tip_angles.shape),
        )
        return Sighting(time, noisy, 1.0)
