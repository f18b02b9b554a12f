"""The look that all figures share: colours for colour-blind eyes too (Okabe and Ito 2008), fonts, writing a file."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from gelbot.show.progress import without_number

BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, FAINT = "#222222", "#8a8a8a"
PHASE_SHADES = ("#e9f1f8", "#fdf0d9", "#e6f3ee", "#f7e8f0")

# Both maps leave out the ends of the printed ones: plates and gel stay lighter than the ink drawn on them.
VOLTAGE_MAP = LinearSegmentedColormap.from_list("volts", matplotlib.colormaps["RdBu_r"](np.linspace(0.1, 0.9, 65)))
ADSORPTION_MAP = LinearSegmentedColormap.from_list("ads", matplotlib.colormaps["YlGn"](np.linspace(0.12, 0.95, 65)))

Place: TypeAlias = tuple[float, float, float, float]
"""A rectangle of a figure: left, bottom, width, height, as shares of the figure."""

SETTINGS: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def new_figure(width: float, height: float, dpi: float) -> Figure:
    """An empty white figure of `width` x `height` inches that needs no display and no global state."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write `figure` to `path`, a file of the kind that its name ends with (.png, .pdf), in one indivisible step."""
    draft = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        figure.savefig(draft, format=path.suffix[1:])
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path


def add_colour_bars(figure: Figure, limit: float, most_adsorption: float, places: Sequence[Place], size: float) -> None:
    """Horizontal bars for voltages up to `limit` [V] and adsorption, in two `places` of the figure, `size` of font."""
    meanings = (
        (VOLTAGE_MAP, "voltage [V]", -limit, limit),
        (ADSORPTION_MAP, "adsorption", 0.0, most_adsorption),
    )
    for place, (colours, label, low, high) in zip(places, meanings, strict=True):
        axes = figure.add_axes(place)
        mappable = ScalarMappable(Normalize(low, high), colours)
        figure.colorbar(mappable, cax=axes, orientation="horizontal", ticks=[low, (low + high) / 2.0, high])
        axes.set_title(label, fontsize=size, pad=3)
        axes.tick_params(labelsize=size, pad=1.5)


def drawable(run: xr.Dataset) -> xr.Dataset:
    """The run without frames that are not finite. Raises `ValueError` when nothing is left."""
    frames = run.isel(time=np.flatnonzero(np.isfinite(run["centre"].values).all(axis=1))) if "centre" in run else run
    if frames.sizes.get("time", 0) == 0:
        raise ValueError("a run without frames gives no picture")
    return frames


def phase_name(run: xr.Dataset, phase: int) -> str:
    """The name of phase number `phase`, or "phase 3" where the run does not name it."""
    names = list(run.attrs.get("phase_names", []))
    return str(names[phase]) if 0 <= phase < len(names) else f"phase {phase + 1}"


MANY = 12
"""Changes of phase above which a run is a rhythm: its phases "forth 1", "forth 2", ... are then shown as "forth"."""


def stretches(run: xr.Dataset) -> list[tuple[int, int, str]]:
    """The first and the last frame of each stretch of the run with one phase, and its name."""
    phase = run["phase"].values
    names = np.array([phase_name(run, k) for k in range(int(phase.max()) + 1)])[phase]
    if is_rhythm(run):
        names = np.array([without_number(name) for name in names])
    changes = np.flatnonzero(names[1:] != names[:-1]) + 1
    return [(int(a), int(b), str(names[a])) for a, b in pairwise([0, *changes, len(phase) - 1])]


def is_rhythm(run: xr.Dataset) -> bool:
    """Whether the phases change so often that a picture has no room for each."""
    return int(np.count_nonzero(np.diff(run["phase"].values))) > MANY


def phase_shade(phase: int) -> str:
    """A pale background colour for phase number `phase`."""
    return PHASE_SHADES[phase % len(PHASE_SHADES)]
