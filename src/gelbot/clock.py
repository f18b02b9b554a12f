"""Clocks for whoever waits: the real one, and one that a test or a simulation moves by hand."""

from __future__ import annotations

import os
import time as machine
from contextlib import suppress
from threading import Lock, get_native_id
from typing import Protocol

EAGER, USUAL = -10, 0
"""The niceness of a thread that must be in time, and of others."""


def be_in_time() -> None:
    """Ask the system to let this thread, and those that it will begin, run before others.

    Many systems allow that only to an administrator: then nothing changes.
    """
    _be(EAGER)


def be_as_others() -> None:
    """Take back `be_in_time` for this thread and those that it will begin."""
    _be(USUAL)


def _be(niceness: int) -> None:
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, get_native_id(), niceness)


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
        self._start = machine.monotonic()

    def now(self) -> float:
        """The time [s]."""
        return machine.monotonic() - self._start

    def wait_until(self, time: float) -> None:
        """Sleep until it is `time` [s]."""
        left = time - self.now()
        if left > 0.0:
            machine.sleep(left)


class HandClock:
    """A clock that stands still but where it is waited for or moved: an hour of it takes as long as its work."""

    def __init__(self, time: float = 0.0) -> None:
        self._now = time

    def now(self) -> float:
        """The time [s]."""
        return self._now

    def wait_until(self, time: float) -> None:
        """Be at `time` [s]."""
        self._now = max(self._now, time)

    def move(self, seconds: float) -> None:
        """Go on by `seconds`, or back: what the clock of a broken machine would do."""
        self._now += seconds


class PacedClock:
    """The time of a simulated gel: `pace` of its seconds to one of another clock's; None: as fast as it is waited for.

    It can stand still, and then goes on where it stood. May be used from any thread.
    """

    def __init__(self, wall: Clock, pace: float | None = 1.0, running: bool = True) -> None:
        self._wall, self._pace, self._running = wall, pace, running
        self._base, self._since = 0.0, wall.now()
        self._lock = Lock()

    def now(self) -> float:
        """The time [s]."""
        with self._lock:
            return self._now()

    def wait_until(self, time: float) -> None:
        """Sleep until it is `time` [s]; come back at once while the clock stands still."""
        with self._lock:
            if self._pace is None:
                self._base = max(self._base, time) if self._running else self._base
                return
            left = (time - self._now()) / self._pace if self._running else 0.0
            until = self._wall.now() + left
        if left > 0.0:
            self._wall.wait_until(until)

    @property
    def pace(self) -> float | None:
        """Its seconds to one of the other clock's."""
        return self._pace

    def set_pace(self, pace: float | None) -> None:
        """Another pace from now on."""
        with self._lock:
            self._stand()
            self._pace = pace

    def stop(self) -> None:
        """Stand still."""
        with self._lock:
            self._stand()
            self._running = False

    def go(self) -> None:
        """Go on."""
        with self._lock:
            self._stand()
            self._running = True

    def set_back(self, time: float) -> None:
        """Be at `time` [s], where that is past: a simulation that cannot keep up takes its time."""
        with self._lock:
            self._stand()
            self._base = min(self._base, time)

    def _now(self) -> float:
        if not self._running or self._pace is None:
            return self._base
        return self._base + (self._wall.now() - self._since) * self._pace

    def _stand(self) -> None:
        self._base, self._since = self._now(), self._wall.now()
