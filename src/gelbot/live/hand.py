"""Volts by hand: what was asked of the session, also before a tick has carried it out."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.live.actions import Actions
from gelbot.live.moment import Moment

HAND = "by hand"
GRACE = 0.5
"""Seconds that a session has to seat the hand where something else drove."""
SAME = 1e-6
"""Voltages that differ by less [V] are one."""


class Hand:
    """Sets voltages and remembers those that the session has not told of yet: while it stands still, no tick does."""

    def __init__(self, actions: Actions) -> None:
        self._actions = actions
        self._put: dict[int, float] = {}
        self._when = -GRACE

    def put(self, electrodes: Iterable[int], volts: float) -> None:
        """These electrodes at `volts` [V]; those that refuse are left out. Raises `BadInput` when all of them do."""
        refused, done = None, False
        for electrode in electrodes:
            try:
                self._actions.set_voltage(electrode, volts)
            except BadInput as error:
                refused = error
            else:
                self._put[electrode], self._when, done = volts, time.monotonic(), True
        if refused is not None and not done:
            raise refused

    def toggle(self, electrode: int, volts: float) -> None:
        """This electrode at `volts` [V], or at zero if it has them."""
        moment = self._actions.moment()
        has = moment.controller == HAND and abs(float(self.asked(moment)[electrode]) - volts) < SAME
        self.put([electrode], 0.0 if has else volts)

    def pattern(self, name: str, amplitude: float) -> None:
        """A named pattern with this amplitude [V]."""
        self._actions.set_pattern(name, amplitude)
        self._put.clear()

    def asked(self, moment: Moment) -> NDArray[np.float64]:
        """What the electrodes are to have [V], (e,)."""
        if moment.state == "stopped":
            return moment.given
        is_new = time.monotonic() - self._when < GRACE
        if moment.state == "running" or (moment.controller != HAND and not is_new):
            self._put.clear()
            return moment.asked
        asked = moment.asked.copy()
        for electrode, volts in list(self._put.items()):
            asked[electrode] = volts
        return asked
