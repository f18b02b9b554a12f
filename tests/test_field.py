"""The field: panels, images, charges, circuit, the gel as a conductor.

| identity | one road | the other |
|---|---|---|
| panel | closed form and its gradient | numerical integral, differences; moments, far away |
| panels of any shape | areas, normals | area and volume of the shape |
| square plate alone | `solve`'s matrix | C = 0.36679 * 4 pi eps a (Read 1997), order of convergence |
| cube alone | the same | C = 0.6606782 * 4 pi eps a (Hwang and Mascagni 2004) |
| round rod as long as wide | the same | C = 14.95 eps r (Smythe 1956, to 0.2 %) |
| disc on an insulating plane | image in a floor through it | R = 1 / (4 sigma r) |
| square flush in an insulating plane | the same | R = 0.4339 / (sigma a) |
| two plates far apart | `solve` | R = 2 R_1 - 1 / (2 pi sigma d) |
| insulated tank | sum of the currents; equal voltages | 0 |
| reciprocity, dissipation | conductance matrix | its transpose; no negative eigenvalue |
| no flux through floor, lid, walls | normal derivative there | 0 |
| images | Ewald's sums | mirrored cells, added one by one |
| superposition, scaling, symmetry of the array | one solve | another |
| far away | potential of a neutral array, r and 2 r | at least a factor of 4 |
| sphere of conductivity s in a uniform field | panels with continuous current | i_n = 3 s / (s + 2 sigma) i cos theta |
| floating electrodes | `connection` | net current 0 |
| sign | current under a cathode | rises |
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from gelbot.errors import BadInput
from gelbot.field.charge import FieldSolution, SingularField, build_problem, error_estimate, solve
from gelbot.field.circuit import connection, power
from gelbot.field.electrodes import (
    DOWN,
    Block,
    Disc,
    Electrode,
    ElectrodeArray,
    Rectangle,
    Ring,
    Rod,
    Shape,
    square_array,
)
from gelbot.field.gel import gel_inflow, gel_panels
from gelbot.field.images import Images, Tank
from gelbot.field.influence import mutual_images, mutual_potentials
from gelbot.field.panel import far_gradient, far_potential, panel_gradient, panel_potential
from gelbot.field.panels import Panels, graded, panels_of

MM = 1e-3
SQUARE, CUBE = 0.3667874, 0.6606782  # capacitances of the unit plate and of the unit cube, over 4 pi eps
HOME = 10  # the electrode at (12.5, 12.5) mm
OPEN = Tank(floor=None)
DEEP = Tank(-1 * MM, 30 * MM)
CLOSED = Tank(-1 * MM, 30 * MM, (110 * MM, 130 * MM))


def alone(shape: Shape, height: float = 0.0) -> ElectrodeArray:
    return ElectrodeArray((Electrode(shape, np.array([0.0, 0.0, height]), np.eye(3), name="electrode 0"),))


def pair(shape: Shape, distance: float, height: float = 0.0, backing: float = 0.0) -> ElectrodeArray:
    return ElectrodeArray(
        tuple(
            Electrode(shape, np.array([x, 0.0, height]), DOWN, backing, f"electrode {n}")
            for n, x in enumerate((-distance / 2.0, distance / 2.0))
        )
    )


def capacitance(shape: Shape, per_side: int, tank: Tank = OPEN) -> float:
    """Over 4 pi eps; with the shape in the plane of an insulating floor, of the half space above it."""
    panels = panels_of(alone(shape), per_side)
    potentials = mutual_potentials(panels, mutual_images(panels, tank))
    return float(np.linalg.solve(potentials, np.ones(len(potentials))).sum())


def current(solution: FieldSolution, voltages: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Current density [A/m^2], shape (3, p)."""
    return np.tensordot(voltages, solution.lead_current_density(points), 1)


QUADS = [
    (np.array([-0.5, 0.5, 0.5, -0.5]), np.array([-0.5, -0.5, 0.5, 0.5])),
    (np.array([-0.4, 0.5, 0.3, -0.4]), np.array([-0.3, -0.4, 0.5, 0.2])),
    (np.array([-0.5, 0.5, 0.1, 0.1]), np.array([-0.4, -0.3, 0.6, 0.6])),  # a triangle
]


