"""The field against finite elements: closed tanks that scikit-fem solves, on meshes refined until they are known.

| tank | one road | the other |
|---|---|---|
| strip in the lid, the floor an electrode | finite elements | conformal mapping: G = 2 sigma K(k) / K(k') |
| 2 x 2 plates | finite elements | panels and images |
| 4 x 4 plates, ridge | finite elements | panels and images |
| plate in the lid, rod | finite elements | panels and images |
| 2 x 2 plates, a gel of another conductivity | finite elements with two materials | charges on its surface |
| 2 x 2 plates, their backs insulated | finite elements with holes | charges on back and rim |

Elements give too large currents, panels (Galerkin) too small ones: the truth lies between them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import griddata
from scipy.special import ellipk
from skfem import MeshHex

from finite_elements import Box, assemble, faces, graded, rounded, solve_tank, tank_mesh
from gelbot.body.lattice import build_body
from gelbot.body.outline import strip
from gelbot.field.charge import FieldSolution, build_problem, solve
from gelbot.field.electrodes import DOWN, Electrode, ElectrodeArray, Rectangle, Rod, square_array
from gelbot.field.gel import gel_inflow, gel_panels
from gelbot.field.images import Tank

MM = 1e-3
SIGMA = 0.19
PANELS = 12
FLOOR, LID = -1.0, 30.0  # mm
ODD_IN_X = np.array([-1.0, 1.0, -1.0, 1.0])  # voltages of 2 x 2 plates: the plane x = 0 has 0 V, y = 0 is a wall
ODD_IN_BOTH = np.array([1.0, -1.0, -1.0, 1.0])


def mm_box(*corners: float) -> Box:
    """From x, y, z to x, y, z in mm."""
    low, high = np.reshape(np.array(corners) * MM, (2, 3))
    return Box(low, high)


def mm_axis(stops: list[float], edges: dict[float, float], largest: float = 3.0) -> np.ndarray:
    """`graded`, in mm."""
    return graded([s * MM for s in stops], {x * MM: size * MM for x, size in edges.items()}, largest * MM)


def plane(mesh: MeshHex, axis: int) -> np.ndarray:
    """The faces in the plane x = 0 or y = 0."""
    low, high = -np.ones(3), np.ones(3)
    low[axis] = high[axis] = 0.0
    return faces(mesh, Box(low, high))


def closed_tank(x: float, y: float) -> Tank:
    """A tank with inner lengths `x`, `y` in mm."""
    return Tank(FLOOR * MM, LID * MM, (x * MM, y * MM))


def worst(solution: FieldSolution, voltages: np.ndarray, points: np.ndarray, density: np.ndarray) -> float:
    """Largest difference from `density` (3, p) [A/m^2] at `points`, relative to its value at the same point."""
    found = np.tensordot(voltages, solution.lead_current_density(points), 1)
    return float(np.max(np.linalg.norm(found - density, axis=0) / np.linalg.norm(density, axis=0)))


class TestClosedForm:
    """A strip of half-width a in the lid of a long tank of depth H whose floor is the other electrode.

    zeta = tanh(pi w / 2H), w = x + i (H - z), maps the tank onto the upper half plane, the strip onto (-k, k) with
    k = tanh(pi a / 2H) and the floor onto |zeta| > 1; an elliptic integral of t = zeta / k maps that onto a rectangle.
    """

    def test_conductance_and_density(self) -> None:
        depth, a, width = 15.0, 5.0, 75.0
        mesh = tank_mesh(mm_axis([0, a, width], {a: 0.02}), [0, MM], mm_axis([0, depth], {depth: 0.02}))
        electrodes = [faces(mesh, mm_box(0, 0, depth, a, 1, depth)), faces(mesh, mm_box(0, 0, 0, width, 1, 0))]
        answer = solve_tank(assemble(mesh, SIGMA), electrodes, [1.0, 0.0])
        k = np.tanh(np.pi * a / (2.0 * depth))
        exact = SIGMA * MM * ellipk(k * k) / ellipk(1.0 - k * k)  # half of it: x > 0
        assert exact < answer.currents[0] < 1.001 * exact
        assert answer.currents.sum() == pytest.approx(0.0, abs=1e-4 * exact)
        assert answer.power == pytest.approx(answer.currents[0], rel=1e-4)

        points, density = answer.current_density(mm_box(0, 0, 0, 12, 1, 5))
        w = (points[0] + 1j * (depth * MM - points[2])) * np.pi / (2.0 * depth * MM)
        t, per_metre = np.tanh(w) / k, np.pi / (2.0 * depth * MM) / np.cosh(w) ** 2 / k
        truth = SIGMA * np.abs(per_metre / np.sqrt((1.0 - t**2) * (1.0 - (k * t) ** 2))) / ellipk(1.0 - k * k)
        np.testing.assert_allclose(np.linalg.norm(density, axis=0), truth, rtol=1e-3)


@pytest.mark.slow
class TestSquareArrays:
    """Current of one of 2 x 2 plates [mA/V]: half the smallest elements (ratio 2), half the excess.

    | smallest [mm] | 0.2 | 0.1 | 0.05 | 0.025 | 0.0125 | limit | as here | panels = 10 | 16 |
    |---|---|---|---|---|---|---|---|---|---|
    | odd in x | 7.7491 | 7.7363 | 7.7303 | 7.7269 | 7.7252 | 7.723 | 7.736 | 7.7146 | 7.7211 |
    | odd in both | 10.0541 | 10.0332 | 10.0233 | 10.0178 | 10.0151 | 10.012 | 10.032 | 9.9981 | 10.0085 |

    Below the plates the density as here differs from that with 0.0125 mm by 0.12 % and 0.16 %, rms.
    """

    @pytest.mark.parametrize("pattern", [ODD_IN_X, ODD_IN_BOTH], ids=["odd-in-x", "odd-in-both"])
    def test_two_by_two(self, pattern: np.ndarray) -> None:
        """These two, and the first turned by 90 degrees, make up all voltages of the four plates."""
        x = mm_axis([0, 7.5, 17.5, 30], {7.5: 0.05, 17.5: 0.05})
        mesh = tank_mesh(x, x, mm_axis([FLOOR, 0, 3, 15, LID], {15: 0.05}))
        plate = faces(mesh, mm_box(7.5, 7.5, 15, 17.5, 17.5, 15))
        zero = plane(mesh, 0) if pattern is ODD_IN_X else np.union1d(plane(mesh, 0), plane(mesh, 1))
        answer = solve_tank(assemble(mesh, SIGMA), [plate], [1.0], zero)

        array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
        solution = solve(build_problem(array, closed_tank(60, 60), SIGMA, PANELS))
        currents = solution.conductance @ pattern
        np.testing.assert_allclose(currents, currents[3] * pattern, rtol=1e-6)
        assert 0.995 * answer.currents[0] < currents[3] < answer.currents[0]
        assert 0.995 * 4.0 * answer.power < pattern @ currents < 4.0 * answer.power
        for region in (mm_box(0, 0, FLOOR, 10, 10, 0), mm_box(0, 0, 0, 10, 10, 3), mm_box(0, 0, 3, 10, 10, 8)):
            assert worst(solution, pattern, *answer.current_density(region)) < 0.01

    def test_four_by_four(self) -> None:
        """The diagonal is the sum of a part even in x and y and a part odd in both: two quarters of the tank."""
        ridge = np.where(np.eye(4) > 0, -10.0, 10.0)
        even, odd = (ridge + ridge[:, ::-1]) / 2.0, (ridge - ridge[:, ::-1]) / 2.0
        x = mm_axis([0, 7.5, 17.5, 32.5, 42.5, 65], {7.5: 0.05, 17.5: 0.05, 32.5: 0.2, 42.5: 0.2}, 5.0)
        mesh = tank_mesh(x, x, mm_axis([FLOOR, 0, 3, 15, LID], {15: 0.05}, 4.0))
        plates = [faces(mesh, mm_box(a, b, 15, a + 10, b + 10, 15)) for b in (7.5, 32.5) for a in (7.5, 32.5)]
        elements = assemble(mesh, SIGMA)
        first = solve_tank(elements, plates, even[2:, 2:].ravel())
        second = solve_tank(elements, plates, odd[2:, 2:].ravel(), np.union1d(plane(mesh, 0), plane(mesh, 1)))
        place = mm_box(0, 0, 0, 25, 25, 3)
        points, density = first.current_density(place)
        density = density + second.current_density(place)[1]
        below = np.linalg.norm(points[:2] - 12.5 * MM, axis=0) < 8 * MM

        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        solution = solve(build_problem(array, closed_tank(130, 130), SIGMA, PANELS))
        assert worst(solution, ridge.ravel(), points[:, below], density[:, below]) < 0.01
        currents = (solution.conductance @ ridge.ravel()).reshape(4, 4)[2:, 2:].ravel()
        np.testing.assert_allclose(currents, first.currents + second.currents, rtol=0.01)


@pytest.mark.slow
def test_plate_in_the_lid_and_a_rod() -> None:
    """A plate flush in the lid, and a rod of 3 mm diameter that hangs free from z = 2 to 12 mm; the half y > 0.

    Smallest elements 0.2, 0.1, 0.05, 0.025 mm (at the rod twice that): 5.232, 5.222, 5.222, 5.220 mA for 1 V and -1 V.
    """
    x_sizes = {-13.0: 0.1, -3.0: 0.1, 8.5: 0.2, 10.0: 0.2, 11.5: 0.2}
    x = mm_axis([-20, -13, -3, 8.5, 10, 11.5, 20], x_sizes)
    y = mm_axis([0, 1.5, 5, 15], {0.0: 0.2, 1.5: 0.2, 5.0: 0.1})
    z = mm_axis([FLOOR, 2, 4, 12, LID], {2.0: 0.2, 12.0: 0.2, LID: 0.1})
    metal = mm_box(8.5, -1.5, 2, 11.5, 1.5, 12)
    mesh = tank_mesh(x, y, z, [metal])
    electrodes = [faces(mesh, mm_box(-13, -5, LID, -3, 5, LID)), faces(mesh, metal)]
    mesh = rounded(mesh, (10 * MM, 0.0), 1.5 * MM, 5 * MM)
    voltages = np.array([1.0, -1.0])
    answer = solve_tank(assemble(mesh, SIGMA), electrodes, voltages)

    plate = Electrode(Rectangle((10 * MM, 10 * MM)), np.array([-8, 0, LID]) * MM, DOWN, name="plate")
    rod = Electrode(Rod(3 * MM, 10 * MM), np.array([10, 0, 7]) * MM, np.eye(3), name="rod")
    solution = solve(build_problem(ElectrodeArray((plate, rod)), closed_tank(40, 30), SIGMA, PANELS))
    np.testing.assert_allclose(solution.conductance @ voltages, 2.0 * answer.currents, rtol=0.005)
    assert worst(solution, voltages, *answer.current_density(mm_box(-12, 0, FLOOR, 4.9, 10, 4))) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 3.0])
def test_gel_of_another_conductivity(ratio: float) -> None:
    """A block of 15 x 15 x 1 mm on z = 0, below the middle of 2 x 2 plates."""
    x = mm_axis([0, 1.25, 2.5, 3.75, 5, 6, 7.5, 17.5, 30], {7.5: 0.05, 17.5: 0.05})
    mesh = tank_mesh(x, x, mm_axis([FLOOR, 0, 1, 2, 15, LID], {0.0: 0.1, 1.0: 0.1, 15: 0.05}))
    gel = mm_box(0, 0, 0, 7.5, 7.5, 1)
    middles = mesh.p[:, mesh.t].mean(axis=1)
    conductivity = np.where(gel.holds(middles), ratio * SIGMA, SIGMA)
    plate = faces(mesh, mm_box(7.5, 7.5, 15, 17.5, 17.5, 15))
    answer = solve_tank(assemble(mesh, conductivity), [plate], [1.0], plane(mesh, 0))

    body = build_body(strip(15 * MM, 15 * MM), 1 * MM, 1 * MM)
    panels = gel_panels(body.nodes, body.faces, ratio * SIGMA, SIGMA)
    array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
    solution = solve(build_problem(array, closed_tank(60, 60), SIGMA, PANELS, panels))
    for region in (mm_box(0, 0, FLOOR, 6, 6, 0), mm_box(0, 0, 2, 10, 10, 8), mm_box(9, 0, FLOOR, 14, 12, 4)):
        assert worst(solution, ODD_IN_X, *answer.current_density(region)) < 0.01

    # What enters the lower face, away from its rim, where the density grows without bound.
    centres = body.nodes[:, body.faces].mean(axis=1)
    middle = mm_box(0, 0, 0, 5, 5, 0).holds(centres)
    found = (gel_inflow(solution) @ ODD_IN_X)[middle]
    points, density = answer.density_up(mm_box(0, 0, 0, 7.5, 7.5, 0))
    truth = griddata(points[:2].T, density, centres[:2, middle].T)
    inside = np.isfinite(truth)  # the others are closer to a plane of symmetry than any of `points`
    assert inside.sum() > 40
    assert np.linalg.norm((found - truth)[inside]) < 0.01 * np.linalg.norm(truth[inside])


@pytest.mark.slow
def test_insulated_backs() -> None:
    """Plates that face down, 1 mm of insulator above them: a weaker field below than that of bare plates.

    Smallest elements 0.04, 0.01, 0.0025, 0.0006 mm: 5.988, 5.950, 5.935, 5.929 mA/V a plate; limit 5.925. At an edge
    between conductor and insulator the density goes like distance^(-2/3), which is hard for both methods.
    """
    x = mm_axis([0, 7.5, 17.5, 30], {7.5: 0.01, 17.5: 0.01})
    back = mm_box(7.5, 7.5, 15, 17.5, 17.5, 16)
    mesh = tank_mesh(x, x, mm_axis([FLOOR, 0, 3, 15, 16, LID], {15: 0.01, 16: 0.1}), [back])
    answer = solve_tank(
        assemble(mesh, SIGMA), [faces(mesh, mm_box(7.5, 7.5, 15, 17.5, 17.5, 15))], [1.0], plane(mesh, 0)
    )

    bare = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
    backed = ElectrodeArray(tuple(replace(electrode, backing=1 * MM) for electrode in bare.electrodes))
    solution = solve(build_problem(backed, closed_tank(60, 60), SIGMA, PANELS))
    assert (solution.conductance @ ODD_IN_X)[3] == pytest.approx(answer.currents[0], rel=0.02)
    assert worst(solution, ODD_IN_X, *answer.current_density(mm_box(0, 0, FLOOR, 10, 10, 3))) < 0.015
