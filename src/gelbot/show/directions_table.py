"""The table of a body's directions on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gelbot.show.directions_view import in_short


def directions_table(report: Mapping[str, Any]) -> Table:
    """Angle, what the centre moves over, supports, and whether a solution carries over."""
    has_array = report["array"] is not None
    table = Table(title=Text(f"{report['name']}: potential directions"))
    for head in ("", "angle [deg]", "mode", "over tips", "supports", "way [mm]", "kind"):
        table.add_column(Text(head), justify="right" if head in ("", "angle [deg]", "way [mm]", "kind") else "left")
    for head in ("orbit", "solution carries over") if has_array else ():
        table.add_column(Text(head), justify="right" if head == "orbit" else "left")
    for way in report["directions"]:
        cells = [
            str(way["number"]),
            f"{way['angle']:.4g}",
            way["mode"],
            _listed(way["over"]),
            _listed(way["supports"]) + ("" if way["stable"] else " (unstable)"),
            f"{way['travel_mm']:.3g}",
            str(way["kind"]),
        ]
        if has_array:
            cells += [str(way["orbit"]), _fate(way["carries_over"])]
        table.add_row(*(Text(cell) for cell in cells))
    return table


def print_directions(report: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the table, then the symmetry it comes from and what body and electrodes share."""
    console = console or Console()
    console.print(directions_table(report))
    axes = ", ".join(f"{angle:.4g}" for angle in report["reflections"])
    lines = [in_short(report), f"mirror lines at {axes} deg" if axes else "no mirror line: nothing keeps it on a line"]
    if report["miss"] >= 1e-6:
        lines.append(
            f"the outline misses its images by {report['miss']:.1%} of its reach at most (--tolerance "
            f"{report['tolerance']:g}); exactly symmetric it is to order {report['exact_order']}"
        )
    array = report["array"]
    if array is not None:
        order = "round" if array["order"] is None else f"of order {array['order']}"
        shared = "; ".join(one["operation"] for one in array["shared"][1:]) or "nothing but leaving all as it is"
        lines.append(f"about the robot's place the electrodes are {order}; body and electrodes share {shared}")
        if report["mesh_order"] < report["order"]:
            lines.append(
                f"the mesh follows {report['mesh_order']} of the {report['order']} operations: what is simulated is "
                "symmetric only as far"
            )
        others = [f"({x:.4g}, {y:.4g}) mm heading {one['heading']:.4g} deg" for one in report["elsewhere"][1:]
                  for x, y in [one["position_mm"]]]  # fmt: skip
        if others:
            lines.append("the same motion, electrodes exchanged, with the robot laid at " + ", ".join(others))
    for line in lines:
        console.print(line, highlight=False, markup=False)


def _listed(tips: list[int]) -> str:
    return ", ".join(str(tip) for tip in tips)


def _fate(carried: Mapping[str, Any]) -> str:
    how = carried["how"]
    if how == "solved":
        return "solved"
    if how == "operation":
        missed = f" (the body misses by {carried['miss']:.1%})" if carried["miss"] else ""
        return f"yes, {carried['by']}{missed}"
    return f"with {carried['by']}" if how == "heading" else "no, turn the field"