def quad_integral(x: np.ndarray, y: np.ndarray, point: tuple[float, float, float]) -> float:
    """int dS / r over a quadrilateral, by its map from the unit square."""

    def integrand(v: float, u: float) -> float:
        weights = np.array([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
        along = (1 - v) * np.array([x[1] - x[0], y[1] - y[0]]) + v * np.array([x[2] - x[3], y[2] - y[3]])
        across = (1 - u) * np.array([x[3] - x[0], y[3] - y[0]]) + u * np.array([x[2] - x[1], y[2] - y[1]])
        r = np.sqrt((point[0] - weights @ x) ** 2 + (point[1] - weights @ y) ** 2 + point[2] ** 2)
        return abs(along[0] * across[1] - along[1] * across[0]) / r

    return dblquad(integrand, 0.0, 1.0, 0.0, 1.0, epsabs=1e-9)[0]


class TestPanel:
    @pytest.mark.parametrize("quad", range(len(QUADS)))
    @pytest.mark.parametrize(
        "point",
        [(0.3, 0.2, 0.4), (0.3, 0.2, -0.4), (-0.1, 0.4, -2.0), (0.0, 0.1, 0.05), (1.5, -0.7, 0.0), (0.5, 2.0, 0.3)],
        ids=str,
    )
    def test_closed_form_is_the_integral(self, quad, point):
        x, y = QUADS[quad]
        value = panel_potential(np.array(point), x, y)
        assert float(value) == pytest.approx(quad_integral(x, y, point), rel=1e-6)

    @pytest.mark.parametrize("quad", range(len(QUADS)))
    @given(st.tuples(*[st.floats(-2, 2)] * 2, st.floats(0.01, 2) | st.floats(-2, -0.01)))
    def test_gradient_is_that_of_the_potential(self, quad, point):
        x, y = QUADS[quad]
        p, h = np.array(point)[:, None], 1e-5
        shifted = [panel_potential(p + h * e[:, None], x[:, None], y[:, None]) for e in (*np.eye(3), *-np.eye(3))]
        differences = (np.stack(shifted[:3]) - np.stack(shifted[3:])) / (2 * h)
        assert panel_gradient(p, x[:, None], y[:, None]) == pytest.approx(differences, abs=2e-5)

    def test_on_the_panel_itself(self):
        """Middle of a square 4 asinh(1) a, corner half of it: finite, also on the edges."""
        a = 2.0
        x, y = a * QUADS[0][0], a * QUADS[0][1]
        assert float(panel_potential(np.zeros(3), x, y)) == pytest.approx(4.0 * np.arcsinh(1.0) * a)
        assert float(panel_potential(np.array([a / 2, a / 2, 0]), x, y)) == pytest.approx(2.0 * np.arcsinh(1.0) * a)
        assert np.isfinite(panel_potential(np.array([a / 2, 0.1, 0.0]), x, y))

    def test_slope_jumps_by_four_pi_and_vanishes_in_the_plane(self):
        x, y = QUADS[1]
        above, below, on = (panel_gradient(np.array([0.1, 0.05, z]), x, y)[2] for z in (1e-7, -1e-7, 0.0))
        assert above - below == pytest.approx(-4.0 * np.pi, rel=1e-5)
        assert on == 0.0

    @pytest.mark.parametrize(
        ("near", "far", "order"), [(panel_potential, far_potential, 5), (panel_gradient, far_gradient, 6)]
    )
    def test_moments_far_away(self, near, far, order, rng):
        """What is left falls as r^-5, for the slope as r^-6: the octupole of a symmetric panel vanishes."""
        panels = Panels(
            np.stack([QUADS[0][0], QUADS[0][1], np.zeros(4)])[:, :, None], np.zeros(1, int), np.full(1, np.nan)
        )
        directions = rng.normal(size=(3, 40))
        directions /= np.linalg.norm(directions, axis=0)
        errors = []
        for distance in (4.0, 8.0):
            r = distance * directions
            exact = near(r, *panels.outline) / panels.area
            errors.append(np.abs(far(r, panels.moments, np.zeros(1)) - exact).max())
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)


SHAPES = {
    "rectangle": (Rectangle((2.0, 1.0)), 2.0, None),
    "disc": (Disc(2.0), np.pi, None),
    "ring": (Ring(2.0, 1.0), 0.75 * np.pi, None),
    "rod": (Rod(1.0, 3.0), None, 0.75 * np.pi),
    "block": (Block((1.0, 2.0, 3.0)), 22.0, 6.0),
}


class TestPanels:
    @pytest.mark.parametrize("name", SHAPES)
    def test_area_and_volume_of_the_shape(self, name):
        """Polygons that stand for circles have the circle's area, so that discs, rings and rods keep area or volume."""
        shape, area, volume = SHAPES[name]
        panels = panels_of(alone(shape), 10)
        if area is not None:
            assert panels.area.sum() == pytest.approx(area)
        if volume is not None:
            assert (panels.area * np.sum(panels.centre * panels.frame[:, 2], axis=0)).sum() / 3 == pytest.approx(volume)

    @pytest.mark.parametrize("name", ["rectangle", "disc", "ring"])
    def test_a_backing_closes_the_surface(self, name):
        shape, area, _ = SHAPES[name]
        array = ElectrodeArray((Electrode(shape, np.array([3.0, 2.0, 1.0]), DOWN, backing=0.1),))
        panels = panels_of(array, 8)
        assert panels.area[panels.active].sum() == pytest.approx(area)
        assert panels.frame[:, 2, panels.active] == pytest.approx(
            np.broadcast_to([[0.0], [0.0], [-1.0]], (3, panels.active.sum()))
        )
        out = panels.area * panels.frame[:, 2]
        assert out.sum(axis=1) == pytest.approx(np.zeros(3), abs=1e-12)
        assert np.sum(panels.centre * out) / 3 == pytest.approx(0.1 * area)

    def test_graded_towards_the_edges(self):
        x = graded(7)
        assert x == pytest.approx(-x[::-1], abs=0.0)
        widths = np.diff(x)
        assert np.all(np.diff(widths[:4]) > 0.0)
        assert graded(5, ends=1)[[0, -1]] == pytest.approx([-1.0, 1.0])

    def test_moments_are_integrals(self):
        corners = np.stack([QUADS[1][0], QUADS[1][1], 0.3 * QUADS[1][0]])[:, :, None]
        panels = Panels(corners, np.zeros(1, int), np.full(1, np.nan))
        points, shares = panels.nodes(6)
        assert shares.sum() == pytest.approx(1.0)
        d = points[:, :, 0] - panels.centre
        m = np.einsum("ap,bp,p->ab", d, d, shares[:, 0])
        assert panels.moments[:, 0] == pytest.approx([m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]])

    def test_array_of_the_figure(self):
        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        assert array.pitch == pytest.approx(25 * MM)
        assert array.centres.mean(axis=1) == pytest.approx([0.0, 0.0, 15 * MM])
        assert array.centres[:, HOME] == pytest.approx([12.5 * MM, 12.5 * MM, 15 * MM])
        assert array.centres[:, 1] - array.centres[:, 0] == pytest.approx([25 * MM, 0.0, 0.0])


