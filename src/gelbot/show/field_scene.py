"""What stands in a plane of the field: electrodes, gel, floor, surface and walls."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.patheffects import Normal, Stroke, withStroke
from matplotlib.transforms import offset_copy
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gelbot.show.cuts import across, chained, cut, loops, silhouette, surface_cut
from gelbot.show.outlines import Outline, electrode_outlines, seen_from
from gelbot.show.style import FAINT, INK, VOLTAGE_MAP

Floats = NDArray[np.float64]

MM = 1e3
LABELLED = 36
"""More electrodes than this carry no label."""
TINY = 6.5
"""Size of the print in a map [points]."""
LABEL_HEIGHT = 11.0
"""How high the voltage over an electrode reaches [points]."""
WATER, BOARD = "#2b7bb9", "#c9c9c9"
HALO = withStroke(linewidth=1.5, foreground="white")


def draw_scene(axes: Axes, data: xr.Dataset, axis: int, value: float, volts: Normalize) -> None:
    """Draw all that stands where coordinate `axis` is `value` [m]; the axes are in mm, their limits are set.

    `volts` puts the electrodes' voltages on the scale of the potential's colours.
    """
    _draw_boundaries(axes, data, axis)
    _draw_gel(axes, data, axis, value)
    colours = VOLTAGE_MAP(volts(data["electrode_potential"].values))
    if axis == 2:
        _draw_plan(axes, data, value, colours)
    else:
        _draw_section(axes, data, axis, value, colours)


def occupied(data: xr.Dataset, axis: int, value: float) -> Floats:
    """Boxes that other texts should keep out of, (k, 2, 2) [mm]: [box, lowest or highest corner, axis]."""
    outlines = electrode_outlines(data)
    if axis == 2:
        places = [outline.corners[:2].T for outline in outlines]
    else:
        places = [shapely.get_coordinates(cut(outline, axis, value)) for outline in outlines]
    places.append(_gel_cut(data, axis, value).reshape(-1, 2))
    boxes = [(place.min(axis=0), place.max(axis=0)) for place in places if len(place)]
    return np.array(boxes).reshape(-1, 2, 2) * MM


def _draw_section(axes: Axes, data: xr.Dataset, axis: int, value: float, colours: Floats) -> None:
    """Electrodes as the plane cuts them, with their voltages; those in front of it and behind it dotted."""
    backing = data["electrode_backing"].values
    back = data["electrode_axis"].transpose("electrode", "space").values
    volts = data["electrode_potential"].values
    front = np.zeros(3)
    front[axis] = -1.0 if axis == 1 else 1.0
    for n, (outline, colour) in enumerate(zip(electrode_outlines(data), colours, strict=True)):
        found = cut(outline, axis, value)
        if found.is_empty:
            corners = seen_from(outline, front).corners[list(across(axis))].T * MM
            axes.add_patch(Polygon(corners, fill=False, edgecolor=FAINT, linewidth=0.8, linestyle=":", zorder=4))
            continue
        if backing[n] > 0.0:
            behind = outline.corners - backing[n] * back[n][:, None]
            board = Outline(np.concatenate([outline.corners, behind], axis=1), outline.hole[:, :0])
            _draw_cut(axes, cut(board, axis, value), BOARD)
        _draw_cut(axes, found, colour)
        _label(axes, shapely.get_coordinates(found) * MM, _in_volts(volts[n]))


def _draw_plan(axes: Axes, data: xr.Dataset, value: float, colours: Floats) -> None:
    """Electrodes seen from above in the colours of their voltages, with their numbers; filled where they are cut."""
    labelled = data.sizes["electrode"] <= LABELLED
    for n, (outline, colour) in enumerate(zip(electrode_outlines(data), colours, strict=True)):
        found = cut(outline, 2, value)
        if found.area > 0.0:
            _draw_cut(axes, found, colour)
        for loop in seen_from(outline, np.array([0.0, 0.0, 1.0])) if found.area == 0.0 else ():
            if loop.shape[1]:
                patch = Polygon(loop[:2].T * MM, fill=False, edgecolor=colour, linewidth=1.4, zorder=4)
                patch.set_path_effects([Stroke(linewidth=2.6, foreground=INK), Normal()])
                axes.add_patch(patch)
        if labelled:
            x, y = outline.corners[:2].mean(axis=1) * MM
            number = axes.text(x, y, str(n), fontsize=TINY, ha="center", va="center", zorder=7)
            number.set_path_effects([HALO])


def _draw_cut(axes: Axes, shape: BaseGeometry, colour: Any) -> None:
    """What a plane cuts out of something: areas filled, lines thick, both with a dark edge."""
    for edges in loops(shape):
        if len(edges[0]) > 2:
            path = Path.make_compound_path(*[Path(edge * MM, closed=True) for edge in edges])
            axes.add_patch(PathPatch(path, facecolor=colour, edgecolor=INK, linewidth=0.8, zorder=5))
        else:
            (line,) = axes.plot(*(edges[0] * MM).T, color=colour, linewidth=2.2, solid_capstyle="butt", zorder=5)
            line.set_path_effects([Stroke(linewidth=3.8, foreground=INK), Normal()])


def _draw_gel(axes: Axes, data: xr.Dataset, axis: int, value: float) -> None:
    """The gel's outline where the plane cuts it; where it does not, in a view from above, how it looks from there."""
    segments, style = _gel_cut(data, axis, value), "solid"
    if not len(segments) and axis == 2:
        segments, style = silhouette(*_gel(data), axis), (0.0, (3.0, 2.0))
    lines = [line * MM for line in chained(segments)]
    for colour, width in (("white", 2.4), (INK, 1.0)):
        drawn = LineCollection(lines, colors=colour, linewidths=width, zorder=6)
        drawn.set_linestyle(style if colour == INK else "solid")
        axes.add_collection(drawn, autolim=False)


