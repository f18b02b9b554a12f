"""The progress of a run on the terminal: simulated time, phase, height and speed; the progress of many runs."""

from __future__ import annotations

import time as clock
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TaskID, TextColumn, TimeRemainingColumn

RUNS_OF = "{task.completed:.0f} of {task.total:.0f} runs"
"""A column of `runs_bar`."""


def without_number(name: str) -> str:
    """A phase's name without the number at its end: "forth" for "forth 2"."""
    return name.rstrip("0123456789 ") or name


class RunProgress:
    """A context manager that shows how far a run of `duration` [s] has come; feed it with `update`.

    Off a terminal it prints one line per phase, and one for a row of phases whose names differ by their number only.
    The speed counts from the last update at the time of the first, so that what came before, such as compiling, does
    not spoil it.
    """

    def __init__(self, duration: float, console: Console | None = None) -> None:
        self.duration = duration
        self.console = console or Console(stderr=True)
        self._first: tuple[float, float] | None = None
        self._phase: str | None = None
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def __enter__(self) -> RunProgress:
        if self.console.is_terminal:
            self._bar = Progress(
                BarColumn(bar_width=28),
                TextColumn("{task.completed:5.1f} of {task.total:.1f} s"),
                TextColumn("[bold]{task.fields[phase]}"),
                TextColumn("height {task.fields[height]:4.2f} mm"),
                TextColumn("[dim]{task.fields[speed]}"),
                console=self.console,
            )
            self._task = self._bar.add_task("run", total=self.duration, phase="starting", height=0.0, speed="")
            self._bar.start()
        return self

    def update(self, time: float, phase_name: str, height_mm: float) -> None:
        """Show the simulated `time` [s], the phase and the centre's height [mm]."""
        now = clock.perf_counter()
        if self._first is None or time <= self._first[1]:
            self._first = (now, time)
        passed, simulated = now - self._first[0], time - self._first[1]
        speed = f"{simulated / passed:.1f}x real time" if passed > 0.0 and simulated > 0.0 else ""
        if self._bar is not None:
            self._bar.update(self._task, completed=time, phase=phase_name, height=height_mm, speed=speed)
        elif without_number(phase_name) != without_number(self._phase or ""):
            self.console.print(f"{time:6.1f} s  {phase_name}  height {height_mm:.2f} mm", highlight=False, markup=False)
        self._phase = phase_name

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def runs_bar(console: Console, shown: bool, before: ProgressColumn | None, *after: ProgressColumn) -> Progress:
    """A bar for many runs, with the time that is left, and columns of its own `before` and `after` it.

    Not `shown`, or off a terminal, it says nothing.
    """
    columns = [*([] if before is None else [before]), BarColumn(bar_width=28), *after, TimeRemainingColumn()]
    return Progress(*columns, console=console, disable=not (shown and console.is_terminal))
