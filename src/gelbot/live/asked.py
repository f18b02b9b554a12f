"""What a user asks of the session, checked against what stands, before the loop hears of it. All raise `BadInput`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.live.ready import OFFERED, SERVO, Ready
from gelbot.plan.templates import template
from gelbot.scenario.explain import BY_OPTION
from gelbot.scenario.schema import Scenario

HIGHEST = 1.0
"""No tank is deeper [m]: a height beyond it is a slip."""


def changed(ready: Ready, changes: Mapping[str, str]) -> tuple[str, ...]:
    """The changes (key=value) that the scenario was chosen with, and these, which it takes."""
    kept = {change.partition("=")[0]: change for change in ready.changes}
    for key, value in changes.items():
        if key.partition(".")[0] not in OFFERED:
            raise BadInput(key, value, "a key of " + ", ".join(OFFERED))
        kept[key] = f"{key}={value}"
    try:
        ready.source.load(list(kept.values()))
    except BadInput as error:
        # It was written on the page.
        raise error.at(error.where.removesuffix(BY_OPTION)) from None
    return tuple(kept.values())


def check_electrode(ready: Ready, electrode: int, volts: float) -> None:
    """An electrode that is driven, and a voltage [V] that the supply may give."""
    states = ready.nominal.scenario.electrodes.states
    if not 0 <= electrode < len(states):
        raise BadInput("electrode", electrode, f"a number from 0 to {len(states) - 1}")
    if states[electrode] != "driven":
        raise BadInput("electrode", electrode, f"an electrode that is driven: this one is {states[electrode]}")
    _check_volts(ready.nominal.scenario, volts)


def pattern(ready: Ready, name: str, amplitude: float) -> NDArray[np.float64]:
    """The voltages [V] (e,) of a named pattern with this `amplitude` [V], zero where nothing is driven."""
    scenario = ready.nominal.scenario
    shares = template(name, ready.nominal.array, np.array(scenario.place), "pattern")
    _check_volts(scenario, amplitude)
    driven = np.array([state == "driven" for state in scenario.electrodes.states])
    return np.where(driven, amplitude * shares, 0.0)


def check_reference(ready: Ready, height: float | None, driver_follows: bool) -> None:
    """A height [m] for a servo to follow, or None; there is a servo, or the present driver follows heights."""
    if height is None:
        return
    if not (np.isfinite(height) and 0.0 <= height <= HIGHEST):
        raise BadInput("reference", height, f"a height from 0 to {HIGHEST:g} m")
    if not driver_follows and SERVO not in ready.controllers:
        raise BadInput("reference", height, "a scenario with a servo, [programme.servo]")


def check_free_to_drive(is_played: bool) -> None:
    """Not where a recording is played."""
    if is_played:
        raise BadInput("voltages", "others", "those of the recording that is played, and nothing else")


def check_pace(pace: float | None) -> None:
    """Simulated seconds to one of the wall clock; None: as fast as it goes."""
    # Slower than the wall clock its loop would be taken for one that has stalled.
    if pace is not None and not (np.isfinite(pace) and pace >= 1.0):
        raise BadInput("pace", pace, "1 or more, or none: as fast as it goes")


def _check_volts(scenario: Scenario, volts: float) -> None:
    limit = scenario.supply.limit
    if not (np.isfinite(volts) and abs(volts) <= limit):
        raise BadInput("voltage", f"{volts:g} V", f"from {-limit:g} V to {limit:g} V, the supply's limit")
