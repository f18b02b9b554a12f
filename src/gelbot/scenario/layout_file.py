"""Where electrodes stand, read from a file: a table (CSV) or a drawing (SVG) of the array seen from above."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gelbot.columns import LINE, read_columns
from gelbot.errors import BadInput
from gelbot.scenario.fields import written

Floats: TypeAlias = NDArray[np.float64]

SIZES = ("side", "diameter", "inner_diameter", "length", "backing")
COLUMNS = {
    **dict.fromkeys(("z", *SIZES, "size_x", "size_y", "size_z"), "m"),
    **dict.fromkeys(("name", "shape", "conducts"), "text"),
    **dict.fromkeys(("axis_x", "axis_y", "axis_z"), ""),
    "turn": "rad",
}
"""What a table may have beside x and y, with the SI units."""
UNITS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
"""Units of a drawing's width [m]."""
ROUNDING = 1e-6
"""Two points of a drawing closer than this, in its smallest units, are one."""
DRAWN_TO = 1e-3
"""Drawings are rounded: a circle is one to this share of its radius, a right angle to this angle [rad]."""


class Row(NamedTuple):
    """One electrode of a file: what it is there (`origin`), its keys as a scenario has them, and whether z is given."""

    origin: str
    keys: dict[str, Any]
    has_height: bool


def read_layout(path: Path, origin: tuple[float, float] | None) -> list[Row]:
    """The electrodes of a .csv or an .svg file; `origin` [m] see `drawn`. Raises `BadInput` for what cannot be read."""
    kind = path.suffix.lower()
    if kind == ".svg":
        return drawn(path, origin)
    if kind == ".csv":
        return listed(path)
    raise BadInput("file", path.name, "a file that ends in .csv or .svg")


def listed(path: Path) -> list[Row]:
    """The electrodes of a table, one on a line; empty cells leave a key to the scenario."""
    table = read_columns(path, {"x": "m", "y": "m"}, COLUMNS)
    names = [name for name in table if name != LINE]
    lines = enumerate(table[LINE])
    return [_row(f"{path}, line {line}", {name: table[name][k] for name in names}) for k, line in lines]


def _row(origin: str, cells: dict[str, Any]) -> Row:
    given = {name: value for name, value in cells.items() if value is not None}
    keys = {name: given[name] for name in ("name", "shape", "conducts") if name in given}
    keys |= {name: written(given[name]) for name in SIZES if name in given}
    sizes = [name for name in ("size_x", "size_y", "size_z") if name in given]
    if sizes:
        keys["size"] = [written(given[name]) for name in _without_gaps(sizes, "size", origin)]
    axis = [name for name in ("axis_x", "axis_y", "axis_z") if name in given]
    if axis:
        keys["axis"] = [given[name] for name in _without_gaps(axis, "axis", origin)]
    if "turn" in given:
        keys["turn"] = f"{given['turn']!r} rad"
    keys["position"] = [written(given.get(name, 0.0)) for name in "xyz"]
    return Row(origin, keys, "z" in given)


def _without_gaps(given: list[str], key: str, origin: str) -> list[str]:
    """`given`, of key_x, key_y and key_z: all of an axis, the first two or all of a size."""
    complete = [f"{key}_{letter}" for letter in "xyz"]
    if given != complete[: len(given)] or len(given) == 1 or (key == "axis" and len(given) < 3):
        allowed = "all of " if key == "axis" else "size_x and size_y of a rectangle, or all of "
        raise BadInput(origin, " and ".join(given) + " alone", allowed + ", ".join(complete))
    return given


