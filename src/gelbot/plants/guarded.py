"""A plant that is made of an eye and a guard: the bench, and the simulated one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.hardware.guard import CAMERA, Guard
from gelbot.plant import Sighting


class Eye(Protocol):
    """What sees the gel. It calls `on_seen` for each new sighting of it, at once and from whichever thread."""

    on_seen: Callable[[], None]

    def look(self, now: float) -> Sighting:
        """The newest that has been seen by `now` [s]; confidence 0 where the gel is lost."""
        ...


class GuardedPlant:
    """A gel that an `eye` sees and whose voltages pass through a `guard`.

    The guard is told of each new sighting of the gel: electrodes are at zero volts while nobody sees what they do.
    """

    def __init__(self, guard: Guard, eye: Eye, clock: Clock) -> None:
        self.guard, self.eye, self.clock = guard, eye, clock
        eye.on_seen = lambda: guard.feed(CAMERA)

    def observe(self) -> Sighting:
        """What is seen of the gel."""
        sighting = self.eye.look(self.clock.now())
        self.guard.check()
        return sighting

    def apply(self, voltages: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the guard lets through of `voltages` [V], (e,). Raises `BenchStopped`."""
        return self.guard.apply(voltages)
