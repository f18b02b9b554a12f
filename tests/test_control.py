"""Servo, programme, templates, trajectory.

| identity | one road | the other |
|---|---|---|
| Eq. (7) | `servo` | the printed line, both signs |
| saturation | any amplitude | within the supply's limit |
| programme | phase after a tick | each condition alone, all together, the clock |
| templates | pattern of a mirrored robot | the mirrored pattern |
| templates of a rectangular array | by distances | by rows and columns |
| trajectory | `rise` | its ends, and the blend's polynomial |
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.control.programme import (
    ALONG,
    ANGLE,
    HEIGHTS,
    NORMAL,
    Phases,
    Programme,
    Progress,
    advance,
    begin,
    measured,
    next_phase,
)
from gelbot.control.servo import filtered_rate, saturate, servo, slew
from gelbot.errors import BadInput
from gelbot.field.electrodes import Disc, Rod, hexagonal_array, rectangular_array, square_array
from gelbot.plan.templates import TEMPLATES, superposition, template
from gelbot.plan.trajectory import no_faster, rise
from gelbot.points import Observation

MM = 1e-3
KP, KV = 10.0 / MM, 0.5 / MM  # 10 V/mm, 0.5 V s/mm
ARRAY = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
finite = st.floats(-1e3, 1e3)


class TestServo:
    @given(finite, finite, finite, finite, finite)
    def test_equation_7(self, z, z_dot, reference, kp, kv):
        printed = kp * (z - reference) - kv * z_dot
        assert float(servo(z, z_dot, reference, kp, kv, -1.0)) == pytest.approx(printed, rel=1e-12, abs=1e-9)
        corrected = kp * (reference - z) - kv * z_dot
        assert float(servo(z, z_dot, reference, kp, kv, 1.0)) == pytest.approx(corrected, rel=1e-12, abs=1e-9)

    def test_corrected_pulls_to_the_reference_and_printed_away(self):
        """E > 0 lifts the centre: below its reference the body must be given E > 0."""
        assert float(servo(2 * MM, 0.0, 3 * MM, KP, KV, 1.0)) == pytest.approx(10.0)
        assert float(servo(4 * MM, 0.0, 3 * MM, KP, KV, 1.0)) == pytest.approx(-10.0)
        assert float(servo(2 * MM, 0.0, 3 * MM, KP, KV, -1.0)) == pytest.approx(-10.0)

    def test_both_signs_damp_a_rise(self):
        for sign in (1.0, -1.0):
            assert float(servo(3 * MM, 1 * MM, 3 * MM, KP, KV, sign)) == pytest.approx(-0.5)

    def test_closed_loop_of_an_integrator(self):
        """A centre that rises in proportion to E: the corrected law settles, the printed one runs away."""
        ends = {}
        for sign in (1.0, -1.0):
            z = z_dot = 0.0
            for _ in range(700):
                e = float(saturate(servo(z, z_dot, 1 * MM, KP, KV, sign), 10.0))
                z_dot = 0.05 * MM * e  # m/s per volt
                z += 0.02 * z_dot
            ends[sign] = z
        assert ends[1.0] == pytest.approx(1 * MM, rel=1e-2)
        assert ends[-1.0] < 0.0

    @given(finite, finite, st.floats(0.0, 1e3), st.floats(0.01, 1.0))
    def test_slew_is_the_nearest_that_the_rate_allows(self, wanted, last, rate, period):
        given_out = float(slew(wanted, last, rate, period))
        assert abs(given_out - last) <= rate * period * (1.0 + 1e-9) + 1e-9
        if abs(wanted - last) <= rate * period:
            assert given_out == wanted
        assert float(slew(wanted, last, INF, period)) == wanted

    def test_the_filter_is_a_first_order_low_pass(self):
        """A step goes through as 1 - exp(-t / T), where the period is short beside T; without T at once."""
        rate, period = 0.0, 0.01
        for _ in range(100):
            rate = float(filtered_rate(1.0, rate, 0.5, period))
        assert rate == pytest.approx(1.0 - np.exp(-2.0), rel=0.01)
        assert float(filtered_rate(1.0, 0.3, 0.0, period)) == pytest.approx(1.0)

    @given(st.floats(-1e9, 1e9), st.floats(0.0, 100.0))
    def test_the_supply_limits(self, amplitude, limit):
        given_out = float(saturate(amplitude, limit))
        assert abs(given_out) <= limit
        if abs(amplitude) <= limit:
            assert given_out == amplitude


INF = float("inf")
LOWS = {"heights": HEIGHTS, "tip_angles": ANGLE, "above": NORMAL, "along": ALONG}
HIGHS = {"normals": NORMAL, "contact": HEIGHTS + 1, "along_below": ALONG}


def programme(*ends: dict[str, float], amplitudes: tuple[float, ...] | None = None) -> Programme:
    """Phases that end as told (the last one included), each with a pattern and an amplitude of its own."""
    count = len(ends)
    lows, highs = np.full((count, 6), -INF), np.full((count, 6), INF)
    for k, end in enumerate(ends):
        for bounds, places in ((lows, LOWS), (highs, HIGHS)):
            for key in set(end) & set(places):
                bounds[k, places[key]] = end[key]
    volts = jnp.asarray(amplitudes or [10.0 - k for k in range(count)])
    following = jnp.minimum(jnp.arange(count) + 1, count - 1)
    phases = Phases(
        patterns=jnp.asarray(np.linspace(-1.0, 1.0, count * 4).reshape(count, 4)),
        profile_times=jnp.zeros((count, 1)),
        profile_volts=volts[:, None],
        uses_servo=jnp.zeros(count, bool),
        holds=jnp.full(count, jnp.nan),
        lows=jnp.asarray(lows),
        highs=jnp.asarray(highs),
        conditional=jnp.asarray([bool(set(end) - {"durations"}) for end in ends]),
        durations=jnp.asarray([end.get("durations", INF) for end in ends]),
        after_event=following,
        after_time=following,
    )
    followed = jnp.zeros((3, 3)).at[2, 0].set(1.0)  # the centre's height
    reference = jnp.array([0.0, 10.0]), jnp.array([0.0, 5 * MM])
    gains = map(jnp.asarray, (KP, KV, 1.0, INF, 0.0, 10.0, 0.1))
    return Programme(phases, followed, jnp.asarray(False), *reference, *gains)


def is_over(phases: Phases, progress: Progress, time, observation: Observation) -> bool:
    return _next(phases, progress, time, observation) != int(progress.phase)


def _next(phases: Phases, progress: Progress, time, observation: Observation) -> int:
    return int(next_phase(phases, progress, jnp.asarray(time), measured(observation, observation.centre[0])))


def seen(
    height: float = 0.0, tips: tuple[float, float] = (0.0, 0.0), normal: float = 1.0, low: float = 0.0, x: float = 0.0
) -> Observation:
    places = jnp.zeros((3, 2)).at[2].set(low)
    return Observation(jnp.array([x, 0.0, height]), jnp.array([0.0, 0.0, normal]), places, jnp.asarray(tips))


def at(phase: int, began: float = 0.0, height: float = 0.0) -> Progress:
    return Progress(jnp.asarray(phase), *map(jnp.asarray, (began, 0.0, height, 0.0, 0.0)))


class TestProgramme:
    @pytest.mark.parametrize(
        ("condition", "before", "after"),
        [
            ({"heights": 5 * MM}, seen(4.9 * MM), seen(5.0 * MM)),
            ({"tip_angles": 1.4}, seen(tips=(1.3, 1.2)), seen(tips=(0.1, 1.45))),
            ({"normals": -0.85}, seen(normal=-0.8), seen(normal=-0.9)),
            ({"above": 0.85}, seen(normal=0.8), seen(normal=0.9)),
            ({"along": 10 * MM}, seen(x=9.9 * MM), seen(x=10 * MM)),
            ({"along_below": 0.0}, seen(x=0.1 * MM), seen(x=0.0)),
            ({"contact": 1 * MM}, seen(low=1.1 * MM), seen(low=0.9 * MM)),
            ({"heights": 5 * MM, "tip_angles": 1.4}, seen(6 * MM, (1.3, 0.0)), seen(6 * MM, (1.5, 0.0))),
            ({"heights": 5 * MM, "tip_angles": 1.4}, seen(4 * MM, (1.5, 0.0)), seen(6 * MM, (1.5, 0.0))),
            ({"heights": 5 * MM, "normals": 0.0}, seen(6 * MM, normal=0.5), seen(6 * MM, normal=-0.5)),
        ],
        ids=[
            "height",
            "leading tip",
            "normal",
            "upright",
            "along",
            "along, back",
            "contact",
            "tip is missing",
            "height is missing",
            "normal is missing",
        ],
    )
    def test_ends_when_all_its_conditions_hold(self, condition, before, after):
        phases = programme(condition, {}).phases
        assert not is_over(phases, at(0), jnp.asarray(1.0), before)
        assert is_over(phases, at(0), jnp.asarray(1.0), after)

    def test_ends_when_it_is_old_whatever_its_conditions(self):
        phases = programme({"heights": 5 * MM, "durations": 3.0}, {}).phases
        assert not is_over(phases, at(0, began=2.0), jnp.asarray(4.9), seen())
        assert is_over(phases, at(0, began=2.0), jnp.asarray(5.0), seen())
        assert is_over(phases, at(0, began=2.0), jnp.asarray(2.0), seen(6 * MM))

    def test_a_phase_without_conditions_waits_for_its_time(self):
        phases = programme({"durations": 3.0}, {}).phases
        assert not is_over(phases, at(0), jnp.asarray(2.0), seen(1.0, (3.0,), -1.0))

    def test_the_last_phase_never_ends(self):
        phases = programme({"durations": 1.0}, {"durations": 1.0, "heights": 0.0}).phases
        assert not is_over(phases, at(1), jnp.asarray(1e9), seen(1.0))

    def test_phases_keep_their_order(self):
        plan = programme({"heights": 2 * MM}, {"durations": 1.0}, {"normals": -0.5}, {})
        progress = begin(plan, seen())
        story = []
        for k in range(60):
            z = 0.1 * MM * k
            normal = -1.0 if k > 45 else 1.0
            progress, voltages, command = advance(plan, progress, jnp.asarray(0.1 * k), seen(z, normal=normal))
            story.append(int(command.phase))
            expected = (10.0 - story[-1]) * plan.phases.patterns[story[-1]]
            assert np.asarray(voltages) == pytest.approx(np.asarray(expected))
        assert np.all(np.isin(np.diff(story), [0, 1]))
        assert story.index(1) == 20  # at 2 mm
        assert story.index(2) == 30  # a second later
        assert story.index(3) == 46  # when it lies on its back
        assert story[-1] == 3

    def test_servo_phase(self):
        plan = programme({}, {})
        plan = plan._replace(phases=plan.phases._replace(uses_servo=jnp.array([True, False])))
        progress = begin(plan, seen(1 * MM))
        # At 4 s the reference is 2 mm; the body rose 0.05 mm in the last period of 0.1 s.
        progress, voltages, command = advance(plan, progress, jnp.asarray(4.0), seen(1.05 * MM))
        expected = 10.0 * (2.0 - 1.05) - 0.5 * 0.5
        assert float(command.reference) == pytest.approx(2 * MM)
        assert float(command.amplitude) == pytest.approx(expected)
        assert np.asarray(voltages) == pytest.approx(expected * np.asarray(plan.phases.patterns[0]))
        assert float(progress.last_height) == pytest.approx(1.05 * MM)
        # Far below it: the supply's limit.
        _, _, command = advance(plan, progress, jnp.asarray(1e3), seen(1.05 * MM))
        assert float(command.amplitude) == pytest.approx(10.0)

    def test_servo_phase_that_holds_its_own_height(self):
        plan = programme({}, {})
        held = {"uses_servo": jnp.ones(2, bool), "holds": jnp.array([jnp.nan, 4 * MM])}
        plan = plan._replace(phases=plan.phases._replace(**held))
        for phase, reference in ((0, 2 * MM), (1, 4 * MM)):
            progress = at(phase, height=3.5 * MM)
            _, _, command = advance(plan, progress, jnp.asarray(4.0), seen(3.5 * MM))
            assert float(command.reference) == pytest.approx(reference)
            expected = np.clip(10.0 * (reference - 3.5 * MM) / MM, -10.0, 10.0)
            assert float(command.amplitude) == pytest.approx(expected)

    def test_an_event_and_the_time_may_lead_elsewhere(self):
        """A body that fell back is lifted again."""
        phases = programme({"heights": 2 * MM}, {"normals": -0.5, "durations": 5.0}, {}, {}).phases
        phases = phases._replace(after_event=jnp.array([1, 3, 3, 3]), after_time=jnp.array([1, 0, 3, 3]))
        assert _next(phases, at(1), 1.0, seen(normal=-0.9)) == 3
        assert _next(phases, at(1), 5.0, seen()) == 0
        assert _next(phases, at(1), 5.0, seen(normal=-0.9)) == 3

    def test_a_profile_is_linear_in_the_age_of_its_phase(self):
        plan = programme({"durations": 2.0}, {})
        times, volts = jnp.array([[0.0, 2.0], [0.0, 4.0]]), jnp.array([[1.0, 5.0], [0.0, 8.0]])
        plan = plan._replace(phases=plan.phases._replace(profile_times=times, profile_volts=volts))
        progress, given = begin(plan, seen()), []
        for time in (0.0, 1.0, 2.0, 4.0, 9.0):
            progress, _, command = advance(plan, progress, jnp.asarray(time), seen())
            given.append(float(command.amplitude))
        assert given == pytest.approx([1.0, 3.0, 0.0, 4.0, 8.0])

    def test_the_servo_follows_another_point_along_the_floor(self):
        """From where it was: the reference at 4 s is 2 mm to the right."""
        plan = programme({})
        along = jnp.zeros((3, 3)).at[0, 0].set(1.0)
        plan = plan._replace(
            phases=plan.phases._replace(uses_servo=jnp.array([True])), followed=along, from_start=jnp.asarray(True)
        )
        progress = begin(plan, seen(x=7 * MM))
        _, _, command = advance(plan, progress, jnp.asarray(4.0), seen(x=8.5 * MM))
        assert float(command.amplitude) == pytest.approx(10.0 * 0.5 - 0.5 * 15.0)

    def test_the_command_of_a_servo_is_limited_in_its_rate(self):
        plan = programme({})
        plan = plan._replace(phases=plan.phases._replace(uses_servo=jnp.array([True])), slew_rate=jnp.asarray(20.0))
        progress, given = begin(plan, seen()), []
        for k in range(4):
            progress, _, command = advance(plan, progress, jnp.asarray(1e3 + 0.1 * k), seen())
            given.append(float(command.amplitude))
        assert given == pytest.approx([2.0, 4.0, 6.0, 8.0])

    def test_the_limit_holds_for_fixed_amplitudes_too(self):
        plan = programme({}, amplitudes=(-25.0,))
        _, voltages, command = advance(plan, begin(plan, seen()), jnp.asarray(0.0), seen())
        assert float(command.amplitude) == -10.0
        assert float(jnp.max(jnp.abs(voltages))) <= 10.0

    def test_compiles(self):
        plan = programme({"heights": 2 * MM}, {})
        tick = jax.jit(advance)
        progress, _, command = tick(plan, begin(plan, seen()), jnp.asarray(0.0), seen(3 * MM))
        assert int(command.phase) == 1
        assert int(progress.phase) == 1


def pattern(name: str, x: float = 12.5 * MM, y: float = 12.5 * MM) -> np.ndarray:
    """A template as rows of the array, (4, 4)."""
    return template(name, ARRAY, np.array([x, y])).reshape(4, 4)


class TestTemplates:
    def test_ridge_is_the_diagonal_of_figure_6a(self):
        for k in (12.5 * MM, -12.5 * MM, 37.5 * MM):
            assert pattern("ridge", k, k) == pytest.approx(1.0 - 2.0 * np.eye(4))

    def test_crossed_ridge_of_figure_6b(self):
        rows = pattern("crossed-ridge")
        assert (rows < 0).sum() == 3
        assert np.argwhere(rows < 0).tolist() == [[1, 3], [2, 2], [3, 1]]

    def test_off_the_diagonal_the_ridge_is_shorter(self):
        assert (pattern("ridge", 12.5 * MM, -12.5 * MM) < 0).sum() == 3
        assert (pattern("ridge", 37.5 * MM, -37.5 * MM) < 0).sum() == 1
        assert (pattern("crossed-ridge", 12.5 * MM, -12.5 * MM) < 0).sum() == 4

    @pytest.mark.parametrize(("x", "y"), [(12.5, 12.5), (-12.5, 12.5), (37.5, 12.5), (-37.5, -12.5)])
    def test_mirror_images(self, x, y):
        x, y = x * MM, y * MM
        swapped = {"ridge": "crossed-ridge", "crossed-ridge": "ridge"}
        for name in ("ridge", "crossed-ridge", "cathode", "anode"):
            mirrored = swapped.get(name, name)
            assert pattern(mirrored, -x, y) == pytest.approx(pattern(name, x, y)[:, ::-1])
            assert pattern(mirrored, x, -y) == pytest.approx(pattern(name, x, y)[::-1])
            # The diagonal itself is a mirror that leaves the ridge a ridge.
            assert pattern(name, y, x) == pytest.approx(pattern(name, x, y).T)
        for name, opposite in (("plus", "minus"), ("minus", "plus")):
            assert pattern(opposite, -x, -y) == pytest.approx(pattern(name, x, y)[::-1, ::-1])

    def test_the_robot_lies_under_minus(self):
        for name in ("ridge", "crossed-ridge", "cathode"):
            assert pattern(name)[2, 2] == -1.0
        assert pattern("anode") == pytest.approx(-pattern("cathode"))
        assert (pattern("cathode") < 0).sum() == 1

    def test_the_nearest_electrode_is_the_robots(self):
        assert pattern("cathode", 15 * MM, 9 * MM) == pytest.approx(pattern("cathode"))

    def test_half_planes_and_plain_fields(self):
        down, right = np.meshgrid(np.arange(4), np.arange(4), indexing="ij")
        assert pattern("plus") == pytest.approx(np.where(down + right > 4, -1.0, 1.0))
        assert pattern("minus") == pytest.approx(np.where(down + right < 4, -1.0, 1.0))
        assert pattern("uniform")[0] == pytest.approx([-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0])
        assert np.ptp(pattern("uniform"), axis=0) == pytest.approx(np.zeros(4))
        assert not np.any(pattern("off"))

    def test_fields_along_and_across_the_ridge(self):
        right, up = np.meshgrid(np.arange(4) - 2.0, np.arange(4) - 2.0)
        assert pattern("along-ridge") == pytest.approx((right + up) / 4.0)
        assert pattern("across-ridge") == pytest.approx((right - up) / 3.0)

    def test_a_superposition_is_a_sum_within_bounds(self):
        robot = np.array([12.5, 12.5]) * MM
        both = superposition({"ridge": 0.5, "along-ridge": -0.3}, ARRAY, robot).reshape(4, 4)
        assert both == pytest.approx(0.5 * pattern("ridge") - 0.3 * pattern("along-ridge"))
        assert superposition({"ridge": 3.0}, ARRAY, robot).reshape(4, 4) == pytest.approx(pattern("ridge"))

    def test_all_are_shares_of_the_amplitude(self):
        for name in TEMPLATES:
            assert np.abs(pattern(name)).max() <= 1.0

    @given(st.integers(1, 6), st.integers(1, 6), st.floats(-80, 80), st.floats(-80, 80))
    def test_by_distances_as_by_rows_and_columns(self, rows, columns, x, y):
        array, robot = square_array(rows, columns, 10 * MM, 15 * MM, 15 * MM), np.array([x, y]) * MM
        row, column = np.divmod(np.arange(rows * columns), columns)
        home = int(np.argmin(np.linalg.norm(array.centres[:2] - robot[:, None], axis=0)))
        down, right = row - row[home], column - column[home]
        minus = {
            "ridge": down == right,
            "crossed-ridge": down == -right,
            "cathode": (down == 0) & (right == 0),
            "anode": (down != 0) | (right != 0),
            "plus": down + right > 0,
            "minus": down + right < 0,
        }
        for name, cathodes in minus.items():
            assert np.array_equal(template(name, array, robot), np.where(cathodes, -1.0, 1.0)), name
        uniform = np.linspace(-1.0, 1.0, columns)[column] if columns > 1 else np.zeros(rows)
        assert template("uniform", array, robot) == pytest.approx(uniform)

    def test_of_a_hexagonal_array(self):
        """The rows at 60 deg come closest to the diagonals: the two neighbours up to the right and down to the left."""
        array, robot = hexagonal_array(Disc(5 * MM), 5, 5, 10 * MM, 15 * MM), np.zeros(2)
        home = int(np.argmin(np.linalg.norm(array.centres[:2], axis=0)))
        offset = array.centres[:2] - array.centres[:2, home, None]
        near = np.linalg.norm(offset, axis=0) < 11 * MM
        for name, direction in (("ridge", np.pi / 3), ("crossed-ridge", 2 * np.pi / 3)):
            along = 10 * MM * np.array([np.cos(direction), np.sin(direction)])
            expected = [np.linalg.norm(offset.T - k * along, axis=1) < 1e-9 for k in (-1, 0, 1)]
            assert np.array_equal(near & (template(name, array, robot) < 0), np.any(expected, axis=0)), name
        assert (template("cathode", array, robot) < 0).sum() == 1
        assert np.ptp(template("uniform", array, robot)) == pytest.approx(2.0)

    def test_half_planes_leave_out_the_crossed_ridge(self):
        for array in (ARRAY, hexagonal_array(Disc(5 * MM), 4, 6, 10 * MM, 15 * MM)):
            names = ("plus", "minus", "crossed-ridge")
            minus = np.array([template(name, array, np.array([3 * MM, 8 * MM])) < 0 for name in names])
            assert np.array_equal(minus.sum(axis=0), np.ones(array.count))

    def test_a_single_electrode_and_some_above_each_other(self):
        one = rectangular_array(Rod(2 * MM, 9 * MM), 1, 1, (0.0, 0.0), 15 * MM)
        assert [template(name, one, np.zeros(2))[0] for name in TEMPLATES] == [-1, -1, -1, 1, 1, 1, 0, 0, 0, 0]
        column = square_array(3, 1, 10 * MM, 15 * MM, 15 * MM)
        assert not np.any(template("uniform", column, np.zeros(2)))

    def test_unknown_name(self):
        with pytest.raises(BadInput, match="crossed-ridge"):
            pattern("rigde")


class TestTrajectory:
    @given(st.floats(0.0, 1e-2), st.floats(0.0, 1e-2), st.floats(0.1, 100.0), st.floats(0.0, 1.0))
    def test_ends(self, low, high, duration, rounding):
        times, heights = rise(low, high, duration, rounding)
        assert (times[0], times[-1]) == pytest.approx((0.0, duration))
        assert (heights[0], heights[-1]) == pytest.approx((low, high), abs=1e-12)
        assert np.all(np.diff(heights) * np.sign(high - low) >= -1e-15)

    def test_straight_line(self):
        times, heights = rise(1 * MM, 5 * MM, 40.0, rounding=0.0)
        assert heights == pytest.approx(1 * MM + 4 * MM * times / 40.0)

    def test_no_faster_delays_what_is_too_fast_and_nothing_else(self):
        times, values = no_faster(np.array([0.0, 1.0, 5.0]), np.array([0.0, 4.0, 5.0]), 2.0)
        assert times == pytest.approx([0.0, 2.0, 6.0])
        assert values == pytest.approx([0.0, 4.0, 5.0])
        times, values = no_faster(*rise(0.0, 5 * MM, 10.0), 0.5 * MM)
        assert np.abs(np.diff(values) / np.diff(times)).max() <= 0.5 * MM * (1.0 + 1e-9)

    def test_minimum_jerk(self):
        times, heights = rise(0.0, 1.0, 1.0, rounding=1.0, count=2001)
        assert heights == pytest.approx(10 * times**3 - 15 * times**4 + 6 * times**5, abs=1e-12)
        velocity = np.gradient(heights, times)
        acceleration = np.gradient(velocity, times)
        assert abs(velocity[[0, -1]]).max() < 1e-3
        assert abs(acceleration[[0, -1]]).max() < 0.05
        assert velocity.max() == pytest.approx(1.875, rel=1e-4)  # 15/8 of the mean, in the middle
        assert heights[1000] == pytest.approx(0.5)
