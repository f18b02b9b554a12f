"""The predictive controller: a twin of the robot runs ahead, and says which phase of the programme should be next.

Each tick the twin, a simulation of the scenario's nominal robot, is brought on by what was applied and put right by
what is seen. From its state, every phase of the programme is tried over a horizon: what would become of the motion's
goals if it began now? The best one does begin. The trials are cut into pieces, so many each tick, so that a tick keeps
within its period; the voltages of a phase, its servo and its events stay those of the programme. When the trials take
too long, the programme simply goes on: that is the servo.

It sees what a camera sees: centre, normal, tips. It knows the scenario, not the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gelbot.body.symmetry import rotation
from gelbot.control.programme import Command, Playing, advance, begin, play
from gelbot.motion.reach import Seen, misses
from gelbot.points import Observation, essential, observe
from gelbot.run import Programs, compiled_rollout
from gelbot.scenario.build import Experiment, disturbed
from gelbot.simulate import Controller, Frame, Model, State, start

HORIZON = 9.0
"""How far ahead a phase is tried [s]: about as long as a body takes to topple."""
PIECE = 0.5
"""A trial is computed so much of the horizon [s] at a time."""
PIECES = 4
"""So many pieces each tick, at most."""
FORGOTTEN = 0.8
"""What is left, a piece or a tick without one later, of how long the longest piece took."""
SETTLED = 2.0
"""What counts of the last goal is its mean over the end of the horizon [s]."""
BETTER = 0.15
"""Another phase begins only when it comes nearer to the goals by so much, in units of `motion.reach.SCALES`."""
HASTE = 0.02
"""What a second that a goal takes counts against an unit of its shortfall."""
CORRECTION, LEARNING = 0.1, 0.05
"""Shares of the relative difference in the centre's rise by which, each tick, the twin's adsorption and its p_ele
are put right."""
STARTS_AT = 0.3e-3
"""Below this rise [m] the centre says too little about p_ele."""
UPRIGHT = 0.8
"""While its normal's z is above this, the twin is kept where the robot is seen."""
ALIKE = 0.9
"""The twin is believed while the cosine between its normal and the robot's is above this."""


def hold(voltages: Array, time: Array, observation: Observation) -> tuple[Array, Array, None]:
    """A controller that holds the `voltages` that it remembers."""
    return voltages, voltages, None


class Twin(NamedTuple):
    """A robot that runs beside the real one: its `model`, `state`, the factor `strength` on p_ele, and the centre's
    height at the start, `low` [m]."""

    model: Model
    state: State
    strength: Array
    low: Array


class Trial(NamedTuple):
    """A phase on trial: where it stands, and what has been seen on the way."""

    phase: int
    state: State
    memory: Playing
    seen: list[Observation]


Clock = Callable[[], float]


