"""The [electrodes] table of a scenario: what the electrodes are, where they stand, which of them have a voltage."""

from __future__ import annotations

from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ValidationInfo, field_validator, model_validator

from gelbot.errors import NOTHING, BadInput
from gelbot.field.electrodes import Electrode, ElectrodeArray, breadth, hexagonal_array, rectangular_array
from gelbot.field.overlap import CLEARANCE, overlaps
from gelbot.field.panels import FEWEST, panels_of
from gelbot.scenario.electrode_shapes import SHAPE_KEYS, ShapeKeys, displayed, shape_of
from gelbot.scenario.fields import Count, Dimension, Length, NameList, Point, passed_on, wrong
from gelbot.scenario.places import Listed, Place, from_file, place_keys, placed
from gelbot.units import allowed_quantity

GRID = {"rows": "a whole number", "columns": "a whole number", "gap": allowed_quantity("m")}
NEEDED = {
    "rectangular": GRID,
    "hexagonal": GRID,
    "list": {"places": "tables [[electrodes.places]], one for each electrode"},
    "file": {"file": "the name of a .csv or .svg file, in quotes"},
}
"""The keys that each layout must have, with what they hold."""
POSSIBLE = {"rectangular": ("space", "pitch"), "hexagonal": ("space", "pitch"), "list": (), "file": ("gap", "origin")}
"""The keys that a layout can have beside them."""
UNDRIVEN = ("grounded", "floating", "off")
PANELS_MOST = 20_000
"""More panels than this would not be solved in reasonable memory."""