class TestClosedForms:
    def test_square_plate_and_its_order_of_convergence(self):
        values = np.array([capacitance(Rectangle((1.0, 1.0)), n) for n in (5, 10, 20)])
        missing = 1.0 - values / SQUARE
        assert np.all(missing > 0.0)  # Galerkin: from below
        assert np.log2(missing[:-1] / missing[1:]) == pytest.approx([2.8, 3.3], abs=0.4)
        assert capacitance(Rectangle((1.0, 1.0)), 12) == pytest.approx(SQUARE, rel=1e-3)

    def test_cube(self):
        assert capacitance(Block((1.0, 1.0, 1.0)), 8) == pytest.approx(CUBE, rel=1e-3)

    def test_rod_as_long_as_wide(self):
        assert capacitance(Rod(2.0, 2.0), 12) * 4.0 * np.pi == pytest.approx(14.95, rel=3e-3)

    def test_disc(self):
        assert capacitance(Disc(2.0), 12) == pytest.approx(2.0 / np.pi, rel=1e-3)

    def test_ring_with_a_small_hole_is_a_disc(self):
        assert capacitance(Ring(2.0, 0.02), 14) == pytest.approx(2.0 / np.pi, rel=2e-3)

    @pytest.mark.parametrize(
        ("shape", "conductance"), [(Disc(10 * MM), 4.0 * 5 * MM), (Rectangle((10 * MM, 10 * MM)), 10 * MM / 0.4339)]
    )
    def test_flush_in_an_insulating_plane(self, shape, conductance):
        assert 4.0 * np.pi * capacitance(shape, 12, Tank(floor=0.0)) == pytest.approx(conductance, rel=2e-3)

    def test_two_plates_far_apart(self):
        side, distance, sigma = 0.01, 2.0, 0.15
        g = solve(build_problem(pair(Rectangle((side, side)), distance), OPEN, sigma, 12)).conductance
        resistance = 2.0 / (4.0 * np.pi * sigma * capacitance(Rectangle((side, side)), 12))
        between = resistance - 2.0 / (4.0 * np.pi * sigma * distance)
        # One volt between them: half a volt up, half a volt down.
        assert (g @ np.array([0.5, -0.5])) == pytest.approx([1.0 / between, -1.0 / between], rel=1e-5)

    def test_any_position_and_orientation(self, rng):
        """Turned and moved together nothing changes; plates that face each other conduct more than side by side."""
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn *= np.linalg.det(turn)

        def conductance(frame: np.ndarray, shift: np.ndarray) -> float:
            places = ((Disc(8 * MM), (0.0, 0.0, 0.0)), (Rectangle((6 * MM, 4 * MM)), (1 * MM, 2 * MM, 9 * MM)))
            array = ElectrodeArray(tuple(Electrode(s, frame @ np.array(p) + shift, frame) for s, p in places))
            return float(solve(build_problem(array, OPEN, 0.2, 8)).conductance[0, 0])

        moved = conductance(turn, np.array([3 * MM, -40 * MM, 7 * MM]))
        assert moved == pytest.approx(conductance(np.eye(3), np.zeros(3)), rel=1e-9)

    def test_error_estimate(self):
        """The change since the panels were halved is more than the error that is left, and not ten times more."""
        tank = Tank(-1 * MM, 30 * MM, (60 * MM, 60 * MM))
        array = pair(Rectangle((10 * MM, 10 * MM)), 25 * MM, 15 * MM)
        solution = solve(build_problem(array, tank, 0.19, 10))
        best = solve(build_problem(array, tank, 0.19, 24)).conductance
        left = np.abs(solution.conductance - best).max() / np.abs(best).max()
        assert left < error_estimate(solution) < 12.0 * left

    def test_coinciding_electrodes_have_no_solution(self):
        plate = Electrode(Rectangle((1.0, 1.0)), np.zeros(3), np.eye(3), name="left")
        array = ElectrodeArray((plate, Electrode(plate.shape, plate.centre, plate.frame, name="right")))
        with pytest.raises(SingularField, match=r"left, right.*Try"):
            solve(build_problem(array, OPEN, 0.2, 6))


