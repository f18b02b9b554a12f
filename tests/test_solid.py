"""The solid of ten-node tetrahedra.

| identity | one road | the other |
|---|---|---|
| midpoints | nodes behind the vertices | means of the ends of edges |
| lumped volume | sum over nodes | volume of the body |
| force | `solid_balance` | minus the gradient of `solid_energy` |
| energy of a displacement | `solid_balance` | difference of `solid_energy` |
| rigid motion | forces of a moved and turned body | 0 |
| isotropy | forces of a turned, bent body | turned forces |
| momentum | net force, net torque | 0 |
| uniform strain | energy, virial, forces inside | Hooke's law, 0 |
| uniform contraction | body shrunk in its plane | no stress |
| contraction of a vertex | `vertex_contraction` | area-weighted mean, written here |
| stiffness | `solid_blocks` at rest | Hessian of the energy |
| stiffness, strongly bent, turned inside out | least eigenvalue | not negative |
| contraction eps (1 - z / h) | curvature of a strip | eps / (h (1 - eps / 2)) |
| two layers, one contracts | curvature of a strip | Timoshenko (1925) |
| cantilever | tip under its weight | w L^4 / (8 E I) |
| cantilever, large deflection | tip and its slope | the elastica |
| clamped beam | first frequency | 1.8751^2 sqrt(E I / (rho A)) / L^2 |
| finer meshes | sag of the cantilever | converges |
| single precision | forces of a small displacement | those in double precision |
| batch | forces, stiffness | one by one |
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from elastica import elastica
from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import strip
from gelbot.body.quadratic import with_midpoints
from gelbot.mechanics.solid import (
    Solid,
    build_solid,
    gauss_contraction,
    solid_balance,
    solid_blocks,
    solid_energy,
    strain,
    strained_balance,
    vertex_contraction,
)

MM = 1e-3
YOUNG, POISSON = 1e4, 0.3
FIRST_MODE = 1.8751040687  # the first root of cos(x) cosh(x) = -1


class Case(NamedTuple):
    """A body with its solid."""

    body: Body
    solid: Solid

    @property
    def still(self) -> jnp.ndarray:
        """No contraction, at the Gauss points."""
        return jnp.zeros((4, self.body.tetrahedra.shape[1]))


def beam(length: float, width: float, h: float, mesh: float, layers: int = 2, poisson: float = POISSON) -> Case:
    body = with_midpoints(build_body(strip(length, width), h, mesh, layers))
    return Case(body, build_solid(body, YOUNG, poisson))


@pytest.fixture(scope="module")
def case(sheet) -> Case:
    body = with_midpoints(sheet)
    return Case(body, build_solid(body, YOUNG, POISSON))


@pytest.fixture(scope="module")
def tiny() -> Case:
    return beam(2 * MM, 1 * MM, 1 * MM, 1 * MM)


def shaken(case: Case, rng: np.random.Generator, size: float = 0.05 * MM) -> jnp.ndarray:
    return jnp.asarray(case.body.nodes + size * rng.normal(size=case.body.nodes.shape))


def contracted(case: Case, rng: np.random.Generator) -> jnp.ndarray:
    return gauss_contraction(case.solid, jnp.asarray(rng.uniform(0.0, 0.5, case.body.centre.shape)))


def bent(case: Case, angle: float) -> np.ndarray:
    """The body rolled up around an axis along y by `angle` [rad] from end to end."""
    x, y, z = case.body.nodes
    radius = np.ptp(x) / angle
    return np.stack([(radius - z) * np.sin(x / radius), y, radius - (radius - z) * np.cos(x / radius)])


def stiffness(case: Case, x: np.ndarray, contraction: jnp.ndarray) -> scipy.sparse.csc_matrix:
    """The blocks put together, shape (3n, 3n), the space's axis first."""
    diagonal, off = (np.asarray(part) for part in _blocks(case.solid, jnp.asarray(x), contraction))
    n = x.shape[1]
    first, second = np.asarray(case.solid.couplings)
    rows, columns, values = [], [], []
    for i in range(3):
        for j in range(3):
            rows += [i * n + np.arange(n), i * n + first, j * n + second]
            columns += [j * n + np.arange(n), j * n + second, i * n + first]
            values += [diagonal[i, j], off[i, j], off[i, j]]
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return scipy.sparse.csc_matrix(entries, shape=(3 * n, 3 * n))


