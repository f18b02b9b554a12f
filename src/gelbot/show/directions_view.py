"""The paper's Fig. 4 for any body: mirror lines and tips, supports, directions, and the body below its electrodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, PathPatch, Polygon
from matplotlib.path import Path as Loops
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from gelbot.errors import shortened
from gelbot.show.outlines import seen_from, split
from gelbot.show.style import BLUE, FAINT, GREEN, INK, ORANGE, RED, SETTINGS, new_figure, save

Floats = NDArray[np.float64]

WIDTH, DPI = 7.16, 200
"""Both columns of a paper [inches]."""
SMALL, TINY = 8.0, 6.5
"""Sizes of the print [points]."""
GEL, PLATE = "#dcebf5", "#f1f1ef"
BETWEEN = 0.36
"""From a panel to the one below it [inches]."""
WINDOWS = (1.32, 1.32, 1.6)
"""Half the widths of the panels that show the body alone, in its reaches: the last has angles at its rim."""
BESIDE = 0.3
"""How far beside its arrow a text stands, in reaches."""
LABELLED = 24
"""More directions than this carry no angle."""
MODES = {"over-one-tip": (RED, "over one tip"), "over-two-tips": (BLUE, "over two tips")}
FATES: dict[str, tuple[str, str, Any]] = {
    "solved": (INK, "solved", "solid"),
    "operation": (GREEN, "the same voltages, exchanged", "solid"),
    "heading": (ORANGE, "the same voltages, another heading", "solid"),
    "no": (FAINT, "to be solved anew", (0.0, (2.5, 1.5))),
}
SHARED, ELSEWHERE = "mirror line of body and electrodes", "the solved motion elsewhere"
MIRROR: Any = (0.0, (6.0, 2.0, 1.0, 2.0))
GHOST: Any = (0.0, (2.0, 1.5))
HALO = withStroke(linewidth=2.0, foreground="white")


class Sketch(NamedTuple):
    """What is drawn beside the numbers, in the array's frame [mm].

    `outline`, shape (p, 2), about the body's centre; `electrodes`, shape (3, p, e), as `field.outlines` has them, or
    None.
    """

    outline: Floats
    electrodes: Floats | None


def draw_directions(report: Mapping[str, Any], sketch: Sketch, paths: Sequence[Path]) -> list[Path]:
    """Write the picture of a directions.json to `paths`, of the kinds that their names end with."""
    with matplotlib.rc_context({**SETTINGS, "font.size": SMALL, "pdf.fonttype": 42, "axes.linewidth": 0.6}):
        figure, panels = _page(sketch.electrodes is not None)
        _headline(figure, report)
        for letter, what, axes in zip("abcd", _titles(report), panels, strict=False):
            axes.set_title(f"({letter}) {what}", fontsize=SMALL, loc="left", pad=4)
        reach = float(np.linalg.norm(sketch.outline, axis=1).max())
        for axes, window in zip(panels, WINDOWS, strict=False):
            half = window * reach
            axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            axes.add_patch(Polygon(sketch.outline, facecolor=GEL, edgecolor=INK, linewidth=0.9, zorder=2))
        _draw_symmetry(panels[0], report, reach)
        _draw_supports(panels[1], report, reach)
        _draw_all(panels[2], report, reach)
        if sketch.electrodes is not None:
            _draw_below_electrodes(panels[3], report, sketch, reach)
        return [save(figure, path) for path in paths]


def _titles(report: Mapping[str, Any]) -> tuple[str, ...]:
    mirrors, tips = len(report["reflections"]), len(report["tips"])
    lines = "no mirror line" if mirrors == 0 else "1 mirror line" if mirrors == 1 else f"{mirrors} mirror lines"
    one = "on one mirror line" if mirrors else "in one direction"
    number = len(report["directions"])
    return (
        f"{lines}, {tips} tip{'s' * (tips > 1)}",
        f"supports {one}",
        f"{number} direction{'s' * (number > 1)}",
        "below the electrodes",
    )


def _page(has_array: bool) -> tuple[Figure, list[Axes]]:
    """A figure with three panels in a row, or with four in two rows, and a foot for the meaning of colours."""
    if not has_array:
        side, gap, foot, head = 2.24, 0.12, 0.3, 0.78
        total = head + side + foot
        figure = new_figure(WIDTH, total, DPI)
        places = [(0.1 + k * (side + gap), foot, side, side) for k in range(3)]
    else:
        side, gap, foot, head = 3.2, 0.2, 0.92, 0.74
        total = head + 2.0 * side + BETWEEN + foot
        figure = new_figure(WIDTH, total, DPI)
        rows = (foot + side + BETWEEN, foot)
        places = [(0.12 + k * (side + gap), bottom, side, side) for bottom in rows for k in range(2)]
    return figure, [figure.add_axes((x / WIDTH, y / total, w / WIDTH, h / total)) for x, y, w, h in places]


def _headline(figure: Figure, report: Mapping[str, Any]) -> None:
    """Whose directions, and what the numbers come to."""
    height, left = figure.get_figheight(), 0.12 / WIDTH
    title = f"{shortened(str(report['name']), 60)}: potential directions of locomotion"
    figure.text(left, 1.0 - 0.1 / height, title, fontsize=9.5, weight="bold", va="top", parse_math=False)
    figure.text(left, 1.0 - 0.3 / height, in_short(report), fontsize=SMALL, va="top", parse_math=False)


def in_short(report: Mapping[str, Any]) -> str:
    """The group, and how many directions really differ, in one line."""
    rotations, mirrors = report["rotations"], len(report["reflections"])
    number, different = len(report["directions"]), len(report["kinds"])
    parts = [
        f"symmetry of order {report['order']}: {rotations} rotation{'s' * (rotations > 1)}"
        + (f", {mirrors} reflection{'s' * (mirrors > 1)}" if mirrors else ""),
        f"{number} direction{'s' * (number > 1)} of {different} kind{'s' * (different > 1)}",
    ]
    if report["orbits"] is not None:
        parts.append(f"{len(report['orbits'])} different ones below these electrodes")
    return "; ".join(parts)


def _draw_symmetry(axes: Axes, report: Mapping[str, Any], reach: float) -> None:
    """Mirror lines, tips with their numbers, the centre."""
    for angle in report["reflections"]:
        _line(axes, angle, 1.28 * reach)
    _draw_tips(axes, report, ())
    axes.plot(0.0, 0.0, marker="o", markersize=3.0, color=INK, zorder=6)


def _draw_supports(axes: Axes, report: Mapping[str, Any], reach: float) -> None:
    """One mirror line, the tips on which the body slides, and where its centre can go."""
    ways = report["directions"]
    one = ways[(report["solved"] or 1) - 1]
    both = [one] if one["axis"] is None else [way for way in ways if way["axis"] == one["axis"]]
    if one["axis"] is not None:
        _line(axes, one["axis"], 1.28 * reach)
    places = _tip_places(report)
    corners = places[[k - 1 for k in one["supports"]]]
    around = np.argsort(np.arctan2(*(corners - corners.mean(axis=0)).T[::-1]))
    look: Any = {"closed": True, "fill": False, "edgecolor": INK, "linewidth": 0.9, "linestyle": (0.0, (4.0, 2.0))}
    axes.add_patch(Polygon(corners[around], zorder=3, **look))
    _draw_tips(axes, report, one["supports"])
    for way in both:
        colour, _ = MODES[way["mode"]]
        end = max(way["travel_mm"], 0.3 * reach)
        _arrow(axes, way["angle"], 0.0, end, colour, 2.2, 7)
        # Beside the arrow, on its left: the tips stand at its end.
        x, y = 0.5 * end * _unit(way["angle"]) + BESIDE * reach * _unit(way["angle"] + 90.0)
        text = "over " + _named(way["over"])
        label = axes.text(x, y, text, fontsize=TINY, color=colour, ha="center", va="center", zorder=9)
        label.set_path_effects([HALO])
    axes.plot(0.0, 0.0, marker="o", markersize=3.5, color=INK, zorder=8)


def _draw_all(axes: Axes, report: Mapping[str, Any], reach: float) -> None:
    """All directions, in the colours of what they go over, with their angles."""
    for way in report["directions"]:
        colour, _ = MODES[way["mode"]]
        _arrow(axes, way["angle"], 0.1 * reach, 1.15 * reach, colour, 1.3, 5)
        if len(report["directions"]) <= LABELLED:
            x, y = 1.2 * reach * _unit(way["angle"])
            side = x / (1.2 * reach)
            look: Any = {"ha": "left" if side > 0.3 else "right" if side < -0.3 else "center"}
            look["va"] = "center" if abs(side) > 0.3 else "bottom" if y > 0.0 else "top"
            text = f"{round(way['angle'], 1):g}\N{DEGREE SIGN}"
            axes.text(x, y, text, fontsize=TINY, color=colour, zorder=6, **look)
    used = [MODES[mode] for mode in MODES if any(way["mode"] == mode for way in report["directions"])]
    handles = [Line2D([], [], color=colour, linewidth=1.6, label=text) for colour, text in used]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, fontsize=TINY, borderpad=0.2)


def _draw_below_electrodes(axes: Axes, report: Mapping[str, Any], sketch: Sketch, reach: float) -> None:
    """The array from above, the body in its place and where else it could lie, and what serves which direction."""
    plates = [] if sketch.electrodes is None else [split(points) for points in np.moveaxis(sketch.electrodes, 2, 0)]
    place = np.array(report["position_mm"])
    for number, plate in enumerate(plates):
        seen = seen_from(plate, np.array([0.0, 0.0, 1.0]))
        loops = [loop[:2, [*range(loop.shape[1]), 0]].T for loop in seen if loop.shape[1]]
        path = Loops.make_compound_path(*[Loops(loop, closed=True) for loop in loops])
        axes.add_patch(PathPatch(path, facecolor=PLATE, edgecolor="#c4c4c0", linewidth=0.7, zorder=1))
        if len(plates) <= LABELLED:
            low, high = seen.corners[:2].min(axis=1), seen.corners[:2].max(axis=1)
            where: Any = {"xytext": (0.0, 1.5), "textcoords": "offset points", "ha": "left", "va": "bottom"}
            axes.annotate(
                str(number), (low[0], high[1]), fontsize=TINY, color=FAINT, zorder=6, **where
            ).set_path_effects([HALO])
    for other in report["elsewhere"][1:]:
        turn = np.radians(other["heading"] - report["heading"])
        moved = sketch.outline @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        there = np.array(other["position_mm"])
        ghost: Any = {"fill": False, "edgecolor": FAINT, "linewidth": 0.7, "linestyle": GHOST}
        axes.add_patch(Polygon(moved + there, zorder=2, **ghost))
        _arrow(axes, other["angle"], 0.0, 1.35 * reach, FAINT, 0.9, 2, there)
    mirrors = [shared["mirror"] for shared in report["array"]["shared"] if shared["mirror"] is not None]
    for angle in mirrors:
        _line(axes, angle, 2.2 * reach, place, GREEN, 1.0)
    axes.add_patch(Polygon(sketch.outline + place, facecolor=GEL, edgecolor=INK, linewidth=0.9, zorder=3))
    fates = [way["carries_over"]["how"] for way in report["directions"]]
    for way, fate in zip(report["directions"], fates, strict=True):
        colour, _, style = FATES[fate]
        _arrow(axes, way["angle"], 0.0, 1.5 * reach, colour, 2.0 if fate == "solved" else 1.2, 5, place, style)
    _frame(axes, sketch, place, report)
    handles = [
        Line2D([], [], color=colour, linewidth=1.6, linestyle=style, label=text)
        for fate, (colour, text, style) in FATES.items()
        if fate in fates
    ]
    if mirrors:
        handles.append(Line2D([], [], color=GREEN, linewidth=1.0, linestyle=MIRROR, label=SHARED))
    if report["elsewhere"][1:]:
        handles.append(Line2D([], [], color=FAINT, linewidth=0.7, linestyle=GHOST, label=ELSEWHERE))
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.46, -0.085),
        ncols=2,
        columnspacing=1.2,
        fontsize=TINY,
        borderpad=0.2,
    )


def _frame(axes: Axes, sketch: Sketch, place: Floats, report: Mapping[str, Any]) -> None:
    """Limits that show all electrodes and the body with its arrows."""
    corners = [sketch.outline * WINDOWS[-1] + place]
    if sketch.electrodes is not None:
        points = sketch.electrodes[:2].reshape(2, -1).T
        corners.append(points[np.isfinite(points[:, 0])])
    points = np.concatenate(corners)
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2.0, 0.56 * float(np.ptp(points, axis=0).max())
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    axes.spines[:].set(visible=True, color=FAINT)
    axes.tick_params(labelsize=TINY, length=2.5, pad=2)
    axes.yaxis.tick_right()
    axes.set_xlabel("x [mm]", fontsize=TINY, labelpad=0)
    axes.text(1.0, 1.012, "y [mm]", fontsize=TINY, transform=axes.transAxes, ha="right", va="bottom")


def _draw_tips(axes: Axes, report: Mapping[str, Any], supports: Sequence[int]) -> None:
    """Tips as small circles with their numbers, those of `supports` filled."""
    for tip, (x, y) in zip(report["tips"], _tip_places(report), strict=True):
        filled = tip["number"] in supports
        many = len(report["tips"]) > LABELLED
        look: Any = {"markersize": 4.0 if many else 10.5, "markeredgecolor": INK, "markeredgewidth": 0.9, "zorder": 8}
        axes.plot(x, y, marker="o", color=INK if filled else "white", **look)
        if not many:
            colour = "white" if filled else INK
            text: Any = {"ha": "center", "va": "center_baseline", "zorder": 9}
            axes.text(x, y, str(tip["number"]), fontsize=TINY, color=colour, **text)


def _tip_places(report: Mapping[str, Any]) -> Floats:
    """The tips about the body's centre [mm], shape (a, 2)."""
    return np.array([[tip["x_mm"], tip["y_mm"]] for tip in report["tips"]]) - np.array(report["position_mm"])