class Electrodes(ShapeKeys):
    """The electrodes: a `layout`, its own keys and those of the shape; lengths in m.

    `grounded`, `floating` and `off` name electrodes that are not driven; `panels` along the longer side of a plate;
    `bubbling` [A/m^2]: mean current density of an electrode above which gas is to be expected.
    """

    layout: Literal["rectangular", "hexagonal", "list", "file"] = "rectangular"
    rows: Annotated[int, Count(ge=1, le=64)] | None = None
    columns: Annotated[int, Count(ge=1, le=64)] | None = None
    space: Length | None = None
    pitch: Length | None = None
    gap: Length | None = None
    places: tuple[Place, ...] | None = None
    file: str | None = None
    origin: Point | None = None
    grounded: NameList = ()
    floating: NameList = ()
    off: NameList = ()
    panels: Annotated[int, Count(ge=1, le=64)] = 12
    bubbling: Annotated[float, Dimension("A/m^2", gt=0)] = 100.0

    @field_validator("file")
    @classmethod
    def _beside_the_scenario(cls, file: str, info: ValidationInfo) -> str:
        return str(Path((info.context or {}).get("folder", "")) / file)

    @cached_property
    def array(self) -> ElectrodeArray:
        """All electrodes where they stand. A file is read when this is first asked for."""
        if self.layout in ("list", "file"):
            return ElectrodeArray(tuple(self._stand()))
        shape, backing, _ = shape_of(self)
        rows, columns, gap = self.rows or 1, self.columns or 1, self.gap or 0.0
        across = breadth(shape)
        pitch = [self.pitch or size + (self.space or 0.0) for size in across]
        if self.layout == "hexagonal":
            return hexagonal_array(shape, rows, columns, pitch[0], gap, backing)
        return rectangular_array(shape, rows, columns, (pitch[0], pitch[1]), gap, backing)

    def _stand(self) -> list[Electrode]:
        """The electrodes of a list or a file."""
        if self.file is None:
            listed = (Listed(f"places.{n}", place, True) for n, place in enumerate(self.places or ()))
        else:
            listed = from_file(Path(self.file), self.origin)
        electrodes, used = placed(listed, self, self.gap)
        for key in ("gap", *SHAPE_KEYS):
            if getattr(self, key) is not None and key not in used:
                raise BadInput(key, displayed(getattr(self, key)), "nothing: no electrode of this layout uses it")
        return electrodes

    @cached_property
    def states(self) -> tuple[str, ...]:
        """What each electrode is: "driven", "grounded", "floating" or "off"."""
        numbers = {n: state for state in UNDRIVEN for n in self._numbers(state)}
        return tuple(numbers.get(n, "driven") for n in range(self.array.count))

    @property
    def pitch_of_array(self) -> float:
        """Distance between the middles of neighbours [m], 0 where there are none."""
        return self.array.pitch if np.isfinite(self.array.pitch) else 0.0

    @property
    def panels_used(self) -> int:
        """Panels along the longer side of a plate: with fewer than these a round plate is none."""
        return max(self.panels, FEWEST)

    def place_of(self, number: int) -> str:
        """The key under which electrode `number` stands."""
        return {"list": f"electrodes.places.{number}", "file": "electrodes.file"}.get(self.layout, "electrodes")

    def called(self, number: int) -> str:
        """What a message calls electrode `number`: its number, and its name where it has one."""
        name, plain = self.array.electrodes[number].name, f"electrode {number}"
        return plain if name == plain else f'{plain} "{name}"'

    def as_list(self) -> list[dict[str, Any]]:
        """The places of all electrodes as a scenario writes them, so that no file is needed."""
        return [place_keys(electrode, n) for n, electrode in enumerate(self.array.electrodes)]

    @model_validator(mode="after")
    def _is_sound(self) -> Electrodes:
        self._check_keys()
        try:
            array = self.array
        except BadInput as error:
            raise passed_on(error) from error
        self._check_names()
        if "driven" not in self.states:
            last = [state for state in UNDRIVEN if getattr(self, state)][-1]
            raise wrong(last, "all electrodes that were left", "at least one electrode that stays driven")
        total = panel_total(array, self.panels_used)
        if total > PANELS_MOST:
            allowed = f"at most {PANELS_MOST} panels in all: the charges are solved with a dense matrix"
            raise wrong("panels", f"{self.panels}, that is {total} panels in all", allowed)
        self._check_distances()
        return self

    def _check_keys(self) -> None:
        """The layout has all keys that it needs, and no other one."""
        needed, named = NEEDED[self.layout], f'the layout "{self.layout}"'
        known = (*needed, *POSSIBLE[self.layout])
        for key in ("rows", "columns", "gap", "space", "pitch", "places", "file", "origin"):
            value = getattr(self, key)
            if value in (None, ()) and key in needed:
                raise wrong(key, NOTHING, f"{needed[key]}: {named} needs it")
            if value is not None and key not in known:
                raise wrong(key, displayed(value), f"nothing: {named} has no {key}, but {', '.join(known)}")
        if self.space is not None and self.pitch is not None:
            raise wrong("pitch", displayed(self.pitch), "one of space and pitch, not both")
        if "space" in known and self.space is None and self.pitch is None and (self.rows, self.columns) != (1, 1):
            allowed = f"{allowed_quantity('m')} between neighbours, or pitch, from middle to middle: {named} needs one"
            raise wrong("space", NOTHING, allowed)
        if self.origin is not None and Path(self.file or "").suffix.lower() != ".svg":
            raise wrong("origin", displayed(self.origin), "nothing: only a drawing (.svg) has one")

    def _check_names(self) -> None:
        """Names are used once, and each electrode stands in one state."""
        seen: dict[str, int] = {}
        for number, electrode in enumerate(self.array.electrodes):
            if electrode.name in seen:
                given = f'"{electrode.name}" for electrode {seen[electrode.name]} and electrode {number}'
                raise wrong(self.place_of(number).removeprefix("electrodes."), given, "names that differ")
            seen[electrode.name] = number
        states: dict[int, str] = {}
        for state in UNDRIVEN:
            for number in self._numbers(state):
                if number in states:
                    allowed = f"each electrode in one state and once; this one is already in {states[number]}"
                    raise wrong(state, self.called(number), allowed)
                states[number] = state

    def _numbers(self, state: str) -> list[int]:
        """The numbers of the electrodes that the key `state` lists."""
        names = [electrode.name for electrode in self.array.electrodes]
        found = []
        for given in getattr(self, state):
            number = names.index(given) if given in names else given
            if not isinstance(number, int) or not 0 <= number < len(names):
                allowed = f"numbers from 0 to {len(names) - 1}, and names of electrodes"
                near = get_close_matches(given, names, 1) if isinstance(given, str) else []
                raise wrong(state, given, allowed, "".join(near))
            found.append(number)
        return found

    def _check_distances(self) -> None:
        """No two electrodes overlap or touch."""
        pair = next(overlaps(self.array), None)
        if pair is None:
            return
        key = "pitch" if self.pitch is not None else self.place_of(pair[1]).removeprefix("electrodes").lstrip(".")
        given = f"{self.called(pair[0])} and {self.called(pair[1])}, which overlap or touch"
        raise wrong(key, given, f"electrodes that are more than {CLEARANCE * 1e6:g} um apart, backings included")


def panel_total(array: ElectrodeArray, panels: int) -> int:
    """How many panels the electrodes of `array` have in all, `panels` along the longer side of a plate."""
    kinds: dict[tuple[Any, bool], int] = {}
    total = 0
    for electrode in array.electrodes:
        kind = electrode.shape, electrode.backing > 0.0
        if kind not in kinds:
            kinds[kind] = panels_of(ElectrodeArray((electrode,)), panels).count
        total += kinds[kind]
    return total