def drawn(path: Path, origin: tuple[float, float] | None) -> list[Row]:
    """The electrodes of a drawing in its own size: circles are discs, rectangles plates; texts are passed over.

    The drawing is the array seen from above, y up the page. The middle of what is drawn lies at x = y = 0, or else the
    point `origin` [m], counted from the page's upper left corner to the right and downwards.
    """
    from svgelements import SVG, Shape
    from svgelements import Path as SvgPath

    try:
        drawing = SVG.parse(str(path))
        shapes = [element for element in drawing.elements() if isinstance(element, Shape)]
    except Exception as error:  # svgelements raises whatever its XML parser raises
        raise BadInput(str(path), "no drawing that can be read", f"an SVG file ({error})") from error
    if not shapes:
        raise BadInput(str(path), "no circle and no rectangle", "at least one")
    scale = _scale(drawing, path)
    found: list[Drawn] = []
    for number, shape in enumerate(shapes, start=1):
        label = f'element "{shape.id}"' if shape.id else f"element {number} ({type(shape).__name__.lower()})"
        points, is_polygon = _outline(abs(SvgPath(shape)))  # abs: with its turns and scales carried out
        electrode = (_rectangle if is_polygon else _circle)(points * [scale, -scale])
        if electrode is None:
            allowed = "circles, and rectangles with sharp corners; both may be turned, and a path may draw them"
            raise BadInput(f"{path}, {label}", "another shape", allowed, "leave out of the file what is no electrode")
        electrode.keys.update({"name": shape.id} if shape.id else {})
        found.append(electrode._replace(label=label))
    corners = np.concatenate([electrode.corners for electrode in found])
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0 if origin is None else np.array(origin) * [1.0, -1.0]
    for electrode in found:
        x, y = electrode.centre - middle
        electrode.keys["position"] = [written(x), written(y), written(0.0)]
    return [Row(f"{path}, {electrode.label}", electrode.keys, False) for electrode in found]


class Drawn(NamedTuple):
    """An electrode of a drawing: its `keys`, `centre` (2,) [m], and `corners` (p, 2) [m] as far as it goes."""

    keys: dict[str, Any]
    centre: Floats
    corners: Floats
    label: str = ""


def _scale(drawing: Any, path: Path) -> float:
    """Metres in one unit of what svgelements read."""
    width = str(drawing.values.get("width", "")).strip()
    written = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*(mm|cm|in)", width)
    if written is None or float(written[1]) == 0.0:
        allowed = "a drawing whose width has a unit: mm, cm or in"
        raise BadInput(f"{path}, <svg>", f"width={width!r}", allowed, 'width="120mm", beside height and viewBox')
    return float(written[1]) * UNITS[written[2]] / drawing.width


def _outline(path: Any) -> tuple[Floats, bool]:
    """Points along a closed path, (p, 2), and whether they are a polygon's corners; no points where it is not one."""
    from svgelements import Close, Line, Move

    points: list[Any] = []
    sides = 0
    for number, segment in enumerate(path):
        if isinstance(segment, Move):
            if number:
                return np.zeros((0, 2)), True
            points.append(segment.end)
        elif isinstance(segment, Line | Close):
            sides += abs(segment.end - segment.start) > ROUNDING
            points.append(segment.end)
        else:
            points += [segment.point(k / 8.0) for k in range(1, 9)]
    if not points or abs(points[-1] - points[0]) > ROUNDING:
        return np.zeros((0, 2)), True
    kept = [(q.x, q.y) for k, q in enumerate(points[:-1]) if abs(q - points[k + 1]) > ROUNDING]
    return np.array(kept).reshape(-1, 2), sides == len(kept)


def _circle(points: Floats) -> Drawn | None:
    """The disc whose rim goes through `points` [m], or None where there is none."""
    # |p|^2 = 2 p . centre + (radius^2 - |centre|^2) is linear in what is sought.
    origin = points.mean(axis=0)
    p = points - origin
    (a, b, c), *_ = np.linalg.lstsq(np.column_stack([2.0 * p, np.ones(len(p))]), np.sum(p**2, axis=1), rcond=None)
    centre, radius = np.array([a, b]), float(np.sqrt(max(c + a * a + b * b, 0.0)))
    if np.ptp(np.linalg.norm(p - centre, axis=1)) > DRAWN_TO * radius or np.ptp(p, axis=0).min() < 1.8 * radius:
        return None
    keys = {"shape": "disc", "diameter": written(2.0 * radius)}
    return Drawn(keys, centre + origin, centre + origin + radius * np.array([[-1.0, -1.0], [1.0, 1.0]]))


def _rectangle(points: Floats) -> Drawn | None:
    """The plate that faces down and has the corners `points` [m], or None where they make no rectangle."""
    if len(points) != 4:
        return None
    first, second = points[1] - points[0], points[3] - points[0]
    a, b = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    skew = float(np.linalg.norm(points[0] + points[2] - points[1] - points[3]))
    if skew > DRAWN_TO * min(a, b) or abs(float(first @ second)) > DRAWN_TO * a * b:
        return None
    # About an axis that points down, angles count clockwise seen from above.
    turn = -float(np.arctan2(first[1], first[0]))
    keys = {"shape": "rectangle", "size": [written(a), written(b)], "turn": f"{turn!r} rad"}
    return Drawn(keys, points.mean(axis=0), points)
