"""A programme: phases of voltage patterns, each with its amplitude, and the events that end them.

Preparation and transition of Section IV-D are two such phases. Like the servo it works on any plant: it sees time and
essential points, and gives voltages.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from gelbot.control.servo import saturate, servo
from gelbot.points import Observation

CLOCK_SLACK = 1e-4
"""Added up in single precision, a minute of steps is off by less than this [s]."""


class Phases(NamedTuple):
    """Constant data of `p` phases.

    `patterns` (p, e): share of the amplitude on each electrode. `uses_servo` (p,): amplitude from the servo, else
    `amplitudes` [V] (p,). The servo follows the programme's reference, or the phase's own height `holds` [m] (p,) where
    that is not NaN. A phase ends when all its conditions hold: the centre's `heights` [m] reached, the leading
    tip's angle `tip_angles` [rad] reached, the normal's z below `normals`, or when it is `durations` [s] old. A
    condition that does not count is -inf (height, angle) or +inf (normal, duration); `conditional` (p,) tells whether
    any of the first three counts.
    """

    patterns: Array
    amplitudes: Array
    uses_servo: Array
    holds: Array
    heights: Array
    tip_angles: Array
    normals: Array
    conditional: Array
    durations: Array


class Programme(NamedTuple):
    """Phases with the servo's constants; the reference z_d is linear between `reference_times` [s] and
    `reference_heights` [m]; `limit` [V] of the supply, control `period` [s]."""

    phases: Phases
    reference_times: Array
    reference_heights: Array
    kp: Array
    kv: Array
    sign: Array
    limit: Array
    period: Array


class Progress(NamedTuple):
    """Where a programme stands: `phase`, the time [s] it began, the last height [m] seen."""

    phase: Array
    began: Array
    last_height: Array


class Command(NamedTuple):
    """What the programme did: `phase`, `amplitude` E [V], `reference` z_d [m]."""

    phase: Array
    amplitude: Array
    reference: Array


def begin(observation: Observation) -> Progress:
    """A programme at its beginning; the height seen first gives the first velocity, zero."""
    return Progress(jnp.asarray(0), jnp.zeros_like(observation.centre[2]), observation.centre[2])


def is_over(phases: Phases, progress: Progress, time: Array, observation: Observation) -> Array:
    """Whether the present phase ends now: its event has happened, or its time has run out."""
    k = progress.phase
    # The servo lifts the whole body; the tip that points down furthest says how far the arms have come.
    vertical = jnp.max(observation.tip_angles)
    event = (
        phases.conditional[k]
        & (observation.centre[2] >= phases.heights[k])
        & (vertical >= phases.tip_angles[k])
        & (observation.normal[2] <= phases.normals[k])
    )
    late = time - progress.began >= phases.durations[k] - CLOCK_SLACK
    return (event | late) & (k < phases.patterns.shape[0] - 1)


def advance(
    programme: Programme, progress: Progress, time: Array, observation: Observation
) -> tuple[Progress, Array, Command]:
    """One control tick: the voltages [V], shape (e,), to hold for the next period."""
    phases = programme.phases
    ends = is_over(phases, progress, time, observation)
    phase = jnp.where(ends, progress.phase + 1, progress.phase)
    began = jnp.where(ends, time, progress.began)

    z = observation.centre[2]
    rise = jnp.interp(time, programme.reference_times, programme.reference_heights)
    reference = jnp.where(jnp.isnan(phases.holds[phase]), rise, phases.holds[phase])
    z_dot = (z - progress.last_height) / programme.period
    driven = servo(z, z_dot, reference, programme.kp, programme.kv, programme.sign)
    amplitude = saturate(jnp.where(phases.uses_servo[phase], driven, phases.amplitudes[phase]), programme.limit)
    voltages = amplitude * phases.patterns[phase]
    return Progress(phase, began, z), voltages, Command(phase, amplitude, reference)


class Playing(NamedTuple):
    """A programme being played: what it is and where it stands; the memory of `play`."""

    programme: Programme
    progress: Progress


def play(memory: Playing, time: Array, observation: Observation) -> tuple[Playing, Array, Command]:
    """`advance` in the form that `gelbot.simulate.rollout` calls a controller."""
    progress, voltages, command = advance(memory.programme, memory.progress, time, observation)
    return Playing(memory.programme, progress), voltages, command
