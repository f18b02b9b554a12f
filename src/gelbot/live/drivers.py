"""Who can drive on the live bench: a person, the scenario's programme, its servo alone, a predictive controller."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.bench import Decision
from gelbot.control.programme import Command, Phases, Programme, Progress, advance, begin
from gelbot.controllers.predictive import Predictive
from gelbot.points import Observation
from gelbot.scenario.build import Experiment

_advance = jax.jit(advance)


class ByHand:
    """A person: `voltages` [V], (e,), are what was last set."""

    def __init__(self, count: int) -> None:
        self.voltages: NDArray[np.float64] = np.zeros(count)

    def decide(self, time: float, seen: Observation) -> Decision:
        """What was last set."""
        voltages = self.voltages
        return Decision(voltages.copy(), 0, float(np.abs(voltages).max(initial=0.0)), np.nan)


class Programmed:
    """A programme, its servo and its events; `reference` [m]: what the servo follows instead of its own, or None."""

    def __init__(self, programme: Programme) -> None:
        self.reference: float | None = None
        self._programme, self._progress = programme, None
        self._dtype = programme.period.dtype

    def decide(self, time: float, seen: Observation) -> Decision:
        """One tick of the programme. It begins with the first."""
        seen = _cast(seen, self._dtype)
        if self._progress is None:
            self._progress: Progress | None = begin(self._programme, seen)
        programme = held_at(self._programme, self.reference)
        self._progress, volts, command = _advance(programme, self._progress, jnp.asarray(time, self._dtype), seen)
        return _decision(volts, command)


class Predicting:
    """The predictive controller with a twin of the scenario's nominal robot."""

    def __init__(self, nominal: Experiment, clock: bool = True) -> None:
        self._nominal, self._inner = nominal, None
        self._timed = clock
        self._dtype = nominal.state.positions.dtype

    def decide(self, time: float, seen: Observation) -> Decision:
        """One tick; its twin lies where the gel is seen first."""
        import time as clock

        seen = _cast(seen, self._dtype)
        if self._inner is None:
            timed = clock.perf_counter if self._timed else None
            self._inner: Predictive | None = Predictive(self._nominal, {}, seen, clock=timed)
        volts, command = self._inner.tick(jnp.asarray(time, self._dtype), seen)
        return _decision(volts, command)


def held_at(programme: Programme, height: float | None) -> Programme:
    """`programme` whose servo holds `height` [m] in every phase; None: as it is."""
    if height is None:
        return programme
    holds = jnp.full_like(programme.phases.holds, height)
    return programme._replace(phases=programme.phases._replace(holds=holds))


def lifting(programme: Programme) -> Programme:
    """The first phase alone, driven by the servo for ever: it lifts the gel to its reference, and keeps it there."""
    first = jax.tree.map(lambda part: part[:1], programme.phases)
    phases: Phases = first._replace(
        uses_servo=jnp.ones_like(first.uses_servo),
        conditional=jnp.zeros_like(first.conditional),
        durations=jnp.full_like(first.durations, jnp.inf),
        after_event=jnp.zeros_like(first.after_event),
        after_time=jnp.zeros_like(first.after_time),
    )
    return programme._replace(phases=phases)


def _cast(seen: Observation, dtype: Any) -> Observation:
    """What was seen, as the engine's arrays in the scenario's precision."""
    return Observation(*(jnp.asarray(part, dtype) for part in seen))


def _decision(volts: Array, command: Command) -> Decision:
    """What a programme's tick gives, in plain numbers."""
    plain = np.asarray(volts, np.float64)
    return Decision(plain, int(command.phase), float(command.amplitude), float(command.reference))
