"""What every supply can do, whatever it is made of: give voltages on all its channels, and let go of them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Volts = float | NDArray[np.float64]


class Reading(NamedTuple):
    """What a supply has measured on its channels: `volts` [V] (c,) and `amperes` [A] (c,); None where it cannot."""

    volts: NDArray[np.float64] | None
    amperes: NDArray[np.float64] | None


class Supply(Protocol):
    """A supply with `channel_count` outputs, called `name` in messages.

    It gives what it is asked for: limits are the business of `guard.Guard`, which alone may hold one. Methods are
    called by one thread at a time and are over within the `timeout` [s] that the supply was made with, or raise.
    """

    name: str
    channel_count: int

    @property
    def lowest(self) -> Volts:
        """The lowest voltage [V] that it can give; one for all, or one for each channel, shape (c,)."""
        ...

    @property
    def highest(self) -> Volts:
        """The highest voltage [V] that it can give; one for all, or one for each channel, shape (c,)."""
        ...

    @property
    def watchdog(self) -> float | None:
        """After so long [s] without a word from the host it goes to zero volts by itself; None: it keeps them."""
        ...

    @property
    def expired_count(self) -> int:
        """How often it has gone to zero volts by itself, as far as it has said so; 0 where it cannot tell."""
        ...

    def write(self, volts: NDArray[np.float64]) -> None:
        """Put `volts` [V], shape (c,), on the outputs, all at once; returns when the device has said that it did.

        Raises `SupplyFailed`.
        """
        ...

    def read(self) -> Reading:
        """What the device measures. Raises `SupplyFailed`."""
        ...

    def close(self) -> None:
        """Zero volts, then let go of the device. Never raises: there is nothing more that could be done."""
        ...
