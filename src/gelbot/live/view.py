"""Where the camera stands, and where on the screen things are then. Lengths in mm, as in the scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live.moment import Stage

MM = 1e3
FIELD_OF_VIEW = np.radians(20.0)
"""Narrow, from far away: nearly as in the movie, where what is further off is not smaller."""
AZIMUTH, ELEVATION = -60.0, 15.0
"""Of the view of the body [deg], as in the movie: low enough to see under the electrodes."""
OVERLOOK = -80.0, 44.0
"""Azimuth and elevation of the view of the tank [deg]: the rows of a grid stand apart, and a body is seen to rise."""
ROOM = 0.88
"""Of the picture, what is shown fills so much: beside it there are labels."""
NARROW = 0.9
"""Breadth by height of a picture between the panels, in a window that is rather narrow."""
VIEWS = ALL, BODY, ABOVE = "tank", "body", "above"
"""The first one is what one sees first."""


@dataclass(frozen=True)
class View:
    """Camera at `position` (3,) looking at `target` (3,)."""

    position: NDArray[np.float64]
    target: NDArray[np.float64]


def view(stage: Stage, name: str, aspect: float = NARROW) -> View:
    """A view by its name, one of `VIEWS`: all electrodes and the gel from across, the gel alone, all of it from above.

    `aspect`: breadth of the picture by its height.
    """
    middle, breadth = body(stage)
    if name == BODY:
        gap = max((float(o[2].max()) for o in stage.outlines), default=0.0) * MM
        target = np.array([middle[0], middle[1], 0.45 * max(gap, 0.7 * breadth)])
        size = 2.9 * breadth * max(1.0, 0.5 / aspect)
        return View(target + 0.5 * size / np.tan(0.5 * FIELD_OF_VIEW) * _towards(AZIMUTH, ELEVATION), target)
    # The gel, also when it has risen, and something round it where there is nothing else.
    around = middle[:, None] + breadth * np.array([[-1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.7]])
    points = np.concatenate([around, stage.rest * MM, *(o * MM for o in stage.outlines)], axis=1)
    # Not quite from above: there "up" would have no direction.
    return fitted(points, *(OVERLOOK if name == ALL else (-90.0, 89.0)), aspect)


def fitted(points: NDArray[np.float64], azimuth: float, elevation: float, aspect: float) -> View:
    """From this direction [deg], as near as all `points` (3, n) are inside the picture."""
    back = _towards(azimuth, elevation)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    near = back @ points
    place, distances = np.zeros(3), []
    for side, slope in ((right, aspect), (up, 1.0)):
        slope = ROOM * slope * np.tan(0.5 * FIELD_OF_VIEW)
        # A point is inside where |side . (point - eye)| <= slope back . (eye - point): two planes through the eye, and
        # each touches the points.
        high, low = np.max(side @ points + slope * near), np.max(slope * near - side @ points)
        place += 0.5 * (high - low) * side
        distances.append(0.5 * (high + low) / slope)
    far = max(distances)
    # It turns about where the points are.
    return View(place + far * back, place + np.median(near) * back)


def body(stage: Stage) -> tuple[NDArray[np.float64], float]:
    """Middle (3,) and breadth of the gel at rest."""
    low, high = stage.rest.min(axis=1) * MM, stage.rest.max(axis=1) * MM
    return 0.5 * (low + high), max(float(np.max((high - low)[:2])), 1e-3)


def spread(stage: Stage) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From where to where (2,) everything stands on the floor."""
    places = np.concatenate([*(o[:2] for o in stage.outlines), stage.rest[:2]], axis=1) * MM
    return places.min(axis=1), places.max(axis=1)


def on_screen(camera: viser.CameraHandle, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a browser shows `points` (3, n): shares of the picture (2, n) from its upper left corner, NaN behind it."""
    w, x, y, z = camera.wxyz
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    seen = turned.T @ (points - camera.position[:, None])
    half = np.tan(camera.fov / 2.0)
    depth = np.where(seen[2] > 0.0, seen[2], np.nan)
    return 0.5 + 0.5 * seen[:2] / (depth * half * np.array([[camera.aspect], [1.0]]))


def _towards(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """The direction (3,) from a target to a camera."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
