"""Electrodes that stand where a list or a file says, one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError, model_validator

from gelbot.errors import NOTHING, BadInput
from gelbot.field.electrodes import Electrode, frame_of
from gelbot.scenario.electrode_shapes import ShapeKeys, shape_keys, shape_of
from gelbot.scenario.fields import Angle, Direction, Position, written, wrong
from gelbot.scenario.layout_file import read_layout
from gelbot.units import allowed_quantity


class Place(ShapeKeys):
    """One electrode: its middle at `position` [m], its own z along `axis`, about which it is turned by `turn` [rad]."""

    position: Position
    name: str | None = None
    axis: Direction = (0.0, 0.0, -1.0)
    turn: Angle = 0.0

    @model_validator(mode="after")
    def _points_somewhere(self) -> Place:
        if not any(self.axis):
            raise wrong("axis", list(self.axis), "a direction: numbers that are not all zero")
        return self


class Listed(NamedTuple):
    """A `place`, the key under which it stands in [electrodes] (`where`), and whether its height is given there."""

    where: str
    place: Place
    has_height: bool


def from_file(path: Path, origin: tuple[float, float] | None) -> Iterator[Listed]:
    """The places of a file, see `gelbot.scenario.layout_file`."""
    try:
        rows = read_layout(path, origin)
    except BadInput as error:
        where = "file" if error.where == "file" else f"file: {error.where}"
        raise BadInput(where, error.given, error.allowed, error.advice) from error
    for row in rows:
        where = f"file: {row.origin}"
        try:
            yield Listed(where, Place.model_validate(row.keys), row.has_height)
        except ValidationError as error:
            found = error.errors(include_url=False)[0]
            context = found.get("ctx", {})
            key = ".".join(str(part) for part in (*found["loc"], context.get("key", "")) if part != "")
            allowed = context.get("allowed", f"one of {context.get('expected', '')}")
            raise BadInput(f"{where}: {key}", context.get("given", found["input"]), allowed) from error


def placed(listed: Iterable[Listed], common: ShapeKeys, gap: float | None) -> tuple[list[Electrode], set[str]]:
    """The electrodes, and which keys of [electrodes] they use: those in `common` for what a place does not say itself.

    The lowest point of an electrode without a height of its own is at `gap` [m].
    """
    electrodes: list[Electrode] = []
    used: set[str] = set()
    for where, place, has_height in listed:
        try:
            shape, backing, shared = shape_of(place, common)
        except BadInput as error:
            raise BadInput(f"{where}.{error.where}", error.given, error.allowed) from error
        used |= shared
        position, name = np.array(place.position), place.name or f"electrode {len(electrodes)}"
        frame = frame_of(place.axis, place.turn)
        if not has_height:
            if gap is None:
                allowed = f"{allowed_quantity('m')}: the file gives {name} no z; its lowest point gets this height"
                raise BadInput("gap", NOTHING, allowed)
            used.add("gap")
            position[2] = gap - Electrode(shape, position, frame, backing).bounds[0][2]
        electrodes.append(Electrode(shape, position, frame, backing, name))
    return electrodes, used


def place_keys(electrode: Electrode, number: int) -> dict[str, Any]:
    """An electrode as a scenario writes it among the places: what `placed` reads."""
    straight = frame_of(electrode.frame[:, 2].tolist())
    x = straight.T @ electrode.frame[:, 0]
    name = {} if electrode.name == f"electrode {number}" else {"name": electrode.name}
    return {
        **name,
        "position": [written(value) for value in electrode.centre],
        "axis": electrode.frame[:, 2].tolist(),
        "turn": f"{float(np.arctan2(x[1], x[0]))!r} rad",
        **shape_keys(electrode),
    }
