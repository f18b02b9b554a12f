"""trajectory.png, the paper's Fig. 7(a): the centre's height against its reference, and what goes with it."""

from __future__ import annotations

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
    is_rhythm,
    new_figure,
    phase_shade,
    save,
    stretches,
)

TIP_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY)


def draw_trajectory(run: xr.Dataset, path: Path) -> Path:
    """Write the figure of `run` to the PNG file `path`: height, amplitude, tip angles and normal over time."""
    run = drawable(run)
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(7.2, 7.4, 150)
        above, heights = ([draw_height, _draw_way], [1.6, 2.0]) if _is_level(run) else ([draw_height], [3.0])
        parts, heights = [*above, _draw_amplitude, _draw_tips, _draw_normal], [*heights, 1.2, 1.6, 1.2]
        rows = figure.subplots(len(parts), 1, sharex=True, height_ratios=heights)
        for axes, draw in zip(rows, parts, strict=True):
            shade_phases(axes, run, names=axes is rows[0])
            draw(axes, run)
        rows[-1].set_xlabel("time [s]")
        figure.align_ylabels(list(rows))
        figure.subplots_adjust(left=0.11, right=0.975, top=0.955, bottom=0.07, hspace=0.14)
        return save(figure, path)


def shade_phases(axes: Axes, run: xr.Dataset, names: bool) -> None:
    """Shade the phases of `run` over time; with `names`, write each phase's name above its stretch."""
    time, phase, rhythm = run["time"].values, run["phase"].values, is_rhythm(run)
    span = max(float(time[-1] - time[0]), 1e-9)
    axes.set_xlim(time[0], time[0] + span)
    last_end = -np.inf
    for k, (first, last, name) in enumerate(stretches(run)):
        start, end = time[first], time[last]
        axes.axvspan(start, end, color=phase_shade(k if rhythm else int(phase[first])), lw=0, zorder=0)
        if first > 0:
            axes.axvline(start, color=FAINT, lw=0.8, zorder=1)
        # A name is about this wide in the trajectory's figure; one without room would run into its neighbour.
        width, middle = 0.0145 * len(name) * span, (start + end) / 2.0
        if names and middle - width / 2.0 > last_end:
            axes.text(middle, 1.015, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom")
            last_end = middle + width / 2.0


def _is_level(run: xr.Dataset) -> bool:
    """Whether the reference is a way along the floor, not a height."""
    return not run.attrs.get("reference_axis", [0.0, 0.0, 1.0])[2]


def _way(run: xr.Dataset) -> NDArray[np.float64]:
    """How far the reference's point has come along its axis [mm]."""
    axis, point = np.array(run.attrs["reference_axis"]), int(run.attrs["reference_point"])
    places = run["centre"].transpose("time", "space").values
    if point > 0:
        places = run["tip_position"].transpose("time", "space", "tip").values[:, :, point - 1]
    start = run["start_point"].transpose("point", "space").values[point] if "start_point" in run else places[0]
    return 1e3 * (places - start) @ axis


def _draw_way(axes: Axes, run: xr.Dataset) -> None:
    point = int(run.attrs.get("reference_point", 0))
    time = run["time"].values
    axes.plot(time, run["reference"].values * 1e3, "--", color=INK, lw=1.2, label="reference")
    label = "centre of the body" if point == 0 else f"tip {point}"
    axes.plot(time, _way(run), color=BLUE, lw=2.0, label=label)
    axes.set_ylabel("along [mm]")
    axes.legend(loc="upper right")


def draw_height(axes: Axes, run: xr.Dataset, faint: bool = False) -> None:
    """The centre's height and its reference [mm]; `faint`: in grey, as the ground of a curve that grows on it."""
    time, height = run["time"].values, run["centre"].transpose("time", "space").values[:, 2] * 1e3
    reference, phase = run["reference"].values * 1e3, run["phase"].values
    if _is_level(run):
        reference = np.full_like(reference, np.nan)
    if np.isfinite(reference).any():
        axes.plot(time, reference, "--", color=FAINT if faint else INK, lw=1.2, label="reference")
    axes.plot(time, height, color="#c4c4c4" if faint else BLUE, lw=1.2 if faint else 2.0, label="centre of the body")
    axes.set_ylim(0.0, 1.18 * float(np.nanmax([height, reference])))
    axes.set_ylabel("height [mm]", fontsize=8 if faint else None)
    if faint:
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
        axes.tick_params(labelsize=8)
        return
    if phase.max() >= 1 and not is_rhythm(run):
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
