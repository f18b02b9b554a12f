"""A supply on a serial port that speaks the line protocol of docs/hardware.md."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput, SupplyFailed
from gelbot.hardware.asked_volts import checked_volts
from gelbot.hardware.driver_error import first_line
from gelbot.hardware.line_protocol import (
    HIGHEST_NUMBER,
    LONGEST_ANSWER,
    UNREADABLE,
    VERSION,
    Answer,
    GarbledLine,
    Identity,
    Request,
    decode_answer,
    encode_request,
    identity_of,
    read_back_of,
)
from gelbot.hardware.supply import Reading

if TYPE_CHECKING:
    from serial import Serial

BYTES_PER_CHANNEL = 22
"""How many bytes a channel may take in a question and its answer: what it measures, -10000 mV and -1000000 uA."""


class SerialSupply:
    """The device at the serial `port`, such as "/dev/ttyACM0" or "COM3".

    Opening asks the device who it is, again and again for up to `patience` [s]: many boards start anew when their port
    is opened. It is refused when it speaks another version of the protocol, when it has another `channel_count` than is
    given here, or when its own watchdog is missing or slower than `watchdog` [s], where that is given. Afterwards
    `channel_count`, `lowest` and `highest` [V] and `watchdog` [s] (None: it has none) are the device's; `expired_count`
    says how often its watchdog had expired when it last answered.

    Every method is over within `timeout` [s]. A garbled answer, or silence for half that time, is met by sending the
    line once more, under the same number: to write the same voltages twice does no harm.

    Raises `BadInput` for what cannot work, `SupplyFailed` for a device that does not.
    """

    def __init__(
        self,
        port: str,
        baud: int = 115200,
        timeout: float = 0.1,
        channel_count: int | None = None,
        *,
        watchdog: float | None = None,
        patience: float = 3.0,
    ) -> None:
        try:
            import serial
        except ImportError as error:
            raise BadInput(
                "supply", "serial", "an installation with pyserial", 'pip install "gelbot[hardware]"'
            ) from error
        if not 0.0 < timeout < 10.0:
            raise BadInput("timeout", timeout, "a time above 0 s and below 10 s")
        if not 1200 <= baud <= 12_000_000:
            raise BadInput("baud", baud, "1200 to 12000000 bits per second")
        self.name = f"serial supply at {port}"
        self._timeout, self._baud, self._number = timeout, baud, 0
        self._received = b""
        self.expired_count = 0
        try:
            # Exclusive: two programs that both drive a robot would not know of each other.
            self._port: Serial | None = serial.Serial(
                port, baudrate=baud, timeout=timeout, write_timeout=timeout, exclusive=True
            )
        except (ValueError, OSError) as error:
            what = f"the port cannot be opened: {first_line(error)}"
            advice = "its path (python -m serial.tools.list_ports), its cable, your right to open it, other programs"
            raise SupplyFailed(self.name, what, advice) from error
        try:
            identity = self._identify(patience)
            self._check(identity, channel_count, watchdog)
            self._note_expired(self._ask("Z"))  # whatever a host before this one has left
        except BaseException:
            self._let_go()
            raise
        self.name = f"serial supply {identity.name} at {port}"
        self.channel_count = identity.channel_count
        self.lowest, self.highest = identity.lowest * 1e-3, identity.highest * 1e-3
        self.watchdog = identity.watchdog * 1e-3 if identity.watchdog else None

    def write(self, volts: NDArray[np.float64]) -> None:
        """Put `volts` [V], shape (c,), on the outputs, to a millivolt, all at once or none.

        Raises `SupplyFailed` for voltages out of the device's range before anything is sent, and when the device has
        not said within the timeout that it did.
        """
        asked = checked_volts(self.name, volts, self.channel_count, self.lowest, self.highest)
        answer = self._ask("W", tuple(int(value) for value in np.rint(asked * 1e3)))
        self._note_expired(answer)

    def read(self) -> Reading:
        """The voltages [V] and currents [A] that the device measures, each of shape (c,). Raises `SupplyFailed`."""
        answer = self._ask("R")
        back = read_back_of(answer.words, self.channel_count)
        if back is None:
            raise self._nonsense("R", answer)
        self.expired_count = back.expired_count
        amperes = np.array(back.microamperes) * 1e-6 if back.microamperes else None
        return Reading(np.array(back.millivolts) * 1e-3, amperes)

    def close(self) -> None:
        """Zero volts, then let go of the port. Never raises; over within twice the timeout."""
        if self._port is None:
            return
        self._forget()
        with contextlib.suppress(Exception):
            self._ask("Z")
        self._let_go()

    def _identify(self, patience: float) -> Identity:
        until = time.monotonic() + patience
        while True:
            try:
                answer = self._ask("I")
                break
            except SupplyFailed:
                if time.monotonic() >= until:
                    raise
                time.sleep(0.02)
        identity = identity_of(answer.words)
        if identity is None:
            raise self._nonsense("I", answer)
        return identity

    def _check(self, identity: Identity, channel_count: int | None, watchdog: float | None) -> None:
        if identity.version != VERSION:
            what = f"{identity.name} speaks version {identity.version} of the protocol; this host speaks {VERSION}"
            raise SupplyFailed(self.name, what, "the firmware that comes with this version of gelbot")
        if channel_count is not None and identity.channel_count != channel_count:
            what = f"{identity.name} has {identity.channel_count} channels; {channel_count} are asked for"
            raise SupplyFailed(self.name, what, "another port, or the channel count of this device")
        if identity.channel_count < 1 or not identity.lowest <= 0 <= identity.highest:
            what = f"{identity.name} says it has {identity.channel_count} channels from {identity.lowest} mV to "
            raise SupplyFailed(self.name, f"{what}{identity.highest} mV", "its firmware: 0 V must be in its range")
        if watchdog is not None and not 0 < identity.watchdog <= watchdog * 1e3 + 0.5:
            has = f"a watchdog of {identity.watchdog} ms" if identity.watchdog else "no watchdog"
            what = f"{identity.name} has {has}; asked for is one of {watchdog * 1e3:g} ms or less"
            raise SupplyFailed(self.name, what, "a firmware with a faster watchdog, or to allow for a slower one")
        needed = (40 + BYTES_PER_CHANNEL * identity.channel_count) * 10 / self._baud
        if needed > self._timeout:
            where = f"timeout of the {self.name}"
            raise BadInput(where, self._timeout, f"{needed:.2g} s or more at {self._baud} baud", "a faster baud rate")

    def _ask(self, command: str, millivolts: tuple[int, ...] = ()) -> Answer:
        """The device's answer to a new request, which it has carried out. Raises `SupplyFailed`."""
        begun = time.monotonic()
        until = begun + self._timeout
        if self._port is None:
            raise SupplyFailed(self.name, "it was closed", "open it anew")
        self._number = self._number % HIGHEST_NUMBER + 1
        line = encode_request(Request(command, self._number, millivolts))
        try:
            answer = self._exchange(line, begun + 0.5 * self._timeout, until)
        except (GarbledLine, OSError) as error:
            if any(millivolts):  # a zero may come late
                self._forget()
            if isinstance(error, OSError):
                raise self._gone(command, error) from error
            advice = "the baud rate, the cable's length and shield, the device's ground"
            raise SupplyFailed(self.name, f"two answers to {command} were garbled: {error.what}", advice) from error
        if answer is None:
            if any(millivolts):
                self._forget()
            what = f"no answer to {command} within {self._timeout:g} s"
            raise SupplyFailed(self.name, what, "whether it has power, its firmware runs, and the baud rate is right")
        if not answer.done:
            what = f"it refused {command}: {' '.join(answer.words) or 'no reason given'}"
            raise SupplyFailed(self.name, what, "the device's range and firmware")
        return answer

    def _exchange(self, line: bytes, patient_until: float, until: float) -> Answer | None:
        """The answer to `line`, which is sent once more where none is readable before `patient_until`.

        None when there is none before `until`. Raises `GarbledLine` for two unreadable ones, `OSError` of the port.
        """
        self._send(line, until)
        with contextlib.suppress(GarbledLine):
            answer = self._answer(patient_until)
            if answer is not None:
                return answer
        if time.monotonic() >= until:
            return None
        # The line feed ends what may have been left of the first try.
        self._send(b"\n" + line, until)
        return self._answer(until)

    def _forget(self) -> None:
        """Take back what has not been sent yet: voltages must not come late."""
        assert self._port is not None
        with contextlib.suppress(Exception):
            self._port.reset_output_buffer()

    def _send(self, line: bytes, until: float) -> None:
        assert self._port is not None
        if os.name == "posix":
            # pyserial would wait for room in a full line by trying without a pause.
            _, room, _ = select.select([], [self._port.fileno()], [], max(until - time.monotonic(), 0.0))
            if not room:
                raise TimeoutError
        self._port.write_timeout = max(until - time.monotonic(), 1e-3)
        self._port.write(line)

    def _answer(self, until: float) -> Answer | None:
        """The answer to the present request, or None when there is none before `until`. Raises `GarbledLine`."""
        assert self._port is not None
        while True:
            line, end, rest = self._received.partition(b"\n")
            if end:
                self._received = rest
                answer = decode_answer(line + end)
                if answer.number == self._number:
                    return answer
                if answer.number == UNREADABLE:
                    raise GarbledLine(line + end, "the device could not read the line that it was sent")
                continue  # an answer to an earlier request, come too late
            if len(self._received) > LONGEST_ANSWER:
                self._received = b""
                raise GarbledLine(line, "it has no end")
            # What is here already counts, however late it is looked at: a busy host is no fault of the device.
            left, waiting = until - time.monotonic(), self._port.in_waiting
            if left <= 0.0 and not waiting:
                return None
            self._port.timeout = max(left, 0.0)
            self._received += self._port.read(waiting or 1)

    def _note_expired(self, answer: Answer) -> None:
        if len(answer.words) == 1 and answer.words[0].isdigit():
            self.expired_count = int(answer.words[0])

    def _nonsense(self, command: str, answer: Answer) -> SupplyFailed:
        what = f"its answer to {command} makes no sense: {' '.join(answer.words)[:60]!r}"
        return SupplyFailed(self.name, what, "the device's firmware, the port")

    def _gone(self, command: str, error: Exception) -> SupplyFailed:
        import serial

        if isinstance(error, serial.SerialTimeoutException | TimeoutError):
            what = f"it did not take in {command} within {self._timeout:g} s"
            return SupplyFailed(self.name, what, "whether its firmware runs; switch its power off and on")
        what = f"the port failed at {command}: {first_line(error)}"
        return SupplyFailed(self.name, what, "its cable and its power, then open it anew")

    def _let_go(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            # The system may wait half a minute until a hung device has taken in the zero: not at the caller's cost.
            closer = threading.Thread(target=_close, args=(port,), name="closing a serial port", daemon=True)
            closer.start()
            closer.join(self._timeout)


def _close(port: Serial) -> None:
    with contextlib.suppress(Exception):
        port.close()
