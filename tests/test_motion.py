"""Motions: how far a run came towards its goals.

| identity | one road | the other |
|---|---|---|
| shortfall, times | dynamic programming over the frames | all sequences of beginnings, one after the other |
| quantities | `quantity_of` | read off the data set by hand |
| along, across | a point's way in a direction | the same way turned, in the turned direction |
| wrap | the body's slices followed round the rod | the angle of an exact arc and of an exact helix |
"""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from gelbot.errors import BadInput
from gelbot.motion.reach import SCALES, Reached, misses, reach, seen_in, told, worded
from gelbot.motion.wrap import wrapped
from gelbot.scenario import load
from gelbot.scenario.build import build
from gelbot.scenario.motions import UNITS, Goal, check_tips
from gelbot.scenario.schema import Scenario

MM = 1e-3
STEP = 0.1
ROD = '{shape="cylinder", diameter="4 mm", length="%g mm", position=["0 mm", "0 mm", "20 mm"], axis=[%g, %g, %g]}'


def scenario(*goals: str, direction: str | None = "0 deg", more: tuple[str, ...] = ()) -> Scenario:
    """The dome with a motion of these goals, each an inline table of TOML."""
    way = "" if direction is None else f'direction="{direction}", '
    return load("dome", (*more, f"motion={{{way}goals=[{', '.join(goals)}]}}")).scenario


def run_of(
    heights: Any,
    normal: Any = 1.0,
    centre: Any = 0.0,
    tips: Any = None,
    angles: Any = None,
) -> xr.Dataset:
    """Frames with these heights [m] of the centre, its place in x and y [m], z of the normal, tips and their angles."""
    z = np.asarray(heights, float)
    count = len(z)
    place = np.zeros((count, 3))
    place[:, :2], place[:, 2] = centre, z
    up = np.zeros((count, 3))
    up[:, 2] = normal
    tip = np.zeros((count, 3, 2)) if tips is None else np.asarray(tips, float)
    angle = np.zeros((count, 2)) if angles is None else np.asarray(angles, float)
    # The order of the dimensions is nobody's business.
    return xr.Dataset(
        {
            "centre": (("space", "time"), place.T),
            "normal": (("time", "space"), up),
            "tip_position": (("space", "tip", "time"), tip.transpose(1, 2, 0)),
            "tip_angle": (("time", "tip"), angle),
        },
        coords={"time": np.round(STEP * (1.0 + np.arange(count)), 9)},
    )


class Wanted:
    """A goal as the search below sees it: bounds, how many frames it lasts, whether to the end."""

    def __init__(self, goal: Goal) -> None:
        self.low = -np.inf if goal.at_least is None else goal.at_least
        self.high = np.inf if goal.at_most is None else goal.at_most
        self.frames = max(1, round((goal.lasting or 0.0) / STEP))
        self.to_the_end = goal.to_the_end
        self.scale = SCALES[UNITS[goal.quantity]]

    def worst(self, values: np.ndarray, begin: int) -> float:
        """How far it is missed at the worst from frame `begin` on, infinite where the run is too short."""
        end = len(values) if self.to_the_end else begin + self.frames
        if begin + self.frames > len(values):
            return np.inf
        return max(max(self.low - v, v - self.high, 0.0) / self.scale for v in values[begin:end])


def searched(goals: tuple[Goal, ...], values: np.ndarray) -> tuple[float, tuple[int, ...] | None]:
    """The least shortfall of all sequences of beginnings, and the first of those that have it."""
    wanted = [Wanted(goal) for goal in goals]
    best: tuple[float, tuple[int, ...]] | None = None
    for begins in product(range(len(values)), repeat=len(goals)):
        if any(b < a + one.frames for a, b, one in zip(begins, begins[1:], wanted, strict=False)):
            continue
        short = sum(one.worst(values, begin) for one, begin in zip(wanted, begins, strict=True))
        # The last goal's window ends first; with equal windows: it begins first. Then the goal before it, and so on.
        key = (short, begins[::-1])
        if np.isfinite(short) and (best is None or key < best):
            best = key
    return (np.inf, None) if best is None else (best[0], best[1][::-1])


