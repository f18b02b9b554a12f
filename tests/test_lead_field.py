"""The lead field: what is read from the table against the sum over all charges, and against itself.

| identity | one road | the other |
|---|---|---|
| spline and its derivatives | `evaluate` | scipy's tensor product of B-splines |
| current density | spline's slope | the sum's own gradient: panels; point charges |
| order of convergence | cells of one size and of half that | error falls with the third power or more |
| at grid points | potential of the table | the sum, to rounding |
| i has a potential | curl | 0 |
| charge is conserved | divergence | 0, to the order of the spline |
| gradient of i | closed form | differences; `jax.jacfwd`, `jax.jacrev` |
| superposition | one solve for a sum of voltages | sum of two |
| connected electrodes | table of the connected ones | T @ voltages |
| batch | all robots at once | one after the other |
| single precision | float32 | float64 |
"""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from gelbot.field.charge import FieldSolution
from gelbot.field.lead_field import (
    LeadField,
    build_lead_field,
    current_density,
    current_density_gradient,
    potential,
    potential_coefficients,
    working_volume,
)
from gelbot.field.spline import Grid, evaluate

MM = 1e-3
HOME = 10
LOW, HIGH = np.array([2 * MM, 2 * MM, 0.0]), np.array([23 * MM, 23 * MM, 12 * MM])
VOLTAGES = np.vstack([np.random.default_rng(5).uniform(-10, 10, (3, 16)), np.where(np.arange(16) == HOME, -10.0, 10.0)])


class PointCharges:
    """Four plates made of point charges, dense towards the edges, with their images below a floor: exactly harmonic."""

    problem = SimpleNamespace(conductivity=0.15)

    def __init__(self) -> None:
        across = -5 * MM * np.cos(np.pi * (np.arange(10) + 0.5) / 10)
        plate = np.stack([*(g.ravel() for g in np.meshgrid(across, across)), np.full(100, 15 * MM)])
        centres = [(0.0, 0.0), (25 * MM, 0.0), (0.0, 25 * MM), (25 * MM, 25 * MM)]
        above = np.stack([plate + np.array([[x], [y], [0.0]]) for x, y in centres])
        below = above * np.array([[1.0], [1.0], [-1.0]]) - np.array([[0.0], [0.0], [2 * MM]])
        self.charges = np.concatenate([above, below], axis=2)

    def offsets(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = points[None, :, :, None] - self.charges[:, :, None]
        return offset, np.sqrt(np.sum(offset**2, axis=1))

    def lead_potential(self, points: np.ndarray) -> np.ndarray:
        return 1e-5 * np.sum(1.0 / self.offsets(points)[1], axis=2)

    def lead_current_density(self, points: np.ndarray) -> np.ndarray:
        offset, distance = self.offsets(points)
        return 0.15e-5 * np.sum(offset / distance[:, None] ** 3, axis=3)


@pytest.fixture(scope="module")
def charges() -> PointCharges:
    return PointCharges()


@pytest.fixture(scope="module")
def lead(array_field) -> LeadField:
    return build_lead_field(array_field, LOW, HIGH, 1 * MM)


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """Anywhere in the working volume, and as many right below the edges of a plate."""
    rng = np.random.default_rng(4)
    anywhere = rng.uniform(LOW[:, None], HIGH[:, None], (3, 300))
    edge = np.stack(
        [rng.normal(7.5 * MM, 1 * MM, 300), rng.uniform(6 * MM, 19 * MM, 300), rng.uniform(0, 12 * MM, 300)]
    )
    return np.concatenate([anywhere, edge], axis=1)


def error(lead: LeadField, solution: FieldSolution | PointCharges, points: np.ndarray) -> np.ndarray:
    """Largest error at each of `points` over some sets of voltages, relative to the largest current density at any."""
    direct = solution.lead_current_density(points)
    worst = np.zeros(points.shape[1])
    for voltages in VOLTAGES[:, : len(direct)]:
        exact = np.tensordot(voltages, direct, 1)
        found = current_density(lead, potential_coefficients(lead, jnp.asarray(voltages)), jnp.asarray(points))
        worst = np.maximum(worst, np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0).max())
    return worst