def hexagon() -> ElectrodeArray:
    angles = np.pi / 3.0 * np.arange(6)
    places = [np.zeros(3), *(20 * MM * np.array([np.cos(a), np.sin(a), 0.0]) for a in angles)]
    return ElectrodeArray(tuple(Electrode(Disc(8 * MM), p + np.array([0.0, 0.0, 15 * MM]), DOWN) for p in places))


class TestConductance:
    @pytest.fixture(scope="class", params=["open", "deep", "closed", "hexagon", "backed"])
    @staticmethod
    def solution(request) -> FieldSolution:
        array, kind = square_array(3, 3, 10 * MM, 15 * MM, 15 * MM), request.param
        if kind == "hexagon":
            return solve(build_problem(hexagon(), DEEP, 0.19, 8))
        if kind == "backed":
            return solve(build_problem(pair(Rectangle((10 * MM, 10 * MM)), 25 * MM, 15 * MM, 1 * MM), CLOSED, 0.19, 8))
        return solve(build_problem(array, {"open": OPEN, "deep": DEEP, "closed": CLOSED}[kind], 0.19, 8))

    def test_reciprocity(self, solution):
        g = solution.conductance
        assert np.abs(g - g.T).max() < 1e-10 * np.abs(g).max()
        assert solution.asymmetry < 0.01

    def test_no_current_is_lost_and_equal_voltages_drive_none(self, solution):
        g = solution.conductance
        assert np.abs(g.sum(axis=0)).max() < 1e-10 * np.abs(g).max()
        assert np.abs(g.sum(axis=1)).max() < 1e-10 * np.abs(g).max()
        assert np.abs(solution.panel_current.sum(axis=0)).max() < 1e-10 * np.abs(g).max()

    def test_dissipation(self, solution):
        g = solution.conductance
        values = np.linalg.eigvalsh(g)
        assert values[0] > -1e-10 * values[-1]
        assert values[1] > 1e-3 * values[-1]  # only equal voltages dissipate nothing
        assert g[~np.eye(len(g), dtype=bool)].max() < 0.0
        assert np.diag(g).min() > 0.0

    def test_equal_voltages_lift_the_bulk(self, solution, rng):
        points = rng.uniform(-20 * MM, 20 * MM, (3, 20)) * np.array([[1.0], [1.0], [0.04]])
        count = solution.problem.array.count
        assert np.ones(count) @ solution.lead_potential(points) == pytest.approx(np.ones(20), rel=1e-10)
        assert solution.bulk_potential.sum() == pytest.approx(1.0)

    def test_symmetries_of_the_array(self):
        solution = solve(build_problem(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), CLOSED_SQUARE, 0.19, 7))
        g, number = solution.conductance, np.arange(16).reshape(4, 4)
        for image in (number.T, number[::-1], number[:, ::-1], np.rot90(number)):
            p = image.ravel()
            assert np.abs(g[np.ix_(p, p)] - g).max() < 1e-12 * np.abs(g).max()

    def test_boundary_values(self):
        """The potential of the panels' charges, averaged over a panel and at points of the plate, is the voltage."""
        solution = solve(build_problem(square_array(2, 2, 10 * MM, 15 * MM, 15 * MM), DEEP, 0.19, 10))
        middle = solution.lead_potential(solution.problem.array.centres + np.array([[1 * MM], [2 * MM], [0.0]]))
        assert middle == pytest.approx(np.eye(4), abs=3e-3)

    def test_potential_lies_between_the_voltages(self, array_field, rng):
        voltages = rng.uniform(-10.0, 10.0, 16)
        points = rng.uniform([[-60 * MM], [-60 * MM], [-1 * MM]], [[60 * MM], [60 * MM], [60 * MM]], (3, 500))
        phi = voltages @ array_field.lead_potential(points)
        assert phi.max() < voltages.max()
        assert phi.min() > voltages.min()

    @pytest.mark.parametrize(("stretch", "sigma"), [(1.0, 0.3), (2.5, 0.15), (0.1, 1.0)])
    def test_scaling(self, stretch, sigma, rng):
        """Conductance goes as sigma and length; the lead potential belongs to the shape alone."""

        def shape(s: float, conductivity: float) -> FieldSolution:
            array = square_array(2, 2, s * 10 * MM, s * 15 * MM, s * 15 * MM)
            return solve(build_problem(array, Tank(floor=-s * MM, surface=s * 30 * MM), conductivity, 5))

        one, other = shape(1.0, 0.15), shape(stretch, sigma)
        assert other.conductance == pytest.approx(one.conductance * stretch * sigma / 0.15, rel=1e-9)
        points = rng.uniform(0.0, 12 * MM, (3, 30))
        assert other.lead_potential(stretch * points) == pytest.approx(one.lead_potential(points), rel=1e-9)
        i, j = one.lead_current_density(points), other.lead_current_density(stretch * points)
        assert j * stretch == pytest.approx(i * sigma / 0.15, rel=1e-8, abs=1e-8 * np.abs(i).max())

    def test_a_neutral_array_is_not_seen_from_afar(self, array_field, rng):
        voltages = rng.uniform(-10.0, 10.0, 16)
        direction = np.array([0.48, 0.6, 0.64])
        points = np.outer(direction, [1.0, 2.0, 4.0])
        seen = np.abs(voltages @ array_field.lead_potential(points) - voltages @ array_field.bulk_potential)
        assert np.all(seen[:-1] / seen[1:] > 3.9)  # 1/r^2 or faster, where a charge would give 2

    def test_superposition(self, array_field, rng):
        a, b = rng.uniform(-10, 10, (2, 16))
        points = rng.uniform(0.0, 10 * MM, (3, 10))
        total = current(array_field, a + 2.0 * b, points)
        assert total == pytest.approx(current(array_field, a, points) + 2.0 * current(array_field, b, points), rel=1e-9)

    def test_current_density_is_the_slope_of_the_potential(self, array_field, rng):
        points = rng.uniform([[-30 * MM], [-30 * MM], [0.0]], [[30 * MM], [30 * MM], [14 * MM]], (3, 60))
        h = 1e-6
        plus, minus = (
            np.stack([array_field.lead_potential(points + s * h * e[:, None]) for e in np.eye(3)], axis=1)
            for s in (1.0, -1.0)
        )
        i = array_field.lead_current_density(points)
        assert i == pytest.approx(-0.15 * (plus - minus) / (2 * h), abs=1e-5 * np.abs(i).max())

    def test_current_through_a_surface_is_that_of_the_electrode(self, array_field):
        """Gauss: what flows out of a box around an electrode is what the electrode feeds."""
        x0, y0, z0 = array_field.problem.array.centres[:, HOME]
        t, w = np.polynomial.legendre.leggauss(24)
        half, total = np.array([9 * MM, 9 * MM, 6 * MM]), np.zeros(16)
        for axis, side in product(range(3), (-1.0, 1.0)):
            a, b = (k for k in range(3) if k != axis)
            u, v = (g.ravel() for g in np.meshgrid(t, t))
            points = np.empty((3, len(u)))
            points[a], points[b], points[axis] = half[a] * u, half[b] * v, side * half[axis]
            points += np.array([x0, y0, z0])[:, None]
            flow = array_field.lead_current_density(points)[:, axis] * side
            total += flow @ np.outer(w, w).ravel() * half[a] * half[b]
        g = array_field.conductance[HOME]
        assert total == pytest.approx(g, abs=1e-3 * g.max())


