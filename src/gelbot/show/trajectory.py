"""trajectory.png, the paper's Fig. 7(a): the centre's height against its reference, and what goes with it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from gelbot.show.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    RED,
    SETTINGS,
    SKY,
    drawable,
    new_figure,
    phase_name,
    phase_shade,
    save,
)

TIP_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY)


def draw_trajectory(run: xr.Dataset, path: Path) -> Path:
    """Write the figure of `run` to the PNG file `path`: height, amplitude, tip angles and normal over time."""
    run = drawable(run)
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(7.2, 7.4, 150)
        rows = figure.subplots(4, 1, sharex=True, height_ratios=[3.0, 1.2, 1.6, 1.2])
        for axes in rows:
            shade_phases(axes, run, names=axes is rows[0])
        draw_height(rows[0], run)
        _draw_amplitude(rows[1], run)
        _draw_tips(rows[2], run)
        _draw_normal(rows[3], run)
        rows[-1].set_xlabel("time [s]")
        figure.align_ylabels(list(rows))
        figure.subplots_adjust(left=0.11, right=0.975, top=0.955, bottom=0.07, hspace=0.14)
        return save(figure, path)


def shade_phases(axes: Axes, run: xr.Dataset, names: bool) -> None:
    """Shade the phases of `run` over time; with `names`, write each phase's name above its stretch."""
    time, phase = run["time"].values, run["phase"].values
    span = max(float(time[-1] - time[0]), 1e-9)
    axes.set_xlim(time[0], time[0] + span)
    changes = np.flatnonzero(np.diff(phase)) + 1
    last_end = -np.inf
    for first, last in pairwise([0, *changes, len(time) - 1]):
        start, end = time[first], time[last]
        axes.axvspan(start, end, color=phase_shade(int(phase[first])), lw=0, zorder=0)
        if first in changes:
            axes.axvline(start, color=FAINT, lw=0.8, zorder=1)
        name = phase_name(run, int(phase[first]))
        # A name is about this wide in the trajectory's figure; one without room would run into its neighbour.
        width, middle = 0.0145 * len(name) * span, (start + end) / 2.0
        if names and middle - width / 2.0 > last_end:
            axes.text(middle, 1.015, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom")
            last_end = middle + width / 2.0


def draw_height(axes: Axes, run: xr.Dataset, faint: bool = False) -> None:
    """The centre's height and its reference [mm]; `faint`: in grey, as the ground of a curve that grows on it."""
    time, height = run["time"].values, run["centre"].transpose("time", "space").values[:, 2] * 1e3
    reference, phase = run["reference"].values * 1e3, run["phase"].values
    if np.isfinite(reference).any():
        axes.plot(time, reference, "--", color=FAINT if faint else INK, lw=1.2, label="reference")
    axes.plot(time, height, color="#c4c4c4" if faint else BLUE, lw=1.2 if faint else 2.0, label="centre of the body")
    axes.set_ylim(0.0, 1.18 * float(np.nanmax([height, reference])))
    axes.set_ylabel("height [mm]", fontsize=8 if faint else None)
    if faint:
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
        axes.tick_params(labelsize=8)
        return
    if phase.max() >= 1:
        k = int(np.argmax(phase >= 1))
        label = f"switch: {time[k]:.1f} s, {height[k]:.1f} mm"
        axes.plot(time[k], height[k], "o", color=RED, ms=7, zorder=5, label=label)
    axes.legend(loc="upper left")


def _draw_amplitude(axes: Axes, run: xr.Dataset) -> None:
    limit = float(run.attrs["limit"])
    axes.plot(run["time"].values, run["amplitude"].values, color=GREEN, lw=1.4)
    for sign in (-1.0, 1.0):
        axes.axhline(sign * limit, color=FAINT, lw=0.8, ls=":")
    axes.set(ylabel="E [V]", ylim=(-1.25 * limit, 1.25 * limit), yticks=[-limit, 0.0, limit])


def _draw_tips(axes: Axes, run: xr.Dataset) -> None:
    time, angles = run["time"].values, np.degrees(run["tip_angle"].transpose("time", "tip").values)
    for tip, angle in enumerate(angles.T):
        colour = TIP_COLOURS[tip % len(TIP_COLOURS)]
        # Thinner and thinner, so that tips that move alike all show.
        width = 1.1 + 0.6 * max(0, len(TIP_COLOURS) - 1 - tip)
        axes.plot(time, _without_jumps(angle), color=colour, lw=width, label=str(tip + 1))
    # The smallest of these scales that holds all angles.
    reach = next((r for r in (45, 90, 180) if np.abs(angles).max() <= r), 180)
    axes.axhline(90.0, color=FAINT, lw=0.8, ls=":")
    marks = np.arange(-reach, reach + 1, 90 if reach > 90 else 45)
    axes.set(ylabel="tip angle [deg]", ylim=(-1.08 * reach, 1.08 * reach), yticks=marks)
    if 1 < angles.shape[1] <= len(TIP_COLOURS):
        axes.legend(title="tip", loc="lower left", ncols=5, fontsize=8, title_fontsize=8, handlelength=1.2)


def _draw_normal(axes: Axes, run: xr.Dataset) -> None:
    axes.plot(run["time"].values, run["normal"].transpose("time", "space").values[:, 2], color=INK, lw=1.6)
    axes.axhline(-0.8, color=FAINT, lw=0.8, ls=":")
    axes.text(0.008, 0.13, "turned over below the dotted line", transform=axes.transAxes, fontsize=8, va="bottom")
    axes.set(ylabel="normal's z", ylim=(-1.12, 1.12), yticks=[-1, 0, 1])


def _without_jumps(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """The angle [deg] with a gap where it passes from +180 to -180."""
    gaps = np.abs(np.diff(angle, append=angle[-1:])) > 180.0
    return np.where(gaps, np.nan, angle)
