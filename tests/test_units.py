"""Quantities: the same length in any unit is one number, and what is no quantity is refused with a message."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.errors import BadInput
from gelbot.units import KINDS, quantity, registry, shown

FINITE = st.floats(min_value=-1e12, max_value=1e12, allow_subnormal=False)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("15 mm", "m", 0.015),
        ("15mm", "m", 0.015),
        (" 1.5e1 mm ", "m", 0.015),
        ("-.5 cm", "m", -0.005),
        ("0.02 cm^2/mA", "m^2/A", 2e-3),
        ("0.02 cm**2/mA", "m^2/A", 2e-3),
        ("25 kPa", "Pa", 25e3),
        ("10 V/mm", "V/m", 1e4),
        ("0.5 V*s/mm", "V*s/m", 500.0),
        ("20 1/s", "1/s", 20.0),
        ("1 kg/m^3", "kg/m^3", 1.0),
        ("225 deg", "rad", 1.25 * math.pi),
        ("1 rad", "rad", 1.0),
        ("100 ms", "s", 0.1),
        ("1.5 mS/cm", "S/m", 0.15),
    ],
)
def test_reads_values_as_si(text: str, unit: str, value: float):
    assert quantity(text, unit, "key") == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("unit", KINDS)
def test_examples_in_messages_can_be_read(unit: str):
    assert math.isfinite(quantity(KINDS[unit][1], unit, "key"))


@given(FINITE)
def test_a_length_is_the_same_in_any_unit(value: float):
    metres = quantity(f"{value!r} m", "m", "key")
    assert metres == value
    assert quantity(f"{value!r} mm", "m", "key") == pytest.approx(value * 1e-3, rel=1e-12, abs=1e-300)
    assert quantity(f"{value!r} km", "m", "key") == pytest.approx(value * 1e3, rel=1e-12)


@given(FINITE.filter(lambda value: abs(value) > 1e-9), st.sampled_from(["m", "rad", "V", "s"]))
def test_what_is_shown_reads_as_what_it_was(value: float, unit: str):
    assert quantity(shown(value, unit), unit, "key") == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        *(15, 15.0, True, None, [], {}),
        *("", "15", "mm", "15 s", "15 parsec*", "1 mm + 2 mm", "1,5 mm", "2 * 3 mm", "15 nothing"),
        *("nan mm", "inf mm", "-inf mm", "NaN mm", "1e999 mm", "1e308 Gm"),
        *("1 9**9**9**9 mm", "1 m^(9^9)", "1 2²²²²²²²²²m", "1 mm; import os", "1 " + "m" * 100),
        *("1 mm^2", "1 degC", "1 dB", "1 %"),
    ],
)
def test_refuses_what_is_no_length(text: object):
    with pytest.raises(BadInput) as refused:
        quantity(text, "m", "body.thickness")
    assert refused.value.where == "body.thickness"
    assert refused.value.given is text
    assert "a length with its unit" in refused.value.allowed


@given(st.text(max_size=30))
def test_any_text_is_a_number_or_refused(text: str):
    try:
        value = quantity(text, "m", "key")
    except BadInput:
        return
    assert math.isfinite(value)


def test_a_number_without_a_unit_is_told_how_to_write_it():
    with pytest.raises(BadInput, match='such as "1 mm"'):
        quantity("15", "m", "key")


def test_there_is_one_registry():
    assert registry() is registry()