class TestSpline:
    @pytest.mark.parametrize("order", [(0, 0, 0), (1, 0, 0), (0, 2, 1), (3, 0, 1), (0, 0, 3)])
    def test_is_a_tensor_product_of_b_splines(self, rng, order):
        coefficients, places = rng.normal(size=(7, 6, 8)), rng.uniform(0, [[4], [3], [5]], (3, 50))
        exact = coefficients
        for axis, times in enumerate(order):
            count = coefficients.shape[axis]
            basis = BSpline(np.arange(-3.0, count + 1), np.eye(count), 3)(places[axis], nu=times)
            subscripts = ("xyz,px->pyz", "pyz,py->pz", "pz,pz->p")[axis]
            exact = np.einsum(subscripts, exact, basis)
        grid = Grid(jnp.array([1.0, -2.0, 0.5]), jnp.array([0.5, 0.25, 2.0]))
        points = grid.origin[:, None] + grid.spacing[:, None] * places
        found = evaluate(jnp.asarray(coefficients), grid, points, (order,))[0]
        exact = exact / np.prod(grid.spacing ** np.array(order))
        assert found == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())


class TestAccuracy:
    def test_a_thousandth_of_the_largest_current_density_everywhere(self, lead, array_field, points):
        """3 mm under the plates too; a tenth of that in the lower third, where the gel lies."""
        found = error(lead, array_field, points)
        assert found.max() < 1e-3
        assert found[points[2] < 4 * MM].max() < 1e-4

    def test_converges_with_the_third_order_up_to_the_edges_of_the_box(self, charges, points):
        errors = [error(build_lead_field(charges, LOW, HIGH, h * MM), charges, points) for h in (2, 1)]
        coarse, fine = (np.sqrt(np.mean(found**2)) for found in errors)
        assert np.log2(coarse / fine) > 2.8

    def test_meets_the_sum_at_grid_points(self, lead, array_field, rng):
        grid = LOW[:, None] + 1 * MM * rng.integers(0, [[22], [22], [13]], (3, 40))
        for voltages in VOLTAGES:
            exact = voltages @ array_field.lead_potential(grid)
            found = potential(lead, potential_coefficients(lead, jnp.asarray(voltages)), jnp.asarray(grid))
            assert found == pytest.approx(exact, abs=1e-9)

    def test_no_curl_and_little_divergence(self, lead, rng):
        coefficients = potential_coefficients(lead, jnp.asarray(VOLTAGES[0]))
        inside = jnp.asarray(rng.uniform(LOW[:, None], [[23 * MM], [23 * MM], [9 * MM]], (3, 50)))
        slope = np.asarray(jax.jit(jax.jacfwd(lambda p: current_density(lead, coefficients, p).sum(axis=1)))(inside))
        slope = np.moveaxis(slope, 2, 0)
        largest = np.abs(slope).max()
        assert np.abs(slope - slope.transpose(0, 2, 1)).max() < 1e-12 * largest
        assert np.abs(np.trace(slope, axis1=1, axis2=2)).max() < 0.03 * largest

    def test_float32_is_good_to_a_hundred_thousandth(self, lead, points):
        single = LeadField(*(jnp.asarray(part, jnp.float32) for part in lead))
        for voltages in VOLTAGES:
            exact, found = (
                current_density(
                    field, potential_coefficients(field, jnp.asarray(voltages, kind)), jnp.asarray(points, kind)
                )
                for field, kind in ((lead, jnp.float64), (single, jnp.float32))
            )
            assert found.dtype == jnp.float32
            assert found == pytest.approx(np.asarray(exact), abs=1e-5 * np.abs(exact).max())


class TestSuperposition:
    def test_to_rounding(self, lead, points, rng):
        a, b = jnp.asarray(rng.uniform(-10, 10, (2, 16)))

        def i(voltages):
            return np.asarray(current_density(lead, potential_coefficients(lead, voltages), jnp.asarray(points)))

        assert i(2.0 * a - b) == pytest.approx(2.0 * i(a) - i(b), rel=1e-9, abs=1e-9)
        assert i(jnp.ones(16)) == pytest.approx(np.zeros(points.shape), abs=1e-7)

    def test_connected_electrodes_are_those_of_other_voltages(self, charges, points, rng):
        connection = rng.normal(size=(4, 4))
        alone = build_lead_field(charges, LOW, HIGH, 2 * MM)
        connected = build_lead_field(charges, LOW, HIGH, 2 * MM, connection)
        voltages = rng.uniform(-10, 10, 4)
        found = potential_coefficients(connected, jnp.asarray(voltages))
        assert found == pytest.approx(np.asarray(potential_coefficients(alone, jnp.asarray(connection @ voltages))))

    def test_rises_under_the_cathode(self, lead):
        home = jnp.array([[12.5 * MM], [12.5 * MM], [0.4 * MM]])
        assert float(current_density(lead, potential_coefficients(lead, jnp.asarray(VOLTAGES[-1])), home)[2, 0]) > 0.0


