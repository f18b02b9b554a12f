"""From places in the tank to pixels and back: where a camera stands, how it looks, and how large its picture is.

A pinhole at `distance` from the plane in which the gel is looked at; the further away, the more telecentric. A point x
[m] is seen, with r, u the directions to the right and upwards in the picture and c the one towards the camera, at

    (X, Y) = ((x - p) r, (x - p) u) / (1 - (x - p) c / distance),    p = `place`
    pixel  = middle + scale (1 + k1 rho^2) (X, -Y),    rho^2 = (X^2 + Y^2) / DISTORTION_RADIUS^2

A camera that looks through the flat wall of the tank sees everything n = 1.33 times nearer: calibrate in the water.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.hardware.open_cv import cv2_of
from gelbot.units import quantity

Floats = NDArray[np.float64]
View = Literal["side", "above"]

DISTORTION_RADIUS = 10e-3
"""Distance from the middle of the picture, in the gel [m], at which `distortion` is the share by which it grows."""
LENGTHS = ("place_x", "place_y", "place_z", "distance")
ANGLES = ("azimuth", "elevation", "roll")
FITTED = {
    "scale": 1e2, "place_right": 1e-4, "place_up": 1e-4, "roll": 1e-3,
    "azimuth": 1e-3, "elevation": 1e-3, "distortion": 1e-3,
}  # fmt: skip
"""What a calibration by known points can find, with the step of its derivatives."""


@dataclass(frozen=True)
class Calibration:
    """How a camera sees the tank.

    `view`: "side" or "above". `azimuth` [rad]: the direction from the gel in which the camera stands, seen from above;
    from above, the direction of the lower edge of its picture. `elevation` [rad]: how far above the horizon it stands.
    `roll` [rad]: how far the camera is turned counter-clockwise about its axis. `place` [m] (3,): what is seen in the
    middle of the picture, in the plane that is `distance` [m] from the lens (infinite: telecentric). `scale` [px/m]
    there. `distortion` k1. `width`, `height` [px].
    """

    view: View
    azimuth: float
    elevation: float
    roll: float
    place: tuple[float, float, float]
    distance: float
    scale: float
    distortion: float
    width: int
    height: int

    def __post_init__(self) -> None:
        where = "calibration"
        if self.view not in ("side", "above"):
            raise BadInput(f"{where}.view", self.view, '"side" or "above"')
        if not (np.isfinite(self.scale) and self.scale > 0.0):
            raise BadInput(f"{where}.scale", self.scale, "a positive number of pixels per metre")
        if not self.distance > 0.0:
            raise BadInput(f"{where}.distance", self.distance, "a positive length, or inf for a telecentric lens")
        if min(self.width, self.height) < 16:
            raise BadInput(f"{where}.size", f"{self.width} x {self.height} px", "16 x 16 pixels or more")
        if not np.all(np.isfinite([self.azimuth, self.elevation, self.roll, self.distortion, *self.place])):
            raise BadInput(where, self, "finite numbers")

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors (3, 3), one a row: to the right and upwards in the picture, and towards the camera."""
        a, e, r = self.azimuth, self.elevation, self.roll
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        up = np.cross(towards, right)
        return np.array([np.cos(r) * right + np.sin(r) * up, np.cos(r) * up - np.sin(r) * right, towards])

    @property
    def level_axes(self) -> Floats:
        """`axes` of the same camera, neither rolled nor tilted: the tank's own directions, across its view."""
        return replace(self, roll=0.0, elevation=0.0 if self.view == "side" else np.pi / 2.0).axes

    @property
    def middle(self) -> Floats:
        """The pixel (2,) in the middle of the picture; pixel (0, 0) is the middle of the upper left one."""
        return np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])

    def project(self, points: Floats) -> Floats:
        """Pixels (2, n), to the right and downwards, of `points` [m] (3, n)."""
        seen = self.axes @ (points - np.array(self.place)[:, None])
        flat = seen[:2] / (1.0 - seen[2] / self.distance)
        grown = 1.0 + self.distortion * np.sum(flat**2, axis=0) / DISTORTION_RADIUS**2
        return self.middle[:, None] + self.scale * grown * flat * np.array([[1.0], [-1.0]])

    def back(self, pixels: Floats, depth: float = 0.0) -> Floats:
        """Points [m] (3, n) seen at `pixels` (2, n), in the plane `depth` [m] nearer to the camera than `place`."""
        bent = (pixels - self.middle[:, None]) * np.array([[1.0], [-1.0]]) / self.scale
        flat = bent.copy()
        for _ in range(20):  # of a contraction: the distortion is small
            flat = bent / (1.0 + self.distortion * np.sum(flat**2, axis=0) / DISTORTION_RADIUS**2)
        flat = flat * (1.0 - depth / self.distance)
        return np.array(self.place)[:, None] + self.axes.T @ np.vstack([flat, np.full(flat.shape[1], depth)])

    def on_floor(self, pixels: Floats, height: float = 0.0) -> Floats:
        """Points [m] (3, n) at `height` [m] above the floor seen at `pixels`; inf where a ray does not meet it."""
        near, far = self.back(pixels, 0.0), self.back(pixels, -1e-3)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (height - near[2]) / (far[2] - near[2])
            found = near + share * (far - near)
        return np.where(np.isfinite(share), found, np.inf)

    def telecentric_error(self, size: float) -> float:
        """By how much [m] a point at `size` [m] from the middle is misplaced if one takes the lens for telecentric.

        The point stands as much nearer to the camera as it is off the middle: `size`^2 / `distance`.
        """
        return size**2 / self.distance

    def save(self, path: Path) -> None:
        """Write a TOML file, with units."""
        place = ", ".join(f'"{v * 1e3:.9g} mm"' for v in self.place)
        lines = ["# How a camera sees the tank: gelbot.hardware.calibration", f'view = "{self.view}"']
        lines += [f'{name} = "{np.degrees(getattr(self, name)):.9g} deg"' for name in ANGLES]
        lines += [f"place = [{place}]"]
        distance = "inf" if np.isinf(self.distance) else f'"{self.distance * 1e3:.9g} mm"'
        lines += [f"distance = {distance}", f'scale = "{self.scale * 1e-3:.9g} px/mm"']
        lines += [f"distortion = {self.distortion:.9g}", f"size = [{self.width}, {self.height}]"]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_calibration(path: Path) -> Calibration:
    """Read what `Calibration.save` wrote. Raises `BadInput` with the key that is missing or wrong."""
    import tomllib

    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise BadInput(str(path), str(error), "a calibration that gelbot wrote, a TOML file") from error
    keys = {"view", *ANGLES, "place", "distance", "scale", "distortion", "size"}
    for key in sorted(keys ^ set(table)):
        raise BadInput(f"{path}: {key}", "nothing" if key in keys else table[key], f"just the keys {sorted(keys)}")
    place, size, distortion = table["place"], table["size"], table["distortion"]
    if not isinstance(place, list) or len(place) != 3:
        raise BadInput(f"{path}: place", place, "three lengths with their units")
    if not isinstance(size, list) or len(size) != 2 or not all(type(v) is int for v in size):
        raise BadInput(f"{path}: size", size, "width and height in whole pixels")
    if isinstance(distortion, bool) or not isinstance(distortion, int | float):
        raise BadInput(f"{path}: distortion", distortion, "a number")
    x, y, z = (quantity(v, "m", f"{path}: place") for v in place)
    distance = table["distance"]
    try:
        return Calibration(
            view=table["view"],
            **{name: quantity(table[name], "rad", f"{path}: {name}") for name in ANGLES},
            place=(x, y, z),
            distance=np.inf if distance == np.inf else quantity(distance, "m", f"{path}: distance"),
            scale=_pixels_per_metre(table["scale"], f"{path}: scale"),
            distortion=float(distortion),
            width=size[0],
            height=size[1],
        )
    except BadInput as error:
        raise error if error.where.startswith(str(path)) else error.inside(str(path)) from error


