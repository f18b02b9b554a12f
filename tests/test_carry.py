"""Patterns carried to another direction.

| identity | one road | the other |
|---|---|---|
| no turn | the carried pattern's field | the pattern's own |
| a turn that the array shares | the carried pattern's field | that of the pattern with electrodes swapped |
| the error | what `carried` reports | both fields, turned and compared point by point |
| the field of the turned scenario | voltages that the model plays | the field of the unturned one, turned |
"""

from __future__ import annotations

import numpy as np
import pytest

from gelbot.control.programme import Programme
from gelbot.field.charge import FieldSolution, build_problem, solve
from gelbot.field.circuit import connection
from gelbot.field.electrodes import square_array
from gelbot.field.images import Tank
from gelbot.plan.carry import ANGLES, LEVELS, RINGS, carried, sample_points
from gelbot.plan.templates import template
from gelbot.scenario import load
from gelbot.scenario.build import build
from gelbot.scenario.programme_arrays import STANDS

MM = 1e-3
MIDDLE, HOME = np.zeros(2), np.array([12.5, 12.5]) * MM
REACH, HEIGHT = 8 * MM, 6 * MM
DRIVEN = np.eye(16)


@pytest.fixture(scope="module")
def turn_over_field() -> FieldSolution:
    """The array of the scenario turn-over in its tank, coarsely."""
    scenario = load("turn-over", ["electrodes.panels=4"]).scenario
    tank = Tank(-scenario.tank.floor_depth, scenario.tank.depth)
    return solve(build_problem(scenario.electrodes.array, tank, scenario.solution.conductivity, 4))


@pytest.fixture
def pattern(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-1.0, 1.0, 16)


