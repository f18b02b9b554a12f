"""Directions in plain numbers: the content of directions.json. Tips, directions and orbits count from 1."""

from __future__ import annotations

from typing import Any

import numpy as np

from gelbot import __version__
from gelbot.body.symmetry import SymmetryGroup, rotation
from gelbot.body.tips import Tips
from gelbot.directions_report.common import Common
from gelbot.directions_report.subject import Subject
from gelbot.plan.directions import Direction
from gelbot.plan.equivalence import Operation, kinds, turned

MODES = {1: "over-one-tip", 2: "over-two-tips"}
SOLVED, OPERATION, HEADING, ANEW = "solved", "operation", "heading", "no"
"""How one direction has the solution of another: it is the same; by a shared operation; with another heading; not."""
EXACT = 1e-6
"""A body that misses its image by less than this share of its reach is carried exactly."""


def numbers(
    subject: Subject,
    tolerance: float,
    group: SymmetryGroup,
    exact: SymmetryGroup,
    missed: float,
    tips: Tips,
    found: list[Direction],
    common: Common | None,
) -> dict[str, Any]:
    """Plain numbers, angles in degrees from the array's +x. What belongs to electrodes is None without a scenario."""
    lying = turned(group, subject.heading)
    places = tips.points @ rotation(subject.heading).T + subject.place
    of_a_kind = kinds(group, found)
    return {
        "name": subject.name,
        "source": subject.source,
        "tolerance": tolerance,
        "order": group.order,
        "rotations": group.rotation_count,
        "reflections": _axes(lying),
        "miss": missed,
        "exact_order": exact.order,
        "mesh_order": None if common is None else common.mesh,
        "position_mm": _millimetres(subject.place),
        "heading": _degrees(subject.heading),
        "tips": [
            {
                "number": k + 1,
                "x_mm": _round(1e3 * x),
                "y_mm": _round(1e3 * y),
                "angle": _degrees(float(np.arctan2(y - subject.place[1], x - subject.place[0]))),
                "radius_mm": _round(1e3 * float(np.hypot(x - subject.place[0], y - subject.place[1]))),
                "width_mm": _round(1e3 * float(width)),
            }
            for k, ((x, y), width) in enumerate(zip(places, tips.widths, strict=True))
        ],
        "directions": [
            {
                "number": k + 1,
                "angle": _degrees(one.angle + subject.heading),
                "mode": MODES[len(one.over)],
                "over": _from_one(one.over),
                "supports": _from_one(one.supports),
                "axis": None if one.axis is None else _degrees(one.axis + subject.heading, 180.0),
                "travel_mm": _round(1e3 * one.travel),
                "stable": one.stable,
                "kind": 1 + next(n for n, members in enumerate(of_a_kind) if k in members),
                "orbit": None
                if common is None
                else 1 + next(n for n, members in enumerate(common.orbits) if k in members),
                "carries_over": None if common is None else _carries(k, subject, found, of_a_kind, common),
            }
            for k, one in enumerate(found)
        ],
        "kinds": [_from_one(members) for members in of_a_kind],
        "solved": None if common is None else common.solved + 1,
        "orbits": None if common is None else [_from_one(members) for members in common.orbits],
        "array": None if common is None else _array(common),
        "elsewhere": None if common is None else _elsewhere(common),
        "version": __version__,
    }


def _carries(
    number: int, subject: Subject, found: list[Direction], of_a_kind: list[list[int]], common: Common
) -> dict[str, Any]:
    """How direction `number` gets a solution from the one that is solved."""
    solved = common.solved
    for one in common.shared:
        if one.directions[solved] == number:
            return {
                "how": SOLVED if number == solved else OPERATION,
                "by": words_for(one.operation),
                "electrodes": one.electrodes.tolist(),
                "heading": _degrees(subject.heading),
                "miss": _exactly(one.miss),
            }
    if any(number in members and solved in members for members in of_a_kind):
        heading = subject.heading + found[solved].angle - found[number].angle
        return {
            "how": HEADING,
            "by": f"heading {_degrees(heading):g} deg",
            "electrodes": list(range(common.setting.array.count)),
            "heading": _degrees(heading),
            "miss": None,
        }
    return {"how": ANEW, "by": None, "electrodes": None, "heading": None, "miss": None}


def _array(common: Common) -> dict[str, Any]:
    """The electrodes' symmetry about the robot's place, and what the body shares of it."""
    group = common.array
    return {
        "electrodes": common.setting.array.count,
        "order": None if group is None else group.order,
        "rotations": None if group is None else group.rotation_count,
        "reflections": None if group is None else _axes(group),
        "shared": [
            {
                "operation": words_for(one.operation),
                "mirror": _degrees(one.operation.angle, 180.0) if one.operation.is_reflection else None,
                "electrodes": one.electrodes.tolist(),
                "directions": _from_one(one.directions),
                "miss": _exactly(one.miss),
            }
            for one in common.shared
        ],
    }


def _elsewhere(common: Common) -> list[dict[str, Any]]:
    return [
        {
            "operation": words_for(one.operation),
            "position_mm": _millimetres(one.place),
            "heading": _degrees(one.heading),
            "angle": _degrees(one.angle),
            "electrodes": one.electrodes.tolist(),
        }
        for one in common.elsewhere
    ]


def words_for(operation: Operation) -> str:
    """An operation in words, such as "rotation by 72 deg" or "reflection at 45 deg"."""
    if operation.is_reflection:
        return f"reflection at {_degrees(operation.angle, 180.0):g} deg"
    return f"rotation by {_degrees(operation.angle):g} deg"


def _axes(group: SymmetryGroup) -> list[float]:
    return sorted(_degrees(float(angle), 180.0) for angle in group.mirror_angles)


def _degrees(angle: float, period: float = 360.0) -> float:
    """An angle [rad] in degrees, from 0 to less than `period`."""
    return _round(round(float(np.degrees(angle)) % period, 6) % period)


def _exactly(missed: float) -> float:
    return 0.0 if missed < EXACT else missed


def _millimetres(place: Any) -> list[float]:
    return [_round(1e3 * float(value)) for value in place]


def _round(value: float) -> float:
    # Beyond this stands rounding; adding 0 makes -0 plain.
    return round(float(value), 6) + 0.0


def _from_one(members: Any) -> list[int]:
    return [int(k) + 1 for k in members]