def _pixels_per_metre(text: object, where: str) -> float:
    if not isinstance(text, str) or not text.strip().endswith("px/mm"):
        raise BadInput(where, text, 'pixels per millimetre, such as "16 px/mm"')
    try:
        return float(text.strip().removesuffix("px/mm")) * 1e3
    except ValueError as error:
        raise BadInput(where, text, 'pixels per millimetre, such as "16 px/mm"') from error


def from_clicks(
    view: View,
    azimuth: float,
    size: tuple[int, int],
    pair: Floats,
    length: float,
    known: Floats,
    known_at: Floats,
    floor: Floats | None = None,
    elevation: float | None = None,
    distance: float = np.inf,
) -> Calibration:
    """A calibration from two clicks on points a known distance apart.

    `pair` [px] (2, 2), a column for each click, `length` [m] apart in a plane across the line of sight; `known` [px]
    (2,) is the place `known_at` [m] (3,), in that plane. `floor` [px] (2, 2): two points on a line that is level in the
    tank, the left one first; without them the camera stands upright. `azimuth`, `elevation` [rad] (level for the
    side, straight down from above, if not given), `size` [px]: width, height.
    """
    apart = float(np.linalg.norm(pair[:, 1] - pair[:, 0]))
    if apart < 10.0 or not length > 0.0:
        raise BadInput("calibration: clicks", f"{apart:.3g} px for {length} m", "two clicks 10 pixels or more apart")
    roll = 0.0
    if floor is not None:
        run, drop = floor[:, 1] - floor[:, 0]
        if not run > 0.0:
            raise BadInput("calibration: floor", floor.tolist(), "two points on the floor, the left one first")
        roll = float(np.arctan2(drop, run))
    if elevation is None:
        elevation = np.pi / 2.0 if view == "above" else 0.0
    place = (float(known_at[0]), float(known_at[1]), float(known_at[2]))
    at_known = Calibration(view, azimuth, elevation, roll, place, distance, apart / length, 0.0, *size)
    to_middle = at_known.back(at_known.middle[:, None])[:, 0] - at_known.back(known[:, None])[:, 0]
    x, y, z = (float(v) for v in np.array(place) + to_middle)
    return replace(at_known, place=(x, y, z))