CLOSED_SQUARE = Tank(-1 * MM, 30 * MM, (130 * MM, 130 * MM))


def summed_one_by_one(
    tank: Tank, points: np.ndarray, sources: np.ndarray, charges: np.ndarray, order: int
) -> np.ndarray:
    """Potential of neutral charges and all their images up to `order` mirrored cells; half weights close the cells."""
    maps = []
    for low, high in tank.planes:
        if low is None and high is None:
            maps.append([(1.0, 0.0, 1.0)])
        elif low is None or high is None:
            maps.append([(1.0, 0.0, 1.0), *((-1.0, 2.0 * p, 1.0) for p in (low, high) if p is not None)])
        else:
            cells = [
                (1.0, m * (high - low)) if m % 2 == 0 else (-1.0, high + low + m * (high - low))
                for m in range(-order, order + 1)
            ]
            maps.append([(*cell, 0.5 if abs(n - order) == order else 1.0) for n, cell in enumerate(cells)])
    total = np.zeros(points.shape[1])
    for triple in product(*maps):
        sign, shift = (np.array([m[k] for m in triple])[:, None] for k in (0, 1))
        distance = np.linalg.norm(points[:, :, None] - (sign * sources + shift)[:, None], axis=0)
        total += np.prod([m[2] for m in triple]) * ((1.0 / distance) @ charges)
    return total


