"""Whose directions are asked for: the body of a scenario in its place, or an outline drawn in SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from gelbot.body.outline import Outline, outline_from_points, outline_from_svg
from gelbot.errors import BadInput
from gelbot.scenario.load import Loaded, load
from gelbot.units import quantity

UNNAMED = "outline"
"""What results are called of a drawing whose file has no name that a folder could have."""
TOLERANCE_MOST = 0.25
MANY, STRAIGHT = 300, 5e-4
"""A drawing of more points is thinned: what is off a line by less than this share of the reach is no corner."""


class Subject(NamedTuple):
    """An `outline` whose centroid lies at `place` [m], (2,), with `heading` [rad]; where it comes from (`source`).

    `loaded` is the scenario that it belongs to, or None.
    """

    name: str
    source: str
    outline: Outline
    place: NDArray[np.float64]
    heading: float
    loaded: Loaded | None


def subject(name_or_file: str, width: str | None = None, changes: Sequence[str] = ()) -> Subject:
    """What `name_or_file` names: a file that ends in .svg, a built-in scenario, or a scenario file.

    `width` is for drawings, `changes` (key=value) are for scenarios. Raises `BadInput` for all that is wrong with them.
    """
    if Path(name_or_file).suffix.lower() == ".svg":
        if changes:
            raise BadInput("--set", changes[0], "nothing beside a drawing: it has no scenario")
        return _drawn(Path(name_or_file), width)
    if width is not None:
        raise BadInput("--width", width, "nothing beside a scenario: its body has a width; --set changes it")
    loaded = load(name_or_file, changes)
    body = loaded.scenario.body
    pose = body.pose
    name = loaded.scenario.name
    return Subject(name, name_or_file, body.outline(), np.array(pose.position), pose.heading, loaded)


def _drawn(path: Path, width: str | None) -> Subject:
    size = None if width is None else quantity(width, "m", "--width")
    if size is not None and size <= 0.0:
        raise BadInput("--width", width, "a length greater than 0")
    if not path.is_file():
        what = "this is a folder" if path.is_dir() else "there is no such file"
        raise BadInput("outline", str(path), f"an SVG file with a closed path; {what}")
    outline = _thinned(outline_from_svg(path, size, None, "outline"))
    kept = "".join(
        letter if letter.isascii() and (letter.isalnum() or letter in "._-") else "-" for letter in path.stem
    )
    return Subject(kept.strip("-.") or UNNAMED, str(path), outline, np.zeros(2), 0.0, None)


def _thinned(outline: Outline) -> Outline:
    """The outline of a pen that wrote down every step, without the points that lie on a line but for `STRAIGHT`."""
    if len(outline.points) <= MANY:
        return outline
    kept = outline.polygon.simplify(STRAIGHT * outline.reach)
    return outline_from_points(shapely.get_coordinates(kept), "outline")


def checked_tolerance(tolerance: float) -> float:
    """`tolerance`, which has to be a share of the reach. Raises `BadInput` otherwise."""
    if not 0.0 <= tolerance <= TOLERANCE_MOST:
        allowed = f"a share of the outline's reach, from 0 to {TOLERANCE_MOST:g}"
        raise BadInput("--tolerance", tolerance, allowed)
    return tolerance


def angle_of(text: str, where: str = "--solved") -> float:
    """The angle [rad] that `text` means: a number of degrees, or an angle with its unit."""
    try:
        float(text)
    except ValueError:
        return quantity(text, "rad", where)
    return quantity(f"{text} deg", "rad", where)
