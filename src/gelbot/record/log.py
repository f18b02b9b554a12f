"""The log of a bench: one line of JSON for each tick, handed to the system at once, so that a killed program loses
none.

The first line is the head: what was run, and the names of what follows. Each other line is a tick or an event. A line
that was cut off half way, by a kill or a full disk, is no line: the log ends before it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from gelbot.errors import BadInput

FORMAT = "gelbot bench log 1"
UNITS = {
    "time": ("s", "time since the start, when the tick was due"),
    "seen_time": ("s", "time of what was seen, on the same clock"),
    "confidence": ("1", "how sure the sighting is, 0 where the gel was lost"),
    "centre": ("m", "centre of the body, as seen"),
    "normal": ("1", "normal of the body's upper side, as seen"),
    "tip_position": ("m", "tips, as seen"),
    "tip_angle": ("rad", "angle of the tips below their outward direction, as seen"),
    "asked": ("V", "voltages that the driver asked for"),
    "voltage": ("V", "voltages that the electrodes were given"),
    "electrode_current": ("A", "currents from the electrodes into the tank, as the conductances give them"),
    "measured_current": ("A", "currents that the supply measured on its channels"),
    "phase": ("1", "phase of the programme"),
    "amplitude": ("V", "amplitude of the applied voltages"),
    "reference": ("m", "height that the servo follows"),
    "jitter": ("s", "how much later than due the tick began"),
    "took": ("s", "how long the tick was busy"),
    "missed": ("1", "ticks left out before this one"),
}
DIMENSIONS = {
    "centre": ("space",),
    "normal": ("space",),
    "tip_position": ("space", "tip"),
    "tip_angle": ("tip",),
    "asked": ("electrode",),
    "voltage": ("electrode",),
    "electrode_current": ("electrode",),
    "measured_current": ("channel",),
}


class BenchLog:
    """The writer. Each line is with the system when `tick` and `event` return; `OSError` where it cannot take it.

    What a failed write left of its line is taken off again. May be used from any thread.
    """

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        """A new log at `path`; raises `BadInput` when something stands there."""
        self.path = path
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        except FileExistsError as error:
            raise BadInput("log", str(path), "a file that does not exist yet", "another --out folder") from error
        self._length, self._lock = 0, Lock()
        self._write({"format": FORMAT, **head})

    def tick(self, values: Mapping[str, Any]) -> None:
        """A tick, by the names of `UNITS`; what is None is left out."""
        self._write({name: _plain(value) for name, value in values.items() if value is not None})

    def event(self, time: float, text: str) -> None:
        """Something that happened at `time` [s]."""
        self._write({"event": text, "time": round(time, 6)})

    def close(self) -> None:
        """No more lines."""
        with self._lock:
            if self._file >= 0:
                os.close(self._file)
                self._file = -1

    def _write(self, line: Mapping[str, Any]) -> None:
        data = (json.dumps(line, separators=(",", ":"), allow_nan=False) + "\n").encode()
        with self._lock:
            if self._file < 0:
                return
            # Straight to the system, with no buffer of our own that a kill could lose.
            try:
                done = 0
                while done < len(data):
                    done += os.write(self._file, data[done:])
            except OSError as error:
                with suppress(OSError):
                    os.ftruncate(self._file, self._length)
                raise OSError(error.errno, error.strerror, str(self.path)) from error
            self._length += len(data)


def _plain(value: Any) -> Any:
    """As JSON has it: rounded to what matters, null for what is no number."""
    if isinstance(value, np.ndarray):
        return [_plain(part) for part in value.tolist()]
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, float):
        return float(f"{value:.7g}") if np.isfinite(value) else None
    return value


class Event(NamedTuple):
    """Something that happened at `time` [s]."""

    time: float
    text: str


def open_log(path: Path) -> xr.Dataset:
    """The ticks of the log at `path`, along `time`; the head and the `events` are attributes.

    The log may still be growing, or end in the middle of a line. Raises `BadInput` when there is no log.
    """
    allowed = "a log that gelbot live wrote (bench.log)"
    try:
        lines = list(_lines(path))
    except OSError as error:
        raise BadInput("log", str(path), f"{allowed} ({error.strerror})") from error
    if not lines or lines[0].get("format") != FORMAT:
        raise BadInput("log", str(path), allowed)
    head, rows = lines[0], lines[1:]
    ticks = [row for row in rows if "event" not in row]
    events = [Event(row["time"], row["event"]) for row in rows if "event" in row]
    variables = {}
    for name, (unit, text) in UNITS.items():
        values = [row.get(name) for row in ticks]
        example = next((value for value in values if value is not None), None)
        if example is None:
            continue
        # A value that a tick lacks, or null, is no number.
        shape = np.shape(example)
        filled = [np.full(shape, np.nan) if value is None else np.array(value, float) for value in values]
        variables[name] = (("time", *DIMENSIONS.get(name, ())), np.array(filled), {"units": unit, "long_name": text})
    return xr.Dataset(
        {name: variable for name, variable in variables.items() if name != "time"},
        coords={"time": variables["time"]} if "time" in variables else {},
        attrs={**head, "events": events},
    )


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    with path.open("rb") as file:
        for line in file:
            if not line.endswith(b"\n"):
                return
            try:
                read = json.loads(line)
            except ValueError:
                return
            if not isinstance(read, dict):
                return
            yield read
