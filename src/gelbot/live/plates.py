"""The electrodes: a frame in the colour of its voltage round a pane that one sees the gel through. In mm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live import colours
from gelbot.live.moment import Stage
from gelbot.live.view import MM, body, spread

Floats: TypeAlias = NDArray[np.float64]

MOST_LABELS = 40
"""Of more electrodes than these the numbers are left out: they would cover each other."""
VISIBLE = 0.05
"""Volts that are told."""
FRAMES, SOLID = "frames", "solid"
OPACITY = {FRAMES: 0.16, SOLID: 0.88}
"""Of the panes. Through a faint one the gel below is seen, and the pane can still be clicked."""
FRAME = 0.22
"""Breadth of a frame, as a share of the way from the middle to the nearest edge."""


class Plates:
    """The electrodes of `stage`, below `name`; `paint` gives them their volts."""

    def __init__(self, scene: viser.SceneApi, name: str, stage: Stage) -> None:
        self._scene, self._name, self._limit = scene, name, stage.limit
        self.rims: list[Floats] = [outline * MM for outline in stage.outlines]
        """The corners [mm] of each electrode's rim, (3, k)."""
        self._look, self._between = FRAMES, _between(stage)
        self._panes = [self._pane(k) for k in range(len(self.rims))]
        self._frames = [self._frame(k) for k in range(len(self.rims))]
        if self.rims:
            # All in one: each thing by itself takes a processor that draws some time.
            edges = np.concatenate([loop(rim) for rim in self.rims])
            scene.add_line_segments(f"{name}/rims", edges, (110, 110, 110), thickness=1.2, thickness_units="screen")
        self._volts = np.zeros((2, len(self.rims)))
        self._names = short(stage.electrode_names)
        self._labels = self._draw_labels(body(stage)[0])

    def paint(self, given: Floats, asked: Floats) -> None:
        """Show the volts (e,) that they have; `asked` is told where it is something else."""
        volts = np.stack([given, asked])
        for k in np.flatnonzero(np.abs(volts - self._volts).max(axis=0) > 1e-3):
            # What has this colour already is not sent again.
            self._panes[k].color = self._frames[k].color = colours.of_volts(given[k], self._limit)
            if self._labels:
                self._labels[k].text = label(self._names[k], given[k], asked[k])
        self._volts = volts

    def show(self, look: str) -> None:
        """As `FRAMES` or `SOLID`."""
        if look != self._look and look in OPACITY:
            self._look = look
            for pane in self._panes:
                pane.opacity = OPACITY[look]

    def show_labels(self, visible: bool) -> None:
        """Numbers and volts."""
        for one in self._labels:
            one.visible = visible

    def centres(self) -> Floats:
        """The middles of the electrodes [mm], (3, e)."""
        return np.stack([rim.mean(axis=1) for rim in self.rims], axis=1)

    def on_pointer(
        self,
        clicked: Callable[[int, viser.ClientHandle], None],
        dragged: Callable[[viser.SceneNodeDragEvent[viser.MeshHandle]], None],
    ) -> None:
        """Call `clicked` with the electrode's number and the browser, and `dragged` where Ctrl is held and dragged from
        an electrode on."""

        # Coroutines, so that they come in the order in which it happened.
        async def on_drag(event: viser.SceneNodeDragEvent[viser.MeshHandle]) -> None:
            dragged(event)

        for number, parts in enumerate(zip(self._panes, self._frames, strict=True)):

            async def on_click(event: viser.SceneNodePointerEvent[viser.MeshHandle], number: int = number) -> None:
                clicked(number, event.client)

            for part in parts:
                part.on_click(on_click)
                part.on_drag("left", modifier="cmd/ctrl")(on_drag)

    def _pane(self, number: int) -> viser.MeshHandle:
        rim = self.rims[number]
        around = np.arange(rim.shape[1])
        corners = np.concatenate([rim.mean(axis=1, keepdims=True), rim], axis=1).T
        fan = np.stack([np.zeros_like(around), 1 + around, 1 + (around + 1) % len(around)], axis=1)
        # What one sees through is drawn from far to near, by the middles of the boxes round it, and hides what comes
        # later behind it. With corners that no face has, all panes come between the floor and the water's surface.
        beyond = 2.0 * self._between - corners
        return self._mesh(f"{self._name}/panes/{number}", np.concatenate([corners, beyond]), fan, OPACITY[self._look])

    def _frame(self, number: int) -> viser.MeshHandle:
        rim = self.rims[number]
        inner, here = inset(rim, FRAME), np.arange(rim.shape[1])
        on, count = (here + 1) % len(here), len(here)
        band = np.concatenate([np.stack([here, on, on + count]), np.stack([here, on + count, here + count])], axis=1)
        return self._mesh(f"{self._name}/frames/{number}", np.concatenate([rim, inner], axis=1).T, band.T, None)

    def _mesh(self, name: str, corners: Floats, faces: NDArray[np.int64], opacity: float | None) -> viser.MeshHandle:
        return self._scene.add_mesh_simple(
            name, corners, faces, color=colours.of_volts(0.0, self._limit), side="double", flat_shading=True,
            opacity=opacity, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _draw_labels(self, middle: Floats) -> list[viser.LabelHandle]:
        """At the corner that is farthest from the gel, which lies at `middle`: a label in front of it would hide it."""
        if not 0 < len(self.rims) <= MOST_LABELS:
            return []
        far = [np.linalg.norm(rim - middle[:, None], axis=0) for rim in self.rims]
        return [
            self._scene.add_label(
                f"{self._name}/labels/{k}", self._names[k], position=tuple(rim[:, np.argmax(far[k])]),
                anchor="center-center", font_screen_scale=0.8,
            )
            for k, rim in enumerate(self.rims)
        ]  # fmt: skip


def _between(stage: Stage) -> Floats:
    """The middle (3,) of the tank, between its floor and the water's surface."""
    low, high = spread(stage)
    top = stage.water_height * MM
    return np.array([*(0.5 * (low + high)), 0.5 * top if np.isfinite(top) else 1.0])


def short(names: Sequence[str]) -> list[str]:
    """The names without the words with which all of them begin: "electrode 3" is "3" beside "electrode 4"."""
    words = [name.split(" ") for name in names]
    same = 0
    while len(words) > 1 and all(len(w) > same + 1 and w[same] == words[0][same] for w in words):
        same += 1
    return [" ".join(w[same:]) for w in words]


def inset(rim: Floats, share: float) -> Floats:
    """The rim (3, k) of what is left of a plate without a frame, as broad everywhere: `share` of the way from the
    middle to the nearest edge."""
    edges = np.roll(rim, -1, axis=1) - rim
    # Its normal: seen from where it points to, the plate lies to the left of its edges.
    area = np.cross(rim, np.roll(rim, -1, axis=1), axis=0).sum(axis=1)
    inward = np.cross(area, edges, axisa=0, axisb=0).T
    inward /= np.maximum(np.linalg.norm(inward, axis=0), 1e-12)
    before = np.roll(inward, 1, axis=1)
    out = rim.mean(axis=1, keepdims=True) - rim
    width = share * float(np.abs((out * inward).sum(axis=0)).min())
    return rim + width * (before + inward) / np.maximum(1.0 + (before * inward).sum(axis=0), 0.2)


def loop(rim: Floats) -> Floats:
    """The edges (k, 2, 3) of a closed rim (3, k)."""
    return np.stack([rim.T, np.roll(rim, -1, axis=1).T], axis=1)


def label(name: str, given: float, asked: float) -> str:
    """An electrode's name and volts; in brackets those that it was asked to have and has not."""
    if abs(asked - given) >= VISIBLE:
        return f"{name}  {given:+.1f} V ({asked:+.1f})"
    return f"{name}  {given:+.1f} V" if abs(given) >= VISIBLE else name
