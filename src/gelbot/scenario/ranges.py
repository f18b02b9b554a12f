"""Values that are not one but many: what scatters in a study, what a search may choose. Written as text:

    1.7e-2 .. 2.3e-2 cm^2/mA    uniform between two values
    +-10 %                      uniform about the scenario's value, by a share of it; +-1 mm by so much
    normal 5 %                  normally distributed about it, with this standard deviation; or: normal 1 mm
    4 mm | 5 mm | 6 mm          one of these

A value that is a list, such as a position or a pattern, is varied in each of its numbers alone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gelbot.errors import NOTHING, BadInput
from gelbot.scenario.fields import Checked, wrong
from gelbot.units import registry

FORMS = '"1 mm .. 2 mm", "+-10 %", "+-1 mm", "normal 5 %", or "4 mm | 5 mm"'
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
BETWEEN = re.compile(rf"\s*({NUMBER})\s*([^.\d\s][^.]*?)?\s*\.\.\s*({NUMBER})\s*(.*?)\s*")
ABOUT = re.compile(rf"\s*(\+-|±|normal\s)\s*({NUMBER})\s*(.*?)\s*")
VALUE = re.compile(rf"\s*({NUMBER})\s*(.*?)\s*")
EDGE = 1e-9
"""Normal distributions are cut off where a sample in a thousand million lies beyond."""


@dataclass(frozen=True)
class Spread:
    """The values that the scenario's `key` may have; `text` is how they were written.

    `base`: what it is in the scenario, NOTHING where it is not there. `size`: how many numbers are varied.
    """

    key: str
    text: str
    base: Any

    @property
    def size(self) -> int:
        return len(_leaves(self.base)) if isinstance(self.base, list) and self._choices is None else 1

    @property
    def _choices(self) -> list[str] | None:
        return [part.strip() for part in self.text.split("|")] if "|" in self.text else None

    def value(self, shares: NDArray[np.float64]) -> Any:
        """The value as a scenario writes it, for `shares` in [0, 1], shape (size,): its place in the distribution."""
        choices = self._choices
        if choices is not None:
            return _plain(choices[min(int(shares[0] * len(choices)), len(choices) - 1)])
        parts = iter(shares)
        return _mapped(self.base, lambda leaf: self._one(leaf, float(next(parts))))

    def _one(self, leaf: Any, share: float) -> Any:
        between = BETWEEN.fullmatch(self.text)
        if between is not None:
            low, low_unit, high, unit = between.groups()
            least = _converted(float(low), low_unit or unit, unit, self.key)
            return _written(least + share * (float(high) - least), unit)
        about = ABOUT.fullmatch(self.text)
        assert about is not None  # checked when it was read
        kind, amount, unit = about.groups()
        number, base_unit = _parts(leaf, self.key)
        sigma = (
            abs(number) * float(amount) / 100.0 if unit == "%" else _converted(float(amount), unit, base_unit, self.key)
        )
        shift = ndtri(np.clip(share, EDGE, 1.0 - EDGE)) if kind.startswith("normal") else 2.0 * share - 1.0
        return _written(number + float(shift) * sigma, base_unit)

    def shares(self) -> NDArray[np.float64]:
        """Where the scenario's own value lies among those of a range LOW .. HIGH, shape (size,); else the middle."""
        between = BETWEEN.fullmatch(self.text)
        if between is None:
            return np.full(self.size, 0.5)
        low, low_unit, high, unit = between.groups()
        least = _converted(float(low), low_unit or unit, unit, self.key)
        places = []
        for leaf in _leaves(self.base):
            try:
                number, written = _parts(leaf, self.key)
                places.append((_converted(number, written, unit, self.key) - least) / (float(high) - least))
            except BadInput:
                places.append(0.5)
        return np.clip(np.array(places or [0.5]), 0.0, 1.0)


def spread(key: str, text: str, data: Mapping[str, Any], where: str = "") -> Spread:
    """The values `text` of the dotted `key` of a scenario's `data` (parsed TOML). Raises `BadInput` about `where`."""
    found = _at(data, key)
    made = Spread(key, check_form(text, where or key), found)
    if "|" not in text and BETWEEN.fullmatch(text) is None and found is NOTHING:
        raise BadInput(where or key, text, "a range about a value, and the scenario has none there", "LOW .. HIGH")
    made.value(np.full(made.size, 0.5))  # says what does not fit together
    return made


