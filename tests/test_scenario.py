"""Scenarios: what comes with gelbot is sound, text and scenario say the same, and each kind of mistake is explained."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from gelbot.control.programme import ALONG, ANGLE, HEIGHTS, NORMAL, Programme
from gelbot.errors import BadInput
from gelbot.field.charge import build_problem, solve
from gelbot.plan.templates import template
from gelbot.scenario import built_in_text, description, load, names
from gelbot.scenario.build import field_tank
from gelbot.scenario.overrides import with_overrides
from gelbot.scenario.programme_arrays import build_patterns, build_phases, build_programme

REST = 'thickness="1 mm", mesh_size="1 mm", layers=2, pose={position=["0 mm","0 mm"], heading="0 deg", lift="0 mm"}'
BOW_TIE = (
    'body={shape="outline", points=[["0 mm","0 mm"],["9 mm","9 mm"],["9 mm","0 mm"],["0 mm","9 mm"]], ' + REST + "}"
)
NO_OUTLINE = f'body={{shape="outline", {REST}}}'
FROM_SVG = 'body={shape="outline", svg="%s.svg", width="8 mm", ' + REST + "}"
SQUARE_SVG = '<svg xmlns="http://www.w3.org/2000/svg"><path d="M0 0 L10 0 L10 10 L0 10 Z"/></svg>'

OBSTACLE = 'obstacles=[{shape="%s", position=["0 mm", "0 mm", "9 mm"], %s}]'

WAYPOINTS = "programme.reference={waypoints=[%s]}"
TWICE = (
    'programme.phases=[{name="up", pattern="ridge", drive="1 V", until={height="1 mm", then="up"}}, '
    '{name="up", pattern="ridge", drive="1 V"}]'
)

# The change, the key that the message names, the value given, a part of what is allowed.
MISTAKES = [
    ("body.thicknes=1 mm", "body.thicknes", "'1 mm'", "keys thickness"),
    ("nonsense=1", "nonsense", "1", "keys name"),
    ("body.pose.tilt=1 deg", "body.pose.tilt", "'1 deg'", "keys position, heading, lift"),
    ("programme.phases.1.until.hight=1 mm", "programme.phases.1.until.hight", "'1 mm'", "keys height"),
    ("body.thickness=1", "body.thickness", "1", 'such as "1 mm"'),
    ('body.thickness="1"', "body.thickness", "'1'", 'such as "1 mm"'),
    ("body.thickness=1 s", "body.thickness", "'1 s'", "a length"),
    ("body.thickness=0 mm", "body.thickness", "'0 mm'", "greater than 0"),
    ("body.thickness=-1 mm", "body.thickness", "'-1 mm'", "greater than 0"),
    ("body.thickness=nan mm", "body.thickness", "'nan mm'", "finite"),
    ("body.thickness=nan", "body.thickness", "nan", "a length"),
    ("body.pose.lift=-1 mm", "body.pose.lift", "'-1 mm'", "at least 0"),
    ("body.pose.heading=1 m", "body.pose.heading", "'1 m'", "an angle"),
    ("body.pose.position=1 mm", "body.pose.position", "'1 mm'", "a list of two values"),
    ("body.layers=1", "body.layers", "1", "at least 2"),
    ("body.layers=2.5", "body.layers", "2.5", "a whole number"),
    ("body.shape=circle", "body.shape", "'circle'", "starfish, strip, outline"),
    ("material.model=jelly", "material.model", "'jelly'", "'lattice' or 'solid'"),
    (OBSTACLE % ("pyramid", "size=1"), "obstacles.0.shape", "'pyramid'", "sphere, cylinder, box, plane"),
    (OBSTACLE % ("box", 'size=["4 mm"]'), "obstacles.0.size", "['4 mm']", "a list of three values"),
    (OBSTACLE % ("plane", "normal=[0, 0, 0]"), "obstacles.0.normal", "[0.0, 0.0, 0.0]", "not all zero"),
    ("body.mesh_size=1 um", "body.mesh_size", "'0.001 mm'", "at least"),
    ("body.arm_length=9 mm", "body.arm_length", "'9 mm'", "less than"),
    ("body.root_width=6 mm", "body.root_width", "'6 mm'", "where neighbouring arms meet"),
    (BOW_TIE, "body.points", "Self-intersection", "does not cross itself"),
    (NO_OUTLINE, "body.points", "neither", "one of points and svg"),
    (FROM_SVG % "none", "body.svg", "none.svg", "a readable SVG file"),
    ("body.pose.position.0=65 mm", "body.pose.position", "65 mm", "the array's reach"),
    ("material.p_l=1", "material.p_l", "1", "less than 1"),
    ("material.p_l=nan", "material.p_l", "nan", "less than 1"),
    ("material.p_ads=0", "material.p_ads", "0", "greater than 0 and at most 1"),
    ("material.p_ele=0.02 mA/cm^2", "material.p_ele", "'0.02 mA/cm^2'", "an area per current"),
    ("electrodes.rows=0", "electrodes.rows", "0", "at least 1"),
    ("electrodes.gap=0.8 mm", "electrodes.gap", "'0.8 mm'", "more than body.thickness"),
    ("electrodes.panels=50", "electrodes.panels", "50", "at most 20000"),
    ("tank.depth=14 mm", "tank.depth", "'14 mm'", "at least 15 mm: electrode 0 reaches to z = 15 mm"),
    ("tank.floor_depth=-1 mm", "tank.floor_depth", "'-1 mm'", "at least 0"),
    ('tank.size=["80 mm", "150 mm"]', "tank.size", "80 mm", "at least 85 mm"),
    ('tank.open=["+x"]', "tank.open", "'+x'", "without size it has none there"),
    ('tank.open=["lid"]', "tank.open", "'lid'", "'floor', 'surface'"),
    ("tank.friction=-0.1", "tank.friction", "-0.1", "at least 0"),
    ("supply.limit=0 V", "supply.limit", "'0 V'", "greater than 0"),
    ("supply.current_limit=0 A", "supply.current_limit", "'0 A'", "greater than 0"),
    ("material.conductivity=0 S/m", "material.conductivity", "'0 S/m'", "greater than 0"),
    ("electrodes.pitch=25 mm", "electrodes.pitch", "'25 mm'", "one of space and pitch"),
    (f"programme.phases.0.pattern={[1] * 17}", "programme.phases.0.pattern", "17 voltages", "16 voltages"),
    (f"programme.phases.0.pattern={[[1] * 8] * 2}", "programme.phases.0.pattern", "2 rows", "4 rows of 4"),
    (f"programme.phases.0.pattern={[1.5] * 16}", "programme.phases.0.pattern", "1.5", "at most 1"),
    ("programme.phases.0.pattern=rigde", "programme.phases.0.pattern", "'rigde'", "Try: ridge"),
    ("programme.phases.1.drive=11 V", "programme.phases.1.drive", "'11 V'", "supply.limit"),
    ("programme.phases.1.drive=full", "programme.phases.1.drive", "'full'", '"servo"'),
    ("programme.phases.2.until.after=3 s", "programme.phases.2.until", "a table", "goes on to the end of the run"),
    ("programme.phases.0.until={}", "programme.phases.0.until", "{}", "at least one of height"),
    ("programme.phases=[]", "programme.phases", "[]", "not empty"),
    ("programme.servo.sign=plus", "programme.servo.sign", "'plus'", "'corrected' or 'printed'"),
    ('programme.place=["1 mm"]', "programme.place", "['1 mm']", "a list of two values"),
    ("programme.turn=1 mm", "programme.turn", "'1 mm'", "an angle"),
    ("programme.reference.point=tip 0", "programme.reference.point", "'tip 0'", '"centre", or "tip 1"'),
    ("programme.reference.point=1", "programme.reference.point", "1", '"centre", or "tip 1"'),
    ("programme.reference.axis=w", "programme.reference.axis", "'w'", '"x", "y", "z", or an angle'),
    ("programme.reference.speed_limit=0 mm/s", "programme.reference.speed_limit", "'0 mm/s'", "greater than 0"),
    ("programme.reference.speed_limit=1 mm", "programme.reference.speed_limit", "'1 mm'", "a speed"),
    ("programme.reference.waypoints=3", "programme.reference.waypoints", "3", "a list of two or more pairs"),
    (WAYPOINTS % '["0 s", "0 mm"]', "programme.reference.waypoints", "[['0 s', '0 mm']]", "two or more pairs"),
    (WAYPOINTS % '["0 s"], ["1 s", "1 mm"]', "programme.reference.waypoints", "['0 s']", "pairs [time, m]"),
    (WAYPOINTS % '["0 s", "0 V"], ["1 s", "1 mm"]', "programme.reference.waypoints", "'0 V'", "a length"),
    (WAYPOINTS % '["0 m", "0 mm"], ["1 s", "1 mm"]', "programme.reference.waypoints", "'0 m'", "a time"),
    (WAYPOINTS % '["1 s", "0 mm"], ["1 s", "1 mm"]', "programme.reference.waypoints", "[['1 s'", "times growing"),
    (WAYPOINTS % '["-1 s", "0 mm"], ["1 s", "1 mm"]', "programme.reference.waypoints", "[['-1 s'", "times growing"),
    (
        'programme.reference.waypoints=[["0 s", "1 mm"], ["1 s", "2 mm"]]',
        "programme.reference.height",
        "'a value beside waypoints'",
        "only a rise to one height, without waypoints",
    ),
    ('programme.reference={height="6 mm"}', "programme.reference.duration", "nothing", "unless there are waypoints"),
    ('programme.reference={duration="6 s"}', "programme.reference.height", "nothing", "unless there are waypoints"),
    ("programme.servo.slew=0 V/s", "programme.servo.slew", "'0 V/s'", "greater than 0"),
    ("programme.servo.slew=5 V", "programme.servo.slew", "'5 V'", "a voltage per time"),
    ("programme.servo.filter=-1 s", "programme.servo.filter", "'-1 s'", "at least 0"),
    ("programme.phases.1.hold=1 mm", "programme.phases.1.hold", "'1 mm'", 'only with drive = "servo"'),
    ('programme.phases.1.drive=[["0 s", "1 V"]]', "programme.phases.1.drive", "[['0 s', '1 V']]", "two or more pairs"),
    ('programme.phases.1.drive=[["0 s", "1 mm"], ["1 s", "1 V"]]', "programme.phases.1.drive", "'1 mm'", "a voltage"),
    ('programme.phases.1.drive=[["2 s", "1 V"], ["1 s", "1 V"]]', "programme.phases.1.drive", "[['2 s'", "growing"),
    (
        'programme.phases.1.drive=[["0 s", "1 V"], ["1 s", "-11 V"]]',
        "programme.phases.1.drive",
        "'-11 V'",
        "supply.limit",
    ),
    ("programme.phases.0.pattern={}", "programme.phases.0.pattern", "{}", "a table of templates with their weights"),
    ("programme.phases.0.pattern={rigde=1}", "programme.phases.0.pattern", "'rigde'", "Try: ridge"),
    ("programme.phases.0.pattern={ridge=11}", "programme.phases.0.pattern", "11", "at most 10"),
    ('programme.phases.0.pattern={ridge="1 V"}', "programme.phases.0.pattern", "'1 V'", "a number without a unit"),
    ("programme.phases.0.until.contact=[]", "programme.phases.0.until.contact", "[]", "or a list of them"),
    (
        'programme.phases.0.until.lifted=["tip 1", "arm 2"]',
        "programme.phases.0.until.lifted",
        "'arm 2'",
        "essential point",
    ),
    ("programme.phases.0.until.normal_above=1.1", "programme.phases.0.until.normal_above", "1.1", "at most 1"),
    ("programme.phases.0.until.height_below=1", "programme.phases.0.until.height_below", "1", "a length"),
    ("programme.phases.0.until.then=transitoin", "programme.phases.0.until.then", "'transitoin'", "Try: transition"),
    ("programme.phases.0.until.otherwise=off", "programme.phases.0.until.otherwise", "'off'", "the name of one phase"),
    (
        'programme.phases.0.until={after="1 s", then="rest"}',
        "programme.phases.0.until.then",
        "'rest'",
        "only with an event",
    ),
    (
        'programme.phases.0.until={height="1 mm", otherwise="rest"}',
        "programme.phases.0.until.otherwise",
        "'rest'",
        "only with after",
    ),
    (
        'programme.phases.0.until={then="rest"}',
        "programme.phases.0.until",
        "{'then': 'rest'}",
        "at least one of height",
    ),
    (
        'programme.phases.2.until={height="1 mm", after="1 s", then="rest"}',
        "programme.phases.2.until",
        "a table",
        "the phase that follows as otherwise",
    ),
    (
        'programme.phases.2.until={height="1 mm"}',
        "programme.phases.2.until",
        "a table",
        "the phase that follows as then",
    ),
    (TWICE, "programme.phases.0.until.then", "'up'", "the name of one phase: up, up"),
    ("programme.phases.0.until=1", "programme.phases.0.until", "1", "a table"),
    ("simulation.time_step=30 ms", "programme.control_period", "'0.1 s'", "whole multiple of simulation.time_step"),
    ("recording.interval=150 ms", "recording.interval", "'0.15 s'", "whole multiple of programme.control_period"),
    ("recording.chunk=250 ms", "recording.chunk", "'0.25 s'", "whole multiple of recording.interval"),
    ("simulation.duration=0.05 s", "simulation.duration", "'0.05 s'", "whole multiple of recording.interval"),
    ("simulation.precision=float16", "simulation.precision", "'float16'", "'float64' or 'float32'"),
    ("name=../elsewhere", "name", "'../elsewhere'", "letters"),
    ("supply=10", "supply", "10", "a table"),
]


def test_what_must_follow_a_changed_period_is_told_at_once():
    with pytest.raises(
        BadInput, match=r"recording\.interval.*whole multiple of programme\.control_period = 3 s"
    ) as refused:
        load("turn-over", ["programme.control_period=3 s"])
    followed = dict(re.findall(r'([a-z_.]+) = "([^"]+)"', refused.value.advice))
    assert list(followed) == ["recording.interval", "recording.chunk", "simulation.duration"]
    load("turn-over", ["programme.control_period=3 s", *(f"{key}={value}" for key, value in followed.items())])


def with_body_in_tank(x: str) -> list[str]:
    return ['tank.size=["90 mm", "90 mm"]', f"body.pose.position.0={x}"]


@pytest.mark.parametrize(("change", "key", "given", "allowed"), MISTAKES)
def test_a_mistake_is_explained_in_terms_of_the_file(tmp_path: Path, change: str, key: str, given: str, allowed: str):
    file = tmp_path / "mine.toml"
    file.write_text(with_overrides(built_in_text("turn-over"), [change]), encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        load(str(file))
    assert refused.value.where in (f"{file}: {key}", f"{file}: {key}.0")
    assert f"got {given}" in str(refused.value) or given in repr(refused.value.given)
    assert allowed in str(refused.value)


def test_boundaries_that_are_open_do_not_insulate():
    size = 'tank.size=["130 mm", "130 mm"]'
    closed = field_tank(load("turn-over", [size]).scenario)
    assert closed.planes == ((-0.065, 0.065), (-0.065, 0.065), (-1e-3, 30e-3))
    opened = field_tank(load("turn-over", [size, 'tank.open=["floor", "-x", "+y"]']).scenario)
    assert opened.planes == ((None, 0.065), (-0.065, None), (None, 30e-3))


def test_a_body_through_the_wall_of_the_tank_is_refused():
    load("turn-over", with_body_in_tank("37 mm"))
    with pytest.raises(BadInput, match="inside the tank"):
        load("turn-over", with_body_in_tank("38 mm"))


def test_plates_may_lie_in_the_surface():
    assert load("turn-over", ["tank.depth=15 mm"]).scenario.tank.depth == pytest.approx(0.015)


def test_a_missing_key_says_what_belongs_there():
    text = built_in_text("turn-over").replace('thickness = "1 mm"\n', "")
    with pytest.raises(BadInput, match=r"body.thickness: got nothing; allowed: .* a length with its unit"):
        load_text(text)


def test_a_servo_phase_needs_its_tables():
    with pytest.raises(BadInput, match=r"programme.reference: got nothing; .*phases.0.drive is \"servo\""):
        load("dome", ["programme.phases.0.drive=servo"])


def test_several_mistakes_give_the_first_and_a_count():
    with pytest.raises(BadInput, match=r"body.thickness .*got '1 s'.* \(and 2 more errors\)"):
        load("turn-over", ["body.thickness=1 s", "material.p_l=2", "supply.limit=1"])


def load_text(text: str):
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.toml"
        file.write_text(text, encoding="utf-8")
        return load(str(file))


@pytest.mark.parametrize("name", names())
def test_built_in_scenarios_load_and_their_text_reads_as_the_same(name: str):
    loaded = load(name)
    assert loaded.scenario.name == loaded.source == name
    assert loaded.text == built_in_text(name)
    assert load_text(loaded.text).scenario == loaded.scenario
    assert len(description(name)) > 20


def test_the_expected_scenarios_are_there():
    assert {"turn-over", "early-switch", "dome", "strip", "lift", "curl", "right-left", "crawl"} <= set(names())


def test_values_are_si():
    s = load("turn-over", ["body.pose.heading=180 deg", "electrodes.gap=15 mm", "programme.servo.kp=10 V/mm"]).scenario
    assert s.body.pose.heading == pytest.approx(np.pi)
    assert s.electrodes.gap == pytest.approx(0.015)
    assert s.programme.servo is not None
    assert s.programme.servo.kp == pytest.approx(1e4)


def leaves(value: object, path: tuple[str, ...] = ()):
    """Dotted keys and values of everything that is no table and no list."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if inner is None:
        yield ".".join(path), value
    else:
        for key, below in inner:
            yield from leaves(below, (*path, str(key)))