def from_points(
    guess: Calibration, points: Floats, pixels: Floats, fit: tuple[str, ...] = tuple(FITTED)
) -> Calibration:
    """The calibration that sees `points` [m] (3, n) at `pixels` (2, n), near `guess`, by Gauss-Newton.

    `fit` names what is found, of `FITTED`; the rest stays as in the guess. Points in one plane across the line of sight
    say nothing about `distance`, and only weakly where the camera stands: leave those out. Raises `BadInput` when the
    points cannot tell.
    """
    if points.shape[1] * 2 < len(fit):
        raise BadInput("calibration: points", f"{points.shape[1]} points", f"enough for {len(fit)} numbers")
    steps = np.array([FITTED[name] for name in fit])
    found = guess
    for _ in range(30):
        missed = (pixels - found.project(points)).ravel()
        columns = [
            (_changed(found, name, step).project(points) - _changed(found, name, -step).project(points)).ravel() / 2.0
            for name, step in zip(fit, steps, strict=True)
        ]
        slopes = np.stack(columns, axis=1)
        size = np.linalg.norm(slopes, axis=0)
        scaled = slopes / np.maximum(size, 1e-30)
        if size.min() <= 0.0 or np.linalg.cond(scaled) > 1e7:
            raise BadInput("calibration: points", f"points that cannot tell {', '.join(fit)}", "points further apart")
        change = np.linalg.lstsq(scaled, missed, rcond=None)[0] / size
        for name, by in zip(fit, change * steps, strict=True):
            found = _changed(found, name, float(by))
        if np.max(np.abs(change)) < 1e-6:
            break
    return found