class TestImages:
    @pytest.mark.parametrize(
        ("tank", "order", "tolerance"),
        [
            (Tank(-1 * MM), 1, 1e-12),
            (DEEP, 400, 1e-5),
            (Tank(None, None, (110 * MM, 130 * MM)), 60, 1e-5),
            (CLOSED, 14, 3e-4),
            (Tank(-1 * MM, None, (110 * MM, 130 * MM), (True, False, True, True)), 40, 1e-4),
        ],
        ids=["floor", "floor and lid", "walls only", "closed", "one wall absent, no lid"],
    )
    def test_all_images_are_there(self, tank, order, tolerance, rng):
        sources = rng.uniform([[-45 * MM], [-45 * MM], [14 * MM]], [[45 * MM], [45 * MM], [16 * MM]], (3, 20))
        points = rng.uniform([[-30 * MM], [-30 * MM], [0.0]], [[30 * MM], [30 * MM], [12 * MM]], (3, 30))
        charges = rng.normal(size=20)
        charges -= charges.mean()
        images = Images(tank, (sources.min(axis=1), sources.max(axis=1)), (points.min(axis=1), points.max(axis=1)))
        near = sum(1.0 / np.linalg.norm(points[:, :, None] - i.of(sources)[:, None], axis=0) for i in images.near)
        found = near @ charges
        if images.others:
            found += images.point_weights(points).T @ images.kernel @ images.source_weights(sources) @ charges
        # A constant added to all potentials acts on nothing.
        difference = found - summed_one_by_one(tank, points, sources, charges, order)
        assert np.ptp(difference) < tolerance * np.ptp(found)

    @pytest.mark.parametrize("walls", [(True, True, True, True), (True, False, True, False)])
    def test_no_flux_through_floor_lid_and_walls(self, walls, rng):
        tank = Tank(-1 * MM, 30 * MM, (110 * MM, 130 * MM), walls)
        solution = solve(build_problem(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), tank, 0.15, 5))
        voltages = rng.uniform(-10, 10, 16)
        inside = rng.uniform([[-50 * MM], [-60 * MM], [0.0]], [[50 * MM], [60 * MM], [29 * MM]], (3, 40))
        scale = np.abs(current(solution, voltages, np.array([[12.5 * MM], [12.5 * MM], [5 * MM]]))).max()
        for axis, planes in enumerate(tank.planes):
            for place in planes:
                if place is None:
                    continue
                onto = inside.copy()
                onto[axis] = place
                both = np.concatenate([onto, inside], axis=1)  # not only points of one plane
                assert np.abs(current(solution, voltages, both)[axis, :40]).max() < 1e-4 * scale
        absent = inside.copy()
        absent[0] = 55 * MM
        assert (np.abs(current(solution, voltages, absent)[0]).max() > 1e-2 * scale) == (not walls[1])

    def test_the_potential_of_a_closed_tank_has_its_bulk_as_mean(self):
        tank = Tank(-1 * MM, 30 * MM, (60 * MM, 50 * MM))
        solution = solve(build_problem(pair(Disc(10 * MM), 25 * MM, 12 * MM), tank, 0.15, 8))
        x, w = np.polynomial.legendre.leggauss(40)
        grid = np.stack([g.ravel() for g in np.meshgrid(30 * MM * x, 25 * MM * x, 14.5 * MM + 15.5 * MM * x)])
        weights = np.einsum("i,j,k->jik", w, w, w).ravel() / 8.0
        assert solution.lead_potential(grid) @ weights == pytest.approx(solution.bulk_potential, abs=2e-3)
        assert solution.bulk_potential == pytest.approx([0.5, 0.5])

    def test_an_insulating_floor_cuts_the_vertical_current(self):
        """A floor 1 mm under the gel lowers the current under the cathode several times: no small correction."""
        array, home = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM), np.array([[12.5 * MM], [12.5 * MM], [0.5 * MM]])
        voltages = np.where(np.arange(16) == HOME, -10.0, 10.0)
        rising = [
            current(solve(build_problem(array, Tank(floor), 0.15, 6)), voltages, home)[2, 0]
            for floor in (None, -1 * MM)
        ]
        assert rising[0] / rising[1] > 2.5

    @settings(max_examples=10)
    @given(st.integers(0, 15))
    def test_under_a_cathode_the_current_rises(self, array_field, electrode):
        """THE SIGN: voltages -E on one electrode, +E elsewhere, E > 0; the current enters the gel's lower face."""
        x, y, _ = array_field.problem.array.centres[:, electrode]
        voltages = np.where(np.arange(16) == electrode, -10.0, 10.0)
        for z in (0.0, 0.4 * MM, 0.8 * MM):
            i = current(array_field, voltages, np.array([[x], [y], [z]]))
            assert i[2, 0] > 0.0
            assert current(array_field, -voltages, np.array([[x], [y], [z]]))[2, 0] == pytest.approx(-i[2, 0])