class TestBox:
    def test_cells_fill_the_box(self, charges):
        lead = build_lead_field(charges, LOW, np.array([23.3 * MM, 23 * MM, 11 * MM]), 2 * MM)
        low, high = working_volume(lead)
        assert low == pytest.approx(LOW)
        assert high == pytest.approx([23.3 * MM, 23 * MM, 11 * MM])
        assert np.all(np.asarray(lead.spacing) <= 2 * MM)

    def test_outside_the_nearest_point_counts(self, lead):
        coefficients = potential_coefficients(lead, jnp.asarray(VOLTAGES[0]))
        far = jnp.array([[40 * MM, 1 * MM], [10 * MM, 1 * MM], [-5 * MM, 99 * MM]])
        rim = jnp.array([[HIGH[0], LOW[0]], [10 * MM, LOW[1]], [LOW[2], HIGH[2]]])
        assert current_density(lead, coefficients, far) == pytest.approx(current_density(lead, coefficients, rim))
        assert potential(lead, coefficients, far) == pytest.approx(potential(lead, coefficients, rim))

    def test_a_point_on_the_rim_is_inside_and_one_beyond_feels_no_shift(self, lead):
        coefficients = potential_coefficients(lead, jnp.asarray(VOLTAGES[0]))
        rim = jnp.array([[10.3 * MM], [11.7 * MM], [HIGH[2]]])

        @jax.jit
        def slope(points):
            return jax.jacfwd(lambda p: current_density(lead, coefficients, p)[:, 0])(points)[:, :, 0]

        closed = current_density_gradient(lead, coefficients, rim)[:, :, 0]
        assert slope(rim) == pytest.approx(np.asarray(closed))
        beyond = slope(rim + jnp.array([[0.0], [0.0], [1 * MM]]))
        assert beyond[:, 2] == pytest.approx(np.zeros(3))
        assert beyond[:, :2] == pytest.approx(np.asarray(closed[:, :2]))


