"""Analogue outputs of a National Instruments card, through its driver NI-DAQmx. Never tried on a real card."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput, SupplyFailed
from gelbot.hardware.asked_volts import checked_volts
from gelbot.hardware.driver_error import first_line
from gelbot.hardware.supply import Reading


class NiSupply:
    """The analogue outputs `channels`, such as "ao0:15" or ["ao0", "ao3"], of the NI card `device`, such as "Dev1".

    They give `lowest` to `highest` [V]. A static write sets all of them in one call. Where the card has a hardware
    watchdog, it is started: after `watchdog` [s] without a write the card itself goes to 0 V. Then the attribute
    `watchdog` is that time, else None, and `without_watchdog` says why: such a card KEEPS its last voltages when the
    host's program is killed. `require_watchdog` refuses it. Every method is over within `timeout` [s].

    Raises `BadInput` for what cannot work, `SupplyFailed` for a card that does not.
    """

    def __init__(
        self,
        device: str,
        channels: str | Sequence[str],
        lowest: float = -10.0,
        highest: float = 10.0,
        timeout: float = 0.1,
        *,
        watchdog: float = 0.2,
        require_watchdog: bool = False,
    ) -> None:
        try:
            import nidaqmx
        except ImportError as error:
            raise BadInput("supply", "ni", "an installation with nidaqmx", 'pip install "gelbot[ni]"') from error
        if not lowest <= 0.0 <= highest:
            raise BadInput("range", f"{lowest} V .. {highest} V", "a range that 0 V is in")
        if not 0.0 < timeout < 10.0:
            raise BadInput("timeout", timeout, "a time above 0 s and below 10 s")
        if not 0.0 < watchdog <= 10.0:
            raise BadInput("watchdog", watchdog, "a time above 0 s and up to 10 s")
        names = [channels] if isinstance(channels, str) else list(channels)
        if not names or not all(names):
            raise BadInput("channels", channels, 'names of analogue outputs, such as "ao0:15"')
        self.name = f"NI card {device}"
        self.lowest, self.highest, self._timeout = lowest, highest, timeout
        self.watchdog: float | None = None
        self.without_watchdog, self.expired_count = "", 0
        self._task: Any = None
        self._guard: Any = None
        try:
            self._task = nidaqmx.Task()
            for name in names:
                self._task.ao_channels.add_ao_voltage_chan(f"{device}/{name}", min_val=lowest, max_val=highest)
            outputs = [channel.physical_channel.name for channel in self._task.ao_channels]
            self.channel_count = len(outputs)
            self._start_watchdog(device, outputs, watchdog)
            if require_watchdog and self.watchdog is None:
                what = f"it has no hardware watchdog ({self.without_watchdog}): killed, it would keep its voltages"
                raise SupplyFailed(self.name, what, "a card with one, or to do without: watchdog = None")
            self.write(np.zeros(self.channel_count))
        except SupplyFailed:
            self._let_go()
            raise
        except Exception as error:  # the driver's own, and what its absence raises
            self._let_go()
            advice = "the driver NI-DAQmx, the card's name in NI MAX, its channels, other programs that hold it"
            raise SupplyFailed(self.name, f"it cannot be opened: {first_line(error)}", advice) from error

    def _start_watchdog(self, device: str, outputs: list[str], watchdog: float) -> None:
        """Let the card go to 0 V on its own, if it can; there is no other way to ask it than to try."""
        from nidaqmx.constants import WatchdogAOExpirState
        from nidaqmx.system.watchdog import WatchdogTask
        from nidaqmx.types import AOExpirationState

        guard = None
        try:
            guard = WatchdogTask(device, timeout=watchdog)
            volts = WatchdogAOExpirState.VOLTAGE
            guard.cfg_watchdog_ao_expir_states([AOExpirationState(output, 0.0, volts) for output in outputs])
            guard.start()
        except Exception as error:  # a card without one says so in a code of its own
            self.without_watchdog = first_line(error)
            if guard is not None:
                with contextlib.suppress(Exception):
                    guard.close()
            return
        self._guard, self.watchdog = guard, watchdog

    def write(self, volts: NDArray[np.float64]) -> None:
        """Put `volts` [V], shape (c,), on the outputs in one call; whether in one instant is up to the card.

        Raises `SupplyFailed`: for voltages out of range before anything is sent.
        """
        asked = checked_volts(self.name, volts, self.channel_count, self.lowest, self.highest)
        if self._task is None:
            raise SupplyFailed(self.name, "it was closed", "open it anew")
        try:
            if self._guard is not None:
                if self._guard.expired:
                    self.expired_count += 1
                    self._guard.clear_expiration()  # until then the card takes no voltages
                self._guard.reset_timer()
            self._task.write(
                asked.tolist() if asked.size > 1 else float(asked[0]), auto_start=True, timeout=self._timeout
            )
        except Exception as error:  # the driver's own
            what = f"the card did not take its voltages: {first_line(error)}"
            raise SupplyFailed(self.name, what, "its cable and power, NI MAX, other programs that use it") from error

    def read(self) -> Reading:
        """Nothing: an analogue output measures neither voltage nor current."""
        return Reading(None, None)

    def close(self) -> None:
        """Zero volts, then let go of the card. Never raises."""
        if self._task is not None:
            with contextlib.suppress(Exception):
                self.write(np.zeros(self.channel_count))
        self._let_go()

    def _let_go(self) -> None:
        # The watchdog last: should the zero have failed, it may still come.
        for task in (self._task, self._guard):
            if task is not None:
                with contextlib.suppress(Exception):
                    task.close()
        self._task = self._guard = None