def named(given: str) -> tuple[str, str] | None:
    """Key and range of an option written KEY=RANGE, the range perhaps in quotes; None where it has no key."""
    key, equals, text = given.partition("=")
    return (key.strip(), text.strip().strip("\"'")) if equals and key.strip() else None


def overridden(
    own: Mapping[str, str], where: str, option: str, given: Sequence[str], example: str
) -> dict[str, tuple[str, str]]:
    """The range of each key and where it stands: a scenario's `own`, at `where`, with the options `given` in its place
    or beside it. A range that is `fixed` takes a key out. Raises `BadInput` for an option without a key."""
    texts = {key: (text, f"{where}.{key}") for key, text in own.items()}
    for one in given:
        read = named(one)
        if read is None:
            raise BadInput(option, one, f"key=range, such as {example}")
        key, text = read
        if text == "fixed":
            texts.pop(key, None)
        else:
            texts[key] = (text, f"{option} {key}")
    return texts


def check_form(text: object, where: str) -> str:
    """`text` when it is one of the forms above; raises `BadInput` otherwise."""
    if isinstance(text, str):
        choices = [part.strip() for part in text.split("|")]
        if len(choices) > 1 and all(choices):
            return text
        between = BETWEEN.fullmatch(text)
        about = ABOUT.fullmatch(text)
        if between is not None:
            low, high = float(between[1]), float(between[3])
            has_unit = between[4] or not between[2]  # the first value's unit is no unit of the second
            if has_unit and math.isfinite(low) and math.isfinite(high) and low != high:
                return text
        elif about is not None and math.isfinite(float(about[2])):
            return text
    raise BadInput(where, text, f"a range of values: {FORMS}")


class ScatterField(Checked):
    """A table of keys of the scenario, each with its range of values; read flat, with dotted keys."""

    @property
    def allowed(self) -> str:
        return f"a table of keys of the scenario, each with a range of values: {FORMS}"

    def parse(self, given: object) -> dict[str, str]:
        if not isinstance(given, dict):
            raise wrong("", given, self.allowed)
        return _flat(given)


def _flat(table: dict[str, Any], above: str = "") -> dict[str, str]:
    """The ranges of a table and those below it, by their dotted keys."""
    flat: dict[str, str] = {}
    for name, value in table.items():
        key = above + name
        if isinstance(value, dict):
            flat |= _flat(value, f"{key}.")
            continue
        try:
            flat[key] = check_form(value, key)
        except BadInput as error:
            raise wrong(error.where, error.given, error.allowed) from error
    return flat


Scatter = Annotated[dict[str, str], ScatterField()]


def _at(data: Any, key: str) -> Any:
    for part in key.split("."):
        if isinstance(data, Mapping) and part in data:
            data = data[part]
        elif isinstance(data, list) and part.isascii() and part.isdigit() and int(part) < len(data):
            data = data[int(part)]
        else:
            return NOTHING
    return data


def _leaves(value: Any) -> list[Any]:
    return [leaf for part in value for leaf in _leaves(part)] if isinstance(value, list) else [value]


def _mapped(value: Any, change: Any) -> Any:
    return [_mapped(part, change) for part in value] if isinstance(value, list) else change(value)


def _parts(leaf: Any, key: str) -> tuple[float, str]:
    """Number and unit of a value of the scenario."""
    if isinstance(leaf, int | float) and not isinstance(leaf, bool):
        return float(leaf), ""
    match = VALUE.fullmatch(leaf) if isinstance(leaf, str) else None
    if match is None:
        raise BadInput(key, leaf, "a number, with a unit or without, that can be varied")
    return float(match[1]), match[2]


def _converted(number: float, unit: str, to: str, key: str) -> float:
    if unit == to:
        return number
    try:
        return float(registry().Quantity(number, unit or "1").to(to or "1").magnitude)
    except Exception as error:  # whatever pint raises
        raise BadInput(
            key, f"{number:g} {unit}".strip(), f"a value in a unit like that of the scenario, {to or 'none'}"
        ) from error


def _written(number: float, unit: str) -> Any:
    # So many digits are plenty, and can be read.
    return f"{number:.7g} {unit}" if unit else float(f"{number:.7g}")


def _plain(text: str) -> Any:
    """A choice as a scenario writes it: a number without a unit is a number."""
    try:
        return float(text) if not re.fullmatch(r"[+-]?\d+", text) else int(text)
    except ValueError:
        return text