HEIGHTS = st.lists(st.integers(0, 6).map(lambda k: 0.5 * k * MM), min_size=1, max_size=9)


@st.composite
def height_goals(draw: st.DrawFn) -> list[str]:
    goals = []
    count = draw(st.integers(1, 3))
    for number in range(count):
        low = draw(st.integers(0, 5)) * 0.5
        bounds = draw(
            st.sampled_from(
                [f'at_least="{low} mm"', f'at_most="{low} mm"', f'at_least="{low} mm", at_most="{low + 0.5} mm"']
            )
        )
        lasting = draw(st.sampled_from(["", ', lasting="0.1 s"', ', lasting="0.3 s"']))
        end = ", to_the_end=true" if number == count - 1 and draw(st.booleans()) else ""
        goals.append(f'{{quantity="height", {bounds}{lasting}{end}}}')
    return goals


class TestSequences:
    @settings(max_examples=150)
    @given(HEIGHTS, height_goals())
    def test_the_best_sequence_of_all(self, heights: list[float], goals: list[str]) -> None:
        asked = scenario(*goals)
        assert asked.motion is not None
        found = reach(run_of(heights), asked)
        short, begins = searched(asked.motion.goals, np.array(heights))
        assert found.met == (short == 0.0)
        assert found.shortfall == pytest.approx(short, rel=1e-12, abs=1e-15)
        if found.met:
            assert begins is not None
            assert found.times == pytest.approx([STEP * (1 + begin) for begin in begins])
            assert found.reason == ""
            assert np.isnan(found.best)
        else:
            assert len(found.times) < len(goals)
            assert found.reason.startswith(f"goal {len(found.times) + 1} (") or "longer run" in found.reason

    def test_each_goal_counts_from_when_the_one_before_it_has_lasted(self) -> None:
        up, down = '{quantity="height", at_least="3 mm", lasting="0.2 s"}', '{quantity="height", at_most="1 mm"}'
        # Low, high for one frame only, low, high for two, low.
        heights = np.array([0, 4, 0, 4, 4, 0, 0]) * MM
        assert reach(run_of(heights), scenario(up, down)).times == pytest.approx([0.4, 0.6])
        assert reach(run_of(heights), scenario(down, up)).times == pytest.approx([0.1, 0.4])
        assert not reach(run_of(heights[:5]), scenario(up, down)).met

    def test_a_later_better_sequence_is_taken_instead_of_an_earlier_worse_one(self) -> None:
        up, down = '{quantity="height", at_least="3 mm"}', '{quantity="height", at_most="0 mm"}'
        found = reach(run_of(np.array([2.4, 0, 1, 3, 0.5]) * MM), scenario(up, down))
        assert found.shortfall == pytest.approx(0.5)
        assert found.times == pytest.approx([0.4])

    def test_to_the_end_is_to_the_end(self) -> None:
        kept = '{quantity="normal", at_most=-0.8, lasting="0.3 s", to_the_end=true}'
        for normals, time in (
            ([1, -1, 1, -1, -1, -1], 0.4),
            ([1, -1, -1, -1, 1, -1], None),
            ([1, 1, 1, 1, -1, -1], None),
            ([-1] * 6, 0.1),
        ):
            found = reach(run_of(np.zeros(6), normals), scenario(kept))
            assert (found.times[0] if found.met else None) == (time if time is None else pytest.approx(time))

    def test_what_is_missing_adds_up(self) -> None:
        goals = '{quantity="height", at_least="3 mm"}', '{quantity="normal", at_most=-0.5}'
        found = reach(run_of([1 * MM, 2 * MM, 2 * MM], normal=[1.0, 1.0, 0.25]), scenario(*goals))
        assert found.shortfall == pytest.approx(1.0 + 0.75 / 0.5)
        assert found.times == ()


