"""Pictures of a simulated gel as a camera would take them: uneven light, blur, noise, a floor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.hardware.calibration import Calibration
from gelbot.hardware.open_cv import cv2_of

Floats = NDArray[np.float64]
Pixels = NDArray[np.uint8]

SUBPIXEL_BITS = 4
"""OpenCV draws at whole pixels, or at fractions of a power of two of them."""
FINER = 2
"""Pictures are drawn this much larger and made smaller, which smooths the edges of the gel."""


@dataclass(frozen=True)
class Light:
    """What a picture suffers from.

    Grey values of 255: `background` behind the gel, `gel` where it is seen face on, `rim` darker where it is seen
    edge on. Shares: `gradient` from the left to the right edge, `vignette` at the corners. `blur` [px]: standard
    deviation of the lens's blur; `smear` [px]: how far the picture moves to the right while it is exposed. `noise`:
    standard deviation, in grey values. `jpeg`: quality 1 to 100, or None. `floor` and `below`: how much darker the line
    where the floor begins is, and what lies under it (seen from the side only).
    """

    background: float = 190.0
    gel: float = 95.0
    rim: float = 25.0
    gradient: float = 0.3
    vignette: float = 0.25
    blur: float = 1.0
    smear: float = 0.0
    noise: float = 4.0
    jpeg: int | None = None
    floor: float = 60.0
    below: float = 30.0


def render(
    positions: Floats, faces: NDArray[np.int64], calibration: Calibration, light: Light, rng: np.random.Generator
) -> Pixels:
    """A grey picture (height, width) of the surface `faces` (3, f) of the nodes `positions` [m] (3, n).

    Faces that turn towards the camera are filled from the back to the front. With no faces, the tank is empty.
    """
    cv2 = cv2_of("a rendered picture")
    scene = _tank(calibration, light)
    if faces.size:
        scene = _with_gel(scene, positions, faces, calibration, light)
    picture = cv2.resize(scene, (calibration.width, calibration.height), interpolation=cv2.INTER_AREA)
    if light.blur > 0.0:
        picture = cv2.GaussianBlur(picture, (0, 0), light.blur)
    if light.smear >= 2.0:
        length = round(light.smear)
        picture = cv2.filter2D(picture, -1, np.full((1, length), 1.0 / length, np.float32))
    picture = picture * _illumination(calibration, light)
    if light.noise > 0.0:
        picture = picture + rng.normal(0.0, light.noise, picture.shape)
    grey = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    if light.jpeg is not None:
        _, packed = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, light.jpeg])
        grey = np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)
    return grey


def _tank(calibration: Calibration, light: Light) -> NDArray[np.float32]:
    """The tank without gel: its floor ends in a line, seen from the side."""
    scene = np.full((FINER * calibration.height, FINER * calibration.width), light.background, np.float32)
    if calibration.view == "side":
        rows, columns = np.mgrid[: scene.shape[0] : 8, : scene.shape[1] : 8]
        height = calibration.back(np.stack([columns.ravel(), rows.ravel()]) / FINER)[2].reshape(rows.shape)
        height = np.asarray(cv2_of("a rendered picture").resize(height, scene.shape[::-1]))
        scene[height < 0.0] -= light.below
        scene[np.abs(height) < 0.1e-3] -= light.floor
    return scene


def _with_gel(
    scene: NDArray[np.float32],
    positions: Floats,
    faces: NDArray[np.int64],
    calibration: Calibration,
    light: Light,
) -> NDArray[np.float32]:
    cv2 = cv2_of("a rendered picture")
    a, b, c = (positions[:, faces[k]] for k in range(3))
    normals = np.cross(b - a, c - a, axis=0)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=0), 1e-30)
    depth = calibration.axes[2] @ ((a + b + c) / 3.0)
    # Pixel p of the picture covers p - 1/2 to p + 1/2, and as many pixels of the finer one as it is finer.
    pixels = (calibration.project(positions) + 0.5) * FINER - 0.5
    corners = np.round(pixels.T[faces.T] * 2**SUBPIXEL_BITS).astype(np.int32)
    facing = normals.T @ calibration.axes[2]
    for k in np.argsort(depth):
        if facing[k] > -0.05:
            grey = light.gel - light.rim * (1.0 - min(1.0, abs(float(facing[k])))) + 12.0 * float(normals[2, k])
            cv2.fillConvexPoly(scene, corners[k], grey, shift=SUBPIXEL_BITS)
    return scene


def _illumination(calibration: Calibration, light: Light) -> Floats:
    x = np.linspace(-1.0, 1.0, calibration.width)[None, :]
    y = np.linspace(-1.0, 1.0, calibration.height)[:, None]
    return (1.0 + 0.5 * light.gradient * x) * (1.0 - 0.5 * light.vignette * (x**2 + y**2))


def write_video(path: Path, pictures: Iterable[Pixels], frames_per_second: float) -> None:
    """Write grey or BGR `pictures` as a video; the ending of `path` says of which kind (.avi: hardly compressed).

    Raises `BadInput` when there are no pictures, or the file cannot be written.
    """
    cv2 = cv2_of("a video")
    writer = None
    code = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    try:
        for picture in pictures:
            if writer is None:
                size = (picture.shape[1], picture.shape[0])
                writer = cv2.VideoWriter(str(path), code, frames_per_second, size)
                if not writer.isOpened():
                    raise BadInput("video", str(path), "a file that can be written, .avi or .mp4")
            writer.write(picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    finally:
        if writer is not None:
            writer.release()
    if writer is None:
        raise BadInput("video", "no pictures", "one picture or more")
