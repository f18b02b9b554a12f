"""Clocks for whoever waits: the real one, and one that a test or a simulation moves by hand."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Seconds from a beginning of its own, that never go back."""

    def now(self) -> float:
        """The time [s]."""
        ...

    def wait_until(self, time: float) -> None:
        """Come back when it is `time` [s], or at once when that is past."""
        ...


class WallClock:
    """The time since the clock was made. Setting the machine's date does not move it."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def now(self) -> float:
        """The time [s]."""
        return time.monotonic() - self._start

    def wait_until(self, time_: float) -> None:
        """Sleep until it is `time_` [s]."""
        left = time_ - self.now()
        if left > 0.0:
            time.sleep(left)


class HandClock:
    """A clock that stands still but where it is waited for or moved: an hour of it takes as long as its work."""

    def __init__(self, time_: float = 0.0) -> None:
        self._now = time_

    def now(self) -> float:
        """The time [s]."""
        return self._now

    def wait_until(self, time_: float) -> None:
        """Be at `time_` [s]."""
        self._now = max(self._now, time_)

    def move(self, seconds: float) -> None:
        """Go on by `seconds`, or back: what the clock of a broken machine would do."""
        self._now += seconds