def _named(tips: Sequence[int]) -> str:
    return f"tip {tips[0]}" if len(tips) == 1 else f"tips {tips[0]} and {tips[1]}"


def _unit(angle: float) -> Floats:
    return np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])


def _line(
    axes: Axes, angle: float, half: float, place: Floats | None = None, colour: str = FAINT, width: float = 0.8
) -> None:
    """A mirror line through `place`, to both sides."""
    middle = np.zeros(2) if place is None else place
    ends = np.array([middle - half * _unit(angle), middle + half * _unit(angle)])
    axes.plot(*ends.T, color=colour, linewidth=width, linestyle=MIRROR, zorder=4)


def _arrow(
    axes: Axes,
    angle: float,
    start: float,
    end: float,
    colour: str,
    width: float,
    zorder: float,
    place: Floats | None = None,
    style: Any = "solid",
) -> None:
    """An arrow from `place` along `angle` [deg], from `start` to `end` [mm]; its head is solid whatever its `style`."""
    middle = np.zeros(2) if place is None else place
    tail, head = middle + start * _unit(angle), middle + end * _unit(angle)
    size = 5.0 + 2.5 * width
    if style != "solid":
        axes.plot(*np.array([tail, head]).T, color=colour, linewidth=width, linestyle=style, zorder=zorder)
        tail = head - 1e-3 * (head - tail)
    arrow = FancyArrowPatch(
        tuple(tail), tuple(head), arrowstyle="-|>", mutation_scale=size, shrinkA=0.0, shrinkB=0.0, color=colour
    )
    arrow.set(linewidth=width, zorder=zorder, joinstyle="miter")
    axes.add_patch(arrow)
