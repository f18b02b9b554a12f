"""The desired trajectory of the centre's height (Section IV-D): a rise with rounded ends.

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