class TestReasons:
    def test_the_first_goal_that_was_missed(self) -> None:
        goals = '{quantity="height", at_least="2 mm"}', '{quantity="height", at_most="0.5 mm", lasting="20 ms"}'
        found = reach(run_of(np.array([1, 3, 2, 1]) * MM), scenario(*goals))
        assert found.reason == "goal 2 (height at most 0.5 mm for 0.02 s) not met: nearest 1 mm"
        assert found.best == pytest.approx(1 * MM)
        assert found.times == pytest.approx([0.2])

    def test_reached_but_not_kept(self) -> None:
        found = reach(
            run_of(np.array([1, 3, 1]) * MM), scenario('{quantity="height", at_least="2 mm", lasting="0.2 s"}')
        )
        assert found.reason == "goal 1 (height at least 2 mm for 0.2 s) not met: nearest 3 mm (reached, but not kept)"

    def test_a_run_that_is_too_short(self) -> None:
        goal = '{quantity="height", at_least="2 mm", lasting="1 s"}'
        found = reach(run_of(np.array([3, 3, 3]) * MM), scenario(goal))
        assert found == (False, (), np.inf, "goal 1 (height at least 2 mm for 1 s) needs a longer run", found.best)
        two = scenario('{quantity="height", at_least="2 mm"}', goal)
        assert reach(run_of(np.array([3, 3, 3]) * MM), two).reason.startswith("goal 2 (")

    def test_a_run_without_frames(self) -> None:
        found = reach(run_of([]), scenario('{quantity="height", at_least="2 mm"}'))
        assert (found.met, found.reason) == (False, "the run has no frames")

    def test_a_run_that_broke_off(self) -> None:
        """What is not finite never meets a goal, not even one with an upper bound."""
        found = reach(run_of([3 * MM, np.nan, np.nan]), scenario('{quantity="height", at_most="1 mm"}'))
        assert not found.met
        assert found.shortfall == pytest.approx(2.0)
        assert found.best == pytest.approx(3 * MM)
        lost = reach(run_of([np.nan, np.nan]), scenario('{quantity="height", at_most="1 mm"}'))
        assert not lost.met
        assert lost.reason.endswith("not met: broke off")

    @pytest.mark.parametrize(
        ("goal", "words"),
        [
            ('{quantity="height", at_least="3 mm", lasting="20 s"}', "height at least 3 mm for 20 s"),
            ('{quantity="normal", at_most=-0.8, to_the_end=true}', "normal at most -0.8, to the end"),
            ('{quantity="along", point="tip 2", at_least="1 cm"}', "along of tip 2 at least 10 mm"),
            (
                '{quantity="tip_angle", at_least="45 deg", at_most="2 rad"}',
                "tip_angle at least 45 deg and at most 114.592 deg",
            ),
        ],
    )
    def test_goals_in_words(self, goal: str, words: str) -> None:
        motion = scenario(goal).motion
        assert motion is not None
        assert worded(motion.goals[0]) == words


class TestQuantities:
    def test_each_is_what_the_run_says(self, rng: np.random.Generator) -> None:
        count = 7
        run = run_of(
            rng.normal(size=count) * MM,
            rng.uniform(-1, 1, count),
            rng.normal(size=(count, 2)) * MM,
            rng.normal(size=(count, 3, 2)) * MM,
            rng.normal(size=(count, 2)),
        )
        cases = {
            '{quantity="height", at_least="0 mm"}': (run["centre"].values[2], MM),
            '{quantity="height", point="tip 2", at_least="0 mm"}': (run["tip_position"].values[2, 1], MM),
            '{quantity="normal", at_least=0}': (run["normal"].values[:, 2], 0.5),
            '{quantity="tip_angle", at_least="0 deg"}': (run["tip_angle"].values.max(axis=1), np.pi / 6.0),
        }
        for goal, (values, scale) in cases.items():
            asked = scenario(goal)
            (found,) = misses(asked, seen_in(run, asked), np.zeros((2, 3)))
            assert found == pytest.approx(np.maximum(-values, 0.0) / scale)

    @pytest.mark.parametrize("angle", [0.0, 45.0, 90.0, 200.0])
    @pytest.mark.parametrize("point", [0, 1])
    def test_along_and_across_are_counted_from_the_start_in_the_direction(self, angle: float, point: int) -> None:
        way = np.array([[0.0, 0.0], [3.0, 1.0], [5.0, 2.0]]) * MM  # along and across
        a = np.radians(angle)
        turned = way @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + 7 * MM
        tips = np.zeros((3, 3, 2))
        tips[:, :2, 0] = turned
        run = run_of(np.zeros(3), centre=turned, tips=tips)
        at = "" if point == 0 else 'point="tip 1", '
        for quantity, best in (("along", 5 * MM), ("across", 2 * MM)):
            found = reach(run, scenario(f'{{quantity="{quantity}", {at}at_least="1 m"}}', direction=f"{angle} deg"))
            assert found.best == pytest.approx(best)

    def test_the_static_part_knows_the_start_better_than_the_first_frame(self) -> None:
        run = run_of(np.zeros(2), centre=np.array([[1.0, 0.0], [2.0, 0.0]]) * MM)
        asked = scenario('{quantity="along", at_least="1 m"}')
        assert reach(run, asked).best == pytest.approx(1 * MM)
        run["start_point"] = (("point", "space"), np.zeros((3, 3)))
        assert reach(run, asked).best == pytest.approx(2 * MM)

    def test_a_run_of_one_frame(self) -> None:
        found = reach(run_of([3 * MM]), scenario('{quantity="height", at_least="2 mm"}'))
        assert found == Reached(True, (STEP,), 0.0, "", found.best)


