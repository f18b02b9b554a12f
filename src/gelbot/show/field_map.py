"""The field on a plane, as a paper could print it: potential, and current density with its streamlines."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from gelbot.errors import shortened
from gelbot.show.contour_labels import label_contours, plain
from gelbot.show.cuts import across
from gelbot.show.field_scene import LABEL_HEIGHT, MM, TINY, draw_scene, occupied
from gelbot.show.style import FAINT, INK, SETTINGS, VOLTAGE_MAP, Place, new_figure, save

Floats = NDArray[np.float64]

WIDTH, DPI = 7.16, 200
"""Both columns of a paper [inches]."""
TALLEST = 4.4
"""Most height of a map [inches]."""
BETWEEN = 0.36
"""From a map to the one below it [inches]."""
WIDE = 1.5
"""A plane wider than this, in its heights, has its maps one above the other, else side by side."""
OUTLIERS = 0.4
"""Per cent of the current densities beyond each end of the colours: at the edges of plates they have no limit."""
SMALL = 8.0
"""Size of the print round the maps [points]."""
AMPERES = "A/m$^2$"
LINES = 3.0
"""Density of the streamlines, both ways together."""
STEPS = [1.0, 2.0, 5.0, 10.0]
DENSITY_MAP = matplotlib.colormaps["viridis"]


class Section(NamedTuple):
    """The field on a plane: its normal's `axis`, where it is [m], its grid `u` (u,), `v` (v,) [mm].

    `potential` (v, u) [V], `density` (3, v, u) [A/m^2].
    """

    axis: int
    value: float
    u: Floats
    v: Floats
    potential: Floats
    density: Floats

    @staticmethod
    def of(data: xr.Dataset, number: int) -> Section:
        """Plane `number` of a field's data set."""
        axis = "xyz".index(data.attrs["plane_axes"][number])
        right, up = (f"{'xyz'[a]}_{number}" for a in across(axis))
        return Section(
            axis=axis,
            value=float(data[f"{'xyz'[axis]}_{number}"]),
            u=data[right].values * MM,
            v=data[up].values * MM,
            potential=data[f"potential_{number}"].transpose(up, right).values,
            density=data[f"current_density_{number}"].transpose("space", up, right).values,
        )

    @property
    def is_uniform(self) -> bool:
        """One potential everywhere, but for rounding: no current flows."""
        return bool(np.ptp(self.potential) <= 1e-9 * np.abs(self.potential).max())


class Page(NamedTuple):
    """A figure with the places of its two maps and of their colour bars, which are upright or not."""

    figure: Figure
    maps: tuple[Place, Place]
    bars: tuple[Place, Place]
    upright: bool


def draw_plane(data: xr.Dataset, number: int, paths: list[Path]) -> list[Path]:
    """Write the picture of plane `number` of a field's data set to `paths`, of the kinds that their names end with."""
    section = Section.of(data, number)
    with matplotlib.rc_context({**SETTINGS, "font.size": SMALL, "pdf.fonttype": 42, "axes.linewidth": 0.6}):
        page = _page(section)
        figure = page.figure
        maps, bars = ([figure.add_axes(place) for place in places] for places in (page.maps, page.bars))
        for letter, what, axes in zip("ab", ("potential", "current density"), maps, strict=True):
            _frame(axes, section, f"({letter}) {what}", named=letter == "b" or not page.upright)
        _headline(page, data, section)
        upright = "vertical" if page.upright else "horizontal"
        volts = _draw_potential(maps[0], section, data)
        figure.colorbar(volts, bars[0], orientation=upright, label="potential [V]", ticks=MaxNLocator(9, steps=STEPS))
        amperes = _draw_density(maps[1], section)
        beyond = {"low": "min", "high": "max", "low high": "both"}.get(_beyond(section, amperes), "neither")
        bar = figure.colorbar(
            amperes, bars[1], orientation=upright, label=f"current density [{AMPERES}]", extend=beyond
        )
        bar.locator, bar.formatter = LogLocator(subs=(1.0, 2.0, 5.0)), FuncFormatter(lambda x, _: f"{x:g}")
        bar.minorlocator = NullLocator()
        for axes in maps:
            draw_scene(axes, data, section.axis, section.value, _volts(section))
        return [save(figure, path) for path in paths]


def _page(section: Section) -> Page:
    """Sizes in inches: margins, and maps of the plane's own proportions."""
    aspect = float(np.ptp(section.v) / np.ptp(section.u))
    left, gap, head, foot = 0.5, 0.62, 0.7, 0.42
    if 1.0 / aspect > WIDE:
        width = min(WIDTH - left - 0.95, TALLEST / aspect)
        height = width * aspect
        total = head + 2.0 * height + BETWEEN + foot
        bottoms = (foot + height + BETWEEN, foot)
        maps = [(left, bottom, width, height) for bottom in bottoms]
        bars = [(left + width + 0.15, bottom, 0.11, height) for bottom in bottoms]
    else:
        width = min((WIDTH - left - gap - 0.15) / 2.0, TALLEST / aspect)
        height = width * aspect
        foot += 0.62
        total = head + height + foot
        starts = (left, left + width + gap)
        maps = [(start, foot, width, height) for start in starts]
        bars = [(start + 0.04 * width, 0.42, 0.92 * width, 0.11) for start in starts]

    def shares(places: list[Place]) -> tuple[Place, Place]:
        one, other = ((x / WIDTH, y / total, w / WIDTH, h / total) for x, y, w, h in places)
        return one, other

    return Page(new_figure(WIDTH, total, DPI), shares(maps), shares(bars), 1.0 / aspect > WIDE)


