"""A plant that is made of an eye and a guard: the bench, and the simulated one."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.hardware.guard import CAMERA, Guard
from gelbot.plant import Sighting


class Eye(Protocol):
    """What sees the gel."""

    def look(self, now: float) -> Sighting:
        """The newest that has been seen by `now` [s]; confidence 0 where the gel is lost."""
        ...


class GuardedPlant:
    """A gel that an `eye` sees and whose voltages pass through a `guard`.

    The guard is told of each new sighting of the gel: electrodes are at zero volts while nobody sees what they do.
    """

    def __init__(self, guard: Guard, eye: Eye, clock: Clock) -> None:
        self.guard, self.eye = guard, eye
        self._clock, self._newest = clock, -np.inf

    def observe(self) -> Sighting:
        """What is seen of the gel."""
        sighting = self.eye.look(self._clock.now())
        if sighting.confidence > 0.0 and sighting.time > self._newest:
            self._newest = sighting.time
            self.guard.feed(CAMERA)
        self.guard.check()
        return sighting

    def apply(self, voltages: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the guard lets through of `voltages` [V], (e,). Raises `BenchStopped`."""
        return self.guard.apply(voltages)