def strip_round(
    angle: float, pitch: float, slices: int = 30, radius: float = 2.5 * MM, close: float = 1.0, layers: int = 2
) -> tuple[np.ndarray, np.ndarray]:
    """Rest positions (3, n) of a strip, and where they are on a helix of so many radians about the x axis through
    (0, 0, 20 mm), whose `pitch` [m] is its advance in a whole turn; beyond the share `close` it goes on straight."""
    length = abs(angle) * np.hypot(radius, pitch / (2.0 * np.pi))
    s, w, t = np.meshgrid(np.linspace(0, 1, 4 * slices), [-0.5, 0.5], np.linspace(-0.5, 0.5, layers), indexing="ij")
    s, w, t = (one.ravel() for one in (s, w, t))
    rest = np.stack([s * length, w * MM, (t + 0.5) * MM])
    turned = np.minimum(s, close) * angle
    r = radius + t * MM
    x = pitch * turned / (2.0 * np.pi) + w * MM
    at = np.stack([x, r * np.cos(turned), r * np.sin(turned)])
    beyond = np.maximum(s - close, 0.0) * length
    at[1] -= beyond * np.sin(close * angle) * np.sign(angle)
    at[2] += beyond * np.cos(close * angle) * np.sign(angle)
    return rest, at + np.array([[0.0], [0.0], [20 * MM]])


def wrap_of(rest: np.ndarray, at: np.ndarray, slices: int, asked: Scenario) -> float:
    """The wrap of the body at one moment, whose mesh has so many slices along it."""
    run = xr.Dataset({"rest_position": (("space", "node"), rest), "position": (("time", "space", "node"), at[None])})
    mesh = float(np.ptp(rest[0])) / slices
    body = asked.body.model_copy(update={"mesh_size": mesh})
    return float(wrapped(run, asked.model_copy(update={"body": body}))[0])