LEAVES = [(name, key) for name in names() for key, _ in leaves(tomllib.loads(built_in_text(name)))]
VALUES = st.one_of(
    st.integers(-5, 5), st.booleans(), st.text("abc \"'\\\n#[]=é", max_size=8), st.lists(st.integers(0, 3))
)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(LEAVES), VALUES)
def test_a_change_changes_one_value_and_nothing_else(place: tuple[str, str], value: object):
    name, key = place
    before = dict(leaves(tomllib.loads(built_in_text(name))))
    text = with_overrides(built_in_text(name), [f"{key}={tomlkit.item(value).as_string()}"])
    after = dict(leaves(tomllib.loads(text)))
    kept = {k: v for k, v in after.items() if k != key and not k.startswith(f"{key}.")}
    assert kept == {k: v for k, v in before.items() if k != key}
    assert {k: v for k, v in after.items() if k not in kept} == dict(leaves(value, tuple(key.split("."))))


@pytest.mark.parametrize(
    "changes",
    [
        ["tank.depth=30 mm", "body.root_width=2.5 mm", "programme.phases.1.until.after=3 s"],
        ['programme.phases.0={name="a", pattern="off", drive="0 V", until={after="1 s"}}', "supply.limit=20 V"],
        ['programme.phases=[{name="a", pattern="ridge", drive="5 V"}]', "programme.phases.0.name=b"],
        ['tank={floor_depth="0 mm", friction=0}', "body.pose.position.1=0 mm", "name=mine"],
    ],
)
def test_changed_text_reads_as_the_changed_scenario(changes: list[str]):
    loaded = load("turn-over", changes)
    assert load_text(loaded.text).scenario == loaded.scenario != load("turn-over").scenario
    assert "# Fig. 3" in loaded.text