def _changed(old: Calibration, name: str, by: float) -> Calibration:
    if name in ("place_right", "place_up"):
        x, y, z = (float(v) for v in np.array(old.place) + by * old.axes[int(name == "place_up")])
        return replace(old, place=(x, y, z))
    return replace(old, **{name: getattr(old, name) + by})


def as_table(calibration: Calibration) -> dict[str, Any]:
    """Plain numbers in SI units, for a page or a log."""
    return {**asdict(calibration), "place": list(calibration.place)}


def from_checkerboard(
    picture: NDArray[np.uint8], corners: tuple[int, int], square: float, first: Floats, guess: Calibration
) -> Calibration:
    """A calibration from a picture of a printed checkerboard, upright (side) or flat on the floor (above).

    `corners`: how many inner corners a row and a column have, `square` [m]: the side of a square. `first` [m] (3,):
    where the inner corner stands that is seen lower left; the board faces the camera of the `guess`, whose view,
    azimuth, elevation and distance are kept. Raises `BadInput` when the board is not found.
    """
    cv2 = cv2_of("calibration")
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    found, places = cv2.findChessboardCornersSB(grey, corners)
    if not found:
        given = f"no board of {corners[0]} x {corners[1]} inner corners"
        raise BadInput("calibration: picture", given, "all inner corners in the picture, sharp, without reflections")
    grid = places.reshape(corners[1], corners[0], 2).astype(float)
    # Whichever corner OpenCV begins with: rows to the right, columns upwards.
    if abs(grid[0, -1, 0] - grid[0, 0, 0]) < abs(grid[-1, 0, 0] - grid[0, 0, 0]):
        grid = grid.transpose(1, 0, 2)
    grid = grid[:, ::-1] if grid[0, -1, 0] < grid[0, 0, 0] else grid
    grid = grid[::-1] if grid[-1, 0, 1] > grid[0, 0, 1] else grid
    rows, columns = np.mgrid[: grid.shape[0], : grid.shape[1]]
    right, up, _ = guess.level_axes
    points = first[:, None] + square * (right[:, None] * columns.ravel() + up[:, None] * rows.ravel())
    pixels = grid.reshape(-1, 2).T
    span = float(np.linalg.norm(pixels[:, -1] - pixels[:, 0]) / np.linalg.norm(points[:, -1] - points[:, 0]))
    x, y, z = (float(v) for v in points.mean(axis=1))
    height, width = grey.shape
    near = replace(guess, scale=span, place=(x, y, z), width=width, height=height)
    return from_points(near, points, pixels, ("scale", "place_right", "place_up", "roll", "distortion"))


def write_checkerboard(path: Path, corners: tuple[int, int] = (9, 6), square: float = 2e-3) -> None:
    """An SVG of a checkerboard with that many inner corners, squares of `square` [m], true to scale at 100 %.

    A scale of 10 mm is printed below it: measure that, for many printers shrink.
    """
    columns, rows, side = corners[0] + 1, corners[1] + 1, square * 1e3
    width, height = max((columns + 2) * side, 14.0), (rows + 2) * side + 4.0
    squares = "".join(
        f'<rect x="{(c + 1) * side:.4f}" y="{(r + 1) * side:.4f}" width="{side:.4f}" height="{side:.4f}"/>'
        for r in range(rows)
        for c in range(columns)
        if (r + c) % 2 == 0
    )
    rule = f'<rect x="2" y="{height - 3.0:.4f}" width="10" height="0.3"/>'
    text = f'<text x="2" y="{height - 0.8:.4f}" font-size="1.6">10 mm; squares {side:g} mm</text>'
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{height:.4f}mm" '
        f'viewBox="0 0 {width:.4f} {height:.4f}"><rect width="100%" height="100%" fill="#fff"/>'
        f"{squares}{rule}{text}</svg>\n",
        encoding="utf-8",
    )
