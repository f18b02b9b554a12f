"""Quantities with units: text such as "15 mm" at the edges, SI floats inside."""

from __future__ import annotations

import math
import re
from functools import cache, lru_cache
from typing import TYPE_CHECKING

from gelbot.errors import BadInput

if TYPE_CHECKING:
    from pint import UnitRegistry

KINDS = {
    "m": ("a length", "1 mm"),
    "s": ("a time", "1 s"),
    "rad": ("an angle", "45 deg"),
    "Pa": ("a pressure", "25 kPa"),
    "kg/m^3": ("a density", "1000 kg/m^3"),
    "m^2/A": ("an area per current", "0.02 cm^2/mA"),
    "S/m": ("a conductivity", "0.15 S/m"),
    "1/s": ("a rate", "20 1/s"),
    "V": ("a voltage", "10 V"),
    "A": ("a current", "200 mA"),
    "C": ("a charge", "20 C"),
    "A/m^2": ("a current density", "10 mA/cm^2"),
    "m/s": ("a speed", "1 mm/s"),
    "V/s": ("a voltage per time", "5 V/s"),
    "V/m": ("a voltage per length", "10 V/mm"),
    "V*s/m": ("a voltage per velocity", "0.5 V*s/mm"),
}
"""What a value in this SI unit is called, and how a user would write one."""

NUMBER = re.compile(r"\s*([+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|inf(?:inity)?(?!\w)|nan(?!\w)))", re.IGNORECASE)
# Powers of numbers are no units, and could keep the reader busy for ever.
NOT_A_UNIT = re.compile(r"\d\s*(?:\^|\*\*|[⁰¹²³⁴⁵⁶⁷⁸⁹])|(?:\^|\*\*)\s*\(|^.{60}")


def quantity(text: object, unit: str, where: str) -> float:
    """The value of `text`, a number followed by its unit, in the SI unit `unit`.

    Raises `BadInput`, found at `where`, when `text` is no string, has no unit or an unknown one, has another dimension
    than `unit`, or is not finite.
    """
    allowed = allowed_quantity(unit)
    example = KINDS.get(unit, ("", f"1 {unit}"))[1]
    if not isinstance(text, str):
        advice = f'a string with the unit, such as "{example}"' if isinstance(text, int | float) else ""
        raise BadInput(where, text, allowed, advice)
    match = NUMBER.match(text)
    if match is None:
        raise BadInput(where, text, allowed, "a number first, then the unit")
    value, written = float(match.group(1)), text[match.end() :].strip()
    if not written:
        raise BadInput(where, text, allowed, f'the number with its unit, such as "{example}"')
    if not math.isfinite(value):
        raise BadInput(where, text, f"{allowed}, and finite")
    try:
        if NOT_A_UNIT.search(written):
            raise ValueError(written)
        result = _converted(value, written, unit)
    except Exception as error:  # pint raises whatever its tokenizer, its arithmetic and its conversions raise
        raise BadInput(where, text, allowed) from error
    if not math.isfinite(result):
        raise BadInput(where, text, f"{allowed}, and finite")
    return result


@lru_cache(4096)
def _converted(value: float, written: str, unit: str) -> float:
    """`value` of the unit `written`, in `unit`: kept, since the robots of a study have nearly all values in common."""
    return float(registry().Quantity(value, registry().parse_units(written)).to(unit).magnitude)


def allowed_quantity(unit: str) -> str:
    """What a message says of a quantity in the SI unit `unit`: its kind, with an example."""
    kind, example = KINDS.get(unit, ("a quantity", f"1 {unit}"))
    return f'{kind} with its unit, such as "{example}"'


def shown(value: float, unit: str) -> str:
    """`value` in the SI unit `unit` as a user would read it: millimetres for lengths, degrees for angles."""
    scale, name = {"m": (1e3, "mm"), "rad": (180.0 / math.pi, "deg")}.get(unit, (1.0, unit))
    return f"{value * scale:.6g} {name}"


@cache
def registry() -> UnitRegistry[float]:
    """The one registry of units, made when it is first needed: it takes nearly half a second."""
    from pint import UnitRegistry

    return UnitRegistry()
