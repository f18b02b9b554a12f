"""What a supply may be asked for: which channel feeds which electrode, and the voltages that are left of a wish."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

UNCONNECTED = -1
"""The channel of an electrode that no channel feeds."""

Floats = NDArray[np.float64]


class Wiring(NamedTuple):
    """From electrodes to channels: `channel` (e,) of each electrode, `UNCONNECTED` where there is none; an electrode
    has `gain` (e,) times the volts of its channel plus `offset` [V] (e,): what the amplifier does. `channel_count` in
    all.
    """

    channel: NDArray[np.int64]
    gain: Floats
    offset: Floats
    channel_count: int

    def to_channels(self, voltages: Floats) -> Floats:
        """What the channels must give [V], (c,), for `voltages` [V], (e,), on the electrodes; 0 where nothing hangs."""
        volts = np.zeros(self.channel_count)
        fed = self.channel >= 0
        volts[self.channel[fed]] = (voltages[fed] - self.offset[fed]) / self.gain[fed]
        return volts

    def to_electrodes(self, volts: Floats) -> Floats:
        """What the electrodes have [V], (e,), while the channels give `volts` [V], (c,); 0 where nothing is
        connected."""
        fed = self.channel >= 0
        return np.where(fed, self.gain * volts[np.where(fed, self.channel, 0)] + self.offset, 0.0)


def straight(count: int, channel_count: int | None = None) -> Wiring:
    """Electrode 0 on channel 0, and so on, without an amplifier."""
    return Wiring(np.arange(count), np.ones(count), np.zeros(count), channel_count or count)


@dataclass(frozen=True)
class Limits:
    """What nothing above may exceed.

    `voltage` [V] of an electrode, `slew` [V/s] away from its last one, `current` [A]: sum of the positive currents,
    `charge` [C]: its integral since the electrodes were made live. Currents are those that the conductance matrix
    `conductance` [S] (e, e) gives for the voltages, floating electrodes included; without it they are only limited
    where the supply measures them.
    """

    voltage: float
    slew: float = np.inf
    current: float = np.inf
    charge: float = np.inf
    conductance: Floats | None = None

    def total_current(self, voltages: Floats) -> float:
        """The sum of the positive currents [A], I = C V, at `voltages` [V], (e,); 0 where no matrix tells."""
        if self.conductance is None:
            return 0.0
        return float(np.maximum(self.conductance @ voltages, 0.0).sum())

    def allowed(self, asked: Floats, last: Floats, elapsed: float) -> Floats:
        """What is left of the voltages `asked` for [V], (e,), `elapsed` [s] after the `last` ones [V], (e,).

        Each is cut to the limit and to what the slew allows; then all are made smaller by the same factor until the
        current is within its limit: the pattern stays what it was.
        """
        near = self.slew * elapsed if np.isfinite(self.slew) else np.inf
        volts = np.clip(np.clip(asked, last - near, last + near), -self.voltage, self.voltage)
        total = self.total_current(volts)
        return volts * (self.current / total) if total > self.current else volts
