"""The field: panels, charges, images, lead field.

| identity | one road | the other |
|---|---|---|
| panel | closed form | numerical integral; a point charge, far away |
| square plate alone | influence matrix | C = 0.36679 * 4 pi eps a (Read 1997) |
| two plates far apart | `solve` | R = 2 R_1 - 1 / (2 pi sigma d) |
| square plate flush in an insulating plane | image in a floor through the plate | R = 0.4339 / (sigma a) |
| insulated tank | sum of the currents; equal voltages | 0 |
| reciprocity, dissipation | conductance matrix | its transpose; no negative eigenvalue |
| no flux through floor, lid, walls | normal derivative there | 0 |
| superposition, scaling, symmetry of the array | one solve | another |
| far away | potential of a neutral array, r and 2 r | at least a factor of 4 |
| lead field | spline | finite differences of the direct sum; no curl; no divergence |
| sign | current under a cathode | rises |
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from gelbot.field.charge import CLOSED_FORM_DISTANCE, FieldSolution, build_problem, solve
from gelbot.field.electrodes import ElectrodeArray, panels_of, square_array
from gelbot.field.images import Tank, images
from gelbot.field.lead_field import LeadField, build_lead_field, current_density, potential_coefficients
from gelbot.field.panel import point_potential, square_potential

MM = 1e-3
SQUARE_CAPACITANCE = 0.36679  # of the unit square plate, over 4 pi eps
HOME = 10  # the electrode at (12.5, 12.5) mm


def direct_lead(solution: FieldSolution, points: np.ndarray, step: float = 2e-5) -> np.ndarray:
    """-sigma grad phi_e by central differences of the summed potential, shape (e, 3, p)."""
    shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
    both = solution.lead_potential(np.concatenate([points + h[:, None] for h in shifts], axis=1))
    plus, minus = np.split(both.reshape(len(both), 6, -1), 2, axis=1)
    return -solution.problem.conductivity * (plus - minus) / (2.0 * step)


def direct_current(solution: FieldSolution, voltages: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Current density [A/m^2] without the spline, shape (3, p)."""
    return np.tensordot(voltages, direct_lead(solution, points), 1)


def plate(side: float = 1.0, height: float = 0.0) -> ElectrodeArray:
    return ElectrodeArray(np.zeros((2, 1)), side, height, 1, 1)