def _headline(page: Page, data: xr.Dataset, section: Section) -> None:
    """What is seen where, and below it what drives it."""
    height = page.figure.get_figheight()
    seen = "seen from above" if section.axis == 2 else "section"
    name = shortened(str(data.attrs["scenario_name"]), 40)
    title = f"{name}: {seen} at {'xyz'[section.axis]} = {plain(section.value * MM)} mm"
    drive, gel = shortened(str(data.attrs["drive"]), 70), float(data.attrs["gel_conductivity"])
    if np.isfinite(gel):
        drive += f"; gel of {gel:.4g} S/m in a solution of {float(data.attrs['conductivity']):.4g} S/m"
    left = page.maps[0][0]
    page.figure.text(left, 1.0 - 0.1 / height, title, fontsize=9.5, weight="bold", va="top")
    page.figure.text(left, 1.0 - 0.3 / height, drive, fontsize=SMALL, va="top")


def _frame(axes: Axes, section: Section, title: str, named: bool) -> None:
    """Limits, title, ticks; the axis to the right is `named` unless the map below it has the same."""
    axes.set(xlim=section.u[[0, -1]], ylim=section.v[[0, -1]])
    right, up = ("xyz"[a] for a in across(section.axis))
    if named:
        axes.set_xlabel(f"{right} [mm]", labelpad=1)
    else:
        axes.tick_params(labelbottom=False)
    axes.set_ylabel(f"{up} [mm]", labelpad=1)
    axes.set_title(title, fontsize=SMALL, loc="left", pad=4)
    axes.tick_params(length=2.5, pad=2)
    axes.spines[:].set(visible=True, color=FAINT)


def _draw_potential(axes: Axes, section: Section, data: xr.Dataset) -> ContourSet:
    """Filled contours, white at 0 V, each second one with its value."""
    u, v, potential = section.u, section.v, section.potential
    low, high = float(potential.min()), float(potential.max())
    levels = MaxNLocator(24, steps=STEPS).tick_values(*((low - 0.5, high + 0.5) if section.is_uniform else (low, high)))
    filled = axes.contourf(u, v, potential, levels=levels, cmap=VOLTAGE_MAP, norm=_volts(section))
    # No white hairlines between the areas, in viewers that smooth their edges.
    filled.set_edgecolor("face")
    if section.is_uniform:
        return filled
    lines = axes.contour(u, v, potential, levels=levels, colors=INK, linewidths=0.4, linestyles="solid")
    step = levels[1] - levels[0]
    even = [level for level in levels if round(level / step) % 2 == 0]
    above = 0.0 if section.axis == 2 else LABEL_HEIGHT
    label_contours(axes, lines, even, occupied(data, section.axis, section.value), above, TINY)
    return filled


def _volts(section: Section) -> Normalize:
    most = max(float(np.abs(section.potential).max()), 1e-9)
    return Normalize(-most, most, clip=True)


def _draw_density(axes: Axes, section: Section) -> QuadMesh:
    """Its size in colours, on a logarithmic scale; lines along the part of it that lies in the plane."""
    size = _size(section)
    low, high = (1.0, 10.0) if section.is_uniform else np.percentile(size, [OUTLIERS, 100.0 - OUTLIERS])
    norm = LogNorm(max(low, 1e-6 * high), max(high, 1.001 * low))
    mesh = axes.pcolormesh(section.u, section.v, size, cmap=DENSITY_MAP, norm=norm, shading="gouraud")
    mesh.set_rasterized(True)
    if not section.is_uniform:
        right, up = (section.density[a] for a in across(section.axis))
        span = np.array([np.ptp(section.u), np.ptp(section.v)])
        lines: Any = tuple(LINES * span / span.sum())  # annotated as one number in matplotlib, where it may be two
        look: Any = {"color": "white", "linewidth": 0.5, "arrowsize": 0.5, "minlength": 0.15}
        axes.streamplot(section.u, section.v, right, up, density=lines, **look)
    return mesh


def _beyond(section: Section, mesh: QuadMesh) -> str:
    """On which sides values are beyond the colours."""
    size, (low, high) = _size(section), mesh.get_clim()
    return " ".join(name for name, there in (("low", size.min() < low), ("high", size.max() > high)) if there)


def _size(section: Section) -> Floats:
    """|i| [A/m^2], shape (v, u)."""
    return np.linalg.norm(section.density, axis=0)
