"""map.png: where in a plane of two values a motion is met, and how long it takes there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from gelbot.show.style import INK, SETTINGS, new_figure, save

FAST_TO_SLOW = LinearSegmentedColormap.from_list("fast", ["#0072B2", "#8fc6e8", "#e3f0f8"])
FAILED = "#e9b8a0"


def draw_sweep(made: Mapping[str, Any], path: Path) -> Path:
    """Write the figure of a map: a cell for each run, red-brown where the motion was not met, else its time in blue,
    and the boundary between them."""
    x, y = (np.array(made[axis]["values"]) for axis in "xy")
    met = np.array(made["met_at"], bool)
    time = np.array([[np.nan if t is None else t for t in line] for line in made["t_motion_s"]], float)
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(7.2, 4.6, 150)
        axes = figure.add_axes((0.12, 0.14, 0.7, 0.76))
        axes.set_facecolor(FAILED)
        cells = axes.pcolormesh(x, y, np.ma.masked_invalid(time), cmap=FAST_TO_SLOW, shading="nearest")
        if met.any() and not met.all():
            axes.contour(x, y, met.astype(float), levels=[0.5], colors=INK, linewidths=1.4)
        labels = [made[axis]["key"] + (f" [{made[axis]['unit']}]" if made[axis]["unit"] else "") for axis in "xy"]
        axes.set(xlabel=labels[0], ylabel=labels[1])
        axes.set_title(f"{made['scenario']}: met at {made['met']} of {made['n']} points", loc="left", fontsize=11)
        if met.any():
            figure.colorbar(cells, cax=figure.add_axes((0.85, 0.14, 0.02, 0.76)), label="whole motion [s]")
        axes.plot([], [], "s", color=FAILED, ms=9, label="not met")
        axes.legend(loc="upper center", bbox_to_anchor=(0.9, 1.12), fontsize=9)
        return save(figure, path)
