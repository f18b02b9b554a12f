"""Checks among the tables of a scenario: do body and electrodes fit together and into the tank, do the voltages fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.body.symmetry import rotation
from gelbot.field.electrodes import THIN, Electrode, ElectrodeArray
from gelbot.field.overlap import reaches_into
from gelbot.scenario.bench import Supply
from gelbot.scenario.bodies import Body
from gelbot.scenario.electrodes import Electrodes
from gelbot.scenario.fields import wrong
from gelbot.scenario.programmes import Programme
from gelbot.scenario.tables import Tank
from gelbot.units import shown

SLACK = 1e-9
"""Two lengths closer than this [m] are equal: a body may touch the line that it must not cross."""


def posed_points(body: Body) -> NDArray[np.float64]:
    """The outline of the body where it lies at the start, in the array's frame [m], shape (p, 2)."""
    pose = body.pose
    return body.outline().points @ rotation(pose.heading).T + np.array(pose.position)


def check_gel_is_clear(body: Body, electrodes: Electrodes) -> None:
    """No electrode reaches into the place of the body; electrodes that have a `gap` hang above it."""
    low, high = body.pose.lift, body.thickness + body.pose.lift
    if electrodes.gap is not None and electrodes.gap <= high:
        allowed = f"more than body.thickness + body.pose.lift = {shown(high, 'm')}"
        raise wrong("electrodes.gap", shown(electrodes.gap, "m"), allowed)
    outline = posed_points(body)
    for number, electrode in enumerate(electrodes.array.electrodes):
        if reaches_into(electrode, outline, low, high):
            given = f"{electrodes.called(number)}, which reaches into the gel or touches it"
            allowed = f"electrodes that are beside the gel, below z = {shown(low, 'm')} or above z = {shown(high, 'm')}"
            raise wrong(electrodes.place_of(number), given, allowed)


class Boundary(NamedTuple):
    """A plane that bounds the solution: coordinate `axis` is at most (`sign` 1) or at least (-1) `limit` [m]."""

    key: str
    axis: int
    sign: int
    limit: float


def boundaries(tank: Tank) -> Iterator[Boundary]:
    """Floor, surface and walls of `tank` that are not open, with the keys that place them."""
    if "floor" not in tank.open:
        yield Boundary("tank.floor_depth", 2, -1, -tank.floor_depth)
    if tank.depth is not None and "surface" not in tank.open:
        yield Boundary("tank.depth", 2, 1, tank.depth)
    for axis, size in enumerate(tank.size or ()):
        for sign, name in ((-1, "-"), (1, "+")):
            if name + "xy"[axis] not in tank.open:
                yield Boundary("tank.size", axis, sign, sign * size / 2.0)


def mounted(array: ElectrodeArray, tank: Tank) -> ElectrodeArray:
    """The array as the solution sees it: a plate that lies in a boundary has that for its back."""

    def seen(electrode: Electrode) -> Electrode:
        flush = any(_lies_in(electrode, plane) == -1 for plane in boundaries(tank))
        return replace(electrode, backing=0.0) if flush else electrode

    return ElectrodeArray(tuple(seen(electrode) for electrode in array.electrodes))


def _lies_in(electrode: Electrode, plane: Boundary) -> int:
    """1 for a plate in `plane` that faces out of the tank, -1 for one that faces into it, 0 for all others."""
    across = float(electrode.frame[plane.axis, 2])
    flat = isinstance(electrode.shape, THIN) and abs(across) > 1.0 - SLACK
    return round(plane.sign * across) if flat and abs(electrode.centre[plane.axis] - plane.limit) < SLACK else 0


def check_tank(electrodes: Electrodes, tank: Tank) -> None:
    """The electrodes are inside the tank; they may touch its boundaries."""
    array = mounted(electrodes.array, tank)
    for key, axis, sign, limit in boundaries(tank):
        ends = np.array([e.bounds[(sign + 1) // 2][axis] for e in array.electrodes])
        furthest = int(np.argmax(sign * ends))
        if sign * (ends[furthest] - limit) > SLACK:
            letter, whole = "xyz"[axis], 2.0 if key == "tank.size" else 1.0
            given = shown(whole * abs(limit), "m") + (f" in {letter}" if axis < 2 else "")
            reach = f"{electrodes.called(furthest)} reaches to {letter} = {shown(float(ends[furthest]), 'm')}"
            least = shown(whole * sign * float(ends[furthest]), "m") + (f" in {letter}" if axis < 2 else "")
            raise wrong(key, given, f"at least {least}: {reach}")
    for number, electrode in enumerate(array.electrodes):
        if electrode.backing and any(_lies_in(electrode, plane) == 1 for plane in boundaries(tank)):
            given = f"{electrodes.called(number)}, whose front lies against a boundary of the tank"
            raise wrong(electrodes.place_of(number), given, "a front that faces the solution, or another axis")


def check_reach(body: Body, electrodes: Electrodes, tank: Tank) -> None:
    """The whole body lies inside the tank and within the array's outline, widened all round."""
    points, array = posed_points(body), electrodes.array
    lows, highs = (np.array([electrode.bounds[k] for electrode in array.electrodes]) for k in (0, 1))
    # Where electrodes are small or few, so that they have no pitch, the body and the electrodes are the measure.
    widened = max(electrodes.pitch_of_array, float((highs - lows)[:, :2].max()), float(np.ptp(points, axis=0).max()))
    for k, axis in enumerate("xy"):
        low, high = float(points[:, k].min()), float(points[:, k].max())
        name = f"the array's reach (its outline widened by {shown(widened, 'm')})"
        limits = [(float(lows[:, k].min()) - widened, float(highs[:, k].max()) + widened, name)]
        if tank.size is not None:
            limits.append((-tank.size[k] / 2.0, tank.size[k] / 2.0, "the tank"))
        for least, most, name in limits:
            if low < least - SLACK or high > most + SLACK:
                x, y = (shown(value, "m") for value in body.pose.position)
                given = f"({x}, {y}), where the body spans {shown(low, 'm')} to {shown(high, 'm')} in {axis}"
                span = f"between {shown(least, 'm')} and {shown(most, 'm')} in {axis}"
                allowed = f"inside {name}: the whole body {span}"
                raise wrong("body.pose.position", given, allowed)


def check_voltages(programme: Programme, electrodes: Electrodes, supply: Supply) -> None:
    """A written pattern has one number for each electrode; a fixed voltage is one that the supply can give."""
    rows, columns, count = electrodes.rows, electrodes.columns, electrodes.array.count
    in_rows = rows is not None and columns is not None
    limit = supply.limit
    for index, phase in enumerate(programme.phases):
        key = f"programme.phases.{index}"
        for _, voltage in phase.profile:
            if abs(voltage) > limit:
                allowed = f"at most supply.limit = {shown(limit, 'V')} either way"
                raise wrong(f"{key}.drive", shown(voltage, "V"), allowed)
        if not isinstance(phase.pattern, tuple):
            continue
        given = sum(len(row) for row in phase.pattern)
        allowed = f"{count} voltages, one for each of the {f'{rows} x {columns}' if in_rows else count} electrodes"
        if given != count:
            more = "more" if given > count else "fewer"
            raise wrong(f"{key}.pattern", f"{given} voltages", f"{allowed}; there are {more} voltages than electrodes")
        if in_rows and len(phase.pattern) > 1 and {len(row) for row in phase.pattern} != {columns}:
            lengths = ", ".join(str(len(row)) for row in phase.pattern)
            written = f"{len(phase.pattern)} rows of {lengths}"
            raise wrong(f"{key}.pattern", written, f"{rows} rows of {columns} numbers")
