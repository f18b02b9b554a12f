"""The body's contact with itself: distances, forces, which pairs are looked at, and real collisions.

| identity | one road | the other |
|---|---|---|
| no hidden nan | nodes on nodes | finite values, normals, derivatives |
| closest points | `closest_weights` | the least over many points of both sides |
| barrier | its derivatives, by `jax.grad` | its force, its stiffness |
| envelope theorem | `jax.grad` of the energy of all contacts, friction included | minus the forces |
| balance | sum of a contact's forces and of their torques | 0 |
| parallel edges | energy of two edges turned through parallel | continuous, 0 there |
| crossing strips | least distance, face on face, node on face, edge on edge | the distance set |
| rigid motion | distances and staleness of a moved and turned body | the same; not stale |
| candidates | `find_pairs` | all pairs, one by one |
| a flat and a domed body | candidates | none |
| too little room | `missed` | more than 0 |
| no crossing | distance after the `longest_way` | at least `KEPT` of the one before |
| what is not watched | way of a node that has moved margin / 2 | 0 |
| a way far too long | the same, of a node that has not moved | as far as is watched, not 0 |
| faces on each other | the preconditioner (Woodbury) | the dense stiffness, contacts included, solved |
| few places taken | energy, forces, `longest_way` with many more places | the same |
| a batch, single precision | last axis; 32 bits | one robot after the other; 64 bits |
| two strips that fall on each other, 90 and 45 degrees | nodes inside tetrahedra | less than 1 % of the thickness deep|
| a strip that curls until its ends meet | the same | the same |
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array
from scipy.spatial.transform import Rotation

from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import strip
from gelbot.mechanics.implicit import (
    Mechanics,
    apply_inverse,
    begin_step,
    build_preconditioner,
    no_preconditioner,
    solve_step,
)
from gelbot.mechanics.pair_contact import (
    KEPT,
    PairLaw,
    Touching,
    barrier,
    longest_way,
    pair_balance,
    pair_gaps,
    pair_stiffness,
    touch,
)
from gelbot.mechanics.self_contact import (
    EXCLUSION,
    ContactPairs,
    ContactSurface,
    changed,
    closest_weights,
    contact_surface,
    find_pairs,
    stale,
)

MM = 1e-3
H, MESH = 0.8 * MM, 0.9 * MM
LAYER, MARGIN = 0.05 * H, 0.2 * H
UPRIGHT = jnp.eye(3)
LAW = PairLaw(jnp.asarray(30.0), jnp.asarray(LAYER), jnp.asarray(0.2), jnp.asarray(2e-6))
DT = jnp.asarray(0.05)

look, start, act, way = jax.jit(find_pairs), jax.jit(touch), jax.jit(pair_balance), jax.jit(longest_way)
energy_slope = jax.jit(jax.grad(lambda *of: pair_balance(*of)[0], argnums=3))


@pytest.fixture(scope="module")
def band() -> Body:
    """A strip of 8 x 2 x 0.8 mm."""
    return build_body(strip(8.0 * MM, 2.0 * MM), H, MESH)


@cache
def long_strip() -> tuple[Body, ContactSurface]:
    """A strip of 24 x 3 x 0.8 mm; no fixture, whose contents hypothesis would print."""
    body = build_body(strip(24.0 * MM, 3.0 * MM), H, MESH)
    return body, surface_of(body)


@pytest.fixture(scope="module")
def double(band) -> Body:
    """Two strips as one body, far apart at rest."""
    n, f = band.nodes.shape[1], band.faces.shape[1]
    both = partial(np.concatenate, axis=-1)
    return replace(
        band,
        nodes=both([band.nodes, band.nodes + np.array([[0.0], [0.0], [0.1]])]),
        tetrahedra=both([band.tetrahedra, band.tetrahedra + n]),
        faces=both([band.faces, band.faces + n]),
        springs=both([band.springs, band.springs + n]),
        spring_length=both([band.spring_length] * 2),
        spring_volume=both([band.spring_volume] * 2),
        spring_faces=both([band.spring_faces, band.spring_faces + f]),
        spring_face_weights=both([band.spring_face_weights] * 2),
        node_volume=both([band.node_volume] * 2),
    )


@pytest.fixture(scope="module")
def two(double) -> ContactSurface:
    return surface_of(double, contacts_per_node=6.0)  # face on face, node on node


def surface_of(body: Body, **more: float) -> ContactSurface:
    return contact_surface(body.faces, body.nodes, H, MESH, LAYER, MARGIN, **more)


def both_at(band: Body, lower: Rotation, upper: Rotation, shift: np.ndarray) -> Array:
    """Two strips turned about their middles, the second moved by `shift`."""
    x = band.nodes - np.array([[0.0], [0.0], [0.5 * H]])
    return jnp.asarray(np.concatenate([lower.as_matrix() @ x, upper.as_matrix() @ x + shift[:, None]], axis=1))


def about(axis: str, degrees: float | list[float]) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


def rolled(x: np.ndarray, radius: float) -> np.ndarray:
    """The sheet bent upwards about the y direction: its mid-plane lies on a cylinder, thickness and length are kept."""
    r, angle = radius - (x[2] - 0.5 * H), x[0] / radius
    return np.stack([r * np.sin(angle), x[1], radius - r * np.cos(angle)])


def distances(touching: Touching) -> np.ndarray:
    """Of the pairs that are there [m]."""
    return np.asarray(pair_gaps(touching.pairs, touching.corners).distance)[np.asarray(touching.pairs.valid)]


def touched(surface: ContactSurface, x: Array) -> Touching:
    pairs = look(surface, x, UPRIGHT)
    assert int(pairs.missed) == 0
    return start(surface, pairs, LAW, x)


GAP = 0.5 * LAYER
UP = np.array([0.0, 0.0, 1.0])
TILTED = H / np.sqrt(2.0) / 2.0 + 2.0 * MM / np.sqrt(2.0) / 2.0  # how far an edge of the rim is from a strip's axis
MEETINGS = {
    "face on face": (about("z", 0), about("z", 90), (H + GAP) * UP),
    "face on face, 45 degrees": (about("z", 0), about("z", 45), (H + GAP) * UP),
    "rim on face": (about("z", 0), about("xz", [90, 30]), (0.5 * H + 1.0 * MM + GAP) * UP),
    "corner on face": (
        about("z", 0),
        about("yz", [60, 30]),
        (0.5 * H + 4.0 * MM * np.sin(np.pi / 3) + 0.5 * H * 0.5 + GAP) * UP,
    ),
    "edge on face": (about("z", 0), about("xz", [45, 20]), (0.5 * H + TILTED + GAP) * UP),
    "edge on edge, 90 degrees": (about("x", 45), about("xz", [45, 90]), (2.0 * TILTED + GAP) * UP),
    "edge on edge, 45 degrees": (about("x", 45), about("xz", [45, 45]), (2.0 * TILTED + GAP) * UP),
}


class TestDistances:
    @pytest.mark.parametrize("first", [1, 2])
    def test_closest_of_many_points(self, first, rng):
        corners = rng.normal(size=(3, 4, 300))
        weights = np.asarray(closest_weights(jnp.asarray(corners), first))
        assert np.sum(weights[:first], axis=0) == pytest.approx(1.0)
        assert np.sum(weights[first:], axis=0) == pytest.approx(-1.0)
        assert weights[:first].min() >= 0.0
        assert weights[first:].max() <= 1e-12
        distance = np.linalg.norm(np.sum(weights * corners, axis=1), axis=0)
        if first == 1:
            grid = np.array([(i, j, 120 - i - j) for i in range(121) for j in range(121 - i)]).T / 120.0
            tried = np.concatenate([np.ones((1, grid.shape[1])), -grid])
        else:
            s, t = (g.ravel() for g in np.meshgrid(*[np.linspace(0.0, 1.0, 100)] * 2))
            tried = np.stack([1.0 - s, s, t - 1.0, -t])
        found = np.linalg.norm(np.einsum("xkc,kg->xcg", corners, tried), axis=0).min(axis=1)
        assert np.all(distance <= found + 1e-12)
        assert distance == pytest.approx(found, abs=0.06)

    @pytest.mark.parametrize("name", MEETINGS)
    def test_least_distance_is_the_one_set(self, two, band, name):
        assert distances(touched(two, both_at(band, *MEETINGS[name]))).min() == pytest.approx(GAP, abs=1e-9)

    def test_rigid_motion_changes_nothing(self, two, band, rng):
        x = both_at(band, *MEETINGS["edge on edge, 45 degrees"])
        turn = Rotation.random(rng=rng).as_matrix()
        moved = jnp.asarray(turn @ np.asarray(x) + rng.normal(size=(3, 1)) * MM)
        pairs = look(two, x, UPRIGHT)
        assert distances(start(two, pairs, LAW, moved)) == pytest.approx(
            distances(start(two, pairs, LAW, x)), abs=1e-12
        )
        assert not bool(stale(two, pairs, moved, jnp.asarray(turn)))


class TestForces:
    def test_barrier_and_its_derivatives(self):
        d = jnp.linspace(0.01, 1.2, 50) * LAYER
        one = partial(barrier, stiffness=LAW.stiffness, layer=LAW.layer)
        energy, force, stiffness = one(d)
        assert np.asarray(force) == pytest.approx(-np.asarray(jax.vmap(jax.grad(lambda d: one(d)[0]))(d)))
        assert np.asarray(stiffness) == pytest.approx(-np.asarray(jax.vmap(jax.grad(lambda d: one(d)[1]))(d)))
        assert np.all(np.asarray(energy)[np.asarray(d) > LAYER] == 0.0)
        assert np.all(np.diff(energy) <= 0.0)

    @pytest.mark.parametrize("name", MEETINGS)
    def test_envelope_theorem_and_balance(self, two, band, name, rng):
        x = both_at(band, *MEETINGS[name])
        x = x + 0.1 * GAP * jnp.asarray(rng.normal(size=x.shape))
        touching = touched(two, x)
        u = 0.1 * GAP * jnp.asarray(rng.normal(size=x.shape))
        energy, forces = act(touching, LAW, DT, u)
        slope = energy_slope(touching, LAW, DT, u)
        size = np.abs(forces).max()
        assert float(energy) > 0.0
        assert np.asarray(forces) == pytest.approx(-np.asarray(slope), abs=1e-9 * size)
        assert np.abs(np.sum(forces, axis=1)).max() < 1e-12 * size
        # Friction acts where the points were at the step's beginning: without it, the torques cancel.
        _, push = act(touching, LAW._replace(friction=jnp.asarray(0.0)), DT, u)
        assert np.abs(np.sum(np.cross(x + u, push, axis=0), axis=1)).max() < 1e-10 * MM * size

    def test_edges_turn_through_parallel(self):
        """Two edges, one above the other: their energy fades, without a jump, where their closest points would jump."""
        pairs = ContactPairs(
            jnp.zeros((4, 0), int),
            jnp.arange(4)[:, None],
            jnp.ones(1, bool),
            jnp.asarray(1),
            jnp.asarray(0),
            jnp.zeros(()),
        )
        x0 = jnp.array([[-1.0, 1.0, -1.0, 1.0], [0.0, 0.0, -0.2, 0.2], [GAP / MM, GAP / MM, 0.0, 0.0]]) * MM
        surface = contact_surface(*tetrahedron(), H, MESH, LAYER, MARGIN)
        touching = start(surface, pairs, LAW, x0)
        slopes = np.linspace(-0.3, 0.3, 601)
        energies = []
        for slope in slopes:
            turned = x0.at[1, 2:].set(jnp.array([-slope, slope]) * MM)
            energies.append(float(act(touching, LAW._replace(friction=jnp.asarray(0.0)), DT, turned - x0)[0]))
        assert energies[300] == pytest.approx(0.0, abs=1e-20)
        assert max(energies) == pytest.approx(float(barrier(jnp.asarray(GAP), LAW.stiffness, LAW.layer)[0]))
        assert np.abs(np.diff(energies)).max() < 0.05 * max(energies)

    def test_finite_where_nodes_lie_on_nodes(self, two, band):
        x = both_at(band, about("z", 0), about("z", 0), (H + GAP) * UP)
        touching = touched(two, x)
        energy, forces = act(touching, LAW, DT, jnp.zeros_like(x))
        slope = energy_slope(touching, LAW, DT, jnp.zeros_like(x))
        assert distances(touching).size > 50
        assert all(np.all(np.isfinite(a)) for a in (energy, forces, slope))


class TestCandidates:
    def test_none_in_a_flat_and_a_domed_star(self, star):
        surface = surface_of(star)
        dome = np.array(star.nodes)
        dome[2] += 4.0 * MM * (1.0 - (dome[0] ** 2 + dome[1] ** 2) / (8.0 * MM) ** 2)
        for x in (star.nodes, dome):
            pairs = look(surface, jnp.asarray(x), UPRIGHT)
            assert (int(pairs.found), int(pairs.missed)) == (0, 0)

    @pytest.mark.slow
    @settings(max_examples=4)
    @given(st.floats(3.2, 4.2), st.integers(0, 1000))
    def test_all_that_are_near(self, radius, seed):
        """A strip rolled up until its ends meet and pass each other, shaken."""
        (long_band, surface), rng = long_strip(), np.random.default_rng(seed)
        twist = 0.03 * rng.normal() * long_band.nodes[0]
        x = rolled(long_band.nodes, radius * MM) + np.stack([0 * twist, twist, 0 * twist])
        x += 0.02 * MM * rng.normal(size=x.shape)
        pairs = look(surface, jnp.asarray(x), UPRIGHT)
        assert int(pairs.missed) == 0
        valid, met = np.asarray(pairs.valid), pairs.node_face.shape[1]
        faced = {tuple(map(int, p)) for p in np.asarray(pairs.node_face)[:, valid[:met]].T}
        crossed = {frozenset(map(int, p)) for p in np.asarray(pairs.edge_edge)[:, valid[met:]].T}
        nodes = np.asarray(surface.nodes)
        assert faced == {tuple(map(int, p)) for p in near_one_by_one(x, nodes, np.asarray(surface.faces)).T}
        edges = np.asarray(surface.edges)
        assert crossed == {frozenset(map(int, p)) for p in near_one_by_one(x, edges, edges).T}

    def test_too_little_room_is_reported(self):
        long_band, _ = long_strip()
        x = jnp.asarray(rolled(long_band.nodes, 3.0 * MM))
        assert int(find_pairs(surface_of(long_band, contacts_per_node=0.05), x, UPRIGHT).missed) > 0

    def test_stale_when_a_node_has_moved_a_quarter_of_the_margin(self, rng):
        long_band, surface = long_strip()
        x = jnp.asarray(long_band.nodes)
        turn = jnp.asarray(Rotation.random(rng=rng).as_matrix())
        pairs = look(surface, x, UPRIGHT)
        tumbled = turn @ x + jnp.asarray([[1.0], [2.0], [3.0]])
        n = x.shape[1]
        for share, expected in ((0.0, False), (0.24, False), (0.26, True)):
            moved = tumbled.at[0, 5].add(share * MARGIN * n / (n - 1))  # the mean moves too
            assert bool(stale(surface, pairs, moved, turn)) is expected

    def test_batch_is_one_after_the_other(self):
        long_band, surface = long_strip()
        x = jnp.stack([jnp.asarray(rolled(long_band.nodes, r * MM)) for r in (3.824, 20.0)], axis=-1)
        frames = jnp.stack([UPRIGHT, UPRIGHT], axis=-1)
        pairs = look(surface, x, frames)
        touching, u = start(surface, pairs, LAW, x), 1e-7 * jnp.cos(1e7 * x)
        assert np.asarray(stale(surface, pairs, x, frames)).tolist() == [False, False]
        energy, forces = act(touching, LAW, DT, u)
        longest = way(surface, touching, changed(pairs, x, frames), u, 1e3 * u)
        for b in range(2):
            one = touched(surface, x[..., b])
            alone = act(one, LAW, DT, u[..., b])
            assert float(energy[b]) == pytest.approx(float(alone[0]))
            assert np.asarray(forces[..., b]) == pytest.approx(np.asarray(alone[1]), abs=1e-12)
            length = way(surface, one, jnp.zeros_like(u[..., b]), u[..., b], 1e3 * u[..., b])
            assert float(longest[b]) == pytest.approx(float(length), rel=1e-6)
        assert float(energy[0]) > 0.0

    def test_single_precision(self):
        long_band, surface = long_strip()
        x = jnp.asarray(rolled(long_band.nodes, 3.824 * MM))
        single = jax.tree.map(lambda a: a.astype(jnp.float32) if a.dtype == jnp.float64 else a, (surface, LAW, x, DT))
        touching = touch(single[0], find_pairs(single[0], single[2], UPRIGHT), single[1], single[2])
        u = 0.01 * LAYER * jnp.cos(1e6 * x)
        energy, forces = act(touching, single[1], single[3], u.astype(jnp.float32))
        expected = act(touched(surface, x), LAW, DT, u)
        assert energy.dtype == forces.dtype == jnp.float32
        assert float(energy) > 0.0
        assert float(energy) == pytest.approx(float(expected[0]), rel=1e-2)
        assert np.asarray(forces) == pytest.approx(np.asarray(expected[1]), abs=1e-2 * np.abs(expected[1]).max())

    def test_open_surface_is_refused(self, band):
        with pytest.raises(ValueError, match="closed"):
            contact_surface(band.faces[:, 1:], band.nodes, H, MESH, LAYER, MARGIN)


class TestNoCrossing:
    @pytest.mark.parametrize("name", MEETINGS)
    def test_distances_stay(self, two, band, name, rng):
        """A strip that is to jump through the other, turning, stops before it."""
        x = both_at(band, *MEETINGS[name])
        touching, n = touched(two, x), band.nodes.shape[1]
        jump = np.zeros(x.shape)
        jump[:, n:] = -(0.1 * MM) * UP[:, None] + np.cross([20.0, 10.0, 5.0], np.asarray(x[:, n:]).T).T * 1e-3
        jump += 0.2 * GAP * rng.normal(size=x.shape)
        length = way(two, touching, jnp.zeros_like(x), jnp.zeros_like(x), jnp.asarray(jump))
        after = distances(start(two, touching.pairs, LAW, x + length * jump))
        assert 0.0 < float(length) < 1.0
        assert np.all(after >= KEPT * distances(touching) - 1e-15)

    def test_what_is_not_watched(self, two, band):
        x = both_at(band, about("z", 0), about("z", 90), 5.0 * MM * UP)
        touching, n = touched(two, x), band.nodes.shape[1]
        down = jnp.zeros_like(x).at[2, n:].set(-MARGIN)
        none = jnp.zeros_like(x)
        assert float(way(two, touching, none, none, down)) == pytest.approx(1.0)  # half each, seen from the middle
        assert float(way(two, touching, none, none, 2.0 * down)) == pytest.approx(0.5)
        assert float(way(two, touching, none, down, down)) == 0.0
        # A body that has not moved finds no new pairs: a way of 0 would be the end of the step.
        assert float(way(two, touching, none, none, 1e5 * down)) == pytest.approx(1e-5)


class TestPreconditioner:
    def test_contacts_of_faces_on_each_other(self, two, double, band, mechanics):
        x = both_at(band, *MEETINGS["face on face"])
        mech, none = mechanics(double)._replace(surface=two), jnp.zeros_like(x)
        begin = begin_step(mech, x, none, mech.elastic.length, DT, look(two, x, UPRIGHT))
        near = build_preconditioner(mech, begin, none, mech.elastic.length, UPRIGHT)
        law = LAW._replace(stiffness=mech.contact_stiffness * mech.contact_layer / LAYER, stick_speed=mech.stick_speed)
        law = law._replace(friction=mech.self_friction)
        nodes, blocks = pair_stiffness(two, begin.touching, law, DT, none)
        square = blocks.reshape(3 * len(nodes), -1)
        assert np.asarray(square) == pytest.approx(np.asarray(square.T))
        assert np.linalg.eigvalsh(square).min() > -1e-12 * np.linalg.norm(square)
        # Nobody is held when both strips move together.
        assert np.abs(jnp.einsum("iajb,b->ia", blocks, jnp.ones(3))).max() < 1e-9 * np.abs(blocks).max()
        free = partial(apply_inverse, mech, near._replace(correction=None), UPRIGHT)
        count = x.size
        units = jnp.eye(count).reshape(count, *x.shape)
        inverse = np.asarray(jax.vmap(free)(units)).reshape(count, count)
        places = np.asarray(nodes + x.shape[1] * np.arange(3)[:, None]).T.ravel()  # of (3, n), as the blocks have them
        held = np.zeros((count, count))
        held[np.ix_(places, places)] = square
        stiffness = np.linalg.inv(0.5 * (inverse + inverse.T)) + held
        g = np.zeros(x.shape)
        g[2, band.nodes.shape[1] :] = -1e-6  # pressed on each other
        g[2, : band.nodes.shape[1]] = 1e-6
        expected = np.linalg.solve(stiffness, g.ravel())
        found = np.asarray(apply_inverse(mech, near, UPRIGHT, jnp.asarray(g))).ravel()
        assert np.linalg.norm(expected) < 0.1 * np.linalg.norm(free(jnp.asarray(g)))
        assert found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())

    def test_places_that_are_empty_change_nothing(self, double, two, band):
        x = both_at(band, *MEETINGS["edge on face"])
        u = 0.1 * GAP * jnp.cos(1e6 * x)
        found = []
        for room in (1.0, 6.0, 60.0):
            surface = surface_of(double, contacts_per_node=room)
            touching = touched(surface, x)
            found.append((*act(touching, LAW, DT, u), way(surface, touching, jnp.zeros_like(u), u, 1e3 * u)))
        for energy, forces, length in found[1:]:
            assert float(energy) == pytest.approx(float(found[0][0]), rel=1e-12)
            assert np.asarray(forces) == pytest.approx(np.asarray(found[0][1]), abs=1e-12 * np.abs(forces).max())
            assert float(length) == pytest.approx(float(found[0][2]), rel=1e-12)


@partial(jax.jit, static_argnames=("steps",))
def fall(mech: Mechanics, x: Array, rests: Array, dt: Array, steps: int) -> tuple[Array, Array, Array]:
    """Positions (k, 3, n), residuals and missing pairs (k,) of a body with a rest shape for each step, (k, s)."""
    surface = mech.surface
    assert surface is not None

    def one(carry: tuple, rest: Array) -> tuple[tuple, tuple[Array, Array, Array]]:
        x, v, near, pairs, is_old = carry
        found, near, pairs = solve_step(mech, x, v, rest, dt, near, UPRIGHT, is_old, pairs)
        assert pairs is not None
        return (found.x, (found.x - x) / dt, near, pairs, found.iterations > 10), (
            found.x,
            found.residual,
            pairs.missed,
        )

    first = (x, jnp.zeros_like(x), no_preconditioner(mech, ()), find_pairs(surface, x, UPRIGHT), jnp.asarray(True))
    return jax.lax.scan(one, first, rests, length=steps)[1]


class TestCollisions:
    """Penetration is measured otherwise: nodes inside tetrahedra of parts far away at rest."""

    @pytest.mark.slow
    @pytest.mark.parametrize("degrees", [90.0, 45.0])
    def test_strip_falls_on_a_strip(self, double, band, two, mechanics, degrees):
        """Ten times as heavy in water as gel: it presses and bends over the lower one."""
        x = both_at(band, about("z", 0), about("z", degrees), (1.3 * H) * UP) + jnp.asarray(0.6 * H * UP[:, None])
        mech = mechanics(double, density=1500.0, tolerance=0.01)._replace(surface=two)
        steps, n = 50, band.nodes.shape[1]
        rests = jnp.broadcast_to(mech.elastic.length, (steps, len(mech.elastic.length)))
        xs, residual, missed = fall(mech, x, rests, jnp.asarray(0.01), steps)
        assert float(jnp.max(residual)) <= 0.01
        assert int(jnp.max(missed)) == 0
        assert max(deepest(double, np.asarray(x)) for x in xs[::2]) < 0.01 * H
        between = float(jnp.mean(xs[-1, 2, n:]) - jnp.mean(xs[-1, 2, :n]))
        assert 0.2 * H < between < 1.2 * H  # it has fallen, and hangs over the lower strip

    @pytest.mark.slow
    def test_strip_curls_until_its_ends_meet(self, mechanics):
        body = build_body(strip(12.0 * MM, 2.0 * MM), H, MESH)
        surface, steps = surface_of(body, contacts_per_node=6.0), 60
        mech = mechanics(body, tolerance=0.03)._replace(surface=surface)
        upper = np.all(body.nodes[2][body.springs] > 0.9 * H, axis=0)
        shrink = 1.0 - 0.75 * np.linspace(0.0, 1.0, steps)[:, None] * upper
        x = jnp.asarray(body.nodes + 0.02 * H * UP[:, None])
        xs, residual, missed = fall(mech, x, jnp.asarray(body.spring_length * shrink), jnp.asarray(0.1), steps)
        assert float(jnp.max(residual)) <= 0.03
        assert int(jnp.max(missed)) == 0
        assert max(deepest(body, np.asarray(x)) for x in xs[::2]) < 0.01 * H
        assert distances(touched(surface, xs[-1])).min() < LAYER


def tetrahedron() -> tuple[np.ndarray, np.ndarray]:
    """Faces (3, 4) and nodes [m] (3, 4) of a body of four nodes, several mm large."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).T
    return faces, 9.0 * MM * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).T


