"""Ranges of values: what scatters, what may be chosen.

| identity | one road | the other |
|---|---|---|
| uniform | `value` at a share | the straight line between both ends |
| normal | `value` at a share | the quantile of `scipy.stats.norm` |
| units | a range in one unit | the same range in another |
| `shares` | where the scenario's own value lies | the share whose value it is |
| lists | each number of a list | the same number alone |
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from gelbot.errors import NOTHING, BadInput
from gelbot.scenario import load
from gelbot.scenario.ranges import Spread, check_form, spread
from gelbot.units import quantity

DATA: dict[str, Any] = {
    "material": {"p_ele": "0.02 cm^2/mA", "p_l": 0.77, "young_modulus": "50 kPa", "model": "lattice"},
    "body": {"thickness": "1 mm", "layers": 2, "pose": {"position": ["12.5 mm", "-3 mm"], "heading": "225 deg"}},
    "programme": {
        "phases": [
            {"drive": "10 V", "pattern": [[0.5, -1, 0, 1]] * 4},
            {"drive": [["0 s", "1 V"], ["2 s", "3 V"]]},
        ]
    },
}
shares = st.floats(0.0, 1.0)
DIGITS = 1e-6
"""Values are written with seven digits."""


def read(key: str, text: str) -> Spread:
    return spread(key, text, DATA)


def value(key: str, text: str, *at: float) -> Any:
    return read(key, text).value(np.array(at))


class TestUniform:
    @given(shares)
    def test_between_two_values(self, share: float) -> None:
        found = value("material.p_ele", "1.7e-2 .. 2.3e-2 cm^2/mA", share)
        assert found.endswith(" cm^2/mA")
        assert quantity(found, "m^2/A", "") == pytest.approx(1e-4 * 1e3 * (0.017 + 0.006 * share), rel=DIGITS)

    @pytest.mark.parametrize(
        "text", ["0.9 mm .. 1.1 mm", "0.9 .. 1.1 mm", "900 um .. 1.1 mm", ".9mm..1.1mm", "  9e-1   mm ..+1.1 mm "]
    )
    def test_a_unit_may_stand_once_or_differ(self, text: str) -> None:
        ends = [quantity(value("body.thickness", text, share), "m", "") for share in (0.0, 0.5, 1.0)]
        assert ends == pytest.approx([0.9e-3, 1e-3, 1.1e-3], rel=1e-12)

    @given(shares, st.floats(-50, 50), st.floats(-50, 50))
    def test_numbers_without_unit(self, share: float, low: float, high: float) -> None:
        if low != high:
            found = value("material.p_l", f"{low!r} .. {high!r}", share)
            assert found == pytest.approx(low + share * (high - low), rel=DIGITS, abs=1e-12)
            assert isinstance(found, float)

    @given(shares, st.floats(0.1, 90.0))
    def test_about_the_scenario_s_value_by_a_share(self, share: float, percent: float) -> None:
        found = quantity(value("material.young_modulus", f"+-{percent!r} %", share), "Pa", "")
        assert found == pytest.approx(50e3 * (1.0 + (2.0 * share - 1.0) * percent / 100.0), rel=DIGITS)

    def test_about_a_negative_value_low_shares_are_still_low(self) -> None:
        assert value("body.pose.position.1", "+-10 %", 0.0) == "-3.3 mm"

    @pytest.mark.parametrize("text", ["+-1 mm", "±1 mm", "+-1000 um", "+- 0.1 cm", "+-1e-3 m"])
    def test_about_it_by_so_much_in_any_unit(self, text: str) -> None:
        found = [quantity(value("body.pose.position.0", text, share), "m", "") for share in (0.0, 0.25, 0.5, 1.0)]
        assert found == pytest.approx([11.5e-3, 12e-3, 12.5e-3, 13.5e-3], rel=1e-12)
        assert value("body.pose.position.0", text, 1.0).endswith(" mm")  # the scenario's own unit

    def test_degrees_and_radians(self) -> None:
        found = [
            quantity(value("body.pose.heading", text, 1.0), "rad", "")
            for text in ("+-10 deg", f"+-{math.radians(10.0)!r} rad")
        ]
        assert found == pytest.approx([np.radians(235.0)] * 2)

    def test_a_plain_number_is_varied_by_a_plain_number(self) -> None:
        assert value("material.p_l", "+-0.1", 1.0) == pytest.approx(0.87)


class TestNormal:
    @given(st.floats(1e-8, 1.0 - 1e-8))
    def test_quantiles(self, share: float) -> None:
        found = quantity(value("material.young_modulus", "normal 5 %", share), "Pa", "")
        assert found == pytest.approx(norm.ppf(share, 50e3, 2.5e3), rel=DIGITS)
        found = quantity(value("body.thickness", "normal 0.05 mm", share), "m", "")
        assert found == pytest.approx(norm.ppf(share, 1e-3, 0.05e-3), rel=DIGITS)

    def test_the_ends_are_finite(self) -> None:
        low, high = (value("material.p_l", "normal 1 %", share) for share in (0.0, 1.0))
        assert [low, high] == pytest.approx(norm.ppf([1e-9, 1.0 - 1e-9], 0.77, 0.0077), rel=1e-6)

    def test_many_have_this_mean_and_deviation(self, rng: np.random.Generator) -> None:
        one = read("material.p_l", "normal 2 %")
        found = np.array([one.value(rng.uniform(size=1)) for _ in range(4000)])
        assert found.mean() == pytest.approx(0.77, abs=4.0 * 0.0154 / 4000**0.5)
        assert found.std() == pytest.approx(0.0154, rel=0.05)


class TestChoices:
    @given(shares)
    def test_each_has_an_equal_part(self, share: float) -> None:
        assert value("body.thickness", "4 mm | 5 mm |6 mm", share) == f"{4 + min(int(3 * share), 2)} mm"

    def test_they_are_numbers_where_they_have_no_unit(self) -> None:
        found = [value("body.layers", "2 | 3", share) for share in (0.0, 0.99)]
        assert found == [2, 3]
        assert all(isinstance(one, int) for one in found)
        assert value("material.p_l", "0.5 | -1e-1", 1.0) == -0.1

    def test_words_may_be_chosen_and_a_key_need_not_be_there(self) -> None:
        assert value("material.model", "lattice | solid", 0.7) == "solid"
        assert value("material.conductivity", "0.1 S/m | 0.2 S/m", 0.2) == "0.1 S/m"

    def test_a_list_is_chosen_as_a_whole(self) -> None:
        one = read("programme.phases.0.pattern", "ridge | crossed-ridge")
        assert one.size == 1
        assert one.value(np.array([0.9])) == "crossed-ridge"


class TestLists:
    def test_each_number_is_varied_alone(self) -> None:
        one = read("body.pose.position", "+-1 mm")
        assert one.size == 2
        assert one.value(np.array([0.0, 1.0])) == ["11.5 mm", "-2 mm"]

    @given(st.lists(shares, min_size=16, max_size=16))
    def test_a_pattern_keeps_its_rows(self, at: list[float]) -> None:
        one = read("programme.phases.0.pattern", "-1 .. 1")
        assert one.size == 16
        found = one.value(np.array(at))
        assert [len(row) for row in found] == [4, 4, 4, 4]
        assert np.ravel(found) == pytest.approx(2.0 * np.array(at) - 1.0, abs=DIGITS)
        single = [value("programme.phases.0.pattern.0.1", "-1 .. 1", share) for share in at]
        assert list(np.ravel(found)) == single

    def test_a_list_of_pairs_has_times_and_voltages(self) -> None:
        one = read("programme.phases.1.drive", "+-10 %")
        assert one.size == 4
        assert one.value(np.array([0.5, 0.5, 1.0, 0.0])) == [["0 s", "1 V"], ["2.2 s", "2.7 V"]]

    def test_a_number_in_a_list_has_a_key(self) -> None:
        assert value("programme.phases.0.drive", "2 V .. 10 V", 0.25) == "4 V"
        assert read("programme.phases.²", "1 .. 2").base is NOTHING
        assert read("programme.phases.7.drive", "1 V .. 2 V").base is NOTHING


class TestShares:
    @given(st.lists(shares, min_size=2, max_size=2))
    def test_they_are_the_inverse_of_value(self, at: list[float]) -> None:
        text = "-20 mm .. 3 cm"
        data = {"place": spread("place", text, {"place": ["1 mm", "1 mm"]}).value(np.array(at))}
        assert spread("place", text, data).shares() == pytest.approx(at, abs=DIGITS)

    def test_they_are_cut_off_at_the_ends(self) -> None:
        assert read("material.p_l", "0.1 .. 0.5").shares() == pytest.approx([1.0])
        assert read("material.p_l", "0.8 .. 0.9").shares() == pytest.approx([0.0])

    @pytest.mark.parametrize(
        ("key", "text"),
        [
            ("material.p_l", "+-10 %"),
            ("material.p_l", "0.7 | 0.8"),
            ("material.nothing", "1 .. 2"),
            ("material.model", "1 .. 2"),
            ("body.thickness", "1 s .. 2 s"),
        ],
    )
    def test_they_are_the_middle_where_the_scenario_s_value_has_no_place(self, key: str, text: str) -> None:
        assert read(key, text).shares() == pytest.approx([0.5])


@pytest.mark.parametrize(
    "text",
    [
        *("", " ", "1", "1 mm", "1 mm ..", ".. 1 mm", "1 mm .. 1 mm", "a .. b", "1 mm | ", "| 1 mm", "a || b"),
        *("+-", "+- %", "+-x %", "normal", "normal5 %", "normal x", "10 %", "inf .. 1", "nan .. 1"),
        *("1e999 .. 2", "2 .. 1e999", "+-1e999 mm", "normal 1e999 %", 3, 0.5, None, True, ["1 .. 2"]),
    ],
)  # fmt: skip
def test_what_is_no_range_is_refused_with_its_forms(text: object) -> None:
    with pytest.raises(BadInput, match=re.escape('"1 mm .. 2 mm", "+-10 %"')) as refused:
        check_form(text, "here")
    assert str(refused.value).startswith(f"here: got {text!r}; allowed: a range of values")


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("material.nothing", "+-10 %", "a range about a value, and the scenario has none there. Try: LOW .. HIGH"),
        ("material.nothing", "normal 1 mm", "the scenario has none there"),
        ("material.model", "+-10 %", "got 'lattice'; allowed: a number, with a unit or without, that can be varied"),
        ("body.pose", "+-10 %", "a number, with a unit or without"),
        ("body.thickness", "+-1 s", "got '1 s'; allowed: a value in a unit like that of the scenario, mm"),
        ("body.thickness", "normal 1 nonsense", "got '1 nonsense'; allowed: a value in a unit like"),
        ("body.thickness", "+-1", "a value in a unit like that of the scenario, mm"),
        ("material.p_l", "+-1 mm", "a value in a unit like that of the scenario, none"),
        ("body.thickness", "1 mm .. 2", "got '1 mm .. 2'; allowed: a range of values"),
        ("body.thickness", "1 s .. 2 mm", "got '1 s'; allowed: a value in a unit like that of the scenario, mm"),
    ],
)
def test_what_does_not_fit_the_scenario_is_said(key: str, text: str, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        spread(key, text, DATA, "--vary " + key)


@given(st.text("0123456789.+-±e %|normal m", max_size=16))
def test_any_text_is_a_range_or_refused(text: str) -> None:
    try:
        one = spread("body.thickness", text, DATA)
    except BadInput:
        return
    for share in (0.0, 0.3, 1.0):
        assert one.value(np.full(one.size, share)) is not None


SCATTERED = """
[scatter]
material.p_ele = "1.7e-2 .. 2.3e-2 cm^2/mA"
"material.p_l" = "+-10 %"
body.pose.position = "+-1 mm"
programme.phases.0.drive = "2 V | 3 V"
[scatter.tank]
friction = "normal 10 %"
"""


def scatter_of(tmp_path: Path, table: str) -> dict[str, str]:
    from gelbot.scenario import built_in_text

    file = tmp_path / "mine.toml"
    file.write_text(built_in_text("dome") + table, encoding="utf-8")
    return load(str(file)).scenario.scatter


def test_the_table_scatter_is_read_flat_however_it_is_written(tmp_path: Path) -> None:
    assert scatter_of(tmp_path, SCATTERED) == {
        "material.p_ele": "1.7e-2 .. 2.3e-2 cm^2/mA",
        "material.p_l": "+-10 %",
        "body.pose.position": "+-1 mm",
        "programme.phases.0.drive": "2 V | 3 V",
        "tank.friction": "normal 10 %",
    }
    assert load("dome").scenario.scatter == {}


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (
            '[scatter]\nmaterial.p_l = "10 %"\n',
            "mine.toml: scatter.material.p_l: got '10 %'; allowed: a range of values",
        ),
        ("[scatter]\nmaterial.p_l = 0.1\n", "scatter.material.p_l: got 0.1; allowed: a range of values"),
        ('[scatter]\nbody.pose.position = ["+-1 mm", "+-2 mm"]\n', "scatter.body.pose.position: got"),
    ],
)
def test_mistakes_in_the_table_scatter_are_explained(tmp_path: Path, table: str, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        scatter_of(tmp_path, table)


def test_it_is_a_table() -> None:
    with pytest.raises(BadInput, match=re.escape("dome: search (with --set): got 3; allowed: a table of keys")):
        load("dome", ["search=3"])
