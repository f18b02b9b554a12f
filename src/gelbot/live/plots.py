"""The last minute as lines: height against reference, voltages, currents; and the camera's picture."""

from __future__ import annotations

from collections import deque
from typing import Any, TypeAlias

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from gelbot.live.moment import Moment, Stage
from gelbot.show.style import BLUE, FAINT, GREEN, ORANGE, PURPLE, RED, SKY

Lines: TypeAlias = tuple[NDArray[np.float64], ...]

SPAN = 60.0
"""What is shown [s], of the gel's time."""
MOST = 600
"""Points of a line; older ones are forgotten even when they are younger than `SPAN`."""
HEIGHT = 118
"""Of a plot [px]."""
COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, "#7f7f7f", "#b5a800")
BLANK = np.full((48, 64, 3), 240, dtype=np.uint8)
WIDTH = 1.4
"""Of a line [px]."""
HIGHEST = 0.55
"""What is shown of heights, as a share of the gel's breadth: one that stands on its arms is half as high as broad."""


class History:
    """The last minute of a `stage`, a row a moment: time, heights seen, simulated and wanted, volts, currents."""

    def __init__(self, stage: Stage) -> None:
        count = len(stage.outlines)
        self._rows: deque[NDArray[np.float64]] = deque(maxlen=MOST)
        self._count = count
        out = np.linalg.norm(stage.rest[:2] - stage.rest[:2].mean(axis=1, keepdims=True), axis=0)
        # The middle of the gel: the twentieth part of its nodes that lies closest to it at rest, on all its layers.
        self._middle = np.flatnonzero(out <= np.sort(out)[len(out) // 20] + 1e-9)

    def add(self, moment: Moment) -> bool:
        """Keep this moment. Returns whether it was new; one that lies before the last begins the history anew."""
        if self._rows:
            last = float(self._rows[-1][0])
            if moment.time == last:
                return False
            if moment.time < last:
                self._rows.clear()
        seen = float("nan") if moment.observed is None else float(moment.observed.centre[2])
        simulated = float(moment.positions[2, self._middle].mean())
        heights = np.array([moment.time, seen * 1e3, simulated * 1e3, moment.reference * 1e3])
        self._rows.append(
            np.concatenate([heights, np.nan_to_num(np.concatenate([moment.given, moment.currents * 1e3]))])
        )
        while float(self._rows[-1][0] - self._rows[0][0]) > SPAN:
            self._rows.popleft()
        return True

    def heights(self) -> Lines:
        """Time [s] and heights [mm]: seen, simulated, wanted."""
        return self._columns(slice(0, 4))

    def volts(self) -> Lines:
        """Time [s] and the voltage of each electrode [V]."""
        return self._columns([0, *range(4, 4 + self._count)])

    def currents(self) -> Lines:
        """Time [s] and the current of each electrode [mA]."""
        return self._columns([0, *range(4 + self._count, 4 + 2 * self._count)])

    def _columns(self, columns: slice | list[int]) -> Lines:
        # A line needs two points: before there are any, it lies at zero.
        rows = np.array(self._rows) if len(self._rows) > 1 else np.eye(2, 4 + 2 * self._count, k=-1)
        return tuple(np.ascontiguousarray(column) for column in rows[:, columns].T)


class Plots:
    """The panel on the left for one `stage`; `update` shows what is new, `remove` takes it away."""

    def __init__(self, gui: viser.GuiApi, stage: Stage) -> None:
        self._history = History(stage)
        self._picture: viser.GuiImageHandle | None = None
        self._shown: NDArray[np.uint8] | None = None
        self._parts: list[Any] = []
        if stage.has_camera:
            self._parts.append(gui.add_html(_title("camera", ())))
            self._picture = gui.add_image(BLANK, format="jpeg", jpeg_quality=80)
            self._parts.append(self._picture)
        count = len(stage.outlines)
        three = (("seen", BLUE), ("model", FAINT), ("wanted", ORANGE))
        # Limits of its own choice uPlot finds only where there are numbers, and a height may be unknown.
        breadth = 1e3 * float(np.ptp(stage.rest[:2], axis=1).max())
        tall = (0.0, HIGHEST * breadth)
        self._heights = self._plot(gui, _title("height, mm", three), self._history.heights(), three, tall)
        each = [(name, COLOURS[k % len(COLOURS)]) for k, name in enumerate(stage.electrode_names[:count])]
        limits = (-1.05 * stage.limit, 1.05 * stage.limit)
        self._volts = self._plot(gui, _title("voltages, V", ()), self._history.volts(), each, limits)
        self._currents = self._plot(gui, _title("currents, mA", ()), self._history.currents(), each)

    def keep(self, moment: Moment) -> bool:
        """Remember this moment. Returns whether it was new."""
        return self._history.add(moment)

    def update(self) -> None:
        """Show the last minute."""
        self._heights.data = self._history.heights()
        self._volts.data = self._history.volts()
        self._currents.data = self._history.currents()

    def show_picture(self, picture: NDArray[np.uint8] | None) -> None:
        """Show the camera's picture, if it is another one."""
        if self._picture is None or picture is None or picture is self._shown:
            return
        self._shown = picture
        self._picture.image = picture

    def remove(self) -> None:
        """Take the plots away."""
        for part in self._parts:
            part.remove()

    def _plot(
        self,
        gui: viser.GuiApi,
        title: str,
        lines: Lines,
        series: Any,
        limits: tuple[float, float] | None = None,
    ) -> viser.GuiUplotHandle:
        drawn = [
            uplot.Series(label=name, stroke=colour, width=WIDTH, points={"show": False}) for name, colour in series
        ]
        scale = uplot.Scale(auto=True) if limits is None else uplot.Scale(auto=False, range=limits)
        thin = {"stroke": "#eeeeee", "width": 1}
        axis = uplot.Axis(stroke=FAINT, grid=thin, ticks=thin, size=44, font="11px sans-serif")  # pyright: ignore
        across = uplot.Axis(stroke=FAINT, grid=thin, ticks=thin, size=24, font="11px sans-serif")  # pyright: ignore
        self._parts.append(gui.add_html(title))
        plot = gui.add_uplot(
            lines, (uplot.Series(label="s"), *drawn), scales={"x": uplot.Scale(time=False, auto=True), "y": scale},
            axes=(across, axis), legend=uplot.Legend(show=False), height=HEIGHT, padding=(6, 8, 0, 0),
            cursor=uplot.Cursor(show=False),
        )  # fmt: skip
        self._parts.append(plot)
        return plot


def _title(text: str, names: tuple[tuple[str, str], ...]) -> str:
    words = " ".join(f'<span style="color:{colour};margin-left:.5em">&#9644; {name}</span>' for name, colour in names)
    return f'<div class="gelbot-title">{text}{words}</div>'
