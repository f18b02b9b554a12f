"""One moment of a run from above: the whole array, its voltages, and the body."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from gelbot.show.gel_view import Scene
from gelbot.show.style import FAINT, INK, VOLTAGE_MAP


class PlanView:
    """The whole array from above: the plates with their voltages, and the body."""

    def __init__(self, axes: Axes, scene: Scene, labels: bool = True) -> None:
        self.scene, self.axes = scene, axes
        x, y = scene.electrodes[:2]
        offset = scene.side / 2.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        squares = np.stack([x, y], axis=1)[:, None] + offset
        self._plates = PolyCollection(list(squares), edgecolors=INK, linewidths=0.6)
        self._plates.set(cmap=VOLTAGE_MAP, clim=(-scene.limit, scene.limit))
        # The same faces twice: the wide white edges under the dark ones are the body's outline.
        self._halo = PolyCollection([], facecolors="white", edgecolors="white", linewidths=2.4 if labels else 1.2)
        self._body = PolyCollection([], facecolors=INK, edgecolors=INK, linewidths=0.3)
        self.moving = (self._plates, self._halo, self._body)
        for artist in self.moving:
            axes.add_collection(artist, autolim=False)
        margin = scene.side / 2.0 + 0.06 * max(float(np.ptp(x)), scene.side)
        axes.set(xlim=(x.min() - margin, x.max() + margin), ylim=(y.min() - margin, y.max() + margin), aspect="equal")
        axes.spines[["top", "right"]].set_visible(True)
        axes.spines[:].set_color(FAINT)
        if labels:
            axes.tick_params(labelsize=8)
            axes.set_xlabel("x [mm]", fontsize=8, labelpad=1)
            axes.set_ylabel("y [mm]", fontsize=8, labelpad=-4)
        else:
            axes.set(xticks=[], yticks=[])

    @property
    def plates(self) -> PolyCollection:
        """The plates, whose colours mean volts: what a colour bar needs."""
        return self._plates

    def show(self, k: int) -> None:
        """Move the plan to frame `k` of the run."""
        scene = self.scene
        self._plates.set_array(scene.voltage[k])
        outline = scene.position[k][:2][:, scene.faces].transpose(2, 1, 0)
        self._halo.set_verts(outline)
        self._body.set_verts(outline)

    def draw_moving(self, renderer) -> None:
        """Draw what has moved on top of a picture of the rest."""
        for artist in self.moving:
            artist.draw(renderer)
