"""A programme: phases of voltage patterns, each with its amplitude, and the events that end them.

Preparation and transition of Section IV-D are two such phases. Like the servo it works on any plant: it sees time and
essential points, and gives voltages.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from gelbot.control.servo import filtered_rate, saturate, servo, slew
from gelbot.points import Observation, essential

CLOCK_SLACK = 1e-4
"""Added up in single precision, a minute of steps is off by less than this [s]."""

ANGLE, NORMAL, ALONG, HEIGHTS = 0, 1, 2, 3
"""Where the quantities of `measured` stand."""


class Phases(NamedTuple):
    """Constant data of `p` phases.

    `patterns` (p, e): share of the amplitude on each electrode. `uses_servo` (p,): amplitude from the servo, else from
    the phase's own profile, linear between `profile_volts` [V] at `profile_times` [s] (p, w) of its age. The servo
    follows the programme's reference, or the phase's own value `holds` [m] (p,) where that is not NaN.

    A phase ends with its event: when all `measured` quantities lie between `lows` and `highs` (p, m), infinite where
    one does not count; `conditional` (p,) tells whether any does. Then phase `after_event` (p,) begins. Without it the
    phase ends when it is `durations` [s] (p,) old, and phase `after_time` (p,) begins.
    """

    patterns: Array
    profile_times: Array
    profile_volts: Array
    uses_servo: Array
    holds: Array
    lows: Array
    highs: Array
    conditional: Array
    durations: Array
    after_event: Array
    after_time: Array


class Programme(NamedTuple):
    """Phases with the servo's constants.

    The servo's z is the sum of `followed` (3, 1 + a) times the essential points, the centre and `a` tips, as they are
    or, `from_start`, counted from where they were first seen. Its reference z_d is linear between `reference_times` [s]
    and `reference_heights` [m]. `limit` [V] of the supply, control `period` [s]; `slew_rate` [V/s] limits the servo's
    command, `rate_filter` [s] smooths the velocity that it sees.
    """

    phases: Phases
    followed: Array
    from_start: Array
    reference_times: Array
    reference_heights: Array
    kp: Array
    kv: Array
    sign: Array
    slew_rate: Array
    rate_filter: Array
    limit: Array
    period: Array


class Progress(NamedTuple):
    """Where a programme stands: `phase`, the time [s] it `began`; what the servo saw last, z `last_height` [m] (before
    `origin` [m] is taken off), its filtered `rate` [m/s], and the last `amplitude` [V] of all."""

    phase: Array
    began: Array
    origin: Array
    last_height: Array
    rate: Array
    amplitude: Array


class Command(NamedTuple):
    """What the programme did: `phase`, `amplitude` E [V], `reference` z_d [m]."""

    phase: Array
    amplitude: Array
    reference: Array


def measured(observation: Observation, along: Array) -> Array:
    """What a phase's event can depend on, (4 + a,): the steepest of the tips' angles [rad], the normal's z, how far
    `along` [m] the followed point is, and the heights [m] of the essential points, the centre and `a` tips."""
    heights = essential(observation)[2]
    # The servo lifts the whole body; the tip that points down furthest says how far the arms have come.
    return jnp.concatenate([jnp.max(observation.tip_angles)[None], observation.normal[2:], along[None], heights])


def _followed(programme: Programme, observation: Observation) -> Array:
    """The servo's z [m]."""
    return jnp.sum(programme.followed * essential(observation))


def begin(programme: Programme, observation: Observation) -> Progress:
    """A programme at its beginning; the place seen first gives the first velocity, zero."""
    z = _followed(programme, observation)
    zero = jnp.zeros_like(z)
    return Progress(jnp.asarray(0), zero, jnp.where(programme.from_start, z, 0.0), z, zero, zero)


def next_phase(phases: Phases, progress: Progress, time: Array, seen: Array) -> Array:
    """The phase after this tick: another one when its event has happened in what is `seen` (see `measured`), or its
    time has run out."""
    k = progress.phase
    event = phases.conditional[k] & jnp.all((seen >= phases.lows[k]) & (seen <= phases.highs[k]))
    late = time - progress.began >= phases.durations[k] - CLOCK_SLACK
    return jnp.where(event, phases.after_event[k], jnp.where(late, phases.after_time[k], k))


def advance(
    programme: Programme, progress: Progress, time: Array, observation: Observation
) -> tuple[Progress, Array, Command]:
    """One control tick: the voltages [V], shape (e,), to hold for the next period."""
    phases = programme.phases
    z = _followed(programme, observation)
    phase = next_phase(phases, progress, time, measured(observation, z - progress.origin))
    began = jnp.where(phase == progress.phase, progress.began, time)

    rate = filtered_rate(
        (z - progress.last_height) / programme.period, progress.rate, programme.rate_filter, programme.period
    )
    rise = jnp.interp(time, programme.reference_times, programme.reference_heights)
    reference = jnp.where(jnp.isnan(phases.holds[phase]), rise, phases.holds[phase])
    driven = servo(z - progress.origin, rate, reference, programme.kp, programme.kv, programme.sign)
    driven = slew(saturate(driven, programme.limit), progress.amplitude, programme.slew_rate, programme.period)
    profile = jnp.interp(time - began, phases.profile_times[phase], phases.profile_volts[phase])
    amplitude = saturate(jnp.where(phases.uses_servo[phase], driven, profile), programme.limit)
    voltages = amplitude * phases.patterns[phase]
    return Progress(phase, began, progress.origin, z, rate, amplitude), voltages, Command(phase, amplitude, reference)


class Playing(NamedTuple):
    """A programme being played: what it is and where it stands; the memory of `play`."""

    programme: Programme
    progress: Progress


def play(memory: Playing, time: Array, observation: Observation) -> tuple[Playing, Array, Command]:
    """`advance` in the form that `gelbot.simulate.rollout` calls a controller."""
    progress, voltages, command = advance(memory.programme, memory.progress, time, observation)
    return Playing(memory.programme, progress), voltages, command
