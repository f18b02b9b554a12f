"""A device behind a pseudo terminal: a serial port without a cable, which can also be made to fail on purpose."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput


class Device(Protocol):
    """What is served: see `reference_device.ReferenceDevice`."""

    def respond(self, line: bytes, now: float) -> bytes: ...
    def outputs(self, now: float) -> NDArray[np.float64]: ...
    def left(self, now: float) -> float: ...


class ServedDevice:
    """Serves `device` at the path `port`, in the calling thread (`serve`) or in one of its own (`start`).

    `changed` is told the outputs [V] (c,) after each line and when the watchdog expires. Faults, from any thread:

    - `garbled_count`: so many of the next answers have a bit flipped; `deaf_count`: so many of the next requests do
    - `ignores`: it takes lines in and does nothing; `hangs`: it does not even take them in, and the line fills up
    - `unplug()`: the port is gone

    A context manager. Raises `BadInput` where there are no pseudo terminals.
    """

    def __init__(self, device: Device, *, changed: Callable[[NDArray[np.float64]], None] | None = None) -> None:
        try:
            import tty
        except ImportError as error:
            raise BadInput("served device", os.name, "a system with pseudo terminals: Linux or macOS") from error
        self.device, self.changed = device, changed
        self.garbled_count = self.deaf_count = 0
        self.ignores = self._hangs = False
        # The other end is held open too: without, the port would be gone each time a host closes it.
        self._here, self._there = os.openpty()
        tty.setraw(self._there)
        os.set_blocking(self._here, False)
        self.port = os.ttyname(self._there)
        self._wake_read, self._wake_write = os.pipe()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._closed = False

    @property
    def hangs(self) -> bool:
        """Whether it takes nothing in."""
        return self._hangs

    @hangs.setter
    def hangs(self, hangs: bool) -> None:
        self._hangs = hangs
        os.write(self._wake_write, b"x")

    def start(self) -> ServedDevice:
        """Serve in a thread, until `close`."""
        self._thread = threading.Thread(target=self.serve, name="served device", daemon=True)
        self._thread.start()
        return self

    def serve(self) -> None:
        """Answer lines, until `close` or `unplug` from another thread."""
        received = b""
        self._tell()
        while True:
            with self._lock:
                left = self.device.left(time.monotonic())
            readers = [self._wake_read] if self._hangs else [self._wake_read, self._here]
            ready, _, _ = select.select(readers, [], [], min(max(left, 0.0), 3600.0))
            if self._wake_read in ready:
                os.read(self._wake_read, 1)
                if self._closed:
                    return
                continue
            if self._here in ready:
                try:
                    received += os.read(self._here, 4096)
                except OSError:  # the port is gone
                    return
            *lines, received = received.split(b"\n")
            for line in lines:
                self._serve_line(line + b"\n")
            received = received[-4096:]
            self._tell()

    def _serve_line(self, line: bytes) -> None:
        if self.ignores:
            return
        if self.deaf_count:
            self.deaf_count -= 1
            line = _flipped(line)
        with self._lock:
            answer = self.device.respond(line, time.monotonic())
        if answer and self.garbled_count:
            self.garbled_count -= 1
            answer = _flipped(answer)
        # A host that does not read gets no answers: the device goes on.
        with contextlib.suppress(OSError):
            os.write(self._here, answer)

    def outputs(self) -> NDArray[np.float64]:
        """The voltages [V], shape (c,), on the device's outputs now."""
        with self._lock:
            return self.device.outputs(time.monotonic())

    def _tell(self) -> None:
        volts = self.outputs()
        if self.changed is not None:
            self.changed(volts)

    def unplug(self) -> None:
        """The port goes away as that of a device whose cable is pulled."""
        self.close()

    def close(self) -> None:
        """Stop serving; the port is gone."""
        if self._closed:
            return
        self._closed = True
        os.write(self._wake_write, b"x")
        if self._thread is not None:
            self._thread.join()
        for descriptor in (self._here, self._there, self._wake_read, self._wake_write):
            os.close(descriptor)

    def __enter__(self) -> ServedDevice:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()


def _flipped(line: bytes) -> bytes:
    return bytes([line[0] ^ 1]) + line[1:]