_blocks, _balance, _energy = jax.jit(solid_blocks), jax.jit(solid_balance), jax.jit(solid_energy)
_strain, _strained_balance = jax.jit(strain), jax.jit(strained_balance)


def equilibrium(
    case: Case, contraction: jnp.ndarray, load: np.ndarray | None = None, held: np.ndarray | None = None
) -> np.ndarray:
    """Where the forces vanish, shape (3, n), the nodes `held` (n,) excepted: L-BFGS behind a factor of the blocks."""
    x = np.array(case.body.nodes)
    n = x.shape[1]
    load = np.zeros((3, n)) if load is None else load
    free = np.tile(np.ones(n, dtype=bool) if held is None else ~held, 3)

    def gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        energy, forces = _balance(case.solid, start, jnp.asarray(x) - start, contraction)
        return float(energy) - float(np.sum(load * (x - case.body.nodes))), -(np.asarray(forces) + load).ravel()[free]

    def factorised(x: np.ndarray) -> scipy.sparse.linalg.SuperLU:
        k = stiffness(case, x, contraction)[free][:, free]
        # A little more than nothing holds a free body in its place.
        return scipy.sparse.linalg.splu((k + 1e-7 * k.diagonal().mean() * scipy.sparse.eye_array(free.sum())).tocsc())

    start = jnp.asarray(x)
    energy, g = gradient(x)
    enough = 1e-9 * float(np.linalg.norm(g))
    factor, pairs = factorised(x), []
    for iteration in range(1, 400):
        if np.linalg.norm(g) < enough:
            return x
        if iteration % 15 == 0:
            factor, pairs = factorised(x), []
        q, alphas = g.copy(), []
        for s, y in reversed(pairs):
            alphas.append(s @ q / (s @ y))
            q -= alphas[-1] * y
        q = factor.solve(q)
        for (s, y), alpha in zip(pairs, reversed(alphas), strict=True):
            q += (alpha - y @ q / (s @ y)) * s
        length, before, slope = 1.0, (x, energy, g), float(g @ q)
        while True:
            x = before[0].copy()
            x.ravel()[free] -= length * q
            energy, g = gradient(x)
            if energy <= before[1] - 1e-4 * length * slope + 1e-14 * abs(before[1]) or length < 1e-6:
                break
            length *= 0.5
        s, y = -length * q, g - before[2]
        if s @ y > 0.0:
            pairs = [*pairs, (s, y)][-12:]
    raise AssertionError(f"no equilibrium: {np.linalg.norm(g) / enough * 1e-9:.1e} of the first force is left")


def curvature(case: Case, x: np.ndarray) -> float:
    """1 / R [1/m] of the middle half of a strip's mid-surface along its axis: a circle fitted to it."""
    layers, count = case.body.layer_count, case.solid.vertex_faces.shape[1]
    per_layer = count // layers
    rest = case.body.nodes[:, :per_layer]
    axis = (np.abs(rest[1]) < 1e-9) & (np.abs(rest[0]) < 0.26 * np.ptp(rest[0]))
    middle = 0.5 * (x[:, :per_layer] + x[:, count - per_layer : count])[:, axis]
    # A free body may have turned: in the plane in which the points lie.
    centred = middle - middle.mean(axis=1, keepdims=True)
    p, q = (np.linalg.svd(centred)[0].T @ centred)[:2]
    centre_p, centre_q, offset = np.linalg.lstsq(np.column_stack([2.0 * p, 2.0 * q, np.ones_like(p)]), p**2 + q**2)[0]
    assert axis.sum() >= 5
    return float(1.0 / np.sqrt(offset + centre_p**2 + centre_q**2))