class Predictive:
    """The controller of one robot; `tick` is called once each control period.

    `work`: pieces of trials each tick. With a `clock` [s], none is begun that may not be over by `deadline` [s] after
    the tick began, as long as the longest of late took; `late` counts the ticks that began none for that reason.
    """

    def __init__(
        self,
        experiment: Experiment,
        programs: Programs,
        seen: Observation,
        work: int = PIECES,
        clock: Clock | None = None,
        deadline: float = 0.07,
    ) -> None:
        self.experiment, self.programs, self.work = experiment, programs, work
        self.clock, self.deadline, self.late = clock, deadline, 0
        self._longest = 0.0
        self.programme = experiment.programme
        self.progress = begin(self.programme, seen)
        self.period = experiment.scenario.programme.control_period
        self._piece = max(1, round(PIECE / self.period))
        self.twin = twin_at(experiment, seen)
        self.voltages = jnp.zeros_like(self.programme.phases.patterns[0])
        self.trials: list[Trial] = []
        self.settled = False
        self._start = np.asarray(essential(seen))[:2]

    def tick(self, time: Array, seen: Observation) -> tuple[Array, Command]:
        """The voltages [V], shape (e,), to hold for the next period."""
        began = None if self.clock is None else self.clock()
        if float(time) > 0.5 * self.period:
            self.twin = corrected(self._brought_on(self.twin), seen)
        if believed(self.twin, seen):
            chosen = self._plan(began, seen)
        else:
            # A twin that lies otherwise than the robot knows nothing of its future: the programme goes on as it is.
            chosen, self.trials = None, []
        if chosen is not None and chosen != int(self.progress.phase):
            self.progress = self.progress._replace(phase=jnp.asarray(chosen), began=time)
            self.trials = []
        phase = int(self.progress.phase)
        self.progress, self.voltages, command = _tick(self.programme, self.progress, time, seen)
        if int(self.progress.phase) != phase:
            self.trials = []  # they began in another phase
        return self.voltages, command

    def _brought_on(self, twin: Twin) -> Twin:
        """The twin after a period under the voltages that were applied."""
        state, _, _ = self._rolled(hold, twin.state, self.voltages, 1)
        return twin._replace(state=state)

    def _rolled(self, controller: Controller, state: State, memory: Any, periods: int) -> Any:
        """The twin from `state` on under a controller, a step for each control period."""
        dt = jnp.asarray(self.period, state.positions.dtype)
        return _rolled(self.programs, controller, stronger(self.twin), state, memory, dt, periods, 1)

    def _plan(self, began: float | None, seen: Observation) -> int | None:
        """Go on with the trials; the phase to begin, or None while there is nothing to choose."""
        if self.settled:
            # As long as the goal is kept there is nothing better to choose.
            now = Seen(*(np.asarray(part)[None] for part in seen))
            self.settled = bool(misses(self.experiment.scenario, now, self._start)[-1][0] <= 0.0)
            return None
        if not self.trials:
            self._begin_trials()
        done = 0
        for k, trial in enumerate(self.trials):
            while len(trial.seen) * self._piece * self.period < HORIZON - 1e-9:
                if done >= self.work:
                    return None
                now = 0.0 if self.clock is None else self.clock()
                if began is not None and now - began + self._longest > self.deadline:
                    self.late += done == 0
                    self._longest *= FORGOTTEN
                    return None
                known = len(self.programs)
                trial = self._tried(trial)
                self.trials[k] = trial
                done += 1
                # One that had to be compiled says nothing of the next.
                if self.clock is not None and len(self.programs) == known:
                    jax.block_until_ready(trial.state)
                    self._longest = max(self.clock() - now, FORGOTTEN * self._longest)
        values = {trial.phase: self._value(trial) for trial in self.trials}
        here = int(self.progress.phase)
        best = min(values, key=lambda phase: values[phase])
        self.trials = []
        return best if values[best] < values[here] - BETTER else None

    def _begin_trials(self) -> None:
        """Every phase from the twin's state; first the one that goes on."""
        here, now = int(self.progress.phase), self.twin.state.time
        self.trials = []
        for phase in [here, *(p for p in range(self.programme.phases.patterns.shape[0]) if p != here)]:
            progress = self.progress
            if phase != here:
                progress = progress._replace(phase=jnp.asarray(phase), began=now)
            self.trials.append(Trial(phase, self.twin.state, Playing(self.programme, progress), []))

    def _tried(self, trial: Trial) -> Trial:
        """A piece more of a trial."""
        state, memory, frames = self._rolled(play, trial.state, trial.memory, self._piece)
        return Trial(trial.phase, state, memory, [*trial.seen, frames.observation])

    def _value(self, trial: Trial) -> float:
        """What is missing of the goals after a trial, less is better: each at its best, the last one as it stays."""
        seen = jax.tree.map(lambda *parts: np.concatenate(parts), *trial.seen)
        if not np.isfinite(np.asarray(seen.centre)).all():
            return np.inf
        missing = misses(self.experiment.scenario, Seen(*seen), self._start)
        last = missing[-1][-round(SETTLED / self.period) :]
        if trial.phase == int(self.progress.phase):
            self.settled = bool(missing[-1].max() <= 0.0)
        reached = np.flatnonzero(missing[-1] <= 0.0)
        time = (reached[0] + 1) * self.period if reached.size else HORIZON
        return float(sum(miss.min() for miss in missing[:-1]) + last.mean() + HASTE * time)


_tick = jax.jit(advance)


