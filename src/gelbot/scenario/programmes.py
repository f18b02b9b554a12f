"""The [programme] table of a scenario: what the voltages do, phase after phase."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from gelbot.errors import NOTHING, BadInput
from gelbot.plan.templates import TEMPLATES
from gelbot.scenario.fields import Angle, Checked, Coordinate, Dimension, Length, Number, Several, Table, Time, wrong
from gelbot.units import allowed_quantity, quantity, shown

SHARE = Number(ge=-1, le=1)
"""What an electrode may get of the amplitude."""
WEIGHT = Number(ge=-10, le=10)
"""How much of a template there may be in a pattern."""


class PointField(Checked):
    """An essential point, "centre" or "tip 1", "tip 2", ...; read as its number, the centre's being 0."""

    @property
    def allowed(self) -> str:
        return 'an essential point: "centre", or "tip 1", "tip 2", ... (gelbot directions numbers them)'

    def parse(self, given: object) -> int:
        match = re.fullmatch(r"tip\s+([1-9]\d?)", given) if isinstance(given, str) else None
        if match is None and given != "centre":
            raise wrong("", given, self.allowed)
        return 0 if match is None else int(match.group(1))


class PointsField(PointField):
    """One essential point or a list of several; read as their numbers."""

    @property
    def allowed(self) -> str:
        return f"{super().allowed}; or a list of them"

    def parse(self, given: object) -> Any:
        given = given if isinstance(given, list) and given else [given]
        return tuple(super(PointsField, self).parse(point) for point in given)


class AxisField(Checked):
    """ "z", or a direction in the plane; read as a unit vector."""

    @property
    def allowed(self) -> str:
        return f'"x", "y", "z", or {allowed_quantity("rad")} from x'

    def parse(self, given: object) -> tuple[float, float, float]:
        named = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
        if isinstance(given, str) and given in named:
            return named[given]
        try:
            angle = quantity(given, "rad", "")
        except BadInput as error:
            raise wrong("", given, self.allowed) from error
        return (math.cos(angle), math.sin(angle), 0.0)


Point = Annotated[int, PointField()]
Points = Annotated[tuple[int, ...], PointsField()]
Axis = Annotated[tuple[float, float, float], AxisField()]


@dataclass(frozen=True)
class WaypointsField(Checked):
    """A list of pairs [time, value], times growing, the value in `unit`; read as pairs of floats."""

    unit: str = "m"

    @property
    def allowed(self) -> str:
        return (
            f'a list of two or more pairs [time, {self.unit}], their times growing, such as [["0 s", "{self._zero}"]]'
        )

    @property
    def _zero(self) -> str:
        return {"m": "0 mm", "V": "0 V"}[self.unit]

    def parse(self, given: object) -> tuple[tuple[float, float], ...]:
        if not isinstance(given, list) or len(given) < 2:
            raise wrong("", given, self.allowed)
        pairs = []
        for pair in given:
            if not isinstance(pair, list) or len(pair) != 2:
                raise wrong("", pair, self.allowed)
            try:
                pairs.append((quantity(pair[0], "s", ""), quantity(pair[1], self.unit, "")))
            except BadInput as error:
                raise wrong("", error.given, error.allowed, error.advice) from error
        times = [time for time, _ in pairs]
        if times[0] < 0.0 or any(after <= before for before, after in pairwise(times)):
            raise wrong("", given, self.allowed)
        return tuple(pairs)


class Reference(Table):
    """The desired trajectory of an essential `point` along `axis`; see `plan.trajectory`.

    Either a rise from rest to `height` [m] in `duration` [s], or `waypoints` [s, m]. Along z values are heights above
    the floor, along other axes distances from where the point was at the start. `speed_limit` [m/s] delays what would
    be faster.
    """

    point: Point = 0
    axis: Axis = (0.0, 0.0, 1.0)
    height: Length | None = None
    duration: Time | None = None
    rounding: Annotated[float, Number(ge=0, le=1)] = 1.0
    waypoints: Annotated[tuple[tuple[float, float], ...], WaypointsField()] | None = None
    speed_limit: Annotated[float, Dimension("m/s", gt=0)] | None = None

    @model_validator(mode="after")
    def _is_one_of_two(self) -> Reference:
        rise = [key for key in ("height", "duration", "rounding") if key in self.model_fields_set]
        if self.waypoints is not None and rise:
            raise wrong(rise[0], "a value beside waypoints", "only a rise to one height, without waypoints")
        if self.waypoints is None and (self.height is None or self.duration is None):
            missing = "height" if self.height is None else "duration"
            raise wrong(missing, NOTHING, "this key is required, unless there are waypoints")
        return self


