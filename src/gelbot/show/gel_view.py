"""One moment of a run in space: floor, body and electrodes.

Drawn in this order: floor, electrodes in the floor and behind the body, shadow, body, all other electrodes. All but the
floor change from moment to moment, so that a movie draws the rest once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox, TransformedBbox
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from gelbot.show.outlines import Outline, electrode_outlines
from gelbot.show.plates import DrawnPlates, in_view
from gelbot.show.style import ADSORPTION_MAP, FAINT, INK, VOLTAGE_MAP, Place

MM = 1e3
ELEVATION = 14.0
"""Height of the camera [deg]: low enough to see under the electrodes, high enough to see the floor."""
ROOM = 0.55
"""How high the axes may be, as a share of their breadth, before they have to be drawn smaller."""
AMBIENT = 0.6
"""Brightness of a face that the light does not reach, as a share of the brightest."""
STONE = np.array([0.72, 0.72, 0.74, 1.0])
"""The colour of obstacles."""


@dataclass(frozen=True)
class Scene:
    """A run's data for drawing, lengths in mm; read once, time first.

    `position` (t, 3, n), `faces` (3, f), `adsorption` (t, f), `voltage` (t, e) that the electrodes have, `centre` and
    `normal` (t, 3), `electrodes` as outlines, `obstacles` as triangles (m, 3, 3), `limit` [V], `breadth` of the body.
    """

    position: NDArray[np.float64]
    faces: NDArray[np.int64]
    adsorption: NDArray[np.float64]
    voltage: NDArray[np.float64]
    centre: NDArray[np.float64]
    normal: NDArray[np.float64]
    electrodes: list[Outline]
    obstacles: NDArray[np.float64]
    limit: float
    breadth: float

    @staticmethod
    def of(run: xr.Dataset) -> Scene:
        """Read the arrays of `run` into memory."""
        rest = run["rest_position"].transpose("space", "node").values * MM
        taken = "electrode_potential"
        return Scene(
            position=run["position"].transpose("time", "space", "node").values * MM,
            faces=run["faces"].transpose("corner", "face").values,
            adsorption=run["adsorption"].transpose("time", "face").values,
            voltage=run[taken if taken in run else "voltage"].transpose("time", "electrode").values,
            centre=run["centre"].transpose("time", "space").values * MM,
            normal=run["normal"].transpose("time", "space").values,
            electrodes=[Outline(o.corners * MM, o.hole * MM) for o in electrode_outlines(run)],
            obstacles=_obstacles(run) * MM,
            limit=float(run.attrs["limit"]),
            breadth=float(np.ptp(rest[:2], axis=1).max()),
        )

    @cached_property
    def window(self) -> tuple[NDArray[np.float64], float]:
        """Middle (2,) and half width of the square to look at: the body's neighbourhood, wherever it goes."""
        low, high = self.centre[:, :2].min(axis=0), self.centre[:, :2].max(axis=0)
        reach = float(np.ptp(self.centre[:, :2], axis=0).max()) / 2.0 + 0.7 * self.breadth
        return (low + high) / 2.0, max(self.breadth, reach)

    @cached_property
    def most_adsorption(self) -> float:
        """The upper end of the colours: the run's largest adsorption, rounded up to a tenth."""
        return max(0.1, float(np.ceil(10.0 * np.nanmax(self.adsorption) - 1e-9)) / 10.0)

    @cached_property
    def azimuth(self) -> float:
        """Where the camera stands [deg]: across the direction into which the body tips, so that one sees it tip."""
        tilt = self.normal[:, :2].sum(axis=0)
        if np.linalg.norm(tilt) < 0.02 * len(self.normal):
            return -60.0
        across = np.degrees(np.arctan2(tilt[1], tilt[0])) + np.array([90.0, -90.0])
        distance = np.abs((across + 60.0 + 180.0) % 360.0 - 180.0)
        return float(across[np.argmin(distance)]) + 12.0