def deepest(body: Body, x: np.ndarray) -> float:
    """How deep [m] a node lies in a tetrahedron whose middle is 2.5 mm or more away from it at rest; 0: none does."""
    corners = x[:, body.tetrahedra]
    rest = body.nodes
    far = np.linalg.norm(rest[:, :, None] - rest[:, body.tetrahedra].mean(axis=1)[:, None], axis=0) > 2.5 * MM
    low, high = corners.min(axis=1)[:, None], corners.max(axis=1)[:, None]
    nodes, tets = np.nonzero(far & np.all((x[:, :, None] >= low) & (x[:, :, None] <= high), axis=0))
    sides = np.moveaxis(corners[:, 1:, tets] - corners[:, :1, tets], -1, 0)
    to_node = (x[:, nodes] - corners[:, 0, tets]).T
    solvable = np.abs(np.linalg.det(sides)) > 1e-18
    nodes, shares = nodes[solvable], np.linalg.solve(sides[solvable], to_node[solvable][..., None])[..., 0]
    inside = nodes[np.all(shares > 0.0, axis=1) & (shares.sum(axis=1) < 1.0)]
    depth = 0.0
    for i in inside:
        apart = np.linalg.norm(rest[:, i, None] - rest[:, body.faces].mean(axis=1), axis=0) > 2.0 * MM
        faces = body.faces[:, apart]
        corners = np.stack([np.broadcast_to(x[:, i, None], x[:, faces[0]].shape), *(x[:, f] for f in faces)], axis=1)
        weights = np.asarray(closest_weights(jnp.asarray(corners), 1))
        depth = max(depth, np.linalg.norm(np.sum(weights * corners, axis=1), axis=0).min())
    return depth


def near_one_by_one(x: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Nodes (4, c) of all pairs of a simplex `first` (d, .) and one `second` (4 - d, .) that are near by definition."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(first.shape[1]), np.arange(second.shape[1])))
    if first is second:
        i, j = i[i < j], j[i < j]
    rest, reach = long_strip()[0].nodes, LAYER + MARGIN
    middles = rest[:, first].mean(axis=1)[:, i] - rest[:, second].mean(axis=1)[:, j]
    nodes = np.concatenate([first[:, i], second[:, j]])[:, np.linalg.norm(middles, axis=0) >= EXCLUSION * (H + MESH)]
    corners = x[:, nodes]
    distance = np.linalg.norm(np.sum(np.asarray(closest_weights(corners, len(first))) * corners, axis=1), axis=0)
    return nodes[:, distance < reach]