def sag(case: Case) -> float:
    """Deflection of a cantilever under a small weight of its own over w L^4 / (8 E I)."""
    nodes, h = case.body.nodes, case.body.thickness
    length, width = np.ptp(nodes[0]), np.ptp(nodes[1])
    n = nodes.shape[1]
    free = np.tile(nodes[0] > nodes[0].min() + 1e-9, 3)
    load = np.zeros(3 * n)
    load[2 * n :] = -case.body.node_volume
    u = np.zeros(3 * n)
    u[free] = scipy.sparse.linalg.spsolve(stiffness(case, nodes, case.still)[free][:, free], load[free])
    tip = -u[2 * n :][nodes[0] > nodes[0].max() - 1e-9].mean()
    return float(tip / (width * h * length**4 / (8.0 * YOUNG * width * h**3 / 12.0)))


class TestMidpoints:
    def test_midpoints_lie_between_their_ends(self, case, sheet):
        t = case.body.tetrahedra
        for row, (i, j) in enumerate(combinations(range(4), 2)):
            ends = 0.5 * (case.body.nodes[:, t[i]] + case.body.nodes[:, t[j]])
            assert case.body.nodes[:, t[4 + row]] == pytest.approx(ends, abs=1e-15)
        assert np.array_equal(case.body.nodes[:, : sheet.nodes.shape[1]], sheet.nodes)
        assert np.all(np.diff(t, axis=0) > 0)
        assert len(np.unique(case.body.nodes.T.round(12), axis=0)) == case.body.nodes.shape[1]

    def test_volume_is_shared_out(self, case, sheet):
        assert case.body.volume == pytest.approx(sheet.volume, rel=1e-12)
        assert np.all(case.body.node_volume > 0.0)

    def test_essential_points_stay_where_they_were(self, case, sheet):
        assert case.body.nodes @ case.body.centre == pytest.approx(sheet.nodes @ sheet.centre)
        assert case.body.nodes @ case.body.tips.T == pytest.approx(sheet.nodes @ sheet.tips.T)
        assert case.body.node_area.sum() == pytest.approx(sheet.node_area.sum())


