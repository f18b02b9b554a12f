"""Cameras: whoever asks gets the newest picture at once; they are read in a thread of their own."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.errors import CameraFailed
from gelbot.hardware.open_cv import cv2_of

RATE_MEMORY = 0.95
"""How much of the frame rate that is shown is the old one, at each picture."""
NO_PICTURE = 1.0
"""Seconds without a picture after which a camera has stopped, and is opened again."""
TRIES, PAUSE = 3, 0.5
"""How often a camera that has stopped is opened again, and seconds in between."""
FASTEST_FILE = 1000.0
"""A video that claims more pictures a second, or none, is played at `USUAL_RATE`."""
USUAL_RATE = 30.0


class Picture(NamedTuple):
    """`pixels` (h, w) grey or (h, w, 3) BGR, seen at `time` [s] of the clock."""

    time: float
    pixels: NDArray[np.uint8]


class Camera(Protocol):
    """Something that takes pictures."""

    def latest(self) -> Picture | None:
        """The newest picture that was not given yet, at once; None when there is none. Raises `CameraFailed`."""
        ...

    def close(self) -> None:
        """Let go of the device. Never raises."""
        ...


class VideoCamera:
    """A source that OpenCV reads: a camera by its number, a video file, or the address of a stream.

    A picture's time is that of its arrival less `delay` [s], for exposure and transfer. A file is played against the
    clock at its own rate, or at `rate` [1/s], and shown from its beginning on; pictures that come too late for the
    clock are left out. Where the file ends, `latest` gives None for ever and `ended` is true.

    Raises `CameraFailed` when the source cannot be opened; later, `latest` does when it has stopped and opening it
    again did not help.
    """

    def __init__(
        self,
        source: int | str | Path,
        clock: Clock,
        delay: float = 0.0,
        rate: float | None = None,
        size: tuple[int, int] | None = None,
    ) -> None:
        self.source, self.clock, self.delay, self.size = source, clock, delay, size
        self.name = f"camera {source}"
        self.is_file = isinstance(source, Path) or (isinstance(source, str) and Path(source).is_file())
        self.ended = False
        self.frames_per_second = 0.0
        self._rate = rate
        self._failure: CameraFailed | None = None
        self._newest: Picture | None = None
        self._previous: float | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._device = self._opened()
        self._start = clock.now()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()

    def latest(self) -> Picture | None:
        """The newest picture that was not given yet, at once; None when there is none. Raises `CameraFailed`."""
        with self._lock:
            picture, self._newest = self._newest, None
            if picture is None and self._failure is not None:
                raise self._failure
            return picture

    def close(self) -> None:
        """Stop reading and let go of the device. Never raises."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    def _opened(self) -> Any:
        cv2 = cv2_of(self.name)
        source = str(self.source) if isinstance(self.source, Path) else self.source
        if isinstance(self.source, Path) and not self.is_file:
            raise CameraFailed(self.name, "there is no such file", "another path")
        device = cv2.VideoCapture(source)
        if not device.isOpened():
            device.release()
            raise CameraFailed(
                self.name,
                "it cannot be opened",
                "another number (0 is the first camera), the cable, or closing what else uses it",
            )
        if self.size is not None and not self.is_file:
            device.set(cv2.CAP_PROP_FRAME_WIDTH, self.size[0])
            device.set(cv2.CAP_PROP_FRAME_HEIGHT, self.size[1])
        # An old picture is worse than none.
        device.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        return device

    def _run(self) -> None:
        try:
            if self.is_file:
                self._play()
            else:
                self._watch()
        except CameraFailed as failure:
            with self._lock:
                self._failure = failure
        finally:
            self._device.release()

    def _play(self) -> None:
        """A file: each picture when it is its time, the last of those whose time has come."""
        cv2 = cv2_of(self.name)
        own = float(self._device.get(cv2.CAP_PROP_FPS))
        rate = self._rate or (own if 0.0 < own <= FASTEST_FILE else USUAL_RATE)
        count = 0
        while not self._stop.is_set():
            read, pixels = self._device.read()
            if not read:
                self.ended = True
                return
            due = self._start + count / rate
            while self.clock.now() < due and not self._stop.is_set():
                # The clock may be one that is moved by hand: it is looked at, never pushed.
                time.sleep(min(0.002, 0.2 / rate))
            self._keep(pixels, due)
            count += 1

    def _watch(self) -> None:
        """A camera: whatever comes; opened again when nothing comes."""
        last, tries = time.monotonic(), 0
        while not self._stop.is_set():
            read, pixels = self._device.read()
            if read:
                self._keep(pixels, self.clock.now() - self.delay)
                last, tries = time.monotonic(), 0
                continue
            if time.monotonic() - last < NO_PICTURE:
                time.sleep(0.005)
                continue
            if tries == TRIES:
                raise CameraFailed(self.name, "it gives no pictures any more", "the cable, or a shorter one")
            tries += 1
            self._device.release()
            self._stop.wait(PAUSE)
            try:
                self._device = self._opened()
            except CameraFailed:
                if tries == TRIES:
                    raise
            last = time.monotonic()

    def _keep(self, pixels: NDArray[np.uint8], at: float) -> None:
        with self._lock:
            if self._previous is not None and at > self._previous:
                rate = 1.0 / (at - self._previous)
                old = self.frames_per_second or rate
                self.frames_per_second = RATE_MEMORY * old + (1.0 - RATE_MEMORY) * rate
            self._previous = at
            self._newest = Picture(at, pixels)
