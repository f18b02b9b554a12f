"""The page on which the two maps of a plane stand, each beside or above its colour bar."""

from __future__ import annotations

from typing import NamedTuple

from matplotlib.figure import Figure

from gelbot.show.style import Place, new_figure

WIDTH, DPI = 7.16, 200
"""Both columns of a paper [inches]."""
TALLEST = 4.4
"""Most height of a map [inches]."""
BETWEEN = 0.36
"""From a map to the one below it [inches]."""
WIDE = 1.5
"""A plane wider than this, in its heights, has its maps one above the other, else side by side."""
LONG = 1.5
"""A colour bar at least this long [inches] has room for its meaning, a shorter one for its unit."""


class Page(NamedTuple):
    """A figure with the places of its two maps and of their colour bars, which are upright or not."""

    figure: Figure
    maps: tuple[Place, Place]
    bars: tuple[Place, Place]
    upright: bool

    @property
    def has_long_bars(self) -> bool:
        """Whether a colour bar has room for its meaning beside its unit."""
        return max(self.bars[0][2] * WIDTH, self.bars[0][3] * float(self.figure.get_figheight())) >= LONG


def page_for(aspect: float) -> Page:
    """A page for maps of this `aspect`, height over width; sizes in inches: margins, and what the maps need."""
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
