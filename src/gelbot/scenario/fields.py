"""The values of a scenario: how each kind is written, and which values it may have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from gelbot.errors import BadInput
from gelbot.units import allowed_quantity, quantity, shown


class Table(BaseModel):
    """A table of a scenario file: unknown keys are errors, values do not change."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def wrong(key: str, given: object, allowed: str, advice: str = "") -> PydanticCustomError:
    """The error of a check: `key` (dotted, below the table that is being checked) has the value `given`."""
    context = {"key": key, "given": given, "allowed": allowed, "advice": advice}
    return PydanticCustomError("bad_input", "bad input", context)


def passed_on(error: BadInput, prefix: str = "") -> PydanticCustomError:
    """`error`, raised by another module, as an error of a check; `prefix` is taken off its place."""
    key = error.where.removeprefix(prefix).lstrip(".")
    return wrong(key, error.given, error.allowed, error.advice)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Greater than (`gt`), at least (`ge`), less than (`lt`), at most (`le`); None is no bound."""

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None

    def hold(self, value: float) -> bool:
        """Whether `value` is finite and within the bounds."""
        return (
            math.isfinite(value)
            and (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def text(self, unit: str = "") -> str:
        """The bounds in words, with `unit`; empty without bounds."""
        words = {"gt": "greater than", "ge": "at least", "lt": "less than", "le": "at most"}
        given = [(word, getattr(self, name)) for name, word in words.items() if getattr(self, name) is not None]
        return " and ".join(f"{word} {shown(bound, unit) if unit and bound else f'{bound:g}'}" for word, bound in given)


class Checked(Bounds):
    """An annotation that reads one value of a scenario: `parse` makes it, `allowed` says what it may be."""

    @property
    def allowed(self) -> str:
        raise NotImplementedError

    def parse(self, given: object) -> Any:
        raise NotImplementedError

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)


@dataclass(frozen=True)
class Dimension(Checked):
    """A quantity, written with its unit; read as a float in the SI unit `unit`."""

    unit: str

    @property
    def allowed(self) -> str:
        return self._bounded(allowed_quantity(self.unit))

    def parse(self, given: object) -> Any:
        try:
            value = quantity(given, self.unit, "")
        except BadInput as error:
            raise wrong("", given, self._bounded(error.allowed), error.advice) from error
        if not self.hold(value):
            raise wrong("", given, self.allowed)
        return value

    def _bounded(self, kind: str) -> str:
        bounds = self.text(self.unit)
        return f"{kind}, {bounds}" if bounds else kind


@dataclass(frozen=True)
class Several(Checked):
    """A list of values, each as `each` says; `counts` of them are allowed."""

    each: Checked
    counts: tuple[int, ...]

    @property
    def allowed(self) -> str:
        words = " or ".join(("one", "two", "three")[count - 1] for count in self.counts)
        return f"a list of {words} values, each {self.each.allowed}"

    def parse(self, given: object) -> tuple[Any, ...]:
        if not isinstance(given, list) or len(given) not in self.counts:
            raise wrong("", given, self.allowed)
        return tuple(self.each.parse(value) for value in given)


@dataclass(frozen=True)
class Number(Checked):
    """A plain finite number."""

    @property
    def allowed(self) -> str:
        bounds = self.text()
        return f"a number without a unit, {bounds}" if bounds else "a finite number without a unit"

    def parse(self, given: object) -> float:
        if isinstance(given, bool) or not isinstance(given, int | float) or not self.hold(given):
            raise wrong("", given, self.allowed)
        return float(given)


@dataclass(frozen=True)
class Count(Checked):
    """A whole number."""

    @property
    def allowed(self) -> str:
        bounds = self.text()
        return f"a whole number, {bounds}" if bounds else "a whole number"

    def parse(self, given: object) -> int:
        if isinstance(given, bool) or not isinstance(given, int) or not self.hold(given):
            raise wrong("", given, self.allowed)
        return given


@dataclass(frozen=True)
class Names(Checked):
    """A list of whole numbers and texts."""

    @property
    def allowed(self) -> str:
        return "a list of numbers and names of electrodes"

    def parse(self, given: object) -> tuple[int | str, ...]:
        if not isinstance(given, list) or any(isinstance(g, bool) or not isinstance(g, int | str) for g in given):
            raise wrong("", given, self.allowed)
        return tuple(given)


Length = Annotated[float, Dimension("m", gt=0)]
Height = Annotated[float, Dimension("m", ge=0)]
Coordinate = Annotated[float, Dimension("m")]
Point = Annotated[tuple[float, float], Several(Dimension("m"), (2,))]
Position = Annotated[tuple[float, float, float], Several(Dimension("m"), (3,))]
Size = Annotated[tuple[float, float], Several(Dimension("m", gt=0), (2,))]
Sizes = Annotated[tuple[float, ...], Several(Dimension("m", gt=0), (2, 3))]
NameList = Annotated[tuple[int | str, ...], Names()]
Direction = Annotated[tuple[float, float, float], Several(Number(), (3,))]
Angle = Annotated[float, Dimension("rad")]
Time = Annotated[float, Dimension("s", gt=0)]
Density = Annotated[float, Dimension("kg/m^3", gt=0)]


def written(value: Any) -> Any:
    """A length or a list of lengths [m] as a scenario writes it, to the last digit; a text as it is."""
    if isinstance(value, tuple):
        return [written(part) for part in value]
    return value if isinstance(value, str) else f"{float(value)!r} m"


def check_multiples(values: Mapping[str, float], multiples: Mapping[str, str], unit: str = "s") -> None:
    """Check that of `values` [unit], by key, those named in `multiples` are whole multiples (1, 2, ...) of the value of
    the key that stands there; no key comes before the one that it is a multiple of.

    Who changes the first in such a chain learns at once what else has to follow it.
    """
    fitting = dict(values)
    for key, of in multiples.items():
        ratio = values[key] / fitting[of]
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6 * max(1.0, ratio):
            fitting[key] = max(1, round(ratio)) * fitting[of]
    changed = [key for key in multiples if fitting[key] != values[key]]
    if changed:
        first, of = changed[0], multiples[changed[0]]
        allowed = f"a whole multiple of {of} = {shown(values[of], unit)}"
        if len(changed) == 1:
            advice = f'"{shown(fitting[first], unit)}"'
        else:
            advice = "all of " + ", ".join(f'{key} = "{shown(fitting[key], unit)}"' for key in changed)
        raise wrong(first, shown(values[first], unit), allowed, advice)
