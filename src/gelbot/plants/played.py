"""A recorded run as a plant: what was seen then is seen again, and voltages do nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.errors import BadInput
from gelbot.plant import Sighting, as_seen
from gelbot.record.log import open_log
from gelbot.record.run_store import open_run

EARLY = 1e-6
"""Times that are added up are off by less than this [s]."""
POINTS = ("centre", "normal", "tip_position", "tip_angle")


class PlayedPlant:
    """The gel of `recording`, a run's or a log's data set, as `clock` goes on from where it stands now.

    `apply` returns what the electrodes had then. After its end the recording stands still, and nothing is seen.
    """

    def __init__(self, recording: xr.Dataset, clock: Clock) -> None:
        self._clock, self._start = clock, clock.now()
        self._time = np.asarray(recording["time"].values, float)
        self._points = [recording[name].transpose("time", ...).values.astype(float) for name in POINTS]
        taken = "electrode_potential" if "electrode_potential" in recording else "voltage"
        self._voltages = recording[taken].transpose("time", "electrode").values.astype(float)
        sure = recording["confidence"].values if "confidence" in recording else np.ones(len(self._time))
        self._confidence = np.nan_to_num(np.asarray(sure, float))
        seen = recording["seen_time"].values if "seen_time" in recording else self._time
        self._seen_time = np.asarray(seen, float)

    @property
    def duration(self) -> float:
        """How long it is [s]."""
        return float(self._time[-1])

    @property
    def over(self) -> bool:
        """Whether its end has been reached."""
        return self._clock.now() - self._start > self.duration + EARLY

    def observe(self) -> Sighting:
        """What was seen at this time."""
        k = self._place()
        confidence = 0.0 if self.over else float(self._confidence[k])
        points = as_seen(*(part[k] for part in self._points))
        return Sighting(self._start + float(self._seen_time[k]), points, confidence)

    def apply(self, voltages: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the electrodes had at this time [V], (e,)."""
        return self._voltages[self._place()].copy()

    def _place(self) -> int:
        """The last tick that is not later than now; the first one before it."""
        return max(0, int(np.searchsorted(self._time, self._clock.now() - self._start + EARLY, side="right")) - 1)


def recording(path: Path) -> tuple[xr.Dataset, Path]:
    """The recording at `path`, and the file or folder that holds it: a log of a bench, a run, or of a folder with
    several of them the newest log. Raises `BadInput`."""
    allowed = "a log of gelbot live (bench.log), or the folder of a run"
    logs = sorted(path.glob("bench*.log"), key=lambda log: log.stat().st_mtime)
    if logs:
        path = logs[-1]
    for folder in (path / "run.zarr", path):
        if (folder / "zarr.json").is_file():
            return checked(open_run(folder), path, allowed), folder
    if not path.is_file():
        raise BadInput("--plant", str(path), allowed)
    return checked(open_log(path), path, allowed), path


def checked(found: xr.Dataset, path: Path, allowed: str) -> xr.Dataset:
    """`found`, if it can be played."""
    missing = [name for name in (*POINTS, "voltage", "time") if name not in found]
    if missing or found.sizes.get("time", 0) == 0:
        what = f"without {', '.join(missing)}" if missing else "without a tick"
        raise BadInput("--plant", f"{path}, {what}", allowed)
    return found