class TestForces:
    def test_force_is_minus_the_gradient_of_the_energy(self, case, rng):
        x, c = shaken(case, rng), contracted(case, rng)
        u = jnp.asarray(0.05 * MM * rng.normal(size=x.shape))
        expected = -jax.jit(jax.grad(solid_energy, argnums=1))(case.solid, x + u, c)
        energy, forces = _balance(case.solid, x, u, c)
        scale = float(jnp.max(jnp.abs(expected)))
        assert np.asarray(forces) == pytest.approx(np.asarray(expected), abs=1e-12 * scale)
        change = _energy(case.solid, x + u, c) - _energy(case.solid, x, c)
        assert float(energy) == pytest.approx(float(change), rel=1e-9)

    def test_energy_is_the_formula_of_the_docstring(self, tiny, rng):
        """Quadrature written out: F, G and Psi of each Gauss point as they are printed."""
        x, solid, body = np.asarray(shaken(tiny, rng)), tiny.solid, tiny.body
        vertex = rng.uniform(0.0, 0.5, body.centre.shape)
        lame, mu = float(solid.lame), float(solid.shear)
        total = 0.0
        for t in body.tetrahedra.T:
            edges = np.stack([body.nodes[:, t[k]] - body.nodes[:, t[0]] for k in (1, 2, 3)], axis=1)
            for q in range(4):
                bary = np.full(4, (5 - np.sqrt(5)) / 20)
                bary[q] = (5 + 3 * np.sqrt(5)) / 20
                slope = np.concatenate([-np.ones((1, 3)), np.eye(3)])
                shape = [(4 * bary[k] - 1) * slope[k] for k in range(4)]
                shape += [4 * (bary[i] * slope[j] + bary[j] * slope[i]) for i, j in combinations(range(4), 2)]
                c = bary @ vertex[t[:4]]
                F = x[:, t] @ np.array(shape) @ np.linalg.inv(edges) @ np.diag([1 / (1 - c), 1 / (1 - c), 1.0])
                J = np.linalg.det(F)
                psi = mu / 2 * (np.sum(F**2) - 3) - mu * (J - 1) + (lame + mu) / 2 * (J - 1) ** 2
                total += abs(np.linalg.det(edges)) / 24 * (1 - c) ** 2 * psi
        found = _energy(solid, jnp.asarray(x), gauss_contraction(solid, jnp.asarray(vertex)))
        assert float(found) == pytest.approx(total, rel=1e-10)

    @settings(max_examples=10)
    @given(st.integers(0, 10_000))
    def test_rigid_motion_strains_nothing(self, case, seed):
        rng = np.random.default_rng(seed)
        x = Rotation.random(rng=rng).as_matrix() @ case.body.nodes + rng.normal(size=(3, 1))
        forces = _balance(case.solid, jnp.asarray(x), jnp.zeros_like(x), case.still)[1]
        assert np.abs(forces).max() < 1e-12 * YOUNG * MM  # a stress of E on the side of an element: 1e-2 N

    def test_forces_turn_with_the_body(self, case, rng):
        x, c, turn = shaken(case, rng), contracted(case, rng), jnp.asarray(Rotation.random(rng=rng).as_matrix())
        u = jnp.asarray(0.05 * MM * rng.normal(size=x.shape))
        one, other = _balance(case.solid, x, u, c), _balance(case.solid, turn @ x, turn @ u, c)
        assert np.asarray(other[1]) == pytest.approx(np.asarray(turn @ one[1]), abs=1e-11 * np.abs(one[1]).max())
        assert float(other[0]) == pytest.approx(float(one[0]), rel=1e-9)

    def test_it_moves_no_centre_and_turns_nothing(self, case, rng):
        x, c = shaken(case, rng), contracted(case, rng)
        f = np.asarray(_balance(case.solid, x, jnp.zeros_like(x), c)[1])
        assert np.abs(f.sum(axis=1)).max() < 1e-12 * np.abs(f).sum()
        assert np.abs(np.cross(x, f, axis=0).sum(axis=1)).max() < 1e-12 * np.abs(f).sum() * 4 * MM

    def test_uniform_strain_is_hookes_law(self, case, rng):
        strain_of = 1e-6 * rng.normal(size=(3, 3))
        strain_of = (strain_of + strain_of.T) / 2.0
        lame, mu = float(case.solid.lame), float(case.solid.shear)
        assert mu * (3 * lame + 2 * mu) / (lame + mu) == pytest.approx(YOUNG)
        assert lame / (2 * (lame + mu)) == pytest.approx(POISSON)
        stress = 2 * mu * strain_of + lame * np.trace(strain_of) * np.eye(3)
        nodes = jnp.asarray(case.body.nodes)
        energy, forces = _balance(case.solid, nodes, jnp.asarray(strain_of) @ nodes, case.still)
        assert float(energy) == pytest.approx(0.5 * np.sum(stress * strain_of) * case.body.volume, rel=1e-4)
        virial = -np.asarray(forces) @ case.body.nodes.T / case.body.volume
        assert virial == pytest.approx(stress, abs=1e-5 * np.abs(stress).max())
        x, y, z = case.body.nodes
        inside = (np.abs(x) < 1.99 * MM) & (np.abs(y) < 1.99 * MM) & (z > 0.01 * MM) & (z < 0.99 * MM)
        assert inside.any()
        assert (
            np.abs(np.asarray(forces)[:, inside]).max() < 1e-7 * np.abs(forces).max()
        )  # rounding, of a strain of 1e-6

    def test_uniform_contraction_leaves_no_stress(self, case):
        c = gauss_contraction(case.solid, jnp.full(case.body.centre.shape, 0.4))
        shrunk = jnp.asarray(case.body.nodes * np.array([[0.6], [0.6], [1.0]]))
        assert float(_energy(case.solid, shrunk, c)) == pytest.approx(0.0, abs=1e-12 * YOUNG * case.body.volume)
        forces = _balance(case.solid, shrunk, jnp.zeros_like(shrunk), c)[1]
        assert np.abs(forces).max() < 1e-12 * YOUNG * MM**2 * 1e3
        stiff = _balance(case.solid, jnp.asarray(case.body.nodes), jnp.zeros_like(shrunk), c)[1]
        assert np.abs(stiff).max() > 1e-4 * YOUNG * MM**2

    def test_contraction_of_a_vertex(self, case, sheet, rng):
        ads, p_l = rng.uniform(0.0, 1.0, sheet.faces.shape[1]), 0.7
        found = np.asarray(vertex_contraction(case.solid, p_l, jnp.asarray(ads)))
        a, b, c = (sheet.nodes[:, sheet.faces[k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a, axis=0), axis=0)
        for vertex in range(sheet.nodes.shape[1]):
            beside = np.any(sheet.faces == vertex, axis=0)
            assert found[vertex] == pytest.approx(p_l * np.average(ads[beside], weights=area[beside]))

    def test_vertices_inside_do_not_contract(self):
        body = with_midpoints(build_body(strip(4 * MM, 4 * MM), 1 * MM, 1 * MM, 3))
        solid = build_solid(body, YOUNG, POISSON)
        found = np.asarray(vertex_contraction(solid, 0.5, jnp.ones(body.faces.shape[1])))
        x, y, z = body.nodes[:, : len(found)]
        inside = (np.abs(x) < 1.9 * MM) & (np.abs(y) < 1.9 * MM) & (np.abs(z - 0.5 * MM) < 0.1 * MM)
        assert inside.any()
        assert found == pytest.approx(np.where(inside, 0.0, 0.5))

    def test_single_precision_feels_small_displacements(self, rng):
        """Forces that 10 nm bring about, beside the change of shape already there, to a part in 10,000."""
        case = beam(8 * MM, 2 * MM, 1 * MM, 1 * MM)
        x = jnp.asarray(bent(case, 1.5), jnp.float32)
        u, c = jnp.asarray(1e-8 * rng.normal(size=x.shape), jnp.float32), jnp.zeros_like(case.still, jnp.float32)
        single = jax.tree.map(lambda a: a.astype(jnp.float32) if a.dtype == jnp.float64 else a, case.solid)
        double = [a.astype(jnp.float64) for a in (x, u, c)]
        expected = _strained_balance(case.solid, _strain(case.solid, double[0], double[2]), double[1])
        still = _balance(case.solid, double[0], jnp.zeros_like(double[0]), double[2])
        known = _strain(single, x, c)
        mine, before = _strained_balance(single, known, u), _strained_balance(single, known, jnp.zeros_like(u))
        change = np.asarray(mine[1], float) - np.asarray(before[1], float)
        wanted = np.asarray(expected[1] - still[1])
        error = np.linalg.norm(change - wanted) / np.linalg.norm(wanted)
        whole = np.linalg.norm(np.asarray(mine[1]) - np.asarray(expected[1])) / np.linalg.norm(expected[1])
        print(f"single precision: forces {whole:.1e}, change of forces by 10 nm {error:.1e}, energy ", end="")
        print(f"{abs(float(mine[0]) / float(expected[0]) - 1.0):.1e}")
        assert mine[1].dtype == jnp.float32
        assert error < 1e-3
        assert whole < 1e-4
        assert float(mine[0]) == pytest.approx(float(expected[0]), rel=1e-3)


class TestBlocks:
    def test_hessian_at_rest(self, tiny):
        nodes = jnp.asarray(tiny.body.nodes)
        hessian = np.asarray(jax.jit(jax.hessian(solid_energy, argnums=1))(tiny.solid, nodes, tiny.still))
        hessian = hessian.reshape(nodes.size, nodes.size)
        found = stiffness(tiny, tiny.body.nodes, tiny.still).toarray()
        assert found == pytest.approx(hessian, abs=1e-10 * np.abs(hessian).max())

    def test_turns_with_the_body(self, tiny, rng):
        turn = Rotation.random(rng=rng).as_matrix()
        big = np.kron(turn, np.eye(tiny.body.nodes.shape[1]))
        one = stiffness(tiny, tiny.body.nodes, tiny.still).toarray()
        other = stiffness(tiny, turn @ tiny.body.nodes, tiny.still).toarray()
        assert other == pytest.approx(big @ one @ big.T, abs=1e-9 * np.abs(one).max())

    @pytest.mark.parametrize("state", ["bent", "crumpled", "inside out"])
    def test_positive_semidefinite_anywhere(self, case, rng, state):
        if state == "bent":
            x = bent(case, 4.0)
        elif state == "crumpled":
            x = np.asarray(shaken(case, rng, 0.5 * MM))
        else:
            x = case.body.nodes * np.array([[1.0], [1.0], [-1.0]])
        matrix = stiffness(case, x, contracted(case, rng)).toarray()
        assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()
        values = np.linalg.eigvalsh(matrix)
        assert values[0] > -1e-12 * values[-1]


def test_batch_is_one_by_one(tiny, rng):
    x = np.stack([np.asarray(shaken(tiny, rng)) for _ in range(3)], axis=-1)
    u = 0.02 * MM * rng.normal(size=x.shape)
    ads = rng.uniform(size=(tiny.body.faces.shape[1], 3))
    moduli = np.array([0.5, 1.0, 2.0])
    many = tiny.solid._replace(lame=tiny.solid.lame * moduli, shear=tiny.solid.shear * moduli)
    c = gauss_contraction(many, vertex_contraction(many, 0.5, jnp.asarray(ads)))
    energy, forces = _balance(many, jnp.asarray(x), jnp.asarray(u), c)
    blocks = _blocks(many, jnp.asarray(x), c)
    whole = _energy(many, jnp.asarray(x), c)
    for k in range(3):
        one = tiny.solid._replace(lame=many.lame[k], shear=many.shear[k])
        alone = gauss_contraction(one, vertex_contraction(one, 0.5, jnp.asarray(ads[:, k])))
        assert np.asarray(c[..., k]) == pytest.approx(np.asarray(alone), rel=1e-12)
        e, f = _balance(one, jnp.asarray(x[..., k]), jnp.asarray(u[..., k]), alone)
        assert float(energy[k]) == pytest.approx(float(e), rel=1e-10)
        assert np.asarray(forces[..., k]) == pytest.approx(np.asarray(f), abs=1e-12 * np.abs(f).max())
        assert float(whole[k]) == pytest.approx(float(_energy(one, jnp.asarray(x[..., k]), alone)), rel=1e-10)
        for mine, other in zip(blocks, _blocks(one, jnp.asarray(x[..., k]), alone), strict=True):
            assert np.asarray(mine[..., k]) == pytest.approx(np.asarray(other), abs=1e-12 * np.abs(other).max())
    # One contraction for all of a batch.
    shared = _balance(many, jnp.asarray(x), jnp.asarray(u), c[..., 0])[1]
    assert np.asarray(shared[..., 0]) == pytest.approx(np.asarray(forces[..., 0]), abs=1e-12 * np.abs(forces).max())


class TestContractionBends:
    @pytest.mark.parametrize(("eps", "allowed"), [(0.01, 0.003), (0.1, 0.005), (0.4, 0.03)])
    def test_linear_through_the_thickness(self, eps, allowed):
        """Without stress: lengths 1 - eps below, 1 above, h apart; one layer of elements."""
        h = 1 * MM
        case = beam(10 * MM, 2 * MM, h, 1 * MM)
        z = case.body.nodes[2, : case.solid.vertex_faces.shape[1]]
        c = gauss_contraction(case.solid, jnp.asarray(eps * (1.0 - z / h)))
        x = equilibrium(case, c)
        found = curvature(case, x) * h / (eps / (1.0 - eps / 2.0))
        print(f"contraction {eps} (1 - z / h): curvature over eps / (h (1 - eps / 2)): {found:.4f}")
        assert found == pytest.approx(1.0, rel=allowed)

    @pytest.mark.slow
    @pytest.mark.parametrize(("layers", "lower"), [(2, 1), (4, 1), (4, 3)])
    def test_timoshenko_bilayer(self, layers, lower):
        eps, h = 0.005, 1 * MM
        case = beam(10 * MM, 2 * MM, h, 1 * MM, layers + 1)
        height = case.body.nodes[2, case.body.tetrahedra[:4]].mean(axis=0)
        c = jnp.asarray(np.tile(np.where(height < h * lower / layers, eps, 0.0), (4, 1)))
        m = lower / (layers - lower)
        expected = 6.0 * eps * (1.0 + m) ** 2 / (h * (3.0 * (1.0 + m) ** 2 + (1.0 + m) * (m**2 + 1.0 / m)))
        found = curvature(case, equilibrium(case, c)) / expected
        print(f"bilayer, lower {lower} of {layers}: curvature over Timoshenko's: {found:.4f}")
        assert found == pytest.approx(1.0, rel=0.01)


class TestBeam:
    @pytest.mark.parametrize(("poisson", "allowed"), [(0.0, 0.005), (0.3, 0.02), (0.45, 0.05)])
    def test_sags_like_a_beam(self, poisson, allowed):
        """One element wide and thick. The nearer the gel comes to keeping its volume, the stiffer so coarse a mesh."""
        found = sag(beam(20 * MM, 1 * MM, 1 * MM, 1 * MM, poisson=poisson))
        print(f"sag over w L^4 / (8 E I), one layer, mesh 1 mm, nu {poisson}: {found:.4f}")
        assert found == pytest.approx(1.0, rel=allowed)

    @pytest.mark.slow
    def test_sag_converges(self):
        """In the plane and through the thickness: every size is halved."""
        sizes = [2.0, 1.0, 0.5]
        found = [sag(beam(8 * MM, 2 * MM, 2 * MM, s * MM, round(2.0 / s) + 1)) for s in sizes]
        order = np.log2((found[1] - found[0]) / (found[2] - found[1]))
        print(f"sag at mesh 2, 1, 0.5 mm: {found[0]:.5f} {found[1]:.5f} {found[2]:.5f}, order {order:.2f}")
        assert order > 1.5

    def test_first_frequency(self):
        length, width, h, density = 20 * MM, 2 * MM, 1 * MM, 1050.0
        case = beam(length, width, h, 1 * MM)
        nodes = case.body.nodes
        free = np.tile(nodes[0] > nodes[0].min() + 1e-9, 3)
        mass = scipy.sparse.diags_array(np.tile(density * case.body.node_volume, 3)[free]).tocsc()
        k = stiffness(case, nodes, case.still)[free][:, free]
        squares = scipy.sparse.linalg.eigsh(k, 4, mass, sigma=0.0, return_eigenvectors=False, v0=np.ones(free.sum()))
        inertia, area = width * h**3 / 12.0, width * h
        expected = FIRST_MODE**2 * np.sqrt(YOUNG * inertia / (density * area)) / length**2
        found = float(np.sqrt(squares.min())) / expected
        print(f"first frequency of a clamped beam over Euler's: {found:.4f}")
        assert found == pytest.approx(1.0, rel=0.03)

    @pytest.mark.slow
    def test_elastica(self):
        """A dead load at the tip: E I theta'' = -P cos(theta), theta(0) = theta'(L) = 0 (Bisshopp and Drucker 1945)."""
        length, width, h, load = 20 * MM, 1 * MM, 0.5 * MM, 3.5  # of E I / L^2
        case = beam(length, width, h, 0.7 * MM)
        slope, down, back = elastica(load)
        nodes = case.body.nodes
        end = nodes[0] > nodes[0].max() - 1e-9
        force = np.zeros(nodes.shape)
        force[2, end] = -load * YOUNG * width * h**3 / 12.0 / length**2 / end.sum()
        x = equilibrium(case, case.still, force, nodes[0] < nodes[0].min() + 1e-9)
        tip = (x - nodes)[:, end].mean(axis=1) / length
        lean = np.polyfit(nodes[2, end], x[0, end], 1)[0]
        tilt = float(np.arcsin(np.clip(lean, -1.0, 1.0)))
        print(
            f"elastica: tip slope {np.degrees(slope):.1f} deg, found {np.degrees(tilt):.1f}; down {down:.4f}, ", end=""
        )
        print(f"found {-tip[2]:.4f}; back {back:.4f}, found {-tip[0]:.4f}")
        assert np.degrees(slope) == pytest.approx(60.0, abs=5.0)
        assert tilt == pytest.approx(slope, rel=0.02)
        assert -tip[2] == pytest.approx(down, rel=0.02)
        assert -tip[0] == pytest.approx(back, rel=0.02)
