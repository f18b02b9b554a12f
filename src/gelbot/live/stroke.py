"""Painting: which plates a pointer passes over that is dragged from one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live.view import on_screen

Floats: TypeAlias = NDArray[np.float64]

STEPS = 40
"""Places looked at between two that a browser tells of: it tells twenty a second, and a quick hand is far by then."""


class Strokes:
    """The strokes of all browsers: each plate counts once in a stroke."""

    def __init__(self) -> None:
        self._last: dict[int, Floats] = {}
        self._passed: dict[int, set[int]] = {}

    def begin(self, browser: int, place: Sequence[float]) -> None:
        """Another stroke begins at `place`: shares of the picture from its upper left corner."""
        self._last[browser], self._passed[browser] = np.array(place, np.float64), set()

    def go_on(
        self, browser: int, camera: viser.CameraHandle, rims: Sequence[Floats], place: Sequence[float]
    ) -> list[int]:
        """It goes on to `place`. Returns the numbers of the plates, by their `rims` (3, k), that are new to it."""
        if browser not in self._last:
            return []
        here = np.array(place, np.float64)
        way = self._last[browser] + np.linspace(0.0, 1.0, STEPS)[:, None] * (here - self._last[browser])
        self._last[browser] = here
        found = [number for number in under(camera, rims, way) if number not in self._passed[browser]]
        self._passed[browser].update(found)
        return found

    def end(self, browser: int) -> None:
        """It ends, or the browser goes."""
        self._last.pop(browser, None)
        self._passed.pop(browser, None)


def under(camera: viser.CameraHandle, rims: Sequence[Floats], places: Floats) -> list[int]:
    """The plates that are seen at these `places` (n, 2) of the picture, each once; of several the nearest."""
    nearest = np.full(len(places), -1)
    away = [float(np.linalg.norm(rim.mean(axis=1) - camera.position)) for rim in rims]
    for number in sorted(range(len(rims)), key=lambda k: -away[k]):
        nearest[_inside(places, on_screen(camera, rims[number]).T)] = number
    order = [int(number) for number in nearest if number >= 0]
    return list(dict.fromkeys(order))


def _inside(places: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Which of the places (n, 2) lie inside a polygon (k, 2): a ray from there crosses its edges an odd number of
    times."""
    x, y = places[:, 0, None], places[:, 1, None]
    (x1, y1), (x2, y2) = corners.T, np.roll(corners, -1, axis=0).T
    spans = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crosses = spans & (x < x1 + (y - y1) / (y2 - y1) * (x2 - x1))
    return crosses.sum(axis=1) % 2 == 1
