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
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from gelbot.errors import shortened
from gelbot.show.contour_labels import label_contours, plain
from gelbot.show.cuts import across
from gelbot.show.field_page import Page, page_for
from gelbot.show.field_scene import LABEL_HEIGHT, MM, TINY, draw_scene, occupied
from gelbot.show.style import FAINT, INK, SETTINGS, VOLTAGE_MAP, save

Floats = NDArray[np.float64]

OUTLIERS = 0.4
"""Per cent of the current densities beyond each end of the colours: at the edges of plates they have no limit."""
SMALL = 8.0
"""Size of the print round the maps [points]."""
DEEPEST = 300.0
"""Most that a colour range spans, largest over smallest: inside a solid electrode there is no current at all."""
LINES = 3.0
"""Density of the streamlines, both ways together."""
LEVELS = 26
"""Most steps of potential from one contour to the next."""
ALONG = 1e-6
"""A current along the plane that is nowhere more than this share of the largest one is rounding."""
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
        # Nowhere is it beyond that of the electrodes, but for what single panels do at their surface.
        bounds = data["electrode_potential"].values
        potential = data[f"potential_{number}"].transpose(up, right).values.clip(bounds.min(), bounds.max())
        return Section(
            axis=axis,
            value=float(data[f"{'xyz'[axis]}_{number}"]),
            u=data[right].values * MM,
            v=data[up].values * MM,
            potential=potential,
            density=data[f"current_density_{number}"].transpose("space", up, right).values,
        )

    @property
    def size(self) -> Floats:
        """|i| [A/m^2], shape (v, u)."""
        return np.linalg.norm(self.density, axis=0)

    @property
    def flows(self) -> bool:
        """Whether there is any current."""
        return bool(self.size.max() > 0.0)

    @property
    def has_lines(self) -> bool:
        """Whether a current flows along the plane: else it has one potential, and contours would show rounding."""
        along = np.linalg.norm(self.density[list(across(self.axis))], axis=0)
        return bool(along.max() > ALONG * self.size.max())


def draw_plane(data: xr.Dataset, number: int, paths: list[Path]) -> list[Path]:
    """Write the picture of plane `number` of a field's data set to `paths`, of the kinds that their names end with."""
    section = Section.of(data, number)
    with matplotlib.rc_context({**SETTINGS, "font.size": SMALL, "pdf.fonttype": 42, "axes.linewidth": 0.6}):
        page = page_for(float(np.ptp(section.v) / np.ptp(section.u)))
        figure = page.figure
        maps, bars = ([figure.add_axes(place) for place in places] for places in (page.maps, page.bars))
        for letter, what, axes in zip("ab", ("potential", "current density"), maps, strict=True):
            _frame(axes, section, f"({letter}) {what}", named=letter == "b" or not page.upright)
        _headline(page, data, section)
        upright = "vertical" if page.upright else "horizontal"
        long = page.has_long_bars
        labels = ("potential [V]", "current density [A/m$^2$]") if long else ("V", "A/m$^2$")
        volts = _draw_potential(maps[0], section, data)
        ticks = MaxNLocator(9 if long else 5, steps=STEPS)
        figure.colorbar(volts, bars[0], orientation=upright, label=labels[0], ticks=ticks)
        amperes = _draw_density(maps[1], section)
        beyond = {"low": "min", "high": "max", "low high": "both"}.get(_beyond(section, amperes), "neither")
        bar = figure.colorbar(amperes, bars[1], orientation=upright, label=labels[1], extend=beyond)
        low, high = amperes.get_clim()
        is_narrow = high < 5.0 * low or not section.flows
        bar.locator = MaxNLocator(5, steps=STEPS) if is_narrow else LogLocator(subs=(1.0, 2.0, 5.0))
        bar.formatter, bar.minorlocator = FuncFormatter(lambda x, _: f"{x:g}"), NullLocator()
        for axes in maps:
            draw_scene(axes, data, section.axis, section.value, _volts(data))
        return [save(figure, path) for path in paths]


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
    page.figure.text(left, 1.0 - 0.1 / height, title, fontsize=9.5, weight="bold", va="top", parse_math=False)
    page.figure.text(left, 1.0 - 0.3 / height, drive, fontsize=SMALL, va="top", parse_math=False)


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


def _draw_potential(axes: Axes, section: Section, data: xr.Dataset) -> ContourSet | QuadMesh:
    """Filled contours, white at 0 V, each second one with its value; one colour where there is one potential."""
    u, v, potential = section.u, section.v, section.potential
    if not section.has_lines:
        corners = np.full((2, 2), potential.mean())
        return axes.pcolormesh(u[[0, -1]], v[[0, -1]], corners, cmap=VOLTAGE_MAP, norm=_volts(data), shading="gouraud")
    low, high = float(potential.min()), float(potential.max())
    levels = MaxNLocator(LEVELS, steps=[1.0, 2.0, 2.5, 5.0, 10.0]).tick_values(low, high)
    filled = axes.contourf(u, v, potential, levels=levels, cmap=VOLTAGE_MAP, norm=_volts(data))
    # No white hairlines between the areas, in viewers that smooth their edges.
    filled.set_edgecolor("face")
    lines = axes.contour(u, v, potential, levels=levels, colors=INK, linewidths=0.4, linestyles="solid")
    step = levels[1] - levels[0]
    even = [level for level in levels if round(level / step) % 2 == 0]
    above = 0.0 if section.axis == 2 else LABEL_HEIGHT
    label_contours(axes, lines, even, occupied(data, section.axis, section.value), above, TINY)
    return filled


def _volts(data: xr.Dataset) -> Normalize:
    """The scale of the colours of field and plates, the same in all planes; 0 V is in its middle."""
    most = float(np.abs(data["electrode_potential"].values).max()) or 1.0
    return Normalize(-most, most, clip=True)


def _draw_density(axes: Axes, section: Section) -> QuadMesh:
    """Its size in colours, on a logarithmic scale; lines along the part of it that lies in the plane."""
    size, norm = section.size, Normalize(0.0, 1.0)
    if section.flows:
        low, high = np.percentile(size, [OUTLIERS, 100.0 - OUTLIERS])
        norm = LogNorm(max(low, high / DEEPEST), max(high, 1.001 * low))
    mesh = axes.pcolormesh(section.u, section.v, size, cmap=DENSITY_MAP, norm=norm, shading="gouraud")
    mesh.set_rasterized(True)
    if section.has_lines:
        right, up = (section.density[a] for a in across(section.axis))
        span = np.array([np.ptp(section.u), np.ptp(section.v)])
        lines: Any = tuple(LINES * span / span.sum())  # annotated as one number in matplotlib, where it may be two
        look: Any = {"color": "white", "linewidth": 0.5, "arrowsize": 0.5, "minlength": 0.15}
        axes.streamplot(section.u, section.v, right, up, density=lines, **look)
    return mesh


def _beyond(section: Section, mesh: QuadMesh) -> str:
    """On which sides values are beyond the colours."""
    size, (low, high) = section.size, mesh.get_clim()
    return " ".join(name for name, there in (("low", size.min() < low), ("high", size.max() > high)) if there)