class TestOneSided:
    def test_flush_under_the_lid_it_is_a_plate_in_the_lid(self):
        """A plate with an insulated back, hung ever closer below the lid, becomes the plate in the lid."""
        tank, shape = Tank(-1 * MM, 30 * MM, (60 * MM, 60 * MM)), Rectangle((10 * MM, 10 * MM))
        flush = solve(build_problem(pair(shape, 25 * MM, 30 * MM), tank, 0.19, 10)).conductance[0, 0]
        excess = []
        for gap in (0.4 * MM, 0.1 * MM):
            hung = solve(build_problem(pair(shape, 25 * MM, 30 * MM - gap, gap), tank, 0.19, 10)).conductance[0, 0]
            excess.append(hung / flush - 1.0)
        assert 0.0 < excess[1] < 0.6 * excess[0] < 0.06

    def test_no_current_leaves_the_back(self):
        array = pair(Rectangle((10 * MM, 10 * MM)), 25 * MM, 15 * MM, 1 * MM)
        solution = solve(build_problem(array, DEEP, 0.19, 10))
        x = np.array([[12.5 * MM], [1 * MM]])
        below, above = (
            abs(current(solution, np.array([-1.0, 1.0]), np.vstack([x, [[z]]]))[2].item())
            for z in (14.9 * MM, 16.02 * MM)
        )
        assert above < 0.03 * below


def sphere(count: int, radius: float) -> np.ndarray:
    """Nodes (3, n) and outward triangles (3, f) of a sphere about the origin."""
    theta, phi = np.linspace(0.0, np.pi, count + 1), np.linspace(0.0, 2.0 * np.pi, 2 * count + 1)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    return radius * np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])


def sphere_panels(count: int, radius: float, contrast: float) -> Panels:
    x = sphere(count, radius)
    quads = [x[:, :-1, :-1], x[:, 1:, :-1], x[:, 1:, 1:], x[:, :-1, 1:]]
    corners = np.stack([q.reshape(3, -1) for q in quads], axis=1)
    return Panels(corners, np.full(corners.shape[2], -1), np.full(corners.shape[2], contrast))


UNDER_ONE = np.array([[12.5 * MM], [12.5 * MM], [0.0]])
"""From the middle of a 2 x 2 array to below its last electrode."""


