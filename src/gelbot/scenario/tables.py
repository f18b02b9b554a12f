"""The tables of a scenario beside [body], each value in SI, with the checks on one value and within one table."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Annotated, Literal

from pydantic import Field, model_validator

from gelbot.errors import NOTHING, BadInput
from gelbot.plan.templates import TEMPLATES
from gelbot.scenario.fields import (
    Angle,
    Checked,
    Coordinate,
    Count,
    Density,
    Dimension,
    Height,
    Length,
    Number,
    Size,
    Table,
    Time,
    wrong,
)
from gelbot.units import allowed_quantity, quantity, shown

SHARE = Number(ge=-1, le=1)
"""What an electrode may get of the amplitude."""


class Material(Table):
    """The gel: `young_modulus` [Pa], `density` [kg/m^3], and the constants of Eqs. (2), (3) and (6).

    `model`: the paper's spring "lattice", or a "solid" of finite elements with its `poisson_ratio`. `p_ele` [m^2/A] and
    `p_ads` per `adsorption_step` [s]. `conductivity` [S/m]; None: it does not disturb the field. `self_contact`:
    whether the body is kept from passing through itself; `self_friction`: gel on gel, None: as the tank's.
    """

    model: Literal["lattice", "solid"] = "lattice"
    poisson_ratio: Annotated[float, Number(ge=0, le=0.48)] = 0.3
    self_contact: bool = False
    self_friction: Annotated[float, Number(ge=0)] | None = None
    young_modulus: Annotated[float, Dimension("Pa", gt=0)]
    density: Density
    p_ele: Annotated[float, Dimension("m^2/A", ge=0)]
    adsorption_step: Time
    p_ads: Annotated[float, Number(gt=0, le=1)]
    p_l: Annotated[float, Number(ge=0, lt=1)]
    conductivity: Annotated[float, Dimension("S/m", gt=0)] | None = None


class Solution(Table):
    """The surfactant solution: `conductivity` [S/m], `density` [kg/m^3], `drag` [1/s] of the body per its mass."""

    conductivity: Annotated[float, Dimension("S/m", gt=0)]
    density: Density
    drag: Annotated[float, Dimension("1/s", ge=0)]


class Tank(Table):
    """The tank: lengths in m; `depth` None is deep, `size` None is wide; Coulomb `friction` of the floor.

    Its boundaries insulate, but for those in `open`, beyond which the solution goes on.
    """

    floor_depth: Height
    depth: Length | None = None
    size: Size | None = None
    open: tuple[Literal["floor", "surface", "-x", "+x", "-y", "+y"], ...] = ()
    friction: Annotated[float, Number(ge=0)]

    @model_validator(mode="after")
    def _has_what_is_open(self) -> Tank:
        for side in self.open:
            missing = "size" if side[0] in "+-" and self.size is None else "depth" if side == "surface" else None
            if missing and getattr(self, missing) is None:
                raise wrong("open", side, f"a boundary that the tank has: without {missing} it has none there")
        return self


class Supply(Table):
    """The supply: the largest voltage `limit` [V], either way, and sum of positive currents `current_limit` [A]."""

    limit: Annotated[float, Dimension("V", gt=0)]
    current_limit: Annotated[float, Dimension("A", gt=0)] | None = None


class Reference(Table):
    """The desired height of the centre: a rise from rest to `height` [m] in `duration` [s]; see `plan.trajectory`."""

    height: Length
    duration: Time
    rounding: Annotated[float, Number(ge=0, le=1)]


class ServoGains(Table):
    """The servo of Eq. (7): `kp` [V/m], `kv` [V s/m], and whether its sign is corrected or as printed."""

    kp: Annotated[float, Dimension("V/m", ge=0)]
    kv: Annotated[float, Dimension("V*s/m", ge=0)]
    sign: Literal["corrected", "printed"]


class Until(Table):
    """What ends a phase: centre `height` [m], `tip_angle` [rad] and `normal_below` all reached, or `after` [s] over."""

    height: Coordinate | None = None
    tip_angle: Angle | None = None
    normal_below: Annotated[float, Number(ge=-1, le=1)] | None = None
    after: Time | None = None

    @model_validator(mode="after")
    def _says_something(self) -> Until:
        if not self.model_fields_set:
            raise wrong("", {}, "at least one of " + ", ".join(type(self).model_fields))
        return self


class PatternField(Checked):
    """A template's name, or numbers in [-1, 1], read as rows: a flat list is one row."""

    @property
    def allowed(self) -> str:
        return "a template (" + ", ".join(TEMPLATES) + ") or a list of numbers from -1 to 1, one for each electrode"

    def parse(self, given: object) -> str | tuple[tuple[float, ...], ...]:
        if isinstance(given, str) and given in TEMPLATES:
            return given
        if not isinstance(given, list) or not given:
            advice = "".join(get_close_matches(given, TEMPLATES, 1)) if isinstance(given, str) else ""
            raise wrong("", given, self.allowed, advice)
        rows = given if all(isinstance(row, list) for row in given) else [given]
        return tuple(tuple(SHARE.parse(value) for value in row) for row in rows)