class TestPanel:
    @pytest.mark.parametrize(
        "offset",
        [
            (0.3, 0.2, 0.4),
            (0.3, 0.2, -0.4),
            (-0.1, 0.4, -2.0),
            (0.0, 0.0, 0.05),
            (0.0, 0.0, -0.05),
            (1.5, -0.7, 0.0),
            (1.5, -0.7, 1e-3),
            (-0.5, 0.5, -0.7),
            (0.5, 2.0, 0.3),
        ],
        ids=str,
    )
    def test_closed_form_is_the_integral(self, offset):
        a = 1.0
        x, y, z = offset
        integral, _ = dblquad(
            lambda s, t: 1.0 / np.sqrt((x - s) ** 2 + (y - t) ** 2 + z**2), -a / 2, a / 2, -a / 2, a / 2, epsabs=1e-9
        )
        assert float(square_potential(jnp.array(offset), a)) == pytest.approx(integral / a**2, rel=1e-6)

    def test_on_the_panel_itself(self):
        """Middle 4 asinh(1) / a, corner half of it, edge's middle by the two halves' corners: all finite."""
        a = 2.0
        assert float(square_potential(jnp.zeros(3), a)) == pytest.approx(4.0 * np.arcsinh(1.0) / a)
        assert float(square_potential(jnp.array([a / 2, a / 2, 0.0]), a)) == pytest.approx(2.0 * np.arcsinh(1.0) / a)
        # Two rectangles a/2 x a meet at the middle of an edge; each has its corner there.
        edge = 2.0 * (np.arcsinh(0.5) * a + np.arcsinh(2.0) * a / 2.0) / a**2
        assert float(square_potential(jnp.array([a / 2, 0.0, 0.0]), a)) == pytest.approx(edge)

    @given(st.floats(-3, 3), st.floats(-3, 3), st.floats(1e-3, 3))
    def test_both_faces_and_all_corners_are_alike(self, x, y, z):
        values = [
            float(square_potential(jnp.array([sx * x, sy * y, sz * z]), 1.0))
            for sx in (1, -1)
            for sy in (1, -1)
            for sz in (1, -1)
        ]
        assert values == pytest.approx([values[0]] * 8, rel=1e-9)

    def test_far_away_it_is_a_point(self, rng):
        directions = rng.normal(size=(3, 50))
        for distance in (CLOSED_FORM_DISTANCE, 2.0 * CLOSED_FORM_DISTANCE):
            offset = jnp.asarray(distance * directions / np.linalg.norm(directions, axis=0))
            error = np.abs(square_potential(offset, 1.0) / point_potential(offset) - 1.0)
            # The quadrupole of a square, (a / r)^2 (3 sin^2 - 2) / 24: largest on the axis.
            assert error.max() < 1.05 / 12.0 / distance**2

    def test_potential_is_harmonic_off_the_panel(self):
        laplacian = jnp.trace(jax.hessian(lambda p: square_potential(p, 1.0))(jnp.array([0.2, -0.3, -0.5])))
        assert abs(float(laplacian)) < 1e-9

    def test_flux_of_the_unit_charge(self):
        """Just below and above, the slope jumps by -4 pi times the charge density."""
        slope = jax.grad(lambda p: square_potential(p, 1.0))
        jump = slope(jnp.array([0.1, 0.2, 1e-7]))[2] - slope(jnp.array([0.1, 0.2, -1e-7]))[2]
        assert float(jump) == pytest.approx(-4.0 * np.pi, rel=1e-5)


class TestPlates:
    def capacitance(self, per_side: int) -> float:
        problem = build_problem(plate(), Tank(floor=None), 1.0, per_side)
        return float(np.linalg.solve(problem.influence, np.ones(per_side**2)).sum()) / (4.0 * np.pi)

    def test_capacitance_of_a_square_plate(self):
        values = np.array([self.capacitance(n) for n in (4, 8, 16)])
        missing = SQUARE_CAPACITANCE - values
        assert np.all(missing > 0.0)
        rate = np.log2(missing[:-1] / missing[1:])
        assert np.all(rate > 0.9), rate
        extrapolated = 2.0 * values[2] - values[1]
        assert extrapolated == pytest.approx(SQUARE_CAPACITANCE, rel=0.01)

    def test_default_panels_see_the_plate_within_four_per_cent(self):
        assert self.capacitance(8) == pytest.approx(SQUARE_CAPACITANCE, rel=0.04)

    def test_two_plates_far_apart(self):
        side, distance, sigma, n = 0.01, 2.0, 0.15, 16
        array = ElectrodeArray(np.array([[-distance / 2, distance / 2], [0.0, 0.0]]), side, 0.0, 1, 2)
        g = solve(build_problem(array, Tank(floor=None), sigma, n)).conductance
        alone = 1.0 / (4.0 * np.pi * sigma * self.capacitance(n) * side)
        between = 2.0 * alone - 2.0 / (4.0 * np.pi * sigma * distance)
        # One volt between them: half a volt up, half a volt down.
        assert (g @ np.array([0.5, -0.5])) == pytest.approx([1.0 / between, -1.0 / between], rel=1e-5)

    def test_plate_flush_in_an_insulating_plane(self):
        side, sigma = 0.01, 0.15
        resistance = []
        for n in (8, 16):
            problem = build_problem(plate(side), Tank(floor=0.0), sigma, n)
            # The mirror image lies on the plate: only one half of the influence's current enters the upper half space.
            resistance.append(1.0 / float(np.linalg.solve(problem.influence, np.ones(n * n)).sum()))
        extrapolated = 1.0 / (2.0 / resistance[1] - 1.0 / resistance[0])
        assert extrapolated == pytest.approx(0.4339 / (sigma * side), rel=0.01)

    def test_panels_cover_their_plates(self):
        array = square_array(2, 3, 10 * MM, 15 * MM, 15 * MM)
        panels = panels_of(array, 4)
        assert len(panels.electrode) * panels.side**2 == pytest.approx(6 * (10 * MM) ** 2)
        for e in range(array.count):
            mine = panels.centres[:, panels.electrode == e]
            assert mine.mean(axis=1) == pytest.approx([*array.centres[:, e], 15 * MM])
            assert np.ptp(mine[0]) + panels.side == pytest.approx(10 * MM)

    def test_array_of_the_figure(self):
        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        assert array.pitch == pytest.approx(25 * MM)
        assert array.centres.mean(axis=1) == pytest.approx([0.0, 0.0])
        assert array.centres[:, HOME] == pytest.approx([12.5 * MM, 12.5 * MM])
        assert array.centres[:, 1] - array.centres[:, 0] == pytest.approx([25 * MM, 0.0])
        assert plate(0.01).pitch == pytest.approx(0.01)