@pytest.mark.parametrize(
    "change", ["", "=", "a", ".a=1", "a..b=1", "body.arms.x=1", "programme.phases.9.name=x", "programme.phases.name=x"]
)
def test_a_change_that_leads_nowhere_is_refused(change: str):
    with pytest.raises(BadInput) as refused:
        load("turn-over", [change])
    assert refused.value.where == "--set"
    assert refused.value.given in (change, change.partition("=")[0])


def test_an_outline_from_svg_is_written_out_as_points(tmp_path: Path):
    (tmp_path / "square.svg").write_text(SQUARE_SVG)
    file = tmp_path / "mine.toml"
    body = FROM_SVG % "square"
    file.write_text(with_overrides(built_in_text("turn-over"), [body]), encoding="utf-8")
    loaded = load(str(file))
    assert loaded.scenario.body.outline().area == pytest.approx(64e-6)
    assert "svg" not in tomllib.loads(loaded.text)["body"]
    assert load_text(loaded.text).scenario == loaded.scenario


def test_a_written_pattern_may_stand_in_rows():
    flat = load("dome", [f"programme.phases.0.pattern={[0.5] * 8 + [-1] * 8}"]).scenario.programme.phases[0]
    rows = load("dome", [f"programme.phases.0.pattern={[[0.5] * 4] * 2 + [[-1] * 4] * 2}"]).scenario.programme.phases[0]
    assert flat.weights == rows.weights == {}
    assert flat.shares == rows.shares == (0.5,) * 8 + (-1.0,) * 8
    assert load("dome").scenario.programme.phases[0].weights == {"ridge": 1.0}