class DriveField(Checked):
    """The word "servo", or a voltage [V]."""

    @property
    def allowed(self) -> str:
        return f'the word "servo", or {allowed_quantity("V")}'

    def parse(self, given: object) -> str | float:
        if given == "servo":
            return "servo"
        try:
            return quantity(given, "V", "")
        except BadInput as error:
            raise wrong("", given, self.allowed) from error


class Phase(Table):
    """One phase: electrode n gets `shares[n]` times the amplitude, which is `drive` [V] or comes from the servo.

    The servo follows the programme's reference, or keeps the height `hold` [m] where the phase names one.
    """

    name: str
    pattern: Annotated[str | tuple[tuple[float, ...], ...], PatternField()]
    drive: Annotated[Literal["servo"] | float, DriveField()]
    hold: Length | None = None
    until: Until | None = None

    @property
    def template(self) -> str | None:
        """The name of the template, or None where the pattern is written out."""
        return self.pattern if isinstance(self.pattern, str) else None

    @property
    def shares(self) -> tuple[float, ...] | None:
        """The written pattern, row after row, or None for a template."""
        return None if isinstance(self.pattern, str) else tuple(value for row in self.pattern for value in row)


class Programme(Table):
    """What is done: `phases` one after the other, a tick every `control_period` [s]."""

    control_period: Time
    reference: Reference | None = None
    servo: ServoGains | None = None
    phases: Annotated[tuple[Phase, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _is_complete(self) -> Programme:
        for index, phase in enumerate(self.phases):
            for key in ("reference", "servo"):
                needed = phase.drive == "servo" and not (key == "reference" and phase.hold is not None)
                if needed and getattr(self, key) is None:
                    raise wrong(key, NOTHING, f'a table: programme.phases.{index}.drive is "servo" and needs it')
            if phase.hold is not None and phase.drive != "servo":
                raise wrong(f"phases.{index}.hold", shown(phase.hold, "m"), 'only with drive = "servo"')
            if phase.until is not None and index == len(self.phases) - 1:
                raise wrong(f"phases.{index}.until", "a table", "nothing: the last phase goes on to the end of the run")
            if phase.until is None and index < len(self.phases) - 1:
                allowed = "a table: the phase is followed by another"
                raise wrong(f"phases.{index}.until", NOTHING, allowed, 'after = "10 s"')
        return self


class Simulation(Table):
    """How it is computed: `duration` and `time_step` [s]; residual `tolerance` of the implicit step.

    `step_error` [m]: where given, the time step adapts, so that no node is farther off in a step than that.
    `field_spacing` [m]: cells of the table from which the body reads the field.
    """

    duration: Time
    time_step: Time
    tolerance: Annotated[float, Number(gt=0, lt=1)]
    max_iterations: Annotated[int, Count(ge=1)]
    precision: Literal["float64", "float32"]
    step_error: Annotated[float, Dimension("m", ge=1e-9, le=1e-2)] | None = None
    field_spacing: Annotated[float, Dimension("m", ge=1e-4, le=5e-3)] = 1e-3


class Recording(Table):
    """What is kept: a frame every `interval` [s], written every `chunk` [s]; the movie runs `speed` times as fast."""

    interval: Time
    chunk: Time
    frames_per_second: Annotated[int, Count(ge=1, le=120)]
    speed: Annotated[float, Number(gt=0)]