def _rolled(
    programs: Programs,
    controller: Controller,
    model: Model,
    state: State,
    memory: Any,
    dt: Array,
    periods: int,
    steps: int,
) -> tuple[State, Any, Frame]:
    """`simulate.rollout`, compiled once for robots alike."""
    program = compiled_rollout(programs, controller, model, state, memory, dt, periods, steps)
    return program(model, state, memory, dt, step_error=None)


def stronger(twin: Twin) -> Model:
    """The twin's model with its p_ele as learned."""
    gel = twin.model.gel
    return twin.model._replace(gel=gel._replace(p_ele=gel.p_ele * twin.strength))


def twin_at(experiment: Experiment, seen: Observation) -> Twin:
    """The nominal robot where the real one is seen: moved and turned so that centre and tips come near."""
    nominal = observe(experiment.model.points, experiment.state.positions)
    positions = _onto(experiment.state.positions, nominal, seen)
    model = disturbed(experiment, experiment.model, positions)
    state = start(model, positions)
    return Twin(model, state, jnp.ones((), positions.dtype), observe(model.points, positions).centre[2])


def _onto(positions: Array, own: Observation, seen: Observation) -> Array:
    """The node `positions` [m] of what is `own`, moved and turned in the plane so that centre and tips come onto those
    `seen` (Procrustes)."""
    a, b = (np.asarray(one.tips)[:2] - np.asarray(one.centre)[:2, None] for one in (own, seen))
    way = float(np.arctan2(np.sum(a[0] * b[1] - a[1] * b[0]), np.sum(a * b)))
    moved = np.asarray(seen.centre)[:2] - np.asarray(own.centre)[:2]
    x, centre = np.asarray(positions), np.asarray(own.centre)[:2, None]
    flat = rotation(way) @ (x[:2] - centre) + centre + moved[:, None]
    return jnp.asarray(np.vstack([flat, x[2:]]), x.dtype)


def believed(twin: Twin, seen: Observation) -> bool:
    """Whether the twin lies as the robot is seen to lie."""
    own = observe(twin.model.points, twin.state.positions)
    return float(jnp.sum(own.normal * seen.normal)) > ALIKE


def corrected(twin: Twin, seen: Observation) -> Twin:
    """The twin put right by what is seen: where it lies, and how strongly it has adsorbed.

    A centre that has risen more than the twin's has adsorbed more, by about the same share, and goes on doing so.
    Beyond `UPRIGHT` nothing is put right: a toppling body moves faster than what is seen of it can tell.
    """
    state = twin.state
    own = observe(twin.model.points, state.positions)
    if float(own.normal[2]) < UPRIGHT or float(seen.normal[2]) < UPRIGHT:
        return twin
    rise, own_rise = float(seen.centre[2] - twin.low), float(own.centre[2] - twin.low)
    ads, strength = state.ads, twin.strength
    if rise > STARTS_AT and own_rise > STARTS_AT:
        error = float(np.clip(rise / own_rise - 1.0, -0.5, 0.5))
        ads = jnp.clip(ads * (1.0 + CORRECTION * error), 0.0, 1.0)
        strength = jnp.clip(strength * (1.0 + LEARNING * error), 0.5, 2.0)
    state = state._replace(positions=_onto(state.positions, own, seen), ads=ads)
    return twin._replace(state=state, strength=strength.astype(state.positions.dtype))


def march_predictive(
    experiment: Experiment,
    nominal: Experiment,
    programs: Programs,
    work: int = PIECES,
    clock: Clock | None = None,
) -> Iterator[tuple[Frame, Predictive]]:
    """The robot of `experiment` under the controller, whose twin is the `nominal` one: a frame each period."""
    scenario = experiment.scenario
    period = scenario.programme.control_period
    count = round(scenario.simulation.duration / period)
    steps = round(period / scenario.simulation.time_step)
    dtype = experiment.state.positions.dtype
    dt = jnp.asarray(scenario.simulation.time_step, dtype)
    state = experiment.state
    model = disturbed(experiment, experiment.model, state.positions)
    seen = observe(model.points, state.positions)
    controller = Predictive(nominal, programs, seen, work, clock)
    for _ in range(count):
        voltages, command = controller.tick(state.time, seen)
        state, _, frames = _rolled(programs, hold, model, state, voltages, dt, 1, steps)
        frame = jax.tree.map(lambda values: values[0], frames)
        seen = frame.observation
        yield frame._replace(command=command), controller