PROGRAMME = (
    """
programme.phases=[
  {name="up", pattern={ridge=0.5, uniform=-0.25}, drive=[["0 s", "1 V"], ["2 s", "3 V"], ["5 s", "-1 V"]],
   until={height="3 mm", tip_angle="45 deg", after="4 s", then="down", otherwise="rest"}},
  {name="keep", pattern="crossed-ridge", drive="servo", hold="2 mm",
   until={height_below="1 mm", normal_below=0.5, normal_above=-0.5, otherwise="up", after="7 s"}},
  {name="rest", pattern="off", drive="0 V", until={contact=["tip 2", "centre"], lifted="tip 1", along="-2 mm",
   along_below="4 mm", then="keep"}},
  {name="down", pattern=%s, drive="-2 V", until={after="9 s", otherwise="down"}},
]
""".replace("\n", " ")
    % [0.125 * k - 1.0 for k in range(16)]
)
UP, KEEP, LAST, DOWN = 0, 1, 2, 3


def as_set(toml: str) -> str:
    """An inline table of several lines as one value for --set."""
    return " ".join(toml.split())


class TestProgrammeAsArrays:
    """Each key of the table against the array that is played."""

    phases = build_phases(load("turn-over", [as_set(PROGRAMME)]).scenario, [np.zeros(16)] * 4, tips=5)

    def test_profiles_are_padded_with_their_last_point(self) -> None:
        times, volts = np.asarray(self.phases.profile_times), np.asarray(self.phases.profile_volts)
        assert times == pytest.approx(np.array([[0, 2, 5], [0, 0, 0], [0, 0, 0], [0, 0, 0]]))
        assert volts == pytest.approx(np.array([[1, 3, -1], [0, 0, 0], [0, 0, 0], [-2, -2, -2]]))
        assert np.asarray(self.phases.uses_servo).tolist() == [False, True, False, False]
        np.testing.assert_allclose(self.phases.holds, [np.nan, 2e-3, np.nan, np.nan])

    def test_conditions_are_bounds_of_what_is_measured(self) -> None:
        lows, highs = np.full((4, 9), -np.inf), np.full((4, 9), np.inf)
        lows[UP, ANGLE], lows[UP, HEIGHTS] = np.pi / 4.0, 3e-3
        highs[KEEP, NORMAL], highs[KEEP, HEIGHTS] = 0.5, 1e-3
        lows[KEEP, NORMAL] = -0.5
        # On the floor is what is no higher than the body is thick.
        highs[LAST, HEIGHTS] = highs[LAST, HEIGHTS + 2] = 1e-3
        lows[LAST, HEIGHTS + 1] = 1e-3
        lows[LAST, ALONG], highs[LAST, ALONG] = -2e-3, 4e-3
        np.testing.assert_allclose(self.phases.lows, lows)
        np.testing.assert_allclose(self.phases.highs, highs)

    def test_events_and_times_lead_to_phases(self) -> None:
        assert np.asarray(self.phases.conditional).tolist() == [True, True, True, False]
        assert np.asarray(self.phases.durations).tolist() == [4.0, 7.0, np.inf, 9.0]
        assert np.asarray(self.phases.after_event).tolist() == [DOWN, LAST, KEEP, DOWN]
        assert np.asarray(self.phases.after_time).tolist() == [LAST, UP, DOWN, DOWN]

    def test_patterns_are_written_or_superposed(self) -> None:
        scenario = load("turn-over", [as_set(PROGRAMME), "electrodes.panels=4", "electrodes.grounded=[15]"]).scenario
        field = solve(build_problem(scenario.electrodes.array, field_tank(scenario), 0.19, 4))
        patterns = build_patterns(scenario, field, np.eye(16))
        array, home = scenario.electrodes.array, np.array([12.5e-3, 12.5e-3])
        driven = np.arange(16) < 15
        mixed = 0.5 * template("ridge", array, home) - 0.25 * template("uniform", array, home)
        assert patterns[UP] == pytest.approx(np.clip(mixed, -1.0, 1.0) * driven)
        assert patterns[KEEP] == pytest.approx(template("crossed-ridge", array, home) * driven)
        assert not patterns[LAST].any()
        assert patterns[DOWN] == pytest.approx((0.125 * np.arange(16) - 1.0) * driven)

    def test_the_place_picks_the_robot_s_electrode(self) -> None:
        other = load("turn-over", ['programme.place=["-12.5 mm", "12.5 mm"]', "electrodes.panels=4"]).scenario
        assert other.place == (-12.5e-3, 12.5e-3)
        assert load("turn-over").scenario.place == (12.5e-3, 12.5e-3)
        field = solve(build_problem(other.electrodes.array, field_tank(other), 0.19, 4))
        (ridge, crossed, _), place = build_patterns(other, field, np.eye(16)), np.array(other.place)
        assert ridge == pytest.approx(template("ridge", other.electrodes.array, place))
        assert crossed == pytest.approx(template("crossed-ridge", other.electrodes.array, place))

    def test_tips_that_the_body_does_not_have_are_refused(self) -> None:
        scenario = load("turn-over", [as_set(PROGRAMME)]).scenario
        with pytest.raises(
            BadInput, match=r"programme.phases.2.until.contact: got 'tip 2'; allowed: one of the body's 1"
        ):
            build_phases(scenario, [np.zeros(16)] * 4, tips=1)


