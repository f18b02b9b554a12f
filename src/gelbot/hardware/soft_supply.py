"""A supply made of nothing but numbers: what the bench is tried with where no device is."""

from __future__ import annotations

import math
import threading

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelbot.clock import Clock, WallClock
from gelbot.errors import BadInput, SupplyFailed
from gelbot.hardware.asked_volts import checked_volts
from gelbot.hardware.supply import Reading


class SoftSupply:
    """The soft twin of a supply, with the watchdog of a real one.

    `channel_count` outputs from `lowest` to `highest` [V]. When no voltages were written for `watchdog` [s] of `clock`,
    all outputs are zero until the next ones come; None: it has no watchdog, and keeps its last voltages.
    `expired_count` says how often it had, with voltages on them, when it was last written to. `resolution` [V] is the
    step of its converter, 0 for none. `conductance` [S], shape (c, c), of the load gives the currents that it
    "measures", out of each channel; without, `read` has none. May be asked from any thread. Raises `BadInput`.
    """

    def __init__(
        self,
        channel_count: int = 16,
        *,
        clock: Clock | None = None,
        watchdog: float | None = 0.2,
        lowest: float = -10.0,
        highest: float = 10.0,
        resolution: float = 0.0,
        conductance: ArrayLike | None = None,
        name: str = "soft supply",
    ) -> None:
        if channel_count < 1:
            raise BadInput("channel_count", channel_count, "one channel or more")
        if watchdog is not None and not watchdog > 0.0:
            raise BadInput("watchdog", watchdog, "a time above 0 s, or None for a supply without")
        if not (math.isfinite(resolution) and resolution >= 0.0):
            raise BadInput("resolution", resolution, "a voltage step of 0 V or more")
        if not lowest <= 0.0 <= highest:
            raise BadInput("range", f"{lowest} V .. {highest} V", "a range that 0 V is in")
        self.name, self.channel_count = name, channel_count
        self.watchdog, self.lowest, self.highest, self.resolution = watchdog, lowest, highest, resolution
        self._conductance = checked_conductance(conductance, channel_count)
        self._clock = WallClock() if clock is None else clock
        self._lock = threading.Lock()
        self._volts = np.zeros(channel_count)
        self._written, self.expired_count = -math.inf, 0
        self._closed = False

    def write(self, volts: NDArray[np.float64]) -> None:
        """Put `volts` [V], shape (c,), on the outputs. Raises `SupplyFailed` out of range and once closed."""
        asked = checked_volts(self.name, volts, self.channel_count, self.lowest, self.highest)
        with self._lock:
            if self._closed:
                raise SupplyFailed(self.name, "it was closed", "open it anew")
            self.expired_count += self._is_expired() and bool(self._volts.any())
            step = self.resolution
            self._volts = np.round(asked / step) * step if step else asked
            self._written = self._clock.now()

    def outputs(self) -> NDArray[np.float64]:
        """The voltages [V], shape (c,), that are on the outputs now."""
        with self._lock:
            return np.zeros(self.channel_count) if self._is_expired() else self._volts.copy()

    def _is_expired(self) -> bool:
        return self.watchdog is not None and self._clock.now() - self._written >= self.watchdog

    def read(self) -> Reading:
        """The voltages [V] on the outputs, and the currents [A] of the load if there is one; each of shape (c,)."""
        if self._closed:
            raise SupplyFailed(self.name, "it was closed", "open it anew")
        volts = self.outputs()
        return Reading(volts, None if self._conductance is None else self._conductance @ volts)

    def close(self) -> None:
        """Zero volts, for good."""
        with self._lock:
            self._volts = np.zeros(self.channel_count)
            self._closed = True


def checked_conductance(conductance: ArrayLike | None, channel_count: int) -> NDArray[np.float64] | None:
    """`conductance` [S] as an array (c, c), or None. Raises `BadInput` for another shape and what is not finite."""
    if conductance is None:
        return None
    matrix = np.array(conductance, dtype=np.float64)
    if matrix.shape != (channel_count, channel_count):
        allowed = f"a matrix of {channel_count} x {channel_count}, the channels squared"
        raise BadInput("conductance", f"shape {matrix.shape}", allowed)
    if not np.isfinite(matrix).all():
        raise BadInput("conductance", "values that are not finite", "a matrix of finite values [S]")
    return matrix
