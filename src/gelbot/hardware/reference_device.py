"""The reference device: what the firmware of a serial supply does, as a class, and as a program with a port of its own.

    python -m gelbot.hardware.reference_device --outputs outputs.csv

prints the path of a port that `SerialSupply` can open. The firmware in docs/firmware answers every line as this does.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
import time
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelbot.errors import BadInput
from gelbot.hardware.line_protocol import (
    COMMANDS,
    LONGEST_REQUEST,
    UNREADABLE,
    VERSION,
    Answer,
    GarbledLine,
    Identity,
    ReadBack,
    decode,
    encode_answer,
    identity_words,
    integers,
    is_number,
    read_back_words,
)
from gelbot.hardware.served_device import ServedDevice
from gelbot.hardware.soft_supply import checked_conductance


class ReferenceDevice:
    """A device of `channel_count` channels from `lowest` to `highest` [V], all zero until the first voltages come.

    After `watchdog` [s] without a good `W` line all outputs are zero, until the next one; 0: it has no watchdog. The
    `conductance` [S] of its load, shape (c, c), gives the currents that it measures; without, it measures none. Time
    comes in with each call [s]; it opens nothing and waits for nothing. Raises `BadInput`.
    """

    def __init__(
        self,
        channel_count: int = 16,
        *,
        lowest: float = -10.0,
        highest: float = 10.0,
        watchdog: float = 0.2,
        conductance: ArrayLike | None = None,
        name: str = "reference-dac",
    ) -> None:
        if not 1 <= channel_count <= 16:
            raise BadInput("channel_count", channel_count, "1 to 16: more do not fit into a line")
        if not -1e5 <= lowest <= 0.0 <= highest <= 1e5:
            raise BadInput("range", f"{lowest} V .. {highest} V", "a range that 0 V is in")
        if not 0.0 <= watchdog <= 1e3:
            raise BadInput("watchdog", watchdog, "a time in seconds, 0 for none")
        self.identity = Identity(
            name, VERSION, channel_count, round(lowest * 1e3), round(highest * 1e3), round(watchdog * 1e3)
        )
        self.expired_count = 0
        self._conductance = checked_conductance(conductance, channel_count)
        self._millivolts = (0,) * channel_count
        self._expires = math.inf

    def respond(self, line: bytes, now: float) -> bytes:
        """The answer, a line, to a `line` that came at the time `now` [s]; nothing to an empty one."""
        self.expire(now)
        if line == b"\n":  # what a host sends to end a line that may have got stuck
            return b""
        return encode_answer(self._answer(line, now))

    def _answer(self, line: bytes, now: float) -> Answer:
        try:
            words = decode(line)
        except GarbledLine:
            return Answer(False, UNREADABLE, ("crc",))
        if len(line) > LONGEST_REQUEST:
            return Answer(False, UNREADABLE, ("crc",))
        if len(words) < 2 or not is_number(words[1]) or int(words[1]) == UNREADABLE:
            return Answer(False, UNREADABLE, ("number",))
        command, number, values = words[0], int(words[1]), words[2:]
        if command not in COMMANDS:
            return Answer(False, number, ("command",))
        if len(values) != (self.identity.channel_count if command == "W" else 0):
            return Answer(False, number, ("count",))
        if command == "I":
            return Answer(True, number, identity_words(self.identity))
        if command == "R":
            return Answer(True, number, read_back_words(self._read_back()))
        if command == "Z":
            self._millivolts, self._expires = (0,) * self.identity.channel_count, math.inf
            return Answer(True, number, (str(self.expired_count),))
        millivolts = integers(values)
        if millivolts is None:
            return Answer(False, number, ("number",))
        if not all(self.identity.lowest <= value <= self.identity.highest for value in millivolts):
            return Answer(False, number, ("range",))
        self._millivolts = millivolts
        self._expires = now + self.identity.watchdog * 1e-3 if self.identity.watchdog else math.inf
        return Answer(True, number, (str(self.expired_count),))

    def expire(self, now: float) -> None:
        """Zero the outputs if at the time `now` [s] the watchdog has expired."""
        if now >= self._expires:
            self._millivolts, self._expires = (0,) * self.identity.channel_count, math.inf
            self.expired_count += 1

    def outputs(self, now: float) -> NDArray[np.float64]:
        """The voltages [V], shape (c,), on the outputs at the time `now` [s]."""
        self.expire(now)
        return np.array(self._millivolts) * 1e-3

    def left(self, now: float) -> float:
        """The time [s] until the watchdog expires, if nothing comes; infinite where it is not running."""
        return self._expires - now

    def _read_back(self) -> ReadBack:
        amperes = [] if self._conductance is None else self._conductance @ (np.array(self._millivolts) * 1e-3)
        return ReadBack(self.expired_count, self._millivolts, tuple(round(value * 1e6) for value in amperes))


class OutputsFile:
    """A table that gets a row with each change of the outputs: the monotonic time [s] of the machine, then [V]."""

    def __init__(self, file: TextIO, channel_count: int) -> None:
        self._file, self._last = file, np.full(channel_count, np.nan)
        file.write(",".join(["t [s]", *(f"V{channel} [V]" for channel in range(channel_count))]) + "\n")

    def changed(self, volts: NDArray[np.float64]) -> None:
        """Write `volts` [V], shape (c,), down with the time, if they are new."""
        if not np.array_equal(volts, self._last):
            self._last = volts
            self._file.write(",".join([f"{time.monotonic():.6f}", *(f"{value:.3f}" for value in volts)]) + "\n")
            self._file.flush()


def read_conductance(path: Path) -> NDArray[np.float64]:
    """The matrix [S] in a .npy or .csv file. Raises `BadInput`."""
    try:
        matrix = np.load(path) if path.suffix == ".npy" else np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise BadInput("--conductance", str(path), "a .npy or .csv file with a matrix of numbers [S]") from error
    return np.asarray(matrix, dtype=np.float64)


def main(arguments: list[str] | None = None) -> int:
    """The program: serves until it is interrupted or terminated."""
    parser = argparse.ArgumentParser(prog="python -m gelbot.hardware.reference_device", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--channels", type=int, default=16, help="how many channels it has")
    parser.add_argument("--lowest", type=float, default=-10.0, help="lower end of its range [V]")
    parser.add_argument("--highest", type=float, default=10.0, help="upper end of its range [V]")
    parser.add_argument("--watchdog", type=float, default=0.2, help="zero after so long without voltages [s]; 0: never")
    parser.add_argument("--conductance", type=Path, help=".npy or .csv of the load's conductances [S], c x c")
    parser.add_argument("--outputs", type=Path, help="a .csv file that gets a row with each change of the outputs")
    asked = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        conductance = None if asked.conductance is None else read_conductance(asked.conductance)
        device = ReferenceDevice(
            asked.channels,
            lowest=asked.lowest,
            highest=asked.highest,
            watchdog=asked.watchdog,
            conductance=conductance,
        )
        with contextlib.ExitStack() as stack:
            changed = None
            if asked.outputs is not None:
                changed = OutputsFile(stack.enter_context(asked.outputs.open("w")), asked.channels).changed
            served = stack.enter_context(ServedDevice(device, changed=changed))
            print(served.port, flush=True)
            served.serve()
    except (BadInput, OSError) as error:
        print(f"reference_device: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
