"""What a session keeps: the log of the bench, always, and on demand the shape of the simulated gel as a run."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

import jax
import numpy as np
from numpy.typing import NDArray

from gelbot import __version__
from gelbot.bench import Tick
from gelbot.control.programme import Command
from gelbot.live.ready import Ready
from gelbot.live.twin import Twin
from gelbot.record.log import BenchLog
from gelbot.record.run_store import RunStore
from gelbot.run import frames_part, static_part
from gelbot.simulate import Frame, StepReport

Floats = NDArray[np.float64]
CHUNK = 10
"""Frames that are written to a recording together."""
LOG = "bench.log"


class Keeping:
    """The files of a session, in `folder`: bench.log, bench-2.log, ... one for each beginning that was started;
    run.zarr, run-2.zarr, ... one for each recording. `recording`: whether one is being made. What is kept of another
    scenario than the first goes `elsewhere`, into the folder for its name, if that is given."""

    def __init__(self, folder: Path, elsewhere: Callable[[str], Path] | None = None) -> None:
        self.folder, self.recording = folder, False
        self._elsewhere, self._folders = elsewhere, dict[str, Path]()
        self._log: BenchLog | None = None
        self._ready: Ready | None = None
        self._plant = ""
        self._frames: list[Frame] = []
        self._writer: Writer | None = None

    def begin(self, ready: Ready, plant: str) -> None:
        """A new beginning: its log is made when it is started."""
        self.close()
        self._ready, self._plant = ready, plant
        name = ready.loaded.scenario.name
        if name not in self._folders:
            is_other = bool(self._folders)
            self._folders[name] = self._elsewhere(name) if is_other and self._elsewhere is not None else self.folder
        self.folder = self._folders[name]

    def open(self) -> None:
        """The log of this beginning, where it is not there yet. Raises `OSError`."""
        if self._log is not None or self._ready is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        scenario = self._ready.loaded
        head = {
            "scenario_name": scenario.scenario.name,
            "scenario": scenario.text,
            "plant": self._plant,
            "control_period": scenario.scenario.programme.control_period,
            "limit": scenario.scenario.supply.limit,
            "gelbot_version": __version__,
            "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        }
        self._log = BenchLog(_free(self.folder, "bench", ".log"), head)

    def tick(self, tick: Tick, currents: Floats, measured: Floats | None, twin: Twin) -> None:
        """A line of the log, and a frame of the recording. Raises `OSError` when the log cannot be written."""
        if self._log is not None:
            seen = tick.seen.observation
            self._log.tick(
                {
                    "time": round(tick.time, 6),
                    "seen_time": tick.seen.time,
                    "confidence": tick.seen.confidence,
                    "centre": np.asarray(seen.centre),
                    "normal": np.asarray(seen.normal),
                    "tip_position": np.asarray(seen.tips),
                    "tip_angle": np.asarray(seen.tip_angles),
                    "asked": tick.decided.voltages,
                    "voltage": tick.given,
                    "electrode_current": currents,
                    "measured_current": measured,
                    "phase": tick.decided.phase,
                    "amplitude": tick.decided.amplitude,
                    "reference": tick.decided.reference,
                    "jitter": tick.jitter,
                    "took": tick.took,
                    "missed": tick.missed,
                }
            )
        if self._writer is not None:
            self._frames.append(_frame(tick, twin))
            if len(self._frames) >= CHUNK:
                self._hand_over()

    def event(self, time: float, text: str) -> None:
        """Something that happened. A log that cannot be written has been told of before."""
        log = self._log  # another thread may close it meanwhile
        if log is not None:
            with suppress(OSError):
                log.event(time, text)

    def record(self, wanted: bool, ready: Ready) -> None:
        """Begin or end a recording of the simulated gel. Raises `OSError`."""
        if wanted and self._writer is None:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._writer = Writer(ready, _free(self.folder, "run", ".zarr"))
        elif not wanted and self._writer is not None:
            self._hand_over()
            self._writer.close()
            self._writer = None
        self.recording = self._writer is not None

    @property
    def failed(self) -> str:
        """Why the recording could not be written, if it could not."""
        return "" if self._writer is None else self._writer.failed

    def told(self) -> str:
        """Where the files are, in words; nothing where there are none."""
        kept = dict.fromkeys(str(folder) for folder in self._folders.values() if folder.exists())
        return "; what was kept is in " + ", ".join(kept) if kept else ""

    def close(self) -> None:
        """End what is being kept."""
        if self._ready is not None:
            self.record(False, self._ready)
        if self._log is not None:
            self._log.close()
            self._log = None

    def _hand_over(self) -> None:
        if self._writer is not None and self._frames:
            self._writer.frames.put(self._frames)
        self._frames = []


class Writer:
    """Writes a recording in a thread of its own: the disk must not hold up the loop."""

    def __init__(self, ready: Ready, path: Path) -> None:
        self.frames: SimpleQueue[list[Frame] | None] = SimpleQueue()
        self.failed = ""
        self._experiment = ready.nominal
        self._store = RunStore.create(path, static_part(ready.nominal, ready.loaded))
        self._thread = Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """All that was handed over is written; the recording is finished."""
        self.frames.put(None)
        self._thread.join()

    def _write(self) -> None:
        while (frames := self.frames.get()) is not None:
            if self.failed:
                continue
            try:
                self._store.append(frames_part(self._experiment, jax.tree.map(lambda *p: np.stack(p), *frames)))
            except Exception as error:
                self.failed = f"the recording ends here: {error}"
        with suppress(OSError):
            self._store.finish(f"failed: {self.failed}" if self.failed else "finished")


def _frame(tick: Tick, twin: Twin) -> Frame:
    """What a run keeps of a moment: of the simulated gel, under the voltages that were given."""
    state, gel, decided = twin.gel.state, twin.gel, tick.decided
    parts = (tick.time, state.positions, state.ads, tick.given, gel.seen, gel.steps_each_period)
    command = Command(*(np.asarray(part) for part in (decided.phase, decided.amplitude, decided.reference)))  # pyright: ignore
    report = StepReport(*(np.asarray(part) for part in gel.report))  # pyright: ignore
    time, positions, ads, given, seen, steps = jax.tree.map(np.asarray, parts)
    return Frame(time, positions, ads, given, seen, command, report, steps)


def _free(folder: Path, stem: str, ending: str) -> Path:
    """`folder`/stem.ending, or with -2, -3, ... where that stands already."""
    path, count = folder / f"{stem}{ending}", 1
    while path.exists():
        count += 1
        path = folder / f"{stem}-{count}{ending}"
    return path
