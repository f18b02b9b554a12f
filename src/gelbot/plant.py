"""What controls share with gels, simulated or real: a plant is seen, and given voltages; nothing more.

seen = plant.observe()
given = plant.apply(voltages)
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.points import Observation


class Sighting(NamedTuple):
    """What was seen of the gel: the essential points, as of `time` [s] on the clock of the loop.

    `confidence` from 0, lost, to 1. Whoever sees nothing new gives the last sighting again, with its own time.
    """

    time: float
    observation: Observation
    confidence: float


class Plant(Protocol):
    """A gel under electrodes, somewhere."""

    def observe(self) -> Sighting:
        """What is seen of it now."""
        ...

    def apply(self, voltages: NDArray[np.float64]) -> NDArray[np.float64]:
        """Hold `voltages` [V], shape (e,), from now on; returns what the electrodes get of them.

        Raises `BenchStopped` when the electrodes are at zero volts and will stay there.
        """
        ...


def as_seen(centre: Any, normal: Any, tips: Any, tip_angles: Any) -> Observation:
    """Essential points from plain numbers, such as a camera's: shapes and units as in `points.Observation`."""
    return Observation(*(np.asarray(part, np.float64) for part in (centre, normal, tips, tip_angles)))  # pyright: ignore