def _obstacles(run: xr.Dataset) -> NDArray[np.float64]:
    """Their surfaces [m], (m, 3, 3): triangle, corner, space. Runs of before they were kept have none."""
    if "obstacle_surface" not in run:
        return np.zeros((0, 3, 3))
    return run["obstacle_surface"].transpose("obstacle_face", "corner", "space").values


class GelView:
    """The body, the floor and the electrodes round it in a three-dimensional picture; `show` moves it to a moment."""

    def __init__(self, figure: Figure, area: Place, scene: Scene, labels: bool = True) -> None:
        self.scene = scene
        self.axes: Axes3D = figure.add_axes(area, projection="3d", computed_zorder=False)  # pyright: ignore
        (x, y), half = scene.window
        self._low, self._high = np.array([x - half, y - half]), np.array([x + half, y + half])
        self._frame(labels)
        self._towards_camera = _direction(scene.azimuth, ELEVATION)
        # The light comes from above, over the camera's left shoulder.
        self._light = _direction(scene.azimuth - 40.0, 50.0)
        self._ads_colours = ADSORPTION_MAP(np.linspace(0.0, 1.0, 256))
        seen, brightness, _ = self._lit(scene.obstacles)
        # In one collection with the body's faces, so that what is in front of the other is drawn after it.
        self._stones, stone = scene.obstacles[seen], np.tile(STONE, (int(seen.sum()), 1))
        stone[:, :3] *= brightness[seen, None]
        self._stone_colours = stone

        reach = (1.5 if labels else 1.35) * half
        # Above the body at its start, an electrode is before it, whichever way the camera looks.
        top = float(scene.position[0, 2].max())
        self._before, self._behind = in_view(scene.electrodes, np.array([x, y]), reach, self._towards_camera, top)
        self._shadow = Poly3DCollection([], facecolors="#d3d3d3", edgecolors="#d3d3d3", linewidths=0.3, zorder=2)
        self._gel = Poly3DCollection([], linewidths=0.3, zorder=3)
        self._arrow = Line3DCollection([], colors=INK, linewidths=1.2, zorder=4)
        self._plates = DrawnPlates(self._before, zorder=5.0)
        self._far_plates = DrawnPlates(self._behind, zorder=1.5)
        self.moving = (*self._far_plates.artists, self._shadow, self._gel, self._arrow, *self._plates.artists)
        for artist in self.moving:
            self.axes.add_collection3d(artist, autolim=False)
        # The axes themselves are a square in the middle of the area; the picture fills all of it.
        edge = TransformedBbox(Bbox.from_bounds(*area), figure.transFigure)
        for artist in self.axes.collections:
            artist.set_clip_path(None)
            artist.set_clip_box(edge)

    def show(self, k: int) -> None:
        """Move the picture to frame `k` of the run."""
        scene = self.scene
        corners = scene.position[k][:, scene.faces].transpose(2, 1, 0)
        seen, brightness, normals = self._lit(corners)
        adsorbed = np.clip(scene.adsorption[k] / scene.most_adsorption, 0.0, 1.0)
        shade = self._ads_colours[(255.0 * adsorbed).astype(int)]
        shade[:, :3] *= brightness[:, None]
        colours = np.concatenate([shade[seen], self._stone_colours])
        self._gel.set_verts(np.concatenate([corners[seen], self._stones]))
        self._gel.set_facecolor(colours)
        self._gel.set_edgecolor(colours)

        shadow = corners[normals[:, 2] > 0.0].copy()
        shadow[:, :, 2] = 0.0
        self._shadow.set_verts(shadow)

        foot, along = scene.centre[k], scene.normal[k]
        self._arrow.set_segments(_arrow(foot, foot + 0.27 * scene.breadth * along, self._towards_camera))

        colour = VOLTAGE_MAP(Normalize(-scene.limit, scene.limit)(scene.voltage[k]))
        colour[:, 3] = 0.6
        self._plates.paint(colour)
        self._far_plates.paint(colour)

    def _lit(self, corners: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
        """Which triangles (m, 3, 3) face the camera, how bright they are, (m,), and their normals, (m, 3)."""
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        brightness = AMBIENT + (1.0 - AMBIENT) * np.clip(normals @ self._light, 0.0, 1.0)
        return normals @ self._towards_camera > -0.1, brightness, normals

    def draw_moving(self, renderer) -> None:
        """Draw what has moved on top of a picture of the rest; the figure must have been drawn once before."""
        for artist in self.moving:
            artist.do_3d_projection()
            artist.draw(renderer)

    def _frame(self, labels: bool) -> None:
        axes, low, high = self.axes, self._low, self._high
        highest = max(float(outline.corners[2].max()) for outline in self.scene.electrodes)
        top = 1.08 * max(highest, 0.5 * self.scene.breadth)
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_zlim(0.0, top)
        # The axes' box fills the picture's height; one that is too tall is made smaller.
        fits = _screen_height(ROOM) / max(_screen_height(top / (high[0] - low[0])), _screen_height(ROOM))
        zoom: Any = (1.5 if labels else 1.6) * fits  # annotated as int in matplotlib, where it is any number
        axes.set_box_aspect((high[0] - low[0], high[1] - low[1], top), zoom=zoom)
        axes.view_init(elev=ELEVATION, azim=self.scene.azimuth)
        axes.set_proj_type("ortho")
        axes.grid(False)
        axes.patch.set_alpha(0.0)
        if labels:
            sides: Any = axes  # whose axes matplotlib annotates as those of a plane
            for axis, name in ((sides.xaxis, "x"), (sides.yaxis, "y"), (sides.zaxis, "z")):
                axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
                axis.set_label_text(f"{name} [mm]")
                axis.labelpad = -4
            axes.tick_params(pad=-1, labelsize=8)
            axes.set_xticks(_round_marks(low[0], high[0], 10.0))
            axes.set_yticks(_round_marks(low[1], high[1], 10.0))
            sides.set_zticks(np.arange(0.0, top, 5.0))
        else:
            axes.set_axis_off()
        ground = [[(low[0], low[1], 0.0), (high[0], low[1], 0.0), (high[0], high[1], 0.0), (low[0], high[1], 0.0)]]
        floor = Poly3DCollection(ground, facecolors="#f1f1ee", edgecolors=FAINT, linewidths=0.8, zorder=0)
        axes.add_collection3d(floor)
        xs, ys = _round_marks(low[0], high[0], 5.0), _round_marks(low[1], high[1], 5.0)
        lines = [((x, low[1], 0.0), (x, high[1], 0.0)) for x in xs]
        lines += [((low[0], y, 0.0), (high[0], y, 0.0)) for y in ys]
        axes.add_collection3d(Line3DCollection(lines, colors="#dcdcd6", linewidths=0.6, zorder=1))


def _screen_height(ratio: float) -> float:
    """How high a box of height `ratio` and breadth 1 stands on the screen, as a share of its diagonal."""
    e = np.radians(ELEVATION)
    return (ratio * np.cos(e) + np.sqrt(2.0) * np.sin(e)) / np.sqrt(2.0 + ratio**2)


def _direction(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """The unit vector towards `azimuth`, `elevation` [deg], shape (3,)."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _round_marks(low: float, high: float, step: float) -> NDArray[np.float64]:
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def _arrow(
    foot: NDArray[np.float64], head: NDArray[np.float64], towards_camera: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """The strokes of an arrow whose barbs lie across the line of sight."""
    along = head - foot
    across = np.cross(along, towards_camera)
    barbs = [head - 0.25 * along + sign * 0.15 * across for sign in (-1.0, 1.0)]
    return [np.array([foot, head]), np.array([barbs[0], head, barbs[1]])]