def reference_of(*changes: str) -> Programme:
    """The programme of turn-over with another reference."""
    scenario = load("turn-over", ["electrodes.panels=4", *changes]).scenario
    field = solve(build_problem(scenario.electrodes.array, field_tank(scenario), 0.19, 4))
    return build_programme(scenario, field, np.eye(16), tips=5)


class TestReferenceAsArrays:
    def test_a_rise_begins_in_the_middle_of_the_body(self) -> None:
        made = reference_of("programme.reference.duration=20 s", "programme.reference.height=4 mm")
        assert np.interp([0, 10, 20, 99], made.reference_times, made.reference_heights) == pytest.approx(
            [0.5e-3, 2.25e-3, 4e-3, 4e-3]
        )
        assert np.asarray(made.followed) == pytest.approx(np.outer([0, 0, 1], [1, 0, 0, 0, 0, 0]))
        assert not made.from_start

    def test_waypoints_of_a_tip_along_the_floor(self) -> None:
        points = 'waypoints=[["1 s", "0 mm"], ["3 s", "2 mm"], ["4 s", "-1 mm"]]'
        made = reference_of(f'programme.reference={{point="tip 3", axis="30 deg", {points}}}')
        assert np.asarray(made.reference_times) == pytest.approx([1, 3, 4])
        assert np.asarray(made.reference_heights) == pytest.approx([0, 2e-3, -1e-3])
        followed = np.zeros((3, 6))
        followed[:2, 3] = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
        assert np.asarray(made.followed) == pytest.approx(followed)
        assert made.from_start

    @pytest.mark.parametrize(("axis", "direction"), [("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])])
    def test_axes_have_names(self, axis: str, direction: list[int]) -> None:
        made = reference_of(f"programme.reference.axis={axis}")
        assert np.asarray(made.followed)[:, 0] == pytest.approx(direction)
        assert bool(made.from_start) == (axis != "z")
        assert float(made.reference_heights[0]) == (0.5e-3 if axis == "z" else 0.0)

    def test_a_speed_limit_delays(self) -> None:
        points = 'waypoints=[["0 s", "1 mm"], ["2 s", "2 mm"], ["3 s", "5 mm"]]'
        made = reference_of(f'programme.reference={{{points}, speed_limit="1 mm/s"}}')
        assert np.asarray(made.reference_times) == pytest.approx([0, 2, 5])

    def test_a_programme_without_reference_and_servo_follows_nothing(self) -> None:
        scenario = load("dome", ["electrodes.panels=4"]).scenario
        field = solve(build_problem(scenario.electrodes.array, field_tank(scenario), 0.19, 4))
        made = build_programme(scenario, field, np.eye(16), tips=5)
        assert np.isnan(made.reference_heights).all()
        assert (float(made.kp), float(made.kv), float(made.slew_rate)) == (0.0, 0.0, np.inf)

    def test_the_servo_s_slew_and_filter(self) -> None:
        made = reference_of(
            "programme.servo.slew=5 V/s", "programme.servo.filter=200 ms", "programme.servo.sign=printed"
        )
        assert (float(made.slew_rate), float(made.rate_filter), float(made.sign)) == (5.0, 0.2, -1.0)
        assert (float(made.kp), float(made.limit), float(made.period)) == pytest.approx((1e4, 10.0, 0.1))

    def test_a_point_that_the_body_does_not_have_is_refused(self) -> None:
        with pytest.raises(
            BadInput, match=r"programme.reference.point: got 'tip 6'; allowed: one of the body's 5 tips"
        ):
            reference_of("programme.reference.point=tip 6")


def test_a_phase_that_another_follows_needs_an_end() -> None:
    text = 'programme.phases=[{name="a", pattern="off", drive="0 V"}, {name="b", pattern="off", drive="0 V"}]'
    with pytest.raises(
        BadInput, match=r"programme.phases.0.until.*got nothing; allowed: a table: the phase is followed"
    ):
        load("dome", [text])


def test_the_last_phase_may_lead_back() -> None:
    ends = 'until={after="1 s", otherwise="dome"}'
    (phase,) = load(
        "dome", [f'programme.phases=[{{name="dome", pattern="ridge", drive="1 V", {ends}}}]']
    ).scenario.programme.phases
    assert phase.until is not None
    assert not phase.until.has_event