def with_rod(length: float = 60.0, axis: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Scenario:
    return load("dome", (f"obstacles=[{ROD % (length, *axis)}]",)).scenario


class TestWrap:
    @pytest.mark.parametrize("degrees", [60.0, 180.0, 350.0, -200.0])
    @pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (-2.0, 0.0, 0.0)])
    def test_an_arc_has_its_angle(self, degrees: float, axis: tuple[float, float, float]) -> None:
        """Between the middles of its first slice and of its last one."""
        rest, at = strip_round(np.radians(degrees), 0.0)
        found = wrap_of(rest, at, 30, with_rod(axis=axis))
        assert np.degrees(found) == pytest.approx(abs(degrees) * 29 / 30, rel=1e-2)

    @pytest.mark.parametrize("degrees", [400.0, 900.0])
    def test_a_helix_has_more_than_a_whole_turn(self, degrees: float) -> None:
        rest, at = strip_round(np.radians(degrees), 5 * MM, slices=60)
        found = wrap_of(rest, at, 60, with_rod())
        assert np.degrees(found) == pytest.approx(degrees * 59 / 60, rel=1e-2)

    def test_what_stands_off_the_rod_does_not_count(self) -> None:
        rest, at = strip_round(np.radians(180.0), 0.0, close=0.5, slices=60)
        found = np.degrees(wrap_of(rest, at, 60, with_rod()))
        # On the tangent it is against the rod until it is 1.5 thicknesses off it, another 31 degrees at most.
        assert 88.0 < found < 90.0 + np.degrees(np.arccos(2.5 / 3.5))

    def test_what_is_beyond_the_rod_s_ends_does_not_count(self) -> None:
        rest, at = strip_round(np.radians(720.0), 10 * MM, slices=60)
        # The rod covers the first turn only: the helix leaves it at x = 10 mm.
        found = np.degrees(wrap_of(rest, at, 60, with_rod(length=20.0)))
        assert found == pytest.approx(360.0, abs=24.0)

    def test_a_body_that_is_nowhere_near_has_none(self) -> None:
        rest, at = strip_round(np.radians(90.0), 0.0)
        assert wrap_of(rest, at - 10 * MM, 30, with_rod()) == 0.0

    def test_slices_without_nodes_are_left_out(self) -> None:
        """A mesh coarser than its slices: they are no part of the body at the rod's middle."""
        rest, at = strip_round(np.radians(180.0), 0.0, slices=5)
        found = wrap_of(rest, at, 90, with_rod())
        assert np.degrees(found) == pytest.approx(180.0, rel=1e-2)
        assert wrap_of(rest, at - 10 * MM, 90, with_rod()) == 0.0

    def test_it_is_a_goal_with_an_angle(self) -> None:
        asked = scenario(
            '{quantity="wrap", at_least="90 deg"}', more=(f"obstacles=[{ROD % (60.0, 1, 0, 0)}]",), direction=None
        )
        run = run_of([0.0, 0.0])
        (rest, near), (_, far) = strip_round(np.radians(120.0), 0.0), strip_round(np.radians(60.0), 0.0)
        run["rest_position"] = (("space", "node"), rest)
        run["position"] = (("time", "space", "node"), np.stack([far, near]))
        found = reach(run, asked)
        assert found.met
        assert found.times == pytest.approx([0.2])


MISTAKES = [
    ('[{quantity="hight", at_least="1 mm"}]', "motion.goals.0.quantity", "'hight'", "'height'"),
    ('[{quantity="height"}]', "motion.goals.0.at_least", "nothing", "at least one of at_least and at_most"),
    ('[{quantity="height", at_least=1}]', "motion.goals.0.at_least", "1", 'such as "1 mm"'),
    ('[{quantity="height", at_least="1 s"}]', "motion.goals.0.at_least", "'1 s'", "a length"),
    ('[{quantity="tip_angle", at_most="1 mm"}]', "motion.goals.0.at_most", "'1 mm'", "an angle"),
    ('[{quantity="normal", at_most="1 mm"}]', "motion.goals.0.at_most", "'1 mm'", "a finite number without a unit"),
    ('[{quantity="normal", at_most=nan}]', "motion.goals.0.at_most", "nan", "a finite number"),
    ('[{quantity="normal", at_most=true}]', "motion.goals.0.at_most", "True", "a finite number"),
    ('[{quantity="height", at_least="2 mm", at_most="1 mm"}]', "motion.goals.0.at_most", "0.001", "no less than"),
    ('[{quantity="normal", point="tip 1", at_most=0}]', "motion.goals.0.point", "'tip 1'", "of the whole body"),
    ('[{quantity="height", point="tip 0", at_most="1 mm"}]', "motion.goals.0.point", "'tip 0'", "an essential point"),
    ('[{quantity="height", point=["centre"], at_most="1 mm"}]', "motion.goals.0.point", "['centre']", "an essential"),
    ('[{quantity="along", at_least="1 mm"}]', "motion.direction", "nothing", "an angle: goals.0 is along it"),
    ('[{quantity="normal", at_most=0, lasting="0 s"}]', "motion.goals.0.lasting", "'0 s'", "greater than 0"),
    ('[{quantity="normal", at_most=0, lasting=3}]', "motion.goals.0.lasting", "3", "a time"),
    ('[{quantity="normal", at_most=0, to_the_end=true}, {quantity="normal", at_most=0}]',
     "motion.goals.0.to_the_end", "True", "only for the last goal"),
    ('[{quantity="wrap", at_least="90 deg"}]', "motion.goals.0.quantity", "'wrap'", "a cylinder among the obstacles"),
    ('[{quantity="normal", at_most=0, at_last=3}]', "motion.goals.0.at_last", "3", "the keys quantity"),
    ("[]", "motion.goals", "[]", "not empty"),
    ('[{at_least="1 mm"}]', "motion.goals.0.quantity", "nothing", "required"),
    ("[3]", "motion.goals.0", "3", "a table"),
]  # fmt: skip


