"""study.png: how often, how high, how fast - all runs of a study at a glance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from gelbot.show.style import BLUE, FAINT, INK, RED, SETTINGS, SKY, new_figure, save

BINS = 24
HISTOGRAMS = (
    ("t_switch_s", "switch [s]"),
    ("t_transition_s", "transition [s]"),
    ("t_motion_s", "whole motion [s]"),
    ("peak_voltage_V", "peak voltage [V]"),
    ("charge_C", "charge [C]"),
)


def draw_study(study: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Write the figure: all trajectories of the centre, those that failed on top, and the distributions."""
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(9.0, 6.4, 150)
        grid = figure.add_gridspec(2, len(HISTOGRAMS), height_ratios=[2.0, 1.0], hspace=0.42, wspace=0.28,
                                   left=0.07, right=0.98, top=0.9, bottom=0.09)  # fmt: skip
        _draw_heights(figure.add_subplot(grid[0, :]), rows)
        for k, (key, label) in enumerate(HISTOGRAMS):
            _draw_histogram(figure.add_subplot(grid[1, k]), rows, key, label, first=k == 0)
        percent = "{:.1f} %, 95 % interval {:.1f} to {:.1f} %".format(
            *(100.0 * study[key] for key in ("rate", "ci_low", "ci_high"))
        )
        counted = f"{study['successes']} of {study['n']} ({percent})"
        figure.suptitle(f"{study['scenario']}, {study['controller']}: {counted}", x=0.07, ha="left", fontsize=12)
        return save(figure, path)


def _draw_heights(axes: Axes, rows: Sequence[Mapping[str, Any]]) -> None:
    good, bad = [r for r in rows if r["met"]], [r for r in rows if not r["met"]]
    alpha = float(np.clip(12.0 / max(len(good), 1), 0.04, 0.6))
    for row in good:
        axes.plot(row["times_s"], row["heights_mm"], color=BLUE, lw=0.8, alpha=alpha)
    for row in bad:
        axes.plot(row["times_s"], row["heights_mm"], color=RED, lw=1.0, alpha=0.8)
    axes.plot([], [], color=BLUE, label=f"met: {len(good)}")
    if bad:
        axes.plot([], [], color=RED, label=f"failed: {len(bad)}")
    axes.set(xlabel="time [s]", ylabel="height of the centre [mm]", ylim=(0.0, None))
    axes.margins(x=0.0)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2)


def _draw_histogram(axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, label: str, first: bool) -> None:
    values = np.array([row[key] for row in rows if row["met"] and row[key] is not None], float)
    axes.set_xlabel(label, fontsize=9)
    axes.tick_params(labelsize=8)
    if first:
        axes.set_ylabel("runs", fontsize=9)
    if values.size == 0:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=FAINT)
        axes.set(xticks=[], yticks=[])
        return
    # What hardly differs is one bar, not noise.
    width = max(float(np.ptp(values)), 0.02 * abs(float(values.mean())), 1e-12)
    middle = (values.min() + values.max()) / 2.0
    axes.hist(values, bins=BINS, range=(middle - width / 2.0, middle + width / 2.0), color=SKY)
    axes.axvline(float(np.median(values)), color=INK, lw=1.0)
    axes.set_title(f"median {np.median(values):.3g}", fontsize=8)
