"""One moment of a run from above: the whole array, its voltages, and the body."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.path import Path
from numpy.typing import NDArray

from gelbot.show.gel_view import Scene
from gelbot.show.outlines import Outline, seen_from
from gelbot.show.style import FAINT, INK, VOLTAGE_MAP


class PlanView:
    """The whole array from above: the electrodes with their voltages, and the body."""

    def __init__(self, axes: Axes, scene: Scene, labels: bool = True) -> None:
        self.scene, self.axes = scene, axes
        plates = [seen_from(outline, np.array([0.0, 0.0, 1.0])) for outline in scene.electrodes]
        # What is higher is drawn later.
        self._order = np.argsort([plate.corners[2].max() for plate in plates], kind="stable")
        self._plates = PathCollection([_path(plates[n]) for n in self._order], edgecolors=INK, linewidths=0.6)
        self._plates.set(cmap=VOLTAGE_MAP, clim=(-scene.limit, scene.limit))
        # The same faces twice: the wide white edges under the dark ones are the body's outline.
        self._halo = PolyCollection([], facecolors="white", edgecolors="white", linewidths=2.4 if labels else 1.2)
        self._body = PolyCollection([], facecolors=INK, edgecolors=INK, linewidths=0.3)
        self.moving = (self._plates, self._halo, self._body)
        for artist in self.moving:
            axes.add_collection(artist, autolim=False)
        (left, low), (right, high), margin = _bounds(scene, plates)
        axes.set(xlim=(left - margin, right + margin), ylim=(low - margin, high + margin), aspect="equal")
        axes.spines[["top", "right"]].set_visible(True)
        axes.spines[:].set_color(FAINT)
        if labels:
            axes.tick_params(labelsize=8)
            axes.set_xlabel("x [mm]", fontsize=8, labelpad=1)
            axes.set_ylabel("y [mm]", fontsize=8, labelpad=-4)
        else:
            axes.set(xticks=[], yticks=[])

    @property
    def plates(self) -> PathCollection:
        """The plates, whose colours mean volts: what a colour bar needs."""
        return self._plates

    def show(self, k: int) -> None:
        """Move the plan to frame `k` of the run."""
        scene = self.scene
        self._plates.set_array(scene.voltage[k][self._order])
        outline = scene.position[k][:2][:, scene.faces].transpose(2, 1, 0)
        self._halo.set_verts(outline)
        self._body.set_verts(outline)

    def draw_moving(self, renderer) -> None:
        """Draw what has moved on top of a picture of the rest."""
        for artist in self.moving:
            artist.draw(renderer)


def _path(plate: Outline) -> Path:
    """An outline and its hole as a path whose inside can be filled."""
    loops = [loop[:2, [*range(loop.shape[1]), 0]].T for loop in plate if loop.shape[1]]
    return Path.make_compound_path(*[Path(loop, closed=True) for loop in loops])


def _bounds(scene: Scene, plates: list[Outline]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """The lowest and the highest x and y, (2,) each, of electrodes and body, and a margin round them."""
    lows = np.array([plate.corners[:2].min(axis=1) for plate in plates])
    highs = np.array([plate.corners[:2].max(axis=1) for plate in plates])
    body = scene.position[:, :2]
    span = max(float(np.ptp(lows + highs, axis=0).max()) / 2.0, float((highs - lows).max()))
    low, high = lows.min(axis=0), highs.max(axis=0)
    return np.minimum(low, body.min(axis=(0, 2))), np.maximum(high, body.max(axis=(0, 2))), 0.06 * span
