"""Where contours carry their values: on a straight stretch, away from edges, from other things and from each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from gelbot.show.style import INK

Floats = NDArray[np.float64]

ROOM = (11.0, 8.0)
"""Half the width and half the height that a value takes, with some room round it [points]."""
APART = 30.0
"""Least distance of two values [points]."""
SHORTEST = 45.0
"""Contours shorter than this [points] carry no value."""


def label_contours(
    axes: Axes, lines: ContourSet, levels: Sequence[float], occupied: Floats, above: float, size: float
) -> None:
    """Write the values of `levels` on their contours, with print of this `size` [points]; the axes' limits are set.

    The boxes `occupied`, (k, 2, 2) [data], stay free, and so does the stretch of `above` [points] over each of them.
    """
    points = 72.0 / float(axes.figure.dpi)
    to_points = axes.transData
    boxes = to_points.transform(occupied.reshape(-1, 2)).reshape(-1, 2, 2) * points
    boxes[:, 1, 1] += above
    edges = to_points.transform(np.stack([axes.get_xlim(), axes.get_ylim()], axis=1)) * points
    placed: list[Floats] = []
    for level, segments in zip(lines.levels, lines.allsegs, strict=True):
        for segment in segments if any(np.isclose(level, wanted) for wanted in levels) else []:
            line = to_points.transform(segment) * points
            chosen = _best(line, edges, boxes, np.array(placed).reshape(-1, 2))
            if chosen is not None:
                placed.append(chosen)
    if not placed:
        return
    places = to_points.inverted().transform(np.array(placed) / points)
    for text in axes.clabel(lines, list(levels), fontsize=size, fmt=plain, inline_spacing=2, manual=places.tolist()):
        text.set(color=INK, zorder=6, path_effects=[withStroke(linewidth=1.2, foreground="white", alpha=0.7)])


def plain(value: float) -> str:
    """A number with a proper minus sign."""
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _best(line: Floats, edges: Floats, boxes: Floats, placed: Floats) -> Floats | None:
    """The best place on a contour, (2,), whose vertices are `line` (k, 2); all in points. None where there is none."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if along[-1] < SHORTEST:
        return None
    inner = np.arange(SHORTEST / 3.0, along[-1] - SHORTEST / 3.0, 3.0)
    if not len(inner):
        return None

    def at(distance: Floats) -> Floats:
        return np.stack([np.interp(distance, along, line[:, k]) for k in range(2)], axis=1)

    here, room = at(inner), np.array(ROOM)
    inside = np.all((here > edges[0] + room) & (here < edges[1] - room), axis=1)
    taken = np.any(np.all((here[:, None] > boxes[:, 0] - room) & (here[:, None] < boxes[:, 1] + room), axis=2), axis=1)
    distance = np.linalg.norm(here[:, None] - placed, axis=2).min(axis=1, initial=3.0 * APART)
    free = inside & ~taken & (distance > APART)
    if not free.any():
        return None
    # How far the line is from its chord over the length of a value.
    bend = np.linalg.norm(at(inner - ROOM[0]) + at(inner + ROOM[0]) - 2.0 * here, axis=1)
    return here[np.argmin(np.where(free, bend - 0.02 * distance, np.inf))]