class TestConductance:
    def test_reciprocity(self, array_field):
        g = array_field.conductance
        assert np.abs(g - g.T).max() < 1e-10 * np.abs(g).max()

    def test_no_current_is_lost_and_equal_voltages_drive_none(self, array_field):
        g = array_field.conductance
        assert np.abs(g.sum(axis=0)).max() < 1e-10 * np.abs(g).max()
        assert np.abs(g @ np.ones(16)).max() < 1e-10 * np.abs(g).max()

    def test_dissipation(self, array_field):
        g = array_field.conductance
        values = np.linalg.eigvalsh(g)
        assert values[0] > -1e-10 * values[-1]
        assert values[1] > 1e-3 * values[-1]  # only equal voltages dissipate nothing
        assert g[~np.eye(16, dtype=bool)].max() < 0.0
        assert np.diag(g).min() > 0.0

    def test_equal_voltages_lift_the_bulk(self, array_field, rng):
        points = rng.uniform(-20 * MM, 20 * MM, (3, 20)) * np.array([[1.0], [1.0], [0.2]])
        assert np.ones(16) @ array_field.lead_potential(points) == pytest.approx(np.ones(20), rel=1e-10)
        assert array_field.bulk_potential.sum() == pytest.approx(1.0)

    def test_boundary_values(self, array_field):
        panels = array_field.problem.panels
        at_plates = array_field.lead_potential(panels.centres)
        assert at_plates == pytest.approx((np.arange(16)[:, None] == panels.electrode).astype(float), abs=1e-10)

    def test_potential_lies_between_the_voltages(self, array_field, rng):
        voltages = rng.uniform(-10.0, 10.0, 16)
        points = rng.uniform([[-60 * MM], [-60 * MM], [-1 * MM]], [[60 * MM], [60 * MM], [60 * MM]], (3, 500))
        phi = voltages @ array_field.lead_potential(points)
        assert phi.max() < voltages.max()
        assert phi.min() > voltages.min()

    def test_symmetries_of_the_array(self, array_field):
        g, number = array_field.conductance, np.arange(16).reshape(4, 4)
        for image in (number.T, number[::-1], number[:, ::-1], np.rot90(number)):
            p = image.ravel()
            assert np.abs(g[np.ix_(p, p)] - g).max() < 1e-10 * np.abs(g).max()

    @pytest.mark.parametrize(("stretch", "sigma"), [(1.0, 0.3), (2.5, 0.15), (0.1, 1.0)])
    def test_scaling(self, stretch, sigma, rng):
        """Conductance goes as sigma and length; the lead potential belongs to the shape alone."""

        def shape(s: float, conductivity: float) -> FieldSolution:
            array = square_array(2, 2, s * 10 * MM, s * 15 * MM, s * 15 * MM)
            return solve(build_problem(array, Tank(floor=-s * MM, surface=s * 30 * MM), conductivity, 3))

        one, other = shape(1.0, 0.15), shape(stretch, sigma)
        assert other.conductance == pytest.approx(one.conductance * stretch * sigma / 0.15, rel=1e-9)
        points = rng.uniform(0.0, 12 * MM, (3, 30))
        assert other.lead_potential(stretch * points) == pytest.approx(one.lead_potential(points), rel=1e-9)

    def test_a_neutral_array_is_not_seen_from_afar(self, array_field, rng):
        voltages = rng.uniform(-10.0, 10.0, 16)
        direction = np.array([0.48, 0.6, 0.64])
        points = np.outer(direction, [1.0, 2.0, 4.0])
        seen = np.abs(voltages @ array_field.lead_potential(points) - voltages @ array_field.bulk_potential)
        assert np.all(seen[:-1] / seen[1:] > 3.9)  # 1/r^2 or faster, where a charge would give 2


