"""Volts by hand: on and off by a click, on several electrodes at once."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.live.actions import Actions
from gelbot.live.moment import Moment

HAND = "by hand"
SOON = 0.05
"""Seconds beyond a control period in which a session that turns has carried out what was asked of it."""
SAME = 1e-6
"""Voltages that differ by less [V] are one."""


class Hand:
    """Sets voltages of a session whose loop turns every `period` [s]."""

    def __init__(self, actions: Actions, period: float) -> None:
        self._actions, self._soon = actions, period + SOON
        # A session does what it is asked between two ticks, and tells of it then: a second click may come before, and
        # must not take the plate for one without volts.
        self._put: dict[int, tuple[float, float]] = {}

    def put(self, electrodes: Iterable[int], volts: float) -> None:
        """These electrodes at `volts` [V]; those that refuse are left out. Raises `BadInput` when all of them do."""
        refused, done = None, False
        for electrode in electrodes:
            try:
                self._actions.set_voltage(electrode, volts)
            except BadInput as error:
                refused = error
            else:
                self._put[electrode], done = (volts, time.monotonic()), True
        if refused is not None and not done:
            raise refused

    def toggle(self, electrode: int, volts: float) -> None:
        """This electrode at `volts` [V], or at zero if it has them."""
        moment = self._actions.moment()
        told = float(wanted(moment)[electrode]) if moment.controller == HAND else np.nan
        put, when = self._put.get(electrode, (told, -np.inf))
        has = put if time.monotonic() - when < self._soon else told
        self.put([electrode], 0.0 if abs(has - volts) < SAME else volts)

    def pattern(self, name: str, amplitude: float) -> None:
        """A named pattern with this amplitude [V]."""
        self._actions.set_pattern(name, amplitude)
        self._put.clear()


def wanted(moment: Moment) -> NDArray[np.float64]:
    """What the electrodes are to have [V], (e,): where everything was stopped, what they have."""
    return moment.given if moment.state == "stopped" else moment.asked
