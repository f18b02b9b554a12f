"""A bench supply that speaks SCPI, over USB, LAN, GPIB or a serial port; what to say is in its profile."""

from __future__ import annotations

import contextlib
import re
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput, SupplyFailed
from gelbot.hardware.asked_volts import checked_volts
from gelbot.hardware.driver_error import first_line
from gelbot.hardware.scpi_profile import ScpiProfile, load_profile
from gelbot.hardware.supply import Reading


class Session(Protocol):
    """The open line to an instrument: of pyvisa's message-based resources, what is used here. `timeout` is in [ms]."""

    timeout: Any

    def write_raw(self, message: bytes) -> Any: ...
    def read_raw(self) -> bytes: ...
    def clear(self) -> Any: ...
    def close(self) -> Any: ...


class ScpiSupply:
    """The instrument at the VISA `resource`, such as "TCPIP0::192.168.1.20::INSTR".

    `profile` is the name of a built-in profile or a .toml file, `visa_library` what pyvisa is given: "" for the one
    that is installed, "@py" for pyvisa-py, "FILE.yaml@sim" for a simulated instrument. Opening checks who is there,
    sends the profile's `init`, sets zero volts and switches the outputs on. `channel_count`, `lowest` and `highest`
    [V], shape (c,), are the profile's; another `channel_count` is refused. `session` is a line that is open already.

    Every method is over within `timeout` [s], which all messages of a call share. Such an instrument has no watchdog
    (`watchdog` is None): it keeps its voltages when the host dies, unless the profile's `init` sets one up.

    Raises `BadInput` for what cannot work, `SupplyFailed` for an instrument that does not.
    """

    watchdog: float | None = None
    expired_count = 0

    def __init__(
        self,
        resource: str,
        profile: str | Path,
        timeout: float = 1.0,
        visa_library: str = "",
        *,
        channel_count: int | None = None,
        session: Session | None = None,
    ) -> None:
        if not 0.0 < timeout <= 60.0:
            raise BadInput("timeout", timeout, "a time above 0 s and up to 60 s")
        self.profile: ScpiProfile = load_profile(profile)
        self.name = f"{self.profile.name} at {resource}"
        self.channel_count = len(self.profile.channels)
        if channel_count not in (None, self.channel_count):
            allowed = f"{self.channel_count}, the channels of the profile"
            raise BadInput("channel_count", channel_count, allowed, "a copy of the profile with other channels")
        low, high = self.profile.bounds()
        self.lowest, self.highest = np.array(low), np.array(high)
        self._timeout = timeout
        self._known = self._unsure = False
        self._session: Session | None = session or _open_session(
            resource, self.name, visa_library, timeout, self.profile
        )
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        until = time.monotonic() + self._timeout
        identity = self._query(self.profile.identify, until)
        if not re.search(self.profile.identity, identity):
            what = f"it says it is {identity[:80]!r}; the profile is for {self.profile.identity!r}"
            raise SupplyFailed(self.name, what, "another resource, or the profile of this instrument")
        self._known = True
        for command in self.profile.init:
            self._send(command, until)
        self._check("init", until)
        self.write(np.zeros(self.channel_count))
        until = time.monotonic() + self._timeout
        for command in self.profile.output_on:
            self._send(command, until)
        self._check("output_on", until)

    def write(self, volts: NDArray[np.float64]) -> None:
        """Put `volts` [V], shape (c,), on the outputs; returns when the instrument has reported no error.

        All at once where the profile has a command for all channels, a `join` or an `apply`; else one after the other.
        Raises `SupplyFailed`: for voltages out of the profile's range before anything is sent.
        """
        asked = checked_volts(self.name, volts, self.channel_count, self.lowest, self.highest)
        until = time.monotonic() + self._timeout
        self._send(self.profile.set, until, asked)
        if self.profile.apply is not None:
            self._send(self.profile.apply, until)
        self._check("set", until)

    def read(self) -> Reading:
        """What the instrument measures, [V] and [A], each of shape (c,), where the profile can ask it.

        Raises `SupplyFailed`.
        """
        until = time.monotonic() + self._timeout
        return Reading(
            self._measured(self.profile.measure_volts, until), self._measured(self.profile.measure_amperes, until)
        )

    def close(self) -> None:
        """Zero volts, outputs off, then let go of the instrument. Never raises."""
        if self._session is None:
            return
        zero = self.profile.set if self.profile.zero is None else self.profile.zero
        commands = [zero, *([self.profile.apply] if self.profile.apply else []), *self.profile.output_off]
        if not self._known:
            commands = []  # an instrument that is not the one meant is not ours to switch off
        for command in commands:
            # Each has its share of the time: that one fails does not take the others' chance.
            with contextlib.suppress(Exception):
                share = time.monotonic() + self._timeout / len(commands)
                self._send(command, share, np.zeros(self.channel_count))
        self._let_go()

    def _let_go(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            with contextlib.suppress(Exception):
                session.close()

    def _measured(self, query: str | None, until: float) -> NDArray[np.float64] | None:
        if query is None:
            return None
        answers = [self._query(message, until) for message in self.profile.messages(query)]
        words = ",".join(answers).split(",")
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.zeros(0)
        if values.shape != (self.channel_count,):
            what = f"its answer to {query} is no {self.channel_count} numbers: {','.join(answers)[:80]!r}"
            raise SupplyFailed(self.name, what, "the profile's measure_volts and measure_amperes")
        return values

    def _check(self, what: str, until: float) -> None:
        """Ask for errors, which is also how it is known that everything before was carried out."""
        if self.profile.error is None:
            return
        answer = self._query(self.profile.error, until)
        if not re.search(self.profile.no_error, answer):
            raise SupplyFailed(self.name, f"after {what} it reports {answer[:80]!r}", f"the profile's {what}")

    def _query(self, message: str, until: float) -> str:
        self._send_message(message, until)
        raw = self._during(message, until, lambda session: session.read_raw())
        return raw.decode("ascii", errors="replace").strip()

    def _send(self, command: str, until: float, volts: NDArray[np.float64] | None = None) -> None:
        for message in self.profile.messages(command, None if volts is None else volts.tolist()):
            self._send_message(message, until)

    def _send_message(self, message: str, until: float) -> None:
        raw = (message + self.profile.write_terminator).encode("ascii")
        self._during(message, until, lambda session: session.write_raw(raw))

    def _during(self, message: str, until: float, act: Any) -> Any:
        """`act` on the session, with the time that is left. Raises `SupplyFailed` for whatever goes wrong in it."""
        if self._session is None:
            raise SupplyFailed(self.name, "it was closed", "open it anew")
        left = until - time.monotonic()
        late = f"{message} was not over within {self._timeout:g} s"
        advice = "its cable and power, a longer timeout, or a profile with fewer messages"
        if left <= 0.0:
            raise SupplyFailed(self.name, late, advice)
        try:
            self._session.timeout = max(1, round(1e3 * left))
            if self._unsure:
                # An answer that came too late would be taken for the next one's.
                self._unsure = False
                with contextlib.suppress(Exception):  # not every line can be cleared
                    self._session.clear()
            return act(self._session)
        except Exception as error:  # each VISA library raises what it likes
            self._unsure = True
            what = late if "TMO" in str(error) else f"{message} failed: {first_line(error)}"
            raise SupplyFailed(self.name, what, advice) from error


def _open_session(resource: str, name: str, visa_library: str, timeout: float, profile: ScpiProfile) -> Session:
    try:
        import pyvisa
    except ImportError as error:
        raise BadInput("supply", "scpi", "an installation with pyvisa", 'pip install "gelbot[hardware]"') from error
    try:
        manager = pyvisa.ResourceManager(visa_library)
    except Exception as error:  # each VISA library raises what it likes
        allowed = f'a VISA library that can be loaded ({first_line(error)}), "@py" for the one in Python'
        raise BadInput("visa_library", visa_library, allowed, 'pip install "gelbot[hardware]"') from error
    try:
        session: Any = manager.open_resource(resource, open_timeout=round(1e3 * timeout))
    except Exception as error:
        advice = "its address (pyvisa-shell, list), its cable and power, other programs that hold it"
        raise SupplyFailed(name, f"it cannot be opened: {first_line(error)}", advice) from error
    if not hasattr(session, "write_raw"):
        session.close()
        raise BadInput("resource", resource, "an instrument that takes messages, such as TCPIP0::HOST::INSTR")
    session.read_termination = profile.read_terminator
    if profile.baud is not None and resource.upper().startswith("ASRL"):
        session.baud_rate = profile.baud
    return session