class TestDerivatives:
    """Closed forms against differences of the function itself, and against what the array engine makes of it."""

    @pytest.fixture(scope="class")
    @staticmethod
    def coefficients(lead) -> jax.Array:
        return potential_coefficients(lead, jnp.asarray(VOLTAGES[1]))

    @pytest.fixture(scope="class")
    @staticmethod
    def inside() -> jax.Array:
        return jnp.asarray(np.random.default_rng(8).uniform(LOW[:, None], HIGH[:, None], (3, 23)))

    def test_current_density_is_the_slope_of_the_potential(self, lead, coefficients, inside):
        slope = jax.jit(jax.grad(lambda p: potential(lead, coefficients, p).sum()))(inside)
        assert current_density(lead, coefficients, inside) == pytest.approx(-0.15 * np.asarray(slope), rel=1e-9)

    def test_gradient_against_differences(self, lead, coefficients, inside):
        found = np.asarray(current_density_gradient(lead, coefficients, inside))
        for axis, step in enumerate(1e-7 * jnp.eye(3)):
            up, down = (current_density(lead, coefficients, inside + s * step[:, None]) for s in (1, -1))
            assert np.asarray(up - down) / 2e-7 == pytest.approx(
                found[:, axis], rel=1e-5, abs=1e-5 * np.abs(found).max()
            )

    @pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
    def test_gradient_against_automatic(self, lead, coefficients, inside, jacobian):
        closed = np.asarray(current_density_gradient(lead, coefficients, inside))
        whole = np.asarray(jax.jit(jacobian(lambda p: current_density(lead, coefficients, p)))(inside))
        own = np.einsum("kplp->klp", whole)
        assert own == pytest.approx(closed, rel=1e-9, abs=1e-12 * np.abs(closed).max())
        assert np.abs(whole).sum() == pytest.approx(np.abs(own).sum())

    def test_second_derivatives_of_the_current_density(self, lead, coefficients, inside):
        def squares(p):
            return jnp.sum(current_density(lead, coefficients, p) ** 2)

        slope = jax.jit(jax.grad(squares))
        direction = jnp.asarray(np.random.default_rng(9).normal(size=inside.shape))
        step = 1e-8 * direction
        found = jax.jit(lambda *at: jax.jvp(jax.grad(squares), *at)[1])((inside,), (direction,))
        differences = (slope(inside + step) - slope(inside - step)) / 2e-8
        assert found == pytest.approx(np.asarray(differences), rel=1e-4, abs=1e-4 * np.abs(found).max())

    @pytest.mark.parametrize("robots", [(), (11,)])
    def test_reverse_against_differences(self, lead, rng, robots):
        """A scalar of the current density, differentiated by positions and by voltages, along random directions."""
        places = jnp.asarray(np.moveaxis(rng.uniform(LOW, HIGH, (14, *robots, 3)), -1, 0))
        voltages = jnp.asarray(rng.uniform(-10, 10, (16, *robots)))
        weights = jnp.asarray(rng.normal(size=places.shape))

        @jax.jit
        def scalar(places, voltages):
            return jnp.sum(weights * current_density(lead, potential_coefficients(lead, voltages), places) ** 2)

        by_place, by_voltage = jax.jit(jax.grad(scalar, (0, 1)))(places, voltages)
        for _ in range(3):
            move, change = (
                1e-8 * jnp.asarray(rng.normal(size=places.shape)),
                jnp.asarray(rng.normal(size=voltages.shape)),
            )
            moved = (scalar(places + move, voltages) - scalar(places - move, voltages)) / 2.0
            changed = (scalar(places, voltages + 1e-4 * change) - scalar(places, voltages - 1e-4 * change)) / 2e-4
            assert float(jnp.sum(by_place * move)) == pytest.approx(float(moved), rel=1e-4)
            assert float(jnp.sum(by_voltage * change)) == pytest.approx(float(changed), rel=1e-6)

    def test_forward_and_reverse_agree(self, lead, inside, rng):
        @jax.jit
        def currents(places, voltages):
            return current_density(lead, potential_coefficients(lead, voltages), places)

        at = inside, jnp.asarray(VOLTAGES[2])
        shift = tuple(jnp.asarray(rng.normal(size=a.shape)) for a in at)
        weight = jnp.asarray(rng.normal(size=inside.shape))
        forward = jnp.sum(weight * jax.jvp(currents, at, shift)[1])
        reverse = sum(jnp.sum(g * s) for g, s in zip(jax.vjp(currents, *at)[1](weight), shift, strict=True))
        assert float(forward) == pytest.approx(float(reverse), rel=1e-10)


class TestBatch:
    @pytest.mark.parametrize("robots", [1, 19])
    def test_equals_one_robot_after_the_other(self, lead, rng, robots):
        places = jnp.asarray(np.moveaxis(rng.uniform(LOW - 1 * MM, HIGH + 1 * MM, (37, robots, 3)), 2, 0))
        voltages = jnp.asarray(rng.uniform(-10, 10, (16, robots)))
        coefficients = potential_coefficients(lead, voltages)
        for function in (potential, current_density, current_density_gradient):
            together = function(lead, coefficients, places)
            alone = [
                function(lead, potential_coefficients(lead, voltages[:, r]), places[..., r]) for r in range(robots)
            ]
            assert together == pytest.approx(np.stack(alone, axis=-1), rel=1e-9, abs=1e-9)

    def test_equals_a_mapped_function(self, lead, rng):
        places = jnp.asarray(np.moveaxis(rng.uniform(LOW, HIGH, (9, 5, 3)), 2, 0))
        voltages = jnp.asarray(rng.uniform(-10, 10, (16, 5)))

        def currents(voltages, places):
            return current_density(lead, potential_coefficients(lead, voltages), places)

        mapped = jax.jit(jax.vmap(currents, in_axes=(1, 2), out_axes=2))(voltages, places)
        assert mapped == pytest.approx(np.asarray(currents(voltages, places)), rel=1e-9, abs=1e-9)