def turning(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def near(rng: np.random.Generator, place: np.ndarray, count: int = 60) -> np.ndarray:
    """Points [m] about the place that are none of those by which fields are compared, shape (3, count)."""
    radius, angle = REACH * np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.stack(
        [place[0] + radius * np.cos(angle), place[1] + radius * np.sin(angle), rng.uniform(0.1, 1.0, count) * HEIGHT]
    )


def field_of(solution: FieldSolution, points: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Current density at `points`, (3, p)."""
    return solution.current_density(points, volts[:, None])[0]


def turned_field(
    solution: FieldSolution, points: np.ndarray, volts: np.ndarray, place: np.ndarray, angle: float
) -> np.ndarray:
    """The field of `volts`, turned about `place`, at `points`: each vector is fetched from where it was before."""
    wanted = np.empty_like(points)
    for k, point in enumerate(points.T):
        before = np.append(turning(-angle) @ (point[:2] - place) + place, point[2])
        vector = field_of(solution, before[:, None], volts)[:, 0]
        wanted[:, k] = np.append(turning(angle) @ vector[:2], vector[2])
    return wanted


def apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def test_points_fill_a_cylinder_about_the_place() -> None:
    points = sample_points(HOME, REACH, HEIGHT)
    assert points.shape == (3, LEVELS * (1 + RINGS * ANGLES))
    radius = np.hypot(*(points[:2] - HOME[:, None]))
    assert radius.max() == pytest.approx(REACH)
    assert points[2].min() > 0.0
    assert points[2].max() == pytest.approx(HEIGHT)
    # They are carried into themselves by the turns of five arms and of four rows.
    for angle in (np.radians(90.0), 2.0 * np.pi / 12.0):
        moved = turning(angle) @ (points[:2] - HOME[:, None]) + HOME[:, None]
        gaps = np.linalg.norm(moved[:, :, None] - points[:2, None, :], axis=0).min(axis=1)
        assert gaps.max() < 1e-12


@pytest.mark.parametrize("place", [MIDDLE, HOME])
def test_without_a_turn_it_is_the_same_field(
    array_field: FieldSolution, pattern: np.ndarray, rng: np.random.Generator, place: np.ndarray
) -> None:
    found = carried(array_field, DRIVEN, pattern, place, 0.0, REACH, HEIGHT)
    points = near(rng, place)
    assert found.error < 2e-3
    assert apart(field_of(array_field, points, found.pattern), field_of(array_field, points, pattern)) < 3e-3
    assert np.abs(found.pattern).max() <= 1.0


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turn_that_the_array_shares_is_a_change_of_places(
    array_field: FieldSolution, pattern: np.ndarray, rng: np.random.Generator, quarters: int
) -> None:
    angle = quarters * np.pi / 2.0
    centres = array_field.problem.array.centres[:2]
    came_from = turning(-angle) @ centres
    order = np.linalg.norm(came_from[:, :, None] - centres[:, None, :], axis=0).argmin(axis=1)
    assert sorted(order) == list(range(16))
    swapped = pattern[order]
    points = near(rng, MIDDLE)
    exact = turned_field(array_field, points, pattern, MIDDLE, angle)
    assert apart(field_of(array_field, points, swapped), exact) < 1e-9
    found = carried(array_field, DRIVEN, pattern, MIDDLE, angle, REACH, HEIGHT)
    assert found.error < 2e-3
    assert apart(field_of(array_field, points, found.pattern), exact) < 3e-3


@pytest.mark.parametrize("degrees", [36.0, 100.0, -17.0])
def test_the_error_is_the_difference_of_the_fields(
    array_field: FieldSolution, pattern: np.ndarray, rng: np.random.Generator, degrees: float
) -> None:
    angle = np.radians(degrees)
    found = carried(array_field, DRIVEN, pattern, HOME, angle, REACH, HEIGHT)
    points = sample_points(HOME, REACH, HEIGHT)
    wanted = turned_field(array_field, points, pattern, HOME, angle)
    assert found.error == pytest.approx(apart(field_of(array_field, points, found.pattern), wanted), rel=1e-6)
    # No other pattern that was tried comes nearer by more than what keeps voltages small.
    for _ in range(30):
        other = np.clip(found.pattern + rng.normal(scale=0.05, size=16), -1.0, 1.0)
        assert apart(field_of(array_field, points, other), wanted) > found.error - 1e-3


def test_a_common_voltage_has_no_field(array_field: FieldSolution, pattern: np.ndarray) -> None:
    """Nothing is carried to nothing, and what differs by a common voltage to the same."""
    nothing = carried(array_field, DRIVEN, np.zeros(16), HOME, 0.3, REACH, HEIGHT)
    assert nothing.error == 0.0
    assert not nothing.pattern.any()
    one, other = (carried(array_field, DRIVEN, 0.5 * pattern + c, HOME, 0.3, REACH, HEIGHT) for c in (0.0, 0.4))
    assert one.pattern == pytest.approx(other.pattern, abs=1e-6)


@pytest.mark.parametrize("fifth", range(10))
def test_the_array_of_turn_over_gives_each_direction(turn_over_field: FieldSolution, fifth: int) -> None:
    """The patterns of its programme within 5 %; those of half a plane come up against the supply's limit."""
    reach = load("turn-over").scenario.body.outline().reach
    for name, most in (("ridge", 0.05), ("crossed-ridge", 0.05), ("plus", 0.1), ("minus", 0.1)):
        pattern = template(name, turn_over_field.problem.array, HOME)
        found = carried(turn_over_field, DRIVEN, pattern, HOME, np.radians(36.0 * fifth), reach, STANDS * reach)
        assert found.error < most


def test_an_electrode_that_is_not_driven_gets_no_voltage(pattern: np.ndarray) -> None:
    array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
    solution = solve(build_problem(array, Tank(floor=-1 * MM), 0.15, 4))
    states = ["driven"] * 16
    states[3], states[9] = "floating", "grounded"
    connected = connection(solution.conductance, states)
    driven = np.array(states) == "driven"
    found = carried(solution, connected, pattern * driven, HOME, 0.4, REACH, HEIGHT)
    points = sample_points(HOME, REACH, HEIGHT)
    wanted = turned_field(solution, points, connected @ (pattern * driven), HOME, 0.4)
    assert found.error == pytest.approx(apart(field_of(solution, points, connected @ found.pattern), wanted), rel=1e-6)
    assert found.pattern[~driven] == pytest.approx(0.0, abs=1e-9)


COARSE = ("electrodes.panels=4", 'body.mesh_size="1.5 mm"')


def programme_of(*changes: str) -> Programme:
    return build(load("turn-over", (*COARSE, *changes)).scenario).programme


def test_the_programme_s_turn_turns_its_patterns() -> None:
    straight, turned = programme_of(), build(load("turn-over", (*COARSE, 'programme.turn="72 deg"')).scenario)
    reach = turned.body.outline.reach
    patterns = np.asarray(turned.programme.phases.patterns)
    for before, after in zip(np.asarray(straight.phases.patterns), patterns, strict=True):
        found = carried(turned.field, turned.connection, before, HOME, np.radians(72.0), reach, STANDS * reach)
        assert after == pytest.approx(found.pattern, abs=1e-9)
    assert np.array_equal(patterns[1], patterns[2])  # the crossed ridge, twice
    assert np.abs(patterns).max() <= 1.0
    # What is not connected gets nothing, to the last digit: those are the voltages asked of the supply.
    off = programme_of('programme.turn="72 deg"', "electrodes.floating=[5]", "electrodes.off=[0]")
    assert np.all(np.asarray(off.phases.patterns)[:, [0, 5]] == 0.0)


def test_another_conductivity_has_the_same_patterns() -> None:
    turn = 'programme.turn="100 deg"'
    one, other = programme_of(turn), programme_of(turn, "solution.conductivity=1 S/m")
    assert np.asarray(one.phases.patterns) == pytest.approx(np.asarray(other.phases.patterns), abs=1e-9)
