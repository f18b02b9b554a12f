"""What a supply is asked for, checked before anything is sent: one value for each channel, within what it can give."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelbot.errors import SupplyFailed


def checked_volts(
    supply: str, volts: ArrayLike, channel_count: int, lowest: ArrayLike, highest: ArrayLike
) -> NDArray[np.float64]:
    """`volts` [V] as a new array (c,) of the `channel_count` channels.

    `lowest` and `highest` [V] bound them, both ends included; each one value or one for each channel. Raises
    `SupplyFailed` in the name of `supply` for another shape, for what is not finite and for what is out of bounds.
    """
    asked = np.array(volts, dtype=np.float64)
    if asked.shape != (channel_count,):
        what = f"asked for voltages of shape {asked.shape}; it has {channel_count} channels"
        raise SupplyFailed(supply, what, f"one voltage for each channel, an array of shape ({channel_count},)")
    low = np.broadcast_to(np.asarray(lowest, dtype=np.float64), asked.shape)
    high = np.broadcast_to(np.asarray(highest, dtype=np.float64), asked.shape)
    outside = ~((low <= asked) & (asked <= high))  # so that nan is outside too
    if outside.any():
        channel = int(np.argmax(outside))
        what = f"channel {channel} (the first is 0) was asked for {asked[channel]:g} V; nothing was sent"
        advice = f"voltages within its range, {low[channel]:g} V to {high[channel]:g} V"
        raise SupplyFailed(supply, what, advice)
    return asked
