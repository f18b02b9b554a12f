"""The desired trajectory of an essential point (Section IV-D): a rise with rounded ends, or waypoints; never too fast.

The minimum-jerk blend  s(tau) = 10 tau^3 - 15 tau^4 + 6 tau^5  (Flash and Hogan 1985) starts and ends without
velocity or acceleration; `rounding` mixes it with a straight line, which asks for an almost constant voltage.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def rise(
    low: float, high: float, duration: float, rounding: float = 1.0, count: int = 101
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times [s] and heights [m], shape (count,) each, of a rise from `low` to `high` [m] in `duration` [s]."""
    tau = np.linspace(0.0, 1.0, count)
    blend = 10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5
    return duration * tau, low + (high - low) * (rounding * blend + (1.0 - rounding) * tau)


def no_faster(
    times: NDArray[np.float64], values: NDArray[np.float64], speed: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The same path, delayed where its `values` [m] would change faster than `speed` [m/s]: new times [s], the values.

    Each piece takes its own time or |change| / `speed`, whichever is longer.
    """
    pieces = np.maximum(np.diff(times), np.abs(np.diff(values)) / speed)
    return times[0] + np.concatenate([[0.0], np.cumsum(pieces)]), values