class TestGel:
    SIGMA = 0.19

    def uniform(self, gel: Panels | None) -> FieldSolution:
        plates = tuple(
            Electrode(Rectangle((80 * MM, 80 * MM)), np.array([0.0, 0.0, z]), np.eye(3)) for z in (20 * MM, -20 * MM)
        )
        return solve(build_problem(ElectrodeArray(plates), OPEN, self.SIGMA, 6, gel))

    @pytest.mark.parametrize("s", [0.05, 0.6])
    def test_sphere_in_a_uniform_field(self, s):
        """i_n = 3 s / (s + 2 sigma) i cos theta (Maxwell 1873), with the second order of the panels' size."""
        undisturbed = np.tensordot([1.0, -1.0], self.uniform(None).lead_current_density(np.zeros((3, 1))), 1)[2, 0]
        errors = []
        for count in (6, 12):
            panels = sphere_panels(count, 1 * MM, (self.SIGMA - s) / (self.SIGMA + s))
            inflow = gel_inflow(self.uniform(panels)) @ np.array([1.0, -1.0])
            cosine = panels.centre[2] / np.linalg.norm(panels.centre, axis=0)
            exact = -undisturbed * cosine * 3.0 * s / (s + 2.0 * self.SIGMA)
            errors.append(np.abs(inflow - exact).max() / np.abs(exact).max())
        assert errors[1] < 0.03
        assert errors[0] / errors[1] > 2.5

    def test_an_insulating_gel_lets_nothing_in(self):
        assert np.abs(gel_inflow(self.uniform(sphere_panels(6, 1 * MM, 1.0)))).max() < 1e-10

    def test_a_gel_like_the_solution_changes_nothing(self, sheet):
        array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
        alone_ = solve(build_problem(array, DEEP, 0.19, 6))
        gel = gel_panels(sheet.nodes, sheet.faces, 0.19, 0.19)
        with_gel = solve(build_problem(array, DEEP, 0.19, 6, gel))
        assert with_gel.conductance == pytest.approx(alone_.conductance, rel=1e-5)  # the images have another box
        flow = np.einsum("eaf,af->fe", alone_.lead_current_density(gel.centre), gel.frame[:, 2])
        # Averaged over a face against at its middle: the field varies a little.
        assert gel_inflow(with_gel) == pytest.approx(-flow, abs=0.02 * np.abs(flow).max())

    def test_what_enters_leaves(self, sheet):
        array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
        gel = gel_panels(sheet.nodes + UNDER_ONE, sheet.faces, 0.5, 0.19)
        inflow = gel_inflow(solve(build_problem(array, DEEP, 0.19, 6, gel))) * gel.area[:, None]
        assert np.abs(inflow.sum(axis=0)).max() < 0.01 * np.abs(inflow).sum(axis=0).max()

    def test_a_better_conductor_draws_current_in(self, sheet):
        array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
        place, low = sheet.nodes + UNDER_ONE, sheet.faces
        lower = np.cross(*(place[:, low[k]] - place[:, low[0]] for k in (1, 2)), axis=0)[2] < -1e-12
        entering = [
            float(
                (gel_inflow(solve(build_problem(array, DEEP, 0.19, 6, panels)))[:, 3] * panels.area)[lower].sum() * -1.0
            )
            for panels in (gel_panels(place, sheet.faces, s, 0.19) for s in (0.06, 0.19, 0.6))
        ]
        assert entering[0] < entering[1] < entering[2]


class TestCircuit:
    G = np.array([[3.0, -1.0, -2.0], [-1.0, 2.0, -1.0], [-2.0, -1.0, 3.0]])

    def test_all_driven(self):
        assert connection(self.G, ["driven"] * 3) == pytest.approx(np.eye(3))

    def test_a_floating_electrode_carries_no_current(self):
        taken = connection(self.G, ["driven", "floating", "grounded"]) @ np.array([5.0, 99.0, 99.0])
        assert taken == pytest.approx([5.0, 2.5, 0.0])
        assert (self.G @ taken)[1] == pytest.approx(0.0, abs=1e-12)

    def test_off_is_floating(self):
        assert connection(self.G, ["driven", "off", "driven"]) == pytest.approx(
            connection(self.G, ["driven", "floating", "driven"])
        )

    def test_one_driven_alone_lifts_everything(self):
        taken = connection(self.G, ["driven", "off", "floating"]) @ np.array([5.0, 0.0, 0.0])
        assert taken == pytest.approx([5.0, 5.0, 5.0])
        assert power(self.G, taken) == pytest.approx(0.0, abs=1e-12)

    def test_power_is_dissipated(self, array_field, rng):
        """V . I equals the integral of i^2 / sigma; here: between two voltages, I (V_1 - V_2)."""
        v = np.array([2.0, -1.0, 0.0])
        assert power(self.G, v) == pytest.approx(float(v @ self.G @ v))
        assert power(array_field.conductance, rng.normal(size=16)) > 0.0

    @pytest.mark.parametrize(
        ("states", "message"),
        [
            (["off", "floating", "grounded"], "at least one driven"),
            (["driven"], "3, one for each"),
            (["driven", "on", "off"], "one of driven, grounded, floating, off"),
        ],
    )
    def test_what_is_refused(self, states, message):
        with pytest.raises(BadInput, match=message):
            connection(self.G, states)
