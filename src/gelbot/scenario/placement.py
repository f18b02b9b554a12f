"""Checks among the tables of a scenario: does the body fit under the array and into the tank, do the voltages fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelbot.body.symmetry import rotation
from gelbot.scenario.bodies import Body
from gelbot.scenario.fields import wrong
from gelbot.scenario.tables import Electrodes, Programme, Supply, Tank
from gelbot.units import shown

SLACK = 1e-9
"""Two lengths closer than this [m] are equal: a body may touch the line that it must not cross."""


def posed_points(body: Body) -> NDArray[np.float64]:
    """The outline of the body where it lies at the start, in the array's frame [m], shape (p, 2)."""
    pose = body.pose
    return body.outline().points @ rotation(pose.heading).T + np.array(pose.position)


def check_heights(body: Body, electrodes: Electrodes, tank: Tank) -> None:
    """The body lies below the electrodes, the electrodes below the free surface."""
    top = body.thickness + body.pose.lift
    gap, depth = electrodes.gap, tank.depth
    if gap <= top:
        allowed = f"more than body.thickness + body.pose.lift = {shown(top, 'm')}"
        raise wrong("electrodes.gap", shown(gap, "m"), allowed)
    if depth is not None and depth <= gap:
        allowed = f"more than electrodes.gap = {shown(gap, 'm')}: the electrodes hang below the free surface"
        raise wrong("tank.depth", shown(depth, "m"), allowed)


def check_tank(electrodes: Electrodes, tank: Tank) -> None:
    """The electrodes hang inside the tank's walls."""
    if tank.size is None:
        return
    for axis, size, half in zip("xy", tank.size, electrodes.half_extent, strict=True):
        if size < 2.0 * half - SLACK:
            allowed = f"at least {shown(2.0 * half, 'm')} in {axis}, the size of the electrode array"
            raise wrong("tank.size", f"{shown(size, 'm')} in {axis}", allowed)


def check_reach(body: Body, electrodes: Electrodes, tank: Tank) -> None:
    """The whole body lies inside the tank and within the array's outline, widened by one pitch all round."""
    points = posed_points(body)
    for k, axis in enumerate("xy"):
        low, high = float(points[:, k].min()), float(points[:, k].max())
        reach = electrodes.half_extent[k] + electrodes.side + electrodes.space
        limits = [(reach, "the array's reach (its outline widened by one pitch)")]
        if tank.size is not None:
            limits.append((tank.size[k] / 2.0, "the tank"))
        for limit, name in limits:
            if low < -limit - SLACK or high > limit + SLACK:
                x, y = (shown(value, "m") for value in body.pose.position)
                given = f"({x}, {y}), where the body spans {shown(low, 'm')} to {shown(high, 'm')} in {axis}"
                span = f"between {shown(-limit, 'm')} and {shown(limit, 'm')} in {axis}"
                allowed = f"inside {name}: the whole body {span}"
                raise wrong("body.pose.position", given, allowed)


def check_voltages(programme: Programme, electrodes: Electrodes, supply: Supply) -> None:
    """A written pattern has one number for each electrode; a fixed voltage is one that the supply can give."""
    rows, columns, count = electrodes.rows, electrodes.columns, electrodes.count
    limit = supply.limit
    for index, phase in enumerate(programme.phases):
        key = f"programme.phases.{index}"
        if phase.drive != "servo" and abs(phase.drive) > limit:
            allowed = f"at most supply.limit = {shown(limit, 'V')} either way"
            raise wrong(f"{key}.drive", shown(phase.drive, "V"), allowed)
        if isinstance(phase.pattern, str):
            continue
        given = sum(len(row) for row in phase.pattern)
        allowed = f"{count} voltages, one for each of the {rows} x {columns} electrodes"
        if given != count:
            more = "more" if given > count else "fewer"
            raise wrong(f"{key}.pattern", f"{given} voltages", f"{allowed}; there are {more} voltages than electrodes")
        if len(phase.pattern) > 1 and {len(row) for row in phase.pattern} != {columns}:
            lengths = ", ".join(str(len(row)) for row in phase.pattern)
            written = f"{len(phase.pattern)} rows of {lengths}"
            raise wrong(f"{key}.pattern", written, f"{rows} rows of {columns} numbers")
