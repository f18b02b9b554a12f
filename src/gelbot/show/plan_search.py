"""search.png: how a search for a programme went, generation by generation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import MaxNLocator

from gelbot.show.style import BLUE, INK, RED, SETTINGS, new_figure, save

FROM_NONE_TO_ALL = LinearSegmentedColormap.from_list("met", [RED, "#dddddd", BLUE])


def draw_search(generations: Sequence[Sequence[tuple[float, float]]], path: Path) -> Path:
    """Write the figure: the cost of each candidate (first number), coloured by the share of robots that met the motion
    (second), and the best so far."""
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(7.2, 4.0, 150)
        axes = figure.add_axes((0.1, 0.14, 0.74, 0.76))
        number = np.concatenate([np.full(len(made), k + 1.0) for k, made in enumerate(generations)])
        cost, share = np.array([one for made in generations for one in made]).T
        points = axes.scatter(number, cost, c=share, cmap=FROM_NONE_TO_ALL, vmin=0.0, vmax=1.0, s=18, zorder=2)
        best = np.minimum.accumulate([min(one[0] for one in made) for made in generations])
        axes.step(np.arange(len(best)) + 1.0, best, where="mid", color=INK, lw=1.2, label="best so far")
        axes.set(xlabel="generation", ylabel="mean cost over the robots", yscale="log")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.colorbar(points, cax=figure.add_axes((0.87, 0.14, 0.02, 0.76)), label="share of robots that met it")
        return save(figure, path)
