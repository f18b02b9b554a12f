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
"""Of the first view [deg], as in the movie: low enough to see under the electrodes."""
VIEWS = ("body", "tank", "above")


@dataclass(frozen=True)
class View:
    """Camera at `position` (3,) looking at `target` (3,)."""

    position: NDArray[np.float64]
    target: NDArray[np.float64]


def view(stage: Stage, name: str, aspect: float = 1.0) -> View:
    """A view by its name, one of `VIEWS`: the body from across, all electrodes from across, all of it from above.

    `aspect`: breadth of the picture by its height; in a high one what is broad must be further away.
    """
    middle, breadth = body(stage)
    gap = max((float(o[2].max()) for o in stage.outlines), default=0.0) * MM
    corners = [o[:2].T * MM for o in stage.outlines]
    low, high = (f(np.concatenate(corners), axis=0) if corners else middle[:2] for f in (np.min, np.max))
    span = max(float(np.max(high - low)), 2.0 * breadth)
    span = span / min(1.0, aspect)
    if name == "body":
        target = np.array([middle[0], middle[1], 0.45 * max(gap, 0.7 * breadth)])
        return View(target + _away(AZIMUTH, ELEVATION, 2.9 * breadth * max(1.0, 0.5 / aspect)), target)
    target = np.array([*(0.5 * (low + high)), 0.3 * gap])
    if name == "tank":
        return View(target + _away(AZIMUTH, 32.0, 1.15 * span), target)
    # Not quite from above: there "up" would have no direction.
    return View(target + _away(-90.0, 89.0, 1.35 * span), target)


def body(stage: Stage) -> tuple[NDArray[np.float64], float]:
    """Middle (3,) and breadth of the gel at rest."""
    low, high = stage.rest.min(axis=1) * MM, stage.rest.max(axis=1) * MM
    return 0.5 * (low + high), max(float(np.max((high - low)[:2])), 1e-3)


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


def _away(azimuth: float, elevation: float, size: float) -> NDArray[np.float64]:
    """From a target to a camera that sees `size` across the height of its picture."""
    a, e = np.radians(azimuth), np.radians(elevation)
    distance = 0.5 * size / np.tan(0.5 * FIELD_OF_VIEW)
    return distance * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