class TestImages:
    def flux(self, solution: FieldSolution, voltages: np.ndarray, points: np.ndarray, axis: int) -> float:
        """Largest normal current density over the largest of all at `points`, relative to that under the array."""
        scale = np.abs(direct_current(solution, voltages, np.array([[12.5 * MM], [12.5 * MM], [5 * MM]]))).max()
        return float(np.abs(direct_current(solution, voltages, points)[axis]).max() / scale)

    def test_no_flux_through_the_floor(self, array_field, monkeypatch, rng):
        points = np.stack([*rng.uniform(-40 * MM, 40 * MM, (2, 40)), np.full(40, -1 * MM)])
        voltages = rng.uniform(-10, 10, 16)
        # Far images count as points, half a per cent off: what crosses the floor is of that order.
        assert self.flux(array_field, voltages, points, 2) < 0.005
        # With the closed form throughout, image and source are mirror images to rounding.
        monkeypatch.setattr("gelbot.field.charge.CLOSED_FORM_DISTANCE", 1e6)
        exact = solve(build_problem(array_field.problem.array, array_field.problem.tank, 0.15, 3))
        assert self.flux(exact, voltages, points, 2) < 1e-9

    def test_no_flux_through_floor_and_lid(self, rng):
        solution = solve(build_problem(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), Tank(-1 * MM, 30 * MM), 0.15, 3))
        voltages = rng.uniform(-10, 10, 16)
        for z in (-1 * MM, 30 * MM):
            points = np.stack([*rng.uniform(-40 * MM, 40 * MM, (2, 40)), np.full(40, z)])
            assert self.flux(solution, voltages, points, 2) < 0.03  # four reflections

    def test_no_flux_through_walls(self, rng):
        tank = Tank(-1 * MM, None, (110 * MM, 130 * MM))
        solution = solve(build_problem(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), tank, 0.15, 2))
        voltages = rng.uniform(-10, 10, 16)
        for side in (-1.0, 1.0):
            along, up = rng.uniform(-50 * MM, 50 * MM, 30), rng.uniform(0.0, 20 * MM, 30)
            assert self.flux(solution, voltages, np.stack([np.full(30, side * 55 * MM), along, up]), 0) < 0.01
            assert self.flux(solution, voltages, np.stack([along, np.full(30, side * 65 * MM), up]), 1) < 0.01

    def test_four_reflections_are_enough(self, rng):
        """Two per cent of the largest current at the gel, with a lid 30 mm up; ten reflections leave a sixth of it."""
        array, voltages = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), rng.uniform(-10, 10, 16)
        points = rng.uniform([[-40 * MM], [-40 * MM], [0.0]], [[40 * MM], [40 * MM], [10 * MM]], (3, 60))
        currents = [
            direct_current(solve(build_problem(array, Tank(-1 * MM, 30 * MM, None, order), 0.15, 2)), voltages, points)
            for order in (4, 10, 30)
        ]
        scale = np.linalg.norm(currents[-1], axis=0).max()
        errors = [np.linalg.norm(c - currents[-1], axis=0).max() / scale for c in currents[:2]]
        assert errors[0] < 0.02
        assert errors[1] < errors[0] / 3.0

    @pytest.mark.parametrize(
        ("tank", "count"),
        [
            (Tank(None), 1),
            (Tank(-1 * MM), 2),
            (Tank(None, 30 * MM), 2),
            (Tank(-1 * MM, 30 * MM, order=3), 7),
            (Tank(-1 * MM, None, (1.0, 1.0), order=1), 18),
        ],
    )
    def test_how_many_images(self, tank, count):
        found = images(tank)
        assert len(found) == count
        assert found[0].sign == pytest.approx(np.ones(3))
        assert found[0].shift == pytest.approx(np.zeros(3))

    def test_images_lie_behind_the_boundaries(self):
        tank, point = Tank(-1 * MM, 30 * MM, (0.1, 0.2)), np.array([10 * MM, -20 * MM, 15 * MM])
        low, high = np.array([-0.05, -0.1, -1 * MM]), np.array([0.05, 0.1, 30 * MM])
        for image in images(tank)[1:]:
            place = image.sign * point + image.shift
            assert np.any((place < low) | (place > high))

    def test_an_insulating_floor_cuts_the_vertical_current(self):
        """A floor 1 mm under the gel lowers the current under the cathode several times: no small correction."""
        array, home = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), np.array([[12.5 * MM], [12.5 * MM], [0.5 * MM]])
        voltages = np.where(np.arange(16) == HOME, -10.0, 10.0)
        rising = [
            direct_current(solve(build_problem(array, Tank(floor), 0.15, 4)), voltages, home)[2, 0]
            for floor in (None, -1 * MM)
        ]
        assert rising[0] / rising[1] > 2.5

    @settings(max_examples=10)
    @given(st.integers(0, 15))
    def test_under_a_cathode_the_current_rises(self, array_field, electrode):
        """THE SIGN: voltages -E on one electrode, +E elsewhere, E > 0; the current enters the gel's lower face."""
        x, y = array_field.problem.array.centres[:, electrode]
        voltages = np.where(np.arange(16) == electrode, -10.0, 10.0)
        for z in (0.0, 0.4 * MM, 0.8 * MM):
            i = direct_current(array_field, voltages, np.array([[x], [y], [z]]))
            assert i[2, 0] > 0.0
            assert direct_current(array_field, -voltages, np.array([[x], [y], [z]]))[2, 0] == pytest.approx(-i[2, 0])

    def test_superposition(self, array_field, rng):
        a, b = rng.uniform(-10, 10, (2, 16))
        points = rng.uniform(0.0, 10 * MM, (3, 10))
        total = direct_current(array_field, a + 2.0 * b, points)
        parts = direct_current(array_field, a, points) + 2.0 * direct_current(array_field, b, points)
        assert total == pytest.approx(parts, rel=1e-6, abs=1e-6 * np.abs(total).max())


