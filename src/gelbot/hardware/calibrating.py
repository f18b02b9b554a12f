"""`gelbot calibrate`: from a picture of a checkerboard, or of two known points, to the file that a camera needs."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import WallClock
from gelbot.errors import NOTHING, BadInput
from gelbot.hardware.calibration import Calibration, View, from_checkerboard, from_clicks
from gelbot.hardware.camera import VideoCamera
from gelbot.hardware.open_cv import cv2_of
from gelbot.units import quantity

Floats = NDArray[np.float64]
PATIENCE = 5.0
"""A camera must give a picture within this time [s]."""
MARKS, SPACE = 5, 5e-3
"""Lines each way about the known place, and their distance [m], that are drawn into the picture to look at."""


class Asked(NamedTuple):
    """The options of the command, as they were written."""

    source: str
    view: str
    azimuth: str
    distance: str | None
    elevation: str | None
    board: str | None
    square: str
    clicks: tuple[str, ...]
    apart: str | None
    known: str | None
    at: str
    floor: tuple[str, ...]


def calibrate(asked: Asked, out: Path) -> Calibration:
    """Write the calibration to `out`, and beside it the picture with lines on the floor or in the gel's plane.

    Raises `BadInput` and `CameraFailed` before anything is written.
    """
    if asked.view not in get_args(View):
        raise BadInput("--view", asked.view, "side or above")
    view = cast(View, asked.view)
    azimuth = quantity(asked.azimuth, "rad", "--azimuth")
    distance = np.inf if asked.distance is None else quantity(asked.distance, "m", "--distance")
    level = np.pi / 2.0 if view == "above" else 0.0
    elevation = level if asked.elevation is None else quantity(asked.elevation, "rad", "--elevation")
    place = _place(asked.at)
    picture = picture_of(asked.source)
    height, width = picture.shape[:2]
    if asked.board is not None:
        guess = Calibration(view, azimuth, elevation, 0.0, (0.0, 0.0, 0.0), distance, 1e4, 0.0, width, height)
        square = quantity(asked.square, "m", "--square")
        if not square > 0.0:
            raise BadInput("--square", asked.square, "the side of a square, above 0 mm", "2 mm")
        if asked.clicks:
            raise BadInput(
                "--click", " ".join(asked.clicks), "a checkerboard or clicks, one of them", "without --board"
            )
        found = from_checkerboard(picture, corners_of(asked.board), square, place, guess)
    else:
        pair = _pixels(
            "--click", asked.clicks, "two points a known distance apart, such as --click 120,300 --click 500,300"
        )
        if asked.apart is None:
            raise BadInput(
                "--apart", NOTHING, "the distance of the two clicks, or --board with a checkerboard", "15 mm"
            )
        known = pair[:, :1] if asked.known is None else _pixels("--known", (asked.known, asked.known), "")[:, :1]
        floor = (
            _pixels("--floor", asked.floor, "two points on a level line, the left one first") if asked.floor else None
        )
        apart = quantity(asked.apart, "m", "--apart")
        size = (width, height)
        found = from_clicks(view, azimuth, size, pair, apart, known[:, 0], place, floor, elevation, distance)
    if out.exists():
        raise BadInput("--out", str(out), "a file that does not exist yet", "another name")
    found.save(out)
    cv2_of("calibration").imwrite(str(out.with_suffix(".png")), marked(picture, found, place))
    return found


def picture_of(source: str) -> NDArray[np.uint8]:
    """The picture in a file, or the next one of the camera with this number or address. Raises `CameraFailed`."""
    cv2 = cv2_of("calibration")
    if Path(source).is_file():
        pixels = cv2.imread(source)
        if pixels is None:
            raise BadInput("picture", source, "a picture that can be read, such as a PNG", "a camera's number")
        return pixels
    if not source.isdigit() and "://" not in source:
        raise BadInput("picture", source, "a picture that is there, the number of a camera, or the address of a stream")
    clock = WallClock()
    camera = VideoCamera(int(source) if source.isdigit() else source, clock)
    try:
        while (picture := camera.latest()) is None:
            if clock.now() > PATIENCE:
                raise BadInput("picture", source, f"a camera that gives a picture within {PATIENCE:g} s")
            clock.wait_until(clock.now() + 0.02)
        return picture.pixels
    finally:
        camera.close()


def marked(picture: NDArray[np.uint8], calibration: Calibration, place: Floats) -> NDArray[np.uint8]:
    """The picture with lines every `SPACE` about `place` [m] (3,): across the line of sight, from the floor up.

    They are level and upright in the tank; in the picture of a camera that is rolled they lean as the tank does.
    """
    cv2 = cv2_of("calibration")
    colour = picture.copy() if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    right, up, _ = calibration.level_axes
    across = SPACE * np.arange(-MARKS, MARKS + 1)
    foot = place - place[2] * np.array([0.0, 0.0, 1.0]) if calibration.view == "side" else place
    rise = SPACE * np.arange(MARKS) if calibration.view == "side" else across
    lines = [np.stack([foot + a * right + rise[0] * up, foot + a * right + rise[-1] * up]) for a in across]
    lines += [np.stack([foot + across[0] * right + b * up, foot + across[-1] * right + b * up]) for b in rise]
    for line in lines:
        a, b = np.round(calibration.project(line.T).T).astype(int)
        cv2.line(colour, tuple(map(int, a)), tuple(map(int, b)), (60, 160, 255), 1, cv2.LINE_AA)
    return colour


def corners_of(text: str) -> tuple[int, int]:
    """Inner corners of a checkerboard, such as 9x6. Raises `BadInput`."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.strip().isdigit() for part in parts):
        raise BadInput("--board", text, "the inner corners of its rows and columns, such as 9x6")
    return int(parts[0]), int(parts[1])


def _place(text: str) -> Floats:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise BadInput("--at", text, 'x, y and z with units, such as "12.5 mm, 12.5 mm, 0 mm"')
    return np.array([quantity(part, "m", "--at") for part in parts])


def _pixels(option: str, texts: tuple[str, ...], allowed: str) -> Floats:
    """Two places in the picture [px], (2, 2), a column for each."""
    try:
        places = np.array([[float(part) for part in text.split(",")] for text in texts])
    except ValueError:
        places = np.zeros(0)
    if places.shape != (2, 2):
        given = ", ".join(texts) if texts else NOTHING
        raise BadInput(option, given, allowed or "a place in the picture in pixels, such as 320,400")
    return places.T