class ServoGains(Table):
    """The servo of Eq. (7): `kp` [V/m], `kv` [V s/m], and whether its sign is corrected or as printed.

    `slew` [V/s] limits how fast its command changes; `filter` [s] is the time constant of a low pass on the velocity.
    """

    kp: Annotated[float, Dimension("V/m", ge=0)]
    kv: Annotated[float, Dimension("V*s/m", ge=0)]
    sign: Literal["corrected", "printed"]
    slew: Annotated[float, Dimension("V/s", gt=0)] | None = None
    filter: Annotated[float, Dimension("s", ge=0)] = 0.0


class Until(Table):
    """What ends a phase: its event, when all that is named has been reached, or `after` [s] at the latest.

    Centre `height` [m] or more, or `height_below` [m] or less, steepest `tip_angle` [rad] or more, the normal's z at
    most `normal_below` or at least `normal_above`, the points in `contact` on the floor, those in `lifted` off it; the
    reference's point `along` its axis by so much [m] or more, or `along_below` or less. The
    event leads to the phase `then`, the time to the phase `otherwise`; the next one where they are not given.
    """

    height: Coordinate | None = None
    height_below: Coordinate | None = None
    tip_angle: Angle | None = None
    normal_below: Annotated[float, Number(ge=-1, le=1)] | None = None
    normal_above: Annotated[float, Number(ge=-1, le=1)] | None = None
    along: Coordinate | None = None
    along_below: Coordinate | None = None
    contact: Points | None = None
    lifted: Points | None = None
    after: Time | None = None
    then: str | None = None
    otherwise: str | None = None

    @property
    def has_event(self) -> bool:
        """Whether something beside the time can end the phase."""
        return bool(self.model_fields_set - {"after", "then", "otherwise"})

    @model_validator(mode="after")
    def _says_something(self) -> Until:
        if not self.has_event and self.after is None:
            names = ", ".join(key for key in type(self).model_fields if key not in ("then", "otherwise"))
            raise wrong("", self.model_dump(exclude_unset=True), "at least one of " + names)
        if self.then is not None and not self.has_event:
            raise wrong("then", self.then, "only with an event; what follows after a time is named by otherwise")
        if self.otherwise is not None and self.after is None:
            raise wrong("otherwise", self.otherwise, "only with after, the time after which it applies")
        return self


class PatternField(Checked):
    """A template's name, weights of templates, or numbers in [-1, 1], read as rows: a flat list is one row."""

    @property
    def allowed(self) -> str:
        return (
            "a template (" + ", ".join(TEMPLATES) + "), a table of templates with their weights, "
            "or a list of numbers from -1 to 1, one for each electrode"
        )

    def parse(self, given: object) -> str | tuple[tuple[float, ...], ...] | dict[str, float]:
        if isinstance(given, str) and given in TEMPLATES:
            return given
        if isinstance(given, dict) and given:
            for name in given:
                if name not in TEMPLATES:
                    raise wrong(
                        "", name, "one of " + ", ".join(TEMPLATES), "".join(get_close_matches(name, TEMPLATES, 1))
                    )
            return {name: WEIGHT.parse(weight) for name, weight in given.items()}
        if not isinstance(given, list) or not given:
            advice = "".join(get_close_matches(given, TEMPLATES, 1)) if isinstance(given, str) else ""
            raise wrong("", given, self.allowed, advice)
        rows = given if all(isinstance(row, list) for row in given) else [given]
        return tuple(tuple(SHARE.parse(value) for value in row) for row in rows)