LOW, HIGH = np.array([2 * MM, 2 * MM, -0.5 * MM]), np.array([23 * MM, 23 * MM, 12 * MM])


class TestLeadField:
    @pytest.fixture(scope="class")
    @staticmethod
    def lead(array_field) -> LeadField:
        return build_lead_field(array_field, LOW, HIGH, 1 * MM)

    @pytest.fixture(scope="class")
    @staticmethod
    def points() -> np.ndarray:
        return np.random.default_rng(4).uniform(LOW[:, None], HIGH[:, None], (3, 400))

    def error(self, lead: LeadField, solution: FieldSolution, points: np.ndarray) -> float:
        """Worst error over 3 random sets of voltages, relative to the largest current density at `points`."""
        worst, direct = 0.0, direct_lead(solution, points)
        for voltages in np.random.default_rng(5).uniform(-10, 10, (3, 16)):
            exact = np.tensordot(voltages, direct, 1)
            spline = current_density(lead, potential_coefficients(lead, jnp.asarray(voltages)), jnp.asarray(points))
            error = np.linalg.norm(np.asarray(spline) - exact, axis=0).max()
            worst = max(worst, float(error / np.linalg.norm(exact, axis=0).max()))
        return worst

    def test_interpolates_to_a_thousandth_where_the_gel_moves(self, lead, array_field, points):
        """Up to 9 mm, 6 mm under the plates, with 1 mm between grid points."""
        assert self.error(lead, array_field, points[:, points[2] < 9 * MM]) < 1e-3

    def test_interpolates_to_a_hundredth_up_to_3_mm_under_the_plates(self, lead, array_field, points):
        assert self.error(lead, array_field, points) < 1e-2

    @pytest.mark.slow
    def test_a_fine_grid_interpolates_to_a_thousandth_everywhere(self, array_field, points):
        assert self.error(build_lead_field(array_field, LOW, HIGH, 0.5 * MM), array_field, points) < 1e-3

    def test_converges_with_the_third_order(self, lead, array_field, points):
        inner = points[:, (points[2] < 9 * MM) & (points[2] > 1 * MM)]
        coarse = build_lead_field(array_field, LOW, HIGH, 2 * MM)
        rate = np.log2(self.error(coarse, array_field, inner) / self.error(lead, array_field, inner))
        assert rate > 2.5

    def test_meets_the_sum_at_grid_points_to_rounding(self, lead, array_field):
        """A cubic spline's slope at its knots is of higher order than between them."""
        k = np.array([[6, 9, 12], [5, 8, 13], [3, 5, 7]])
        points = LOW[:, None] + 1 * MM * k
        assert self.error(lead, array_field, points) < 5e-4

    def test_no_curl_and_little_divergence(self, lead, rng):
        coefficients = potential_coefficients(lead, jnp.asarray(rng.uniform(-10, 10, 16)))

        def i(p):
            return current_density(lead, coefficients, p[:, None])[:, 0]

        for _ in range(5):
            p = jnp.asarray(rng.uniform(LOW + 2 * MM, HIGH - 4 * MM))
            slope = np.asarray(jax.jacfwd(i)(p))
            assert np.abs(slope - slope.T).max() < 1e-9 * np.abs(slope).max()
            assert abs(np.trace(slope)) < 0.03 * np.abs(slope).max()

    def test_superposition_to_rounding(self, lead, points, rng):
        a, b = jnp.asarray(rng.uniform(-10, 10, (2, 16)))

        def i(voltages):
            return np.asarray(current_density(lead, potential_coefficients(lead, voltages), jnp.asarray(points)))

        assert i(2.0 * a - b) == pytest.approx(2.0 * i(a) - i(b), rel=1e-9, abs=1e-9)
        assert i(jnp.ones(16)) == pytest.approx(np.zeros(points.shape), abs=1e-7)

    def test_outside_the_box_the_nearest_point_counts(self, lead, rng):
        coefficients = potential_coefficients(lead, jnp.asarray(rng.uniform(-10, 10, 16)))
        far = jnp.array([[40 * MM], [10 * MM], [-5 * MM]])
        rim = jnp.array([[HIGH[0]], [10 * MM], [LOW[2]]])
        assert current_density(lead, coefficients, far) == pytest.approx(current_density(lead, coefficients, rim))

    def test_rises_under_the_cathode(self, lead):
        voltages = jnp.where(jnp.arange(16) == HOME, -10.0, 10.0)
        home = jnp.array([[12.5 * MM], [12.5 * MM], [0.4 * MM]])
        assert float(current_density(lead, potential_coefficients(lead, voltages), home)[2, 0]) > 0.0
