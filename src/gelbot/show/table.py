"""The table *paper | this run* at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

NONE = "-"
TABLE_COARSE = 0.01
"""An error of the field's table above this is said."""


def comparison_table(summary: Mapping[str, Any]) -> Table:
    """What Section V of the paper reports beside what `summary`, the content of summary.json, says of this run."""
    table = Table(title=f"{summary.get('scenario') or 'run'}: {summary.get('status') or 'status unknown'}")
    table.add_column("")
    table.add_column("paper", justify="right")
    table.add_column("this run", justify="right")
    rows = (
        ("switch after", "40 s", _value(summary, "t_switch_s", ".1f", " s")),
        ("centre height at the switch", "6.5 mm", _value(summary, "z_switch_mm", ".2f", " mm")),
        ("tip angle at the switch", "vertical (90 deg)", _value(summary, "tip_angle_at_switch_deg", ".0f", " deg")),
        ("transition", "6-10 s", _value(summary, "t_transition_s", ".1f", " s")),
        ("turned over", "5 of 5", "yes" if summary.get("turned_over") else "no"),
        ("stays over", "yes", _stays(summary)),
    )
    motion = summary.get("motion") or {}
    goals = motion.get("goals", [])
    # A scenario without a switch, or of another motion, has nothing to hold against the paper.
    others = goals and not any(goal["goal"].startswith("normal") for goal in goals)
    for row in rows if summary.get("t_switch_s") is not None and not others else ():
        table.add_row(*row)
    for goal in goals:
        reached = goal["reached_s"]
        table.add_row(goal["goal"], "", "no" if reached is None else f"{reached:.1f} s")
    table.add_row("largest height", "", _value(summary, "max_height_mm", ".2f", " mm"))
    table.add_row("height at the end", "", _value(summary, "final_height_mm", ".2f", " mm"))
    table.add_row("normal's z at the end", "", _value(summary, "final_normal_z", ".2f", ""))
    return table


def print_summary(summary: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the table, then how long the run took and what the supply gave."""
    console = console or Console()
    console.print(comparison_table(summary))
    simulated, wall = summary.get("simulated_s"), summary.get("wall_s")
    speed = f" ({simulated / wall:.0f}x real time)" if simulated and wall else ""
    lines = (
        f"simulated {_value(summary, 'simulated_s', '.1f', ' s')} in {_value(summary, 'wall_s', '.1f', ' s')}{speed}; "
        f"compiling took {_value(summary, 'compile_s', '.1f', ' s')}",
        f"supply: at most {_value(summary, 'peak_voltage_V', '.3g', ' V')}, "
        f"{_value(summary, 'peak_current_A', '.3g', ' A')} per electrode; "
        f"charge {_value(summary, 'charge_C', '.3g', ' C')}",
    )
    left = summary.get("left_working_volume_s")
    if left is not None:
        lines += (
            f"from {left:.1f} s on a part of the body was so far from its start, or so near the electrodes, that its "
            "field was taken from the nearest place where it had been tabulated",
        )
    error = summary.get("field_table_error")
    if error is not None and error > TABLE_COARSE:
        lines += (
            f"the field on the body's faces is read from a table that is off by {100.0 * error:.2g} %: electrodes are "
            "near, or the body lies on a boundary. Try: a smaller simulation.field_spacing",
        )
    reason = (summary.get("motion") or {}).get("reason")
    if reason:
        lines += (f"the motion is not met: {reason}",)
    for line in lines:
        console.print(line, highlight=False, markup=False)


def _value(summary: Mapping[str, Any], key: str, form: str, unit: str) -> str:
    value = summary.get(key)
    return NONE if value is None else f"{value:{form}}{unit}"


def _stays(summary: Mapping[str, Any]) -> str:
    stayed = summary.get("stayed_over_s") or 0.0
    if stayed > 0.0:
        return f"yes, {stayed:.1f} s"
    return "no" if summary.get("turned_over") else NONE
