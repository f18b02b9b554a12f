"""The programme of a scenario as arrays, which is what is played: patterns, profiles, conditions, the reference."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from gelbot.control.programme import ALONG, ANGLE, HEIGHTS, NORMAL, Phases, Programme
from gelbot.errors import BadInput
from gelbot.field.charge import FieldSolution
from gelbot.plan.carry import carried
from gelbot.plan.templates import superposition
from gelbot.plan.trajectory import no_faster, rise
from gelbot.scenario.programmes import Reference, Until
from gelbot.scenario.schema import Scenario

UP = (0.0, 0.0, 1.0)
STANDS = 0.8
"""A body that stands on its tips is about this share of its reach high: so far up the field of a pattern counts."""


def build_programme(scenario: Scenario, field: FieldSolution, connection: NDArray[np.float64], tips: int) -> Programme:
    """The phases as arrays, for a body of so many `tips`; conditions that a phase does not name are out of reach.

    `field` and `connection` are those of the electrodes, see `Experiment`.

    Raises `BadInput` for a tip that the body does not have.
    """
    programme, servo = scenario.programme, scenario.programme.servo
    times, heights = _reference(programme.reference, scenario.body.thickness / 2.0)
    # Without a reference the servo, if there is one, holds the centre's height.
    point, axis = (0, UP) if programme.reference is None else (programme.reference.point, programme.reference.axis)
    followed = np.zeros((3, 1 + tips))
    followed[:, _point(point, tips, "programme.reference.point")] = axis
    return Programme(
        phases=build_phases(scenario, build_patterns(scenario, field, connection), tips),
        followed=jnp.asarray(followed),
        from_start=jnp.asarray(axis[2] == 0.0),
        reference_times=jnp.asarray(times),
        reference_heights=jnp.asarray(heights),
        kp=jnp.asarray(0.0 if servo is None else servo.kp),
        kv=jnp.asarray(0.0 if servo is None else servo.kv),
        sign=jnp.asarray(-1.0 if servo is not None and servo.sign == "printed" else 1.0),
        slew_rate=jnp.asarray(np.inf if servo is None or servo.slew is None else servo.slew),
        rate_filter=jnp.asarray(0.0 if servo is None else servo.filter),
        limit=jnp.asarray(scenario.supply.limit),
        period=jnp.asarray(programme.control_period),
    )


def _reference(reference: Reference | None, low: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and values [m] of the trajectory to follow; a rise begins at `low` [m], or at 0 along the floor."""
    if reference is None:
        return np.array([0.0, 1.0]), np.array([np.nan, np.nan])  # nothing to follow
    if reference.waypoints is not None:
        times, values = np.array(reference.waypoints).T
    else:
        assert reference.height is not None  # checked by the table
        assert reference.duration is not None
        low = low if reference.axis[2] else 0.0
        times, values = rise(low, reference.height, reference.duration, reference.rounding)
    return (times, values) if reference.speed_limit is None else no_faster(times, values, reference.speed_limit)


def _point(number: int, tips: int, where: str) -> int:
    """`number` of an essential point, checked: 0 is the centre."""
    if number > tips:
        raise BadInput(where, f"tip {number}", f"one of the body's {tips} tips", "gelbot directions numbers them")
    return number


def build_patterns(
    scenario: Scenario, field: FieldSolution, connection: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """The pattern of each phase, (e,), turned as the programme is."""
    place, turn = np.array(scenario.place), scenario.programme.turn
    reach = scenario.body.outline().reach
    # What is not connected to the supply has no voltage of its own.
    driven = np.array(scenario.electrodes.states) == "driven"
    made: dict[str, NDArray[np.float64]] = {}
    for phase in scenario.programme.phases:
        if str(phase.pattern) in made:
            continue
        shares = phase.shares
        pattern = superposition(phase.weights, field.problem.array, place) if shares is None else np.array(shares)
        pattern = pattern * driven
        if turn:
            pattern = carried(field, connection, pattern, place, turn, reach, STANDS * reach).pattern
        made[str(phase.pattern)] = pattern
    return [made[str(phase.pattern)] for phase in scenario.programme.phases]


def build_phases(scenario: Scenario, patterns: list[NDArray[np.float64]], tips: int) -> Phases:
    """The phases of the programme as arrays, see `build_programme`."""
    phases = scenario.programme.phases
    names = [phase.name for phase in phases]
    # All profiles are as long as the longest: the last point once more.
    longest = max(len(phase.profile) for phase in phases)
    profiles = np.array([[*p.profile, *([p.profile[-1]] * (longest - len(p.profile)))] for p in phases])
    lows, highs = (np.full((len(phases), HEIGHTS + 1 + tips), bound) for bound in (-np.inf, np.inf))
    for k, until in enumerate(phase.until or Until.model_construct() for phase in phases):
        points = {
            key: [HEIGHTS + _point(p, tips, f"programme.phases.{k}.until.{key}") for p in getattr(until, key) or ()]
            for key in ("contact", "lifted")
        }
        bounds: list[tuple[NDArray[np.float64], Any, float | None]] = [
            (lows, ANGLE, until.tip_angle),
            (lows, HEIGHTS, until.height),
            (highs, HEIGHTS, until.height_below),
            (lows, NORMAL, until.normal_above),
            (highs, NORMAL, until.normal_below),
            (lows, ALONG, until.along),
            (highs, ALONG, until.along_below),
            (highs, points["contact"], scenario.body.thickness),
            (lows, points["lifted"], scenario.body.thickness),
        ]
        for side, columns, value in bounds:
            if value is not None:
                side[k, columns] = value
    ends = [phase.until for phase in phases]
    following = [min(k + 1, len(phases) - 1) for k in range(len(phases))]

    def leads(key: str) -> jnp.ndarray:
        named = [None if end is None else getattr(end, key) for end in ends]
        return jnp.asarray([after if n is None else names.index(n) for n, after in zip(named, following, strict=True)])

    return Phases(
        patterns=jnp.asarray(np.array(patterns)),
        profile_times=jnp.asarray(profiles[..., 0]),
        profile_volts=jnp.asarray(profiles[..., 1]),
        uses_servo=jnp.asarray([phase.drive == "servo" for phase in phases]),
        holds=jnp.asarray([np.nan if phase.hold is None else phase.hold for phase in phases]),
        lows=jnp.asarray(lows),
        highs=jnp.asarray(highs),
        conditional=jnp.asarray([end is not None and end.has_event for end in ends]),
        durations=jnp.asarray([np.inf if end is None or end.after is None else end.after for end in ends]),
        after_event=leads("then"),
        after_time=leads("otherwise"),
    )