def _gel(data: xr.Dataset) -> tuple[Floats, NDArray[np.int64]]:
    """Nodes (3, n) [m] and triangles (3, f) of the gel's surface."""
    position = data["body_position"].transpose("space", "node").values
    return position, data["body_faces"].transpose("corner", "face").values


def _gel_cut(data: xr.Dataset, axis: int, value: float) -> Floats:
    return surface_cut(*_gel(data), axis, value)


def _draw_boundaries(axes: Axes, data: xr.Dataset, axis: int) -> None:
    """Insulating floor and walls as thick lines, the free surface as a thin one with its mark."""
    bounds = np.reshape(data.attrs["boundaries"], (3, 2)) * MM
    limits = (axes.get_xlim(), axes.get_ylim())
    for side, along in enumerate(across(axis)):
        for end, place in enumerate(bounds[along]):
            if not np.isfinite(place) or abs(place - limits[side][end]) > 1e-6:
                continue
            surface = along == 2 and end == 1
            spine = axes.spines[("left", "right")[end] if side == 0 else ("bottom", "top")[end]]
            spine.set(color=WATER if surface else INK, linewidth=1.4 if surface else 2.4)
            if surface:
                above = offset_copy(axes.transAxes, axes.get_figure(root=True), y=3.6, units="points")
                axes.plot(0.985, 1.0, marker="v", markersize=5, color=WATER, transform=above, clip_on=False)


def _in_volts(value: float) -> str:
    return f"{value:+.3g} V".replace("-", "\N{MINUS SIGN}") if abs(value) > 5e-4 else "0 V"


def _label(axes: Axes, corners: Floats, text: str) -> None:
    """A text over the cut whose corners are (k, 2) [mm]."""
    (x, _), top = (corners.min(axis=0) + corners.max(axis=0)) / 2.0, corners[:, 1].max()
    lift: Any = {"xytext": (0.0, LABEL_HEIGHT - TINY), "textcoords": "offset points", "ha": "center", "zorder": 7}
    note = axes.annotate(text, (x, top), fontsize=TINY, **lift)
    note.set_path_effects([HALO])
