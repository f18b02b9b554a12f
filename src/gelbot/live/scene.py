"""The tank in three dimensions: floor, water, electrodes, the gel that is simulated and the one that is seen. In mm."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live import colours
from gelbot.live.between import Between
from gelbot.live.moment import Moment, Seen, Stage
from gelbot.live.skin import Skin
from gelbot.live.view import AZIMUTH, MM, body
from gelbot.show.style import ORANGE, PURPLE

MOST_LABELS = 40
"""Of more electrodes than these the numbers are left out: they would cover each other."""
OVERLAID, BESIDE, HIDDEN = "overlaid", "side by side", "hidden"
VISIBLE = 0.05
"""Volts that are told."""
CLOSE = 1e-3
"""A reference that moves by less [mm] is where it was."""


class Scene:
    """What stands in `stage`, drawn once, and what moves in it, by `update`; `remove` takes it all away."""

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._scene, self.stage = scene, stage
        self.middle, self.breadth = body(stage)
        self._root = scene.add_frame("/stage", show_axes=False)
        self._draw_tank()
        self.electrodes = [self._electrode(k) for k in range(len(stage.outlines))]
        self._volts = np.zeros((2, len(stage.outlines)))
        self._names = short(stage.electrode_names)
        self._labels = self._draw_labels()
        self._gel = scene.add_frame("/stage/gel", show_axes=False)
        self._skin, self._between = Skin(scene, "/stage/gel", stage.faces), Between()
        self._seen = _Skeleton(scene, "/stage/seen", self.breadth)
        self._arrows = scene.add_arrows(
            "/stage/current", np.zeros((1, 2, 3)), colours.of_name(PURPLE), visible=False,
            shaft_radius=0.006 * self.breadth, head_radius=0.018 * self.breadth, head_length=0.05 * self.breadth,
        )  # fmt: skip
        self.show_arrows, self.side = True, OVERLAID
        self.reference = _Reference(scene, self.middle, self.breadth)

    def update(self, moment: Moment, asked: NDArray[np.float64], now: float) -> int:
        """Show this moment at `now` [s of the wall clock]; `asked` [V] (e,) is told where it is not what is given.

        Returns how many meshes of the gel were sent.
        """
        sent = self._skin.update(self._between.positions(moment, now) * MM, moment.adsorption)
        self._paint(moment.given, asked)
        self._seen.update(moment.observed, self.side, self._offset())
        arrows = moment.arrows if self.show_arrows else moment.arrows[:0]
        if len(arrows):
            self._arrows.points = (arrows * MM).astype(np.float32)
        self._arrows.visible = len(arrows) > 0
        self.reference.update(moment.reference * MM)
        return sent

    def show_labels(self, visible: bool) -> None:
        """Numbers and volts at the electrodes."""
        for label in self._labels:
            label.visible = visible

    def centres(self) -> NDArray[np.float64]:
        """The middles of the electrodes [mm], (3, e)."""
        return np.stack([o.mean(axis=1) * MM for o in self.stage.outlines], axis=1)

    def remove(self) -> None:
        """Take everything away."""
        self.reference.remove()
        self._root.remove()

    def _offset(self) -> NDArray[np.float64]:
        """From the simulated gel to the seen one when they stand side by side: to the right of the first view."""
        a = np.radians(AZIMUTH + 90.0)
        return 1.25 * self.breadth * np.array([np.cos(a), np.sin(a), 0.0])

    def _draw_tank(self) -> None:
        stage, scene = self.stage, self._scene
        places = np.concatenate([*(o[:2] for o in stage.outlines), stage.rest[:2]], axis=1) * MM
        low, high = places.min(axis=1) - 7.5, places.max(axis=1) + 7.5
        width, height = np.ceil((high - low) / 10.0) * 10.0
        middle = 0.5 * (low + high)
        scene.add_grid(
            "/stage/floor", width=float(width), height=float(height), cell_size=5.0, section_size=5.0,
            position=(middle[0], middle[1], -0.05), cell_color=(205, 205, 200), section_color=(205, 205, 200),
            cell_thickness=0.8, section_thickness=0.8, plane_color=colours.FLOOR, plane_opacity=1.0,
            fade_distance=1e4, shadow_opacity=0.18,
        )  # fmt: skip
        top = stage.water_height * MM
        if np.isfinite(top):
            water = scene.add_box(
                "/stage/water", dimensions=(float(width), float(height), 0.02), color=colours.WATER, opacity=0.10,
                cast_shadow=False, receive_shadow=False, position=(middle[0], middle[1], top),
            )  # fmt: skip
            water.side = "double"
            edge = _loop(np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0], [0.0] * 4]))
            edge = edge * np.array([width / 2.0, height / 2.0, 1.0]) + np.array([*middle, top])
            scene.add_line_segments(
                "/stage/water_edge", edge, colours.of_name("#9cc3da"), thickness=1.2, thickness_units="screen"
            )
        if len(stage.obstacles):
            corners = (stage.obstacles * MM).reshape(-1, 3)
            scene.add_mesh_simple(
                "/stage/obstacles", corners, np.arange(len(corners)).reshape(-1, 3), color=colours.STONE,
                flat_shading=True, side="double",
            )  # fmt: skip

    def _electrode(self, number: int) -> viser.MeshHandle:
        rim = self.stage.outlines[number] * MM
        around = np.arange(rim.shape[1])
        corners = np.concatenate([rim.mean(axis=1, keepdims=True), rim], axis=1).T
        fan = np.stack([np.zeros_like(around), 1 + around, 1 + (around + 1) % len(around)], axis=1)
        self._scene.add_line_segments(
            f"/stage/rims/{number}", _loop(rim), (110, 110, 110), thickness=1.2, thickness_units="screen"
        )
        return self._scene.add_mesh_simple(
            f"/stage/electrodes/{number}", corners, fan, color=colours.of_volts(0.0, self.stage.limit), side="double",
            flat_shading=True, opacity=0.88, cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _draw_labels(self) -> list[viser.LabelHandle]:
        if not 0 < len(self.stage.outlines) <= MOST_LABELS:
            return []
        places = self.centres().T
        return [
            self._scene.add_label(
                f"/stage/labels/{k}", name, position=tuple(place), anchor="center-center", font_screen_scale=0.8,
            )
            for k, (name, place) in enumerate(zip(self._names, places, strict=True))
        ]  # fmt: skip

    def _paint(self, given: NDArray[np.float64], asked: NDArray[np.float64]) -> None:
        volts = np.stack([given, asked])
        for k in np.flatnonzero(np.abs(volts - self._volts).max(axis=0) > 1e-3):
            self.electrodes[k].color = colours.of_volts(given[k], self.stage.limit)
            if self._labels:
                self._labels[k].text = _label(self._names[k], given[k], asked[k])
        self._volts = volts


class _Skeleton:
    """The gel as it is seen: lines from its centre to its tips, and its normal, coloured by how sure that is."""

    def __init__(self, scene: viser.SceneApi, name: str, breadth: float) -> None:
        self._scene, self._name, self._breadth = scene, name, breadth
        self._root = scene.add_frame(name, show_axes=False, visible=False)
        self._knobs: list[viser.IcosphereHandle] = []
        self._lines: viser.LineSegmentsHandle | None = None
        self._normal: viser.ArrowsHandle | None = None
        self._shown: Seen | None = None

    def update(self, seen: Seen | None, side: str, offset: NDArray[np.float64]) -> None:
        self._root.visible = seen is not None and side != HIDDEN
        self._root.position = offset if side == BESIDE else np.zeros(3)
        if seen is None or seen is self._shown or side == HIDDEN:
            return
        self._shown = seen
        points = np.concatenate([seen.centre[None], seen.tips.T]) * MM
        lines = np.stack([np.broadcast_to(points[0], points[1:].shape), points[1:]], axis=1).astype(np.float32)
        normal = np.stack([points[0], points[0] + 0.35 * self._breadth * seen.normal])[None].astype(np.float32)
        colour = colours.of_confidence(seen.confidence)
        if self._lines is None or self._normal is None or len(self._knobs) != len(points):
            self._draw(points, lines, normal, colour)
            return
        self._lines.points, self._normal.points = lines, normal
        for knob, place in zip(self._knobs, points, strict=True):
            knob.position, knob.color = place, colour
        self._lines.colors = self._normal.colors = np.array(colour, dtype=np.uint8)

    def _draw(
        self,
        points: NDArray[np.float64],
        lines: NDArray[np.float32],
        normal: NDArray[np.float32],
        colour: colours.Colour,
    ) -> None:
        scene, name, size = self._scene, self._name, self._breadth
        self._lines = scene.add_line_segments(f"{name}/lines", lines, colour, thickness=2.5, thickness_units="screen")
        for knob in self._knobs[len(points) :]:
            knob.remove()
        # Balls, not points: viser makes a new shader for points that change their colour, and the picture stands still.
        self._knobs = [
            scene.add_icosphere(
                f"{name}/knob_{k}", 0.022 * size, color=colour, subdivisions=2, position=place, cast_shadow=False,
            )
            for k, place in enumerate(points)
        ]  # fmt: skip
        self._normal = scene.add_arrows(
            f"{name}/normal", normal, colour, shaft_radius=0.009 * size, head_radius=0.028 * size,
            head_length=0.07 * size,
        )  # fmt: skip


class _Reference:
    """The height that the centre should have: a pane, and a handle beside the gel to drag it by."""

    def __init__(self, scene: viser.SceneApi, middle: NDArray[np.float64], breadth: float) -> None:
        a = np.radians(AZIMUTH + 90.0)
        beside = middle[:2] - 0.75 * breadth * np.array([np.cos(a), np.sin(a)])
        self._places = (np.array([*middle[:2], 0.0]), np.array([*beside, 0.0]))
        # Not below "/stage": what a handle reports are places in its parent's frame, and this one is the world.
        self.handle = scene.add_transform_controls(
            "/reference", scale=0.22 * breadth, active_axes=(False, False, True), disable_sliders=True,
            disable_rotations=True, translation_limits=((-1e3, 1e3), (-1e3, 1e3), (0.0, 2.0 * breadth)),
            line_width=4.0, visible=False, position=tuple(self._places[1]),
        )  # fmt: skip
        self._pane = scene.add_box(
            "/reference_pane", dimensions=(1.1 * breadth, 1.1 * breadth, 0.03), color=colours.of_name(ORANGE),
            opacity=0.15, cast_shadow=False, receive_shadow=False, visible=False,
        )  # fmt: skip
        rim = 0.55 * breadth * np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0], [0.0] * 4])
        self._edge = scene.add_line_segments(
            "/reference_pane/edge", _loop(rim), colours.of_name(ORANGE), thickness=1.5, thickness_units="screen"
        )
        self.dragged = False
        self._height = float("nan")

    def update(self, height: float) -> None:
        """Stand at `height` [mm], NaN: nowhere. While it is dragged it is left alone."""
        there = bool(np.isfinite(height))
        self.handle.visible = self._pane.visible = there
        if not there or abs(height - self._height) < CLOSE:
            return
        self._height = height
        self._pane.position = self._places[0] + [0.0, 0.0, height]
        if not self.dragged:
            self.handle.position = self._places[1] + [0.0, 0.0, height]

    def stand(self) -> None:
        """Put the handle back beside the pane."""
        self.dragged = False
        if np.isfinite(self._height):
            self.handle.position = self._places[1] + [0.0, 0.0, self._height]

    def remove(self) -> None:
        """Take it away."""
        self.handle.remove()
        self._pane.remove()


def on_each(electrodes: list[viser.MeshHandle], clicked: Callable[[int, viser.ClientHandle], None]) -> None:
    """Call `clicked` with the electrode's number and the browser."""
    for number, electrode in enumerate(electrodes):

        async def on_click(event: viser.SceneNodePointerEvent[viser.MeshHandle], number: int = number) -> None:
            clicked(number, event.client)

        electrode.on_click(on_click)


def short(names: Sequence[str]) -> list[str]:
    """The names without the words with which all of them begin: "electrode 3" is "3" beside "electrode 4"."""
    words = [name.split(" ") for name in names]
    same = 0
    while len(words) > 1 and all(len(w) > same + 1 and w[same] == words[0][same] for w in words):
        same += 1
    return [" ".join(w[same:]) for w in words]


def _loop(rim: NDArray[np.float64]) -> NDArray[np.float64]:
    """The edges (k, 2, 3) of a closed rim (3, k)."""
    return np.stack([rim.T, np.roll(rim, -1, axis=1).T], axis=1)


def _label(name: str, given: float, asked: float) -> str:
    """An electrode's name and volts; in brackets those that it was asked to have and has not."""
    if abs(asked - given) >= VISIBLE:
        return f"{name}  {given:+.1f} V ({asked:+.1f})"
    return f"{name}  {given:+.1f} V" if abs(given) >= VISIBLE else name
