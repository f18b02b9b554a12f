"""The tank in three dimensions: floor, water, electrodes, the gel that is simulated and the one that is seen. In mm."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live import colours
from gelbot.live.between import Between
from gelbot.live.moment import Moment, Seen, Stage
from gelbot.live.plates import FRAMES, Plates, loop
from gelbot.live.skin import Skin
from gelbot.live.view import AZIMUTH, MM, body, spread
from gelbot.show.style import ORANGE, PURPLE

OVERLAID, BESIDE, HIDDEN = "overlaid", "side by side", "hidden"
CLOSE = 1e-3
"""A reference that moves by less [mm] is where it was."""


class Scene:
    """What stands in `stage`, drawn once, and what moves in it, by `update`; `remove` takes it all away."""

    def __init__(self, scene: viser.SceneApi, stage: Stage) -> None:
        self._scene, self.stage = scene, stage
        self.middle, self.breadth = body(stage)
        self._root = scene.add_frame("/stage", show_axes=False)
        self._draw_tank()
        self.plates = Plates(scene, "/stage/electrodes", stage)
        self._gel = scene.add_frame("/stage/gel", show_axes=False)
        self._skin, self._between = Skin(scene, "/stage/gel", stage.faces), Between()
        self._seen = _Skeleton(scene, "/stage/seen", self.breadth)
        self._arrows = scene.add_arrows(
            "/stage/current", np.zeros((1, 2, 3)), colours.of_name(PURPLE), visible=False,
            shaft_radius=0.006 * self.breadth, head_radius=0.018 * self.breadth, head_length=0.05 * self.breadth,
        )  # fmt: skip
        self.show_arrows, self.side, self.look = True, OVERLAID, FRAMES
        self.reference = _Reference(scene, self.middle, self.breadth)

    def update(self, moment: Moment, asked: NDArray[np.float64], now: float) -> int:
        """Show this moment at `now` [s of the wall clock]; `asked` [V] (e,) is told where it is not what is given.

        Returns how many meshes of the gel were sent.
        """
        sent = self._skin.update(self._between.positions(moment, now) * MM, moment.adsorption)
        self.plates.paint(moment.given, asked)
        self.plates.show(self.look)
        self._seen.update(moment.observed, self.side, self._offset())
        arrows = moment.arrows if self.show_arrows else moment.arrows[:0]
        if len(arrows):
            self._arrows.points = (arrows * MM).astype(np.float32)
        self._arrows.visible = len(arrows) > 0
        self.reference.update(moment.reference * MM)
        return sent

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
        low, high = spread(stage)
        low, high = low - 7.5, high + 7.5
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
            edge = loop(np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0], [0.0] * 4]))
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
            "/reference_pane/edge", loop(rim), colours.of_name(ORANGE), thickness=1.5, thickness_units="screen"
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
