"""What a user asks of the field, in words, and what it means: voltages, planes, points, a gel that conducts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.columns import LINE, read_columns
from gelbot.errors import BadInput
from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.images import Tank
from gelbot.field_report.moment import Moment, plain_or_with_unit
from gelbot.plan.templates import superposition, template
from gelbot.scenario.schema import Scenario
from gelbot.units import NUMBER, quantity, shown

Floats = NDArray[np.float64]

SLACK = 1e-9
"""A place nearer than this [m] to a boundary of the tank is inside."""
PLANE = re.compile(r"\s*([xyz])\s*=\s*(.*)", re.DOTALL)
BEFORE_A_NUMBER = re.compile(r"\s+(?=[+-]?\.?\d)")


class Request(NamedTuple):
    """The options of `gelbot field` as they were written; None, or empty, where one was not given."""

    voltages: str | None = None
    template: str | None = None
    amplitude: str | None = None
    planes: tuple[str, ...] = ()
    points: Path | None = None
    gel_conductivity: str | None = None
    run: Path | None = None
    time: str | None = None


class Plane(NamedTuple):
    """The plane where coordinate `axis` (0, 1, 2) is `value` [m]."""

    axis: int
    value: float

    def __str__(self) -> str:
        return f"{'xyz'[self.axis]} = {shown(self.value, 'm')}"


class Drive(NamedTuple):
    """The voltages asked of the supply [V], shape (e,), 0 where it is not connected, and where they come from."""

    voltages: Floats
    source: str


def drive(request: Request, scenario: Scenario, array: ElectrodeArray, moment: Moment) -> Drive:
    """The voltages that are asked for, in this order: --voltages, --template, those of the run, of the first phase."""
    driven = np.array(scenario.electrodes.states) == "driven"
    if request.voltages is not None:
        for option, given in (("--template", request.template), ("--amplitude", request.amplitude)):
            if given is not None:
                raise BadInput(option, given, "nothing beside --voltages, which says everything")
        return Drive(_listed(request.voltages, array, driven), "voltages as given")
    if request.template is None and request.amplitude is None and moment.voltages is not None:
        return Drive(moment.voltages * driven, moment.source)
    if request.template is None and request.amplitude is not None and moment.voltages is not None:
        allowed = "a --template that it multiplies: --run alone has the run's own voltages"
        raise BadInput("--amplitude", request.amplitude, allowed)
    phase = scenario.programme.phases[0]
    place = moment.centre[:2]
    if request.template is not None:
        pattern, source = template(request.template, array, place, "--template"), request.template
    elif phase.shares is None:
        names = " + ".join(phase.weights)
        pattern, source = superposition(phase.weights, array, place), f'phase "{phase.name}", {names}'
    else:
        pattern, source = np.array(phase.shares), f'phase "{phase.name}"'
    limit = scenario.supply.limit
    if request.amplitude is not None:
        amplitude = plain_or_with_unit(request.amplitude, "V", "--amplitude")
    else:
        amplitude = limit if request.template is not None or phase.drive == "servo" else phase.profile[0][1]
    return Drive(amplitude * pattern * driven, f"{source} at {shown(amplitude, 'V')}")


def _listed(text: str, array: ElectrodeArray, driven: NDArray[np.bool_]) -> Floats:
    words = [word for part in text.split(",") for word in BEFORE_A_NUMBER.split(part.strip())]
    if len(words) != array.count:
        plain = len(words) > 1 or (NUMBER.match(text) is not None and ";" not in text)
        given = f"{len(words)} {'voltage' if len(words) == 1 else 'voltages'}" if plain else text
        allowed = f"{array.count} voltages, one for each electrode, in their order, with commas between them"
        allowed += ", in volts or with units"
        raise BadInput("--voltages", given, allowed)
    values = np.array([plain_or_with_unit(word, "V", f"--voltages, electrode {n}") for n, word in enumerate(words)])
    for n in np.flatnonzero(~driven & (values != 0.0)):
        allowed = "0 V: this electrode is not driven, so that the supply gives it no voltage"
        raise BadInput(f"--voltages, electrode {n}", words[n], allowed)
    return values


def planes(request: Request, tank: Tank, moment: Moment) -> list[Plane]:
    """The planes asked for; else two through the middle of the body: a section along x, and a view from above."""
    if not request.planes:
        return [Plane(1, float(moment.centre[1])), Plane(2, float(moment.centre[2]))]
    asked = [_plane(text, tank) for text in request.planes]
    return list({str(plane): plane for plane in asked}.values())


def _plane(text: str, tank: Tank) -> Plane:
    found = PLANE.fullmatch(text)
    if found is None:
        raise BadInput("--plane", text, "x, y or z and where, with a unit, such as z=1mm or y=12.5mm")
    plane = Plane("xyz".index(found[1]), quantity(found[2].strip(), "m", f"--plane {found[1]}"))
    allowed = beyond(plane.axis, plane.value, tank)
    if allowed:
        raise BadInput("--plane", text, f"a plane inside the tank: {allowed}")
    return plane


def beyond(axis: int, value: float, tank: Tank) -> str:
    """Where coordinate `axis` may lie, in words, if `value` [m] is outside the tank; else nothing."""
    low, high = tank.planes[axis]
    outside = (low is not None and value < low - SLACK) or (high is not None and value > high + SLACK)
    if not outside:
        return ""
    bounds = (("at least", low), ("at most", high))
    return f"{'xyz'[axis]} " + " and ".join(f"{word} {shown(b, 'm')}" for word, b in bounds if b is not None)


def points(path: Path, tank: Tank) -> Floats:
    """The points of a CSV file with columns x, y and z [m], shape (3, p); it may have others beside them."""
    table = read_columns(path, {"x": "m", "y": "m", "z": "m"}, passes_over=True)
    for line, *place in zip(table[LINE], table["x"], table["y"], table["z"], strict=True):
        for axis, value in enumerate(place):
            allowed = beyond(axis, value, tank)
            if allowed:
                given = f"{'xyz'[axis]} = {shown(value, 'm')}"
                raise BadInput(f"{path}, line {line}", given, f"a point inside the tank: {allowed}")
    return np.array([table["x"], table["y"], table["z"]])


def gel_conductivity(request: Request, scenario: Scenario) -> float | None:
    """The gel's own conductivity [S/m], or None where it conducts as the solution does."""
    if request.gel_conductivity is None:
        return scenario.material.conductivity
    value = quantity(request.gel_conductivity, "S/m", "--gel-conductivity")
    if value < 0.0:
        raise BadInput("--gel-conductivity", request.gel_conductivity, "a conductivity that is not negative")
    return value