class DriveField(Checked):
    """The word "servo", a voltage [V], or pairs of time [s] and voltage [V]."""

    @property
    def allowed(self) -> str:
        return f'the word "servo", or {allowed_quantity("V")}, or a list of pairs [time, voltage], their times growing'

    def parse(self, given: object) -> str | float | tuple[tuple[float, float], ...]:
        if given == "servo":
            return "servo"
        if isinstance(given, list):
            return WaypointsField(unit="V").parse(given)
        try:
            return quantity(given, "V", "")
        except BadInput as error:
            raise wrong("", given, self.allowed) from error


class Phase(Table):
    """One phase: electrode n gets `shares[n]` times the amplitude, which is `drive` [V] or comes from the servo.

    The servo follows the programme's reference, or keeps the value `hold` [m] where the phase names one.
    """

    name: str
    pattern: Annotated[str | tuple[tuple[float, ...], ...] | dict[str, float], PatternField()]
    drive: Annotated[Literal["servo"] | float | tuple[tuple[float, float], ...], DriveField()]
    hold: Coordinate | None = None
    until: Until | None = None

    @property
    def shares(self) -> tuple[float, ...] | None:
        """The written pattern, row after row, or None for templates."""
        if isinstance(self.pattern, tuple):
            return tuple(value for row in self.pattern for value in row)
        return None

    @property
    def weights(self) -> dict[str, float]:
        """The templates in the pattern with their weights; empty for a written one."""
        if isinstance(self.pattern, str):
            return {self.pattern: 1.0}
        return self.pattern if isinstance(self.pattern, dict) else {}

    @property
    def profile(self) -> tuple[tuple[float, float], ...]:
        """Times [s] of the phase and amplitudes [V]; zero where the servo drives."""
        if isinstance(self.drive, tuple):
            return self.drive
        return ((0.0, 0.0 if self.drive == "servo" else self.drive),)


class Programme(Table):
    """What is done: `phases` one after the other, a tick every `control_period` [s].

    `place` [m]: where it is meant to be done, which picks the robot's electrode; None: where the body lies.
    `turn` [rad] turns all patterns about it: their voltages become those whose field comes nearest to the turned one
    (`plan.carry`).
    """

    control_period: Time
    place: Annotated[tuple[float, float], Several(Dimension("m"), (2,))] | None = None
    turn: Angle = 0.0
    reference: Reference | None = None
    servo: ServoGains | None = None
    phases: Annotated[tuple[Phase, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _is_complete(self) -> Programme:
        names = [phase.name for phase in self.phases]
        for index, phase in enumerate(self.phases):
            last, key = index == len(self.phases) - 1, f"phases.{index}"
            for needed in ("reference", "servo"):
                has_own = needed == "reference" and phase.hold is not None
                if phase.drive == "servo" and not has_own and getattr(self, needed) is None:
                    raise wrong(needed, NOTHING, f'a table: programme.{key}.drive is "servo" and needs it')
            for needed in ("along", "along_below"):
                if self.reference is None and phase.until is not None and getattr(phase.until, needed) is not None:
                    raise wrong(
                        "reference", NOTHING, f"a table: programme.{key}.until.{needed} goes by its point and axis"
                    )
            if phase.hold is not None and phase.drive != "servo":
                raise wrong(f"{key}.hold", shown(phase.hold, "m"), 'only with drive = "servo"')
            self._check_order(phase.until, key, last, names)
        return self

    def _check_order(self, until: Until | None, key: str, last: bool, names: list[str]) -> None:
        """What follows a phase is a phase."""
        if until is None:
            if not last:
                allowed = "a table: the phase is followed by another"
                raise wrong(f"{key}.until", NOTHING, allowed, 'after = "10 s"')
            return
        for word, name in (("then", until.then), ("otherwise", until.otherwise)):
            if name is not None and names.count(name) != 1:
                allowed = "the name of one phase: " + ", ".join(names)
                raise wrong(f"{key}.until.{word}", name, allowed, "".join(get_close_matches(name, names, 1)))
        leads = [until.then] * until.has_event + [until.otherwise] * (until.after is not None)
        if last and None in leads:
            missing = "then" if until.has_event and until.then is None else "otherwise"
            allowed = f"nothing, or the phase that follows as {missing}: the last phase goes on to the end of the run"
            raise wrong(f"{key}.until", "a table", allowed)