@pytest.mark.parametrize(("goals", "key", "given", "allowed"), MISTAKES)
def test_a_mistake_in_a_motion_is_explained(goals: str, key: str, given: str, allowed: str) -> None:
    with pytest.raises(BadInput) as refused:
        load("dome", [f"motion={{goals={goals}}}"])
    assert refused.value.where == f"dome: {key} (with --set)"
    assert f"got {given}" in str(refused.value)
    assert allowed in str(refused.value)


def test_goals_are_about_tips_that_the_body_has() -> None:
    coarse = ('body.mesh_size="1.5 mm"', "electrodes.panels=4")
    body = build(scenario('{quantity="height", point="tip 5", at_least="1 mm"}', more=coarse)).body
    assert len(body.tips) == 5
    with pytest.raises(
        BadInput, match=re.escape("motion.goals.0.point: got 'tip 6'; allowed: one of the body's 5 tips")
    ):
        build(scenario('{quantity="height", point="tip 6", at_least="1 mm"}', more=coarse))


def test_a_body_without_tips_has_no_tip_angle() -> None:
    motion = scenario('{quantity="tip_angle", at_least="1 deg"}').motion
    check_tips(motion, 1)
    with pytest.raises(BadInput, match=r"motion.goals.0.quantity: got 'tip_angle'; allowed: .* no tips"):
        check_tips(motion, 0)


def test_a_run_that_wrote_nothing() -> None:
    found = reach(xr.Dataset(), scenario('{quantity="height", at_least="2 mm"}'))
    assert (found.met, found.times, found.reason) == (False, (), "the run has no frames")


def test_what_was_while_the_goal_before_lasted_does_not_count() -> None:
    asked = scenario(
        '{quantity="height", at_least="2 mm", lasting="0.3 s"}', '{quantity="tip_angle", at_least="60 deg"}'
    )
    angles = np.radians([[0, 0], [65, 0], [65, 0], [65, 0], [40, 0]])
    found = reach(run_of(np.array([0, 3, 3, 3, 3]) * MM, angles=angles), asked)
    assert found.reason == "goal 2 (tip_angle at least 60 deg) not met: nearest 40 deg"


def test_what_is_told_of_a_run() -> None:
    asked = scenario('{quantity="height", at_least="2 mm"}', '{quantity="height", at_most="2.5 mm"}')
    assert asked.motion is not None
    goals = ["height at least 2 mm", "height at most 2.5 mm"]
    found = reach(run_of(np.array([0, 1, 3, 2.2, 0]) * MM), asked)
    when = [{"goal": goal, "reached_s": time} for goal, time in zip(goals, found.times, strict=True)]
    assert told(found, asked.motion) == {"met": True, "goals": when, "reason": ""}
    found = reach(run_of(np.array([0, 1, 3, 3, 3]) * MM), asked)
    when = [{"goal": goals[0], "reached_s": found.times[0]}, {"goal": goals[1], "reached_s": None}]
    reason = "goal 2 (height at most 2.5 mm) not met: nearest 3 mm"
    assert told(found, asked.motion) == {"met": False, "goals": when, "reason": reason}
