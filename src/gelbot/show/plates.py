"""Electrodes in a picture in space: which lie in its window, before and behind the body, and how they are drawn."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import NDArray

from gelbot.show.outlines import Outline, clipped, is_flat, joined, seen_from
from gelbot.show.style import INK

Floats: TypeAlias = NDArray[np.float64]

SLIVER = 0.15
"""An electrode of which less than this share of its breadth lies in the picture is left out."""

Plates: TypeAlias = dict[int, Outline]
"""Electrodes as they look, by their numbers."""


class DrawnPlates:
    """The electrodes of a picture, each in the colour of its voltage."""

    def __init__(self, plates: Plates, zorder: float) -> None:
        self._numbers = list(plates)
        # A seam would show: an electrode with a hole has its edges drawn on their own.
        whole = [plate.hole.shape[1] == 0 for plate in plates.values()]
        edges = [INK if is_whole else "none" for is_whole in whole]
        faces = _equally_long([joined(plate).T for plate in plates.values()])
        self._faces = Poly3DCollection(faces, edgecolors=edges, linewidths=0.8, zorder=zorder)
        loops = [loop for plate, is_whole in zip(plates.values(), whole, strict=True) if not is_whole for loop in plate]
        closed = [np.concatenate([loop, loop[:, :1]], axis=1).T for loop in loops]
        self._rims = Line3DCollection(closed, colors=INK, linewidths=0.8, zorder=zorder)
        self.artists = (self._faces, self._rims)

    def paint(self, colours: Floats) -> None:
        """Give the electrodes their `colours`, RGBA, shape (e, 4)."""
        self._faces.set_facecolor(colours[self._numbers])


def in_view(
    outlines: list[Outline], middle: Floats, half: float, towards_camera: Floats, top: float
) -> tuple[Plates, Plates]:
    """The parts of electrodes inside a square window of `half` its width, before a body and behind it.

    The body stands in the `middle` (2,) of the window and is `top` high.
    """
    before: Plates = {}
    behind: Plates = {}
    for number, outline in enumerate(outlines):
        plate = seen_from(outline, towards_camera)
        part = clipped(plate, middle - half, middle + half)
        if part.corners.shape[1] == 0 or _is_all_hole(part):
            continue
        if not is_flat(outline):
            part = plate  # cut, a rod would show its inside
        breadth, left = np.ptp(plate.corners[:2], axis=1), np.ptp(part.corners[:2], axis=1)
        if np.any(left < SLIVER * breadth):
            continue
        heights = outline.corners[2]
        beyond = (outline.corners.mean(axis=1)[:2] - middle) @ towards_camera[:2] < 0.0
        is_behind = heights.max() <= 0.0 or (heights.min() < top and beyond)
        (behind if is_behind else before)[number] = part
    return before, behind


def _is_all_hole(plate: Outline) -> bool:
    """Whether nothing is left but the hole."""
    outer, hole = (np.cross(loop.T, np.roll(loop, -1, axis=1).T).sum(axis=0) for loop in plate)
    return bool(np.linalg.norm(outer + hole) < 1e-6 * np.linalg.norm(outer))


def _equally_long(loops: list[Floats]) -> list[Floats]:
    """The loops with their last corners repeated: matplotlib does not close loops of different lengths."""
    longest = max((len(loop) for loop in loops), default=0)
    return [np.concatenate([loop, np.repeat(loop[-1:], longest - len(loop), axis=0)]) for loop in loops]
