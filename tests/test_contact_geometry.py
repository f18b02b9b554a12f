"""Obstacles and the body's contact with itself: gaps, normals, weights, and which pairs are looked at.

| identity | one road | the other |
|---|---|---|
| signed distance | `gaps` | closed forms; the closest of many points on the surface |
| eikonal | length of the numerical gradient of a gap | 1 |
| normals | closed form | numerical gradient; `jax.grad` |
| no hidden nan | centres, axes, corners, edges | finite values, normals, derivatives |
| balance | sum of a contact's weights | 0 |
| envelope theorem | `jax.grad` of a pair's gap | w n |
| rigid motion | gaps of a moved and turned body | the same gaps |
| crossing strips | least gap, face on face, node on face, edge on edge | the distance set |
| which sheet a node meets | sum of its shares | 1, over faces, edges and corners |
| sliding from face to face | gap along the way | continuous |
| convex rim | pairs round the corner of what is met | no share |
| candidates | `find_pairs` | all pairs, one by one |
| staleness | a tumbling body; a node that moves | not; yes |
| a flat and a domed body | candidates | none |
| a closed ring | least gap | the overlap set, negative |
| too little room | `missed` | more than 0 |
| a batch | last axis | one robot after the other |
"""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import strip
from gelbot.mechanics import obstacles as obs
from gelbot.mechanics.self_contact import (
    FAR,
    ContactPairs,
    ContactSurface,
    contact_surface,
    find_pairs,
    pair_gaps,
    settle,
    stale,
)

MM = 1e-3
H, MESH = 0.8 * MM, 0.9 * MM
LAYER, MARGIN = 0.01 * MM, 0.2 * MM
UPRIGHT = jnp.eye(3)

look, settled, measured = jax.jit(find_pairs), jax.jit(settle), jax.jit(pair_gaps)
obstacle_gaps = jax.jit(obs.gaps)


def find(surface: ContactSurface, x: jnp.ndarray, frame: jnp.ndarray) -> ContactPairs:
    return settled(surface, look(surface, x, frame), x)


# --- obstacles ---


def around(rng: np.random.Generator) -> obs.Obstacles:
    """One or two of each kind, a few mm in size, turned at random."""
    turn = Rotation.random(2, rng=rng).as_matrix()
    f = jnp.asarray
    return obs.Obstacles(
        obs.Planes(f(rng.normal(size=(3, 2)) * MM), f(turn[:, :, 2].T), f([0.1, 0.2])),
        obs.Spheres(f(rng.normal(size=(3, 1)) * MM), f([2.0 * MM]), f([0.3])),
        obs.Cylinders(
            f(rng.normal(size=(3, 2)) * MM), f(turn[:, :, 0].T), f([1.0, 2.0]) * MM, f([5.0, 1.0]) * MM, f([0.4, 0.5])
        ),
        obs.Boxes(
            f(rng.normal(size=(3, 2)) * MM),
            f(rng.uniform(1.0, 4.0, (3, 2)) * MM),
            f(np.moveaxis(turn, 0, -1)),
            f([0.6, 0.7]),
        ),
    )


def on_surfaces(world: obs.Obstacles, rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Points on the spheres, cylinders and boxes, in their order, shape (3, count) each."""
    clouds = []
    for centre, radius in zip(world.spheres.centre.T, world.spheres.radius, strict=True):
        v = rng.normal(size=(3, count))
        clouds.append(np.asarray(centre)[:, None] + float(radius) * v / np.linalg.norm(v, axis=0))
    for k, (centre, axis) in enumerate(zip(world.cylinders.centre.T, world.cylinders.axis.T, strict=True)):
        radius, length = float(world.cylinders.radius[k]), float(world.cylinders.length[k])
        angle, end = rng.uniform(0.0, 2.0 * np.pi, count), rng.random(count) < 0.5
        r = np.where(end, radius * np.sqrt(rng.random(count)), radius)
        z = np.where(end, 0.5 * length * rng.choice([-1.0, 1.0], count), length * rng.uniform(-0.5, 0.5, count))
        u = np.linalg.svd(np.asarray(axis)[None])[2][1:]
        points = r * np.cos(angle) * u[0][:, None] + r * np.sin(angle) * u[1][:, None] + z * np.asarray(axis)[:, None]
        clouds.append(np.asarray(centre)[:, None] + points)
    for k, (centre, size) in enumerate(zip(world.boxes.centre.T, world.boxes.size.T, strict=True)):
        own = rng.uniform(-0.5, 0.5, (3, count))
        own[rng.integers(0, 3, count), np.arange(count)] = rng.choice([-0.5, 0.5], count)
        clouds.append(
            np.asarray(centre)[:, None] + np.asarray(world.boxes.turn[:, :, k]) @ (np.asarray(size)[:, None] * own)
        )
    return clouds


class TestObstacles:
    def test_floor_is_the_height(self, rng):
        x = jnp.asarray(rng.normal(size=(3, 50)))
        gap, normal = obstacle_gaps(obs.floor(jnp.asarray(0.1)), x)
        assert np.array_equal(gap, x[2:])
        assert np.array_equal(normal, np.broadcast_to(np.array([0.0, 0.0, 1.0])[None, :, None], (1, 3, 50)))

    def test_closed_forms(self):
        world = obs.no_obstacles()._replace(
            cylinders=obs.Cylinders(*(jnp.array(v) for v in ([[0.0]] * 3, [[0.0], [0.0], [1.0]], [1.0], [4.0], [0.1]))),
            boxes=obs.Boxes(jnp.zeros((3, 1)), jnp.full((3, 1), 2.0), jnp.eye(3)[:, :, None], jnp.array([0.1])),
        )
        x = jnp.array([[4.0, 0.0, 6.0], [0.9, 0.0, 0.0], [0.0, 0.0, 1.8], [3.0, 0.0, 0.0]]).T
        gap, _ = obstacle_gaps(world, x)
        assert np.asarray(gap[0]) == pytest.approx([5.0, -0.1, -0.2, 2.0])
        assert np.asarray(gap[1]) == pytest.approx([np.hypot(3.0, 5.0), -0.1, 0.8, 2.0])

    def test_distance_is_that_of_the_closest_point(self, rng):
        world = around(rng)
        x = rng.uniform(-6.0, 6.0, (3, 60)) * MM
        found = np.asarray(obstacle_gaps(world, jnp.asarray(x))[0])[2:]
        for gap, cloud in zip(found, on_surfaces(world, rng, 60_000), strict=True):
            closest = np.sqrt(((x[:, :, None] - cloud[:, None]) ** 2).sum(axis=0)).min(axis=1)
            assert np.all(np.abs(gap) <= closest + 1e-12)
            assert np.abs(gap) == pytest.approx(closest, abs=0.08 * MM)

    def test_normals_are_gradients_of_length_one(self, rng):
        world, x, step = around(rng), rng.uniform(-6.0, 6.0, (3, 200)) * MM, 1e-8
        gap, normal = obstacle_gaps(world, jnp.asarray(x))
        differences = [
            (obstacle_gaps(world, jnp.asarray(x + e))[0] - obstacle_gaps(world, jnp.asarray(x - e))[0]) / (2.0 * step)
            for e in step * np.eye(3)[:, :, None]
        ]
        assert np.asarray(normal) == pytest.approx(np.stack(differences, axis=1), abs=1e-5)
        assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0, abs=1e-12)
        for k in range(7):
            slope = jax.jit(jax.grad(lambda x, k=k: jnp.sum(obs.gaps(world, x)[0][k])))(jnp.asarray(x))
            assert np.asarray(slope) == pytest.approx(np.asarray(normal[k]))
        assert gap.shape == (7, 200)
        assert np.asarray(world.friction) == pytest.approx(0.1 * np.arange(1, 8))

    def test_no_jumps(self, rng):
        """Two points are at least as far apart as their gaps differ."""
        world = around(rng)
        a = rng.uniform(-6.0, 6.0, (3, 4000)) * MM
        b = a + rng.normal(size=a.shape) * 0.1 * MM
        change = np.abs(obstacle_gaps(world, jnp.asarray(a))[0] - obstacle_gaps(world, jnp.asarray(b))[0])
        assert np.all(change <= np.linalg.norm(a - b, axis=0) * (1.0 + 1e-9) + 1e-15)

    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_finite_where_the_gradient_is_not_unique(self, rng, dtype):
        world = around(rng)
        axis, box = world.cylinders.axis[:, 0], world.boxes
        corner = box.centre[:, 0] + box.turn[:, :, 0] @ (0.5 * box.size[:, 0])
        special = [
            world.spheres.centre[:, 0],
            world.cylinders.centre[:, 0],
            world.cylinders.centre[:, 0] + 2.5 * MM * axis,
        ]
        x = jnp.stack([*special, box.centre[:, 0], corner], axis=1).astype(dtype)
        gap, normal = obstacle_gaps(world, x)
        slope = jax.jit(jax.grad(lambda x: sum(jnp.sum(part**3) for part in obs.gaps(world, x))))(x)
        assert gap.dtype == normal.dtype == dtype
        assert np.all(np.isfinite(gap))
        assert np.all(np.isfinite(slope))
        assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0, abs=1e-6)

    def test_batch_is_one_after_the_other(self, rng):
        world, x = around(rng), jnp.asarray(rng.uniform(-6.0, 6.0, (3, 20, 3)) * MM)
        gap, normal = obstacle_gaps(world, x)
        for b in range(3):
            one, its_normal = obstacle_gaps(world, x[:, :, b])
            assert np.asarray(gap[..., b]) == pytest.approx(np.asarray(one), abs=1e-15)
            assert np.asarray(normal[..., b]) == pytest.approx(np.asarray(its_normal), abs=1e-12)

    def test_nothing_around(self):
        gap, normal = obstacle_gaps(obs.no_obstacles(), jnp.zeros((3, 4)))
        assert gap.shape == (0, 4)
        assert normal.shape == (0, 3, 4)


# --- the body with itself ---


@pytest.fixture(scope="module")
def band() -> Body:
    """A strip of 12 x 3 x 0.8 mm."""
    return build_body(strip(12.0 * MM, 3.0 * MM), H, MESH)


@cache
def long_strip() -> tuple[Body, ContactSurface]:
    """A strip of 24 x 3 x 0.8 mm; no fixture, whose contents hypothesis would print."""
    body = build_body(strip(24.0 * MM, 3.0 * MM), H, MESH)
    return body, surface_of(body)


@pytest.fixture(scope="module")
def two(band) -> ContactSurface:
    """Two strips as one surface, far apart at rest."""
    apart = np.array([[0.0], [0.0], [0.1]])
    n = band.nodes.shape[1]
    rest = np.concatenate([band.nodes, band.nodes + apart], axis=1)
    return contact_surface(np.concatenate([band.faces, band.faces + n], axis=1), rest, H, MESH, LAYER, MARGIN)


def surface_of(body: Body, **more: float) -> ContactSurface:
    return contact_surface(body.faces, body.nodes, H, MESH, LAYER, MARGIN, **more)


def both(band: Body, lower: Rotation, upper: Rotation, shift: np.ndarray) -> jnp.ndarray:
    """Two strips turned about their middles, the second moved by `shift`."""
    x = band.nodes - np.array([[0.0], [0.0], [0.5 * H]])
    return jnp.asarray(np.concatenate([lower.as_matrix() @ x, upper.as_matrix() @ x + shift[:, None]], axis=1))


def about(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


def rolled(x: np.ndarray, radius: float) -> np.ndarray:
    """The sheet bent upwards about the y direction: its mid-plane lies on a cylinder, thickness and length are kept."""
    r, angle = radius - (x[2] - 0.5 * H), x[0] / radius
    return np.stack([r * np.sin(angle), x[1], radius - r * np.cos(angle)])


def least(surface: ContactSurface, x: jnp.ndarray) -> tuple[float, ContactPairs]:
    pairs = find(surface, x, UPRIGHT)
    assert int(pairs.missed) == 0
    return float(jnp.min(measured(pairs, x).gap)), pairs


GAP = 0.05 * MM
UP = np.array([0.0, 0.0, 1.0])
TILTED = H / np.sqrt(2.0) / 2.0 + 3.0 * MM / np.sqrt(2.0) / 2.0  # how far an edge of the rim is from a strip's axis
MEETINGS = {
    "face on face": (about("z", 0), about("z", 90), (H + GAP) * UP),
    "face on face, 45 degrees": (about("z", 0), about("z", 45), (H + GAP) * UP),
    "rim on face": (about("z", 0), about("xz", [90, 30]), (0.5 * H + 1.5 * MM + GAP) * UP),
    "corner on face": (
        about("z", 0),
        about("yz", [60, 30]),
        (0.5 * H + 6.0 * MM * np.sin(np.pi / 3) + 0.5 * H * 0.5 + GAP) * UP,
    ),
    "edge on face": (about("z", 0), about("xz", [45, 20]), (0.5 * H + TILTED + GAP) * UP),
    "edge on edge, 90 degrees": (about("x", 45), about("xz", [45, 90]), (2.0 * TILTED + GAP) * UP),
    "edge on edge, 45 degrees": (about("x", 45), about("xz", [45, 45]), (2.0 * TILTED + GAP) * UP),
}


class TestMeetings:
    @pytest.mark.parametrize("name", MEETINGS)
    @pytest.mark.parametrize("change", [0.0, -1.5 * GAP])
    def test_least_gap_is_the_distance(self, two, band, name, change):
        """Also a negative one: what has been pushed through knows it."""
        lower, upper, shift = MEETINGS[name]
        found, pairs = least(two, both(band, lower, upper, shift + change * UP))
        assert found == pytest.approx(GAP + change, abs=1e-9)
        assert np.all((pairs.share >= 0.0) & (pairs.share <= 1.0 + 1e-12))

    @pytest.mark.parametrize("name", MEETINGS)
    def test_envelope_theorem_and_balance(self, two, band, name, rng):
        lower, upper, shift = MEETINGS[name]
        x = both(band, lower, upper, shift)
        x = x + 1e-3 * GAP * jnp.asarray(rng.normal(size=x.shape))
        pairs = find(two, x, UPRIGHT)
        gap, weights, normal = measured(pairs, x)
        real = np.asarray(gap) < FAR
        slope = jax.jit(jax.grad(lambda x: jnp.sum(jnp.where(real, pair_gaps(pairs, x).gap, 0.0))))(x)
        expected = np.zeros(x.shape)
        for k in range(4):
            np.add.at(expected, (slice(None), np.asarray(pairs.nodes[k])), np.asarray(weights[k] * normal))
        assert real.any()
        assert np.asarray(slope) == pytest.approx(expected, abs=1e-6)
        assert np.abs(np.sum(weights, axis=0)).max() < 1e-12
        assert np.linalg.norm(normal, axis=0)[real] == pytest.approx(1.0)
        placed = jnp.sum(weights[None] * x[:, pairs.nodes], axis=1)
        assert np.sum(np.asarray(normal * placed), axis=0)[real] == pytest.approx(np.asarray(gap)[real], abs=1e-12)

    def test_rigid_motion_changes_nothing(self, two, band, rng):
        lower, upper, shift = MEETINGS["edge on edge, 45 degrees"]
        x = both(band, lower, upper, shift + np.array([0.2 * MM, 0.1 * MM, 0.0]))  # no edge ends where they cross
        turn = Rotation.random(rng=rng).as_matrix()
        one = find(two, x, UPRIGHT)
        moved = jnp.asarray(turn @ np.asarray(x) + rng.normal(size=(3, 1)) * MM)
        other = find(two, moved, jnp.asarray(turn))
        gap, moved_gap = measured(one, x).gap, measured(other, moved).gap
        assert np.asarray(moved_gap) == pytest.approx(np.asarray(gap), abs=1e-12)
        real = np.asarray(gap) < FAR
        normals, turned = np.asarray(measured(other, moved).normal), turn @ np.asarray(measured(one, x).normal)
        assert normals[:, real] == pytest.approx(turned[:, real], abs=1e-8)
        assert not bool(stale(two, one, moved, jnp.asarray(turn)))

    def test_sliding_sheet_pushes_alike_everywhere(self, two, band):
        """Face on face, the upper strip slides by a mesh size: a node has one contact, whole, and no gap jumps."""
        lower, upper, shift = MEETINGS["face on face"]
        n = band.nodes.shape[1]
        for slip in np.linspace(0.0, MESH, 40):
            x = both(band, lower, upper, shift + slip * np.array([0.6, 0.8, 0.0]))
            pairs = find(two, x, UPRIGHT)
            gap = np.asarray(measured(pairs, x).gap)
            met = len(np.asarray(pairs.over))
            touching = (np.asarray(pairs.share)[:met] > 0.0) & (gap[:met] < FAR)
            total = np.bincount(np.asarray(pairs.things[0])[:met], np.asarray(pairs.share)[:met] * touching, x.shape[1])
            # Nodes of the lower face of the upper strip that lie well within the lower strip.
            inner = np.flatnonzero((np.asarray(x[2]) < 0.5 * H + 2.0 * GAP) & (np.abs(x[1]) < 1.4 * MM))
            inner = inner[inner >= n]
            assert total[inner] == pytest.approx(1.0)
            assert gap[:met][touching & np.isin(pairs.things[0, :met], inner)] == pytest.approx(GAP, abs=1e-9)
            assert len(inner) > 3

    @pytest.mark.parametrize("depth", [0.02, -0.02])
    def test_no_contact_round_the_corner_of_a_rim(self, two, band, depth):
        """A strip that stands against the side of another meets its side, not its upper and lower faces."""
        x = both(band, about("z", 0), about("x", 90), np.array([0.37, 1.9 + depth, 0.3]) * MM)
        pairs = find(two, x, UPRIGHT)
        gap, _, normal = measured(pairs, x)
        real = np.asarray(gap) < FAR
        assert np.asarray(gap)[real].min() == pytest.approx(depth * MM, abs=1e-9)
        if depth < 0.0:
            pushed = real & (np.asarray(gap) < LAYER)
            assert np.abs(np.asarray(normal)[1, pushed]) == pytest.approx(1.0)

    def test_what_lies_behind_is_met_from_its_other_side(self, two, band):
        """A node deeper than half the thickness behind a face has no contact with it."""
        lower, upper, shift = MEETINGS["face on face"]
        gap, _ = least(two, both(band, lower, upper, 0.4 * H * UP))
        assert gap > -0.5 * H
        gap, _ = least(two, both(band, lower, upper, shift - (0.4 * H + GAP) * UP))
        assert gap == pytest.approx(-0.4 * H)

    def test_derivatives_are_finite_at_corners_and_on_edges(self, two, band):
        x = both(band, about("z", 0), about("z", 0), H * UP)  # node on node, edge on edge, face on face
        pairs = find(two, x, UPRIGHT)
        gap, weights, normal = measured(pairs, x)
        slope = jax.grad(lambda x: jnp.sum(pair_gaps(pairs, x).gap))(x)
        assert int(pairs.found) > 100
        assert all(np.all(np.isfinite(a)) for a in (gap, weights, normal, slope))


class TestCandidates:
    def test_none_in_a_flat_and_a_domed_star(self, star):
        surface = surface_of(star)
        dome = np.array(star.nodes)
        dome[2] += 4.0 * MM * (1.0 - (dome[0] ** 2 + dome[1] ** 2) / (8.0 * MM) ** 2)
        for x in (star.nodes, dome):
            pairs = find(surface, jnp.asarray(x), UPRIGHT)
            assert (int(pairs.found), int(pairs.missed)) == (0, 0)
            assert np.all(np.asarray(measured(pairs, jnp.asarray(x)).gap) == FAR)

    @pytest.mark.slow
    @settings(max_examples=8)
    @given(st.floats(3.1, 4.2), st.integers(0, 1000))
    def test_all_that_are_near(self, radius, seed):
        """A strip rolled up until its ends meet and pass each other, shaken."""
        (long_band, surface), rng = long_strip(), np.random.default_rng(seed)
        twist = 0.03 * rng.normal() * long_band.nodes[0]
        x = rolled(long_band.nodes, radius * MM) + np.stack([0 * twist, twist, 0 * twist])
        x += 0.02 * MM * rng.normal(size=x.shape)
        pairs = find(surface, jnp.asarray(x), UPRIGHT)
        assert int(pairs.missed) == 0
        met = len(np.asarray(pairs.over))
        valid = np.asarray(pairs.valid)
        found = {(int(i), int(j)) for i, j in np.asarray(pairs.things)[:, :met][:, valid[:met]].T}
        assert found == near_one_by_one(surface, x)
        crossed = {(int(min(p)), int(max(p))) for p in np.asarray(pairs.things)[:, met:][:, valid[met:]].T}
        assert crossed == crossing_one_by_one(surface, x)

    def test_ring_closes_until_its_ends_overlap(self):
        """Bent to a circle whose circumference is longer or shorter than the strip: the ends' gap or overlap."""
        (long_band, surface), length = long_strip(), 24.0 * MM
        for gap in (0.15 * MM, 0.01 * MM, -0.03 * MM, -0.1 * MM):
            radius = (length + gap) / (2.0 * np.pi)
            x = rolled(long_band.nodes, radius)
            found, _ = least(surface, jnp.asarray(x))
            # The planes of the ends differ by the angle gap / radius: apart within, overlapping outside.
            half = -0.5 * H if gap > 0.0 else 0.5 * H
            assert found == pytest.approx(2.0 * (radius + half) * np.sin(0.5 * gap / radius), rel=1e-3)
            assert np.sign(found) == np.sign(gap)

    def test_too_little_room_is_reported(self):
        long_band, _ = long_strip()
        x = jnp.asarray(rolled(long_band.nodes, 3.0 * MM))
        pairs = find(surface_of(long_band, contacts_per_node=0.05), x, UPRIGHT)
        assert int(pairs.missed) > 0

    def test_stale_when_a_node_has_moved_half_the_margin(self, rng):
        long_band, surface = long_strip()
        x = jnp.asarray(long_band.nodes)
        turn = jnp.asarray(Rotation.random(rng=rng).as_matrix())
        pairs = find(surface, x, UPRIGHT)
        tumbled = turn @ x + jnp.asarray([[1.0], [2.0], [3.0]])
        assert not bool(stale(surface, pairs, tumbled, turn))
        n = x.shape[1]
        for share, expected in ((0.49, False), (0.51, True)):
            moved = tumbled.at[0, 5].add(share * MARGIN * n / (n - 1))  # the mean moves too
            assert bool(stale(surface, pairs, moved, turn)) is expected

    def test_batch_is_one_after_the_other(self):
        long_band, surface = long_strip()
        x = jnp.stack([jnp.asarray(rolled(long_band.nodes, r * MM)) for r in (3.7, 20.0)], axis=-1)
        frames = jnp.stack([UPRIGHT, UPRIGHT], axis=-1)
        pairs = find(surface, x, frames)
        gap, weights, normal = measured(pairs, x)
        assert np.asarray(stale(surface, pairs, x, frames)).tolist() == [False, False]
        for b in range(2):
            one = find(surface, x[..., b], UPRIGHT)
            mine = measured(one, x[..., b])
            for batched, single in zip((gap, weights, normal, pairs.share), (*mine, one.share), strict=True):
                assert np.asarray(batched[..., b]) == pytest.approx(np.asarray(single), abs=1e-12)

    def test_single_precision(self):
        long_band, surface = long_strip()
        x = jnp.asarray(rolled(long_band.nodes, 3.8 * MM))
        single = find(surface, x.astype(jnp.float32), UPRIGHT)
        gap = measured(single, x.astype(jnp.float32)).gap
        assert gap.dtype == jnp.float32
        assert float(jnp.min(gap)) == pytest.approx(least(surface, x)[0], abs=1e-8)

    def test_open_surface_is_refused(self, band):
        with pytest.raises(ValueError, match="closed"):
            contact_surface(band.faces[:, 1:], band.nodes, H, MESH, LAYER, MARGIN)


def near_one_by_one(surface: ContactSurface, x: np.ndarray) -> set[tuple[int, int]]:
    """Pairs of a node and a face, by definition: distances from the triangles' planes and edges."""
    faces, rest = np.asarray(surface.faces), np.asarray(surface.rest)
    a, b, c = (x[:, faces[k]] for k in range(3))
    normal = np.cross(b - a, c - a, axis=0)
    normal /= np.linalg.norm(normal, axis=0)
    found = set()
    for i in np.unique(faces):
        p = x[:, i, None]
        height = np.sum(normal * (p - a), axis=0)
        inside = np.ones(len(height), dtype=bool)
        edge = np.full(len(height), np.inf)
        for u, v in ((a, b), (b, c), (c, a)):
            inside &= np.sum(np.cross(v - u, p - u, axis=0) * normal, axis=0) >= 0.0
            t = np.clip(np.sum((p - u) * (v - u), axis=0) / np.sum((v - u) ** 2, axis=0), 0.0, 1.0)
            edge = np.minimum(edge, np.linalg.norm(p - u - t * (v - u), axis=0))
        distance = np.where(inside, np.abs(height), edge)
        apart = np.linalg.norm(rest[:, i, None] - rest[:, faces].mean(axis=1), axis=0) >= float(surface.exclusion)
        limit = np.where(height < 0.0, 0.5 * H, LAYER) + MARGIN
        found |= {(int(i), int(f)) for f in np.flatnonzero(apart & (distance < limit))}
    return found


def crossing_one_by_one(surface: ContactSurface, x: np.ndarray) -> set[tuple[int, int]]:
    """Pairs of sharp edges, by definition: distances of segments from their ends and from where their lines cross."""
    edges, rest = np.asarray(surface.edges), np.asarray(surface.rest)
    middle = rest[:, edges].mean(axis=1)
    found = set()
    for e in range(edges.shape[1]):
        a, b = (x[:, edges[k, e], None] for k in (0, 1))
        c, d = (x[:, edges[k]] for k in (0, 1))

        def to_segment(p: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
            t = np.clip(np.sum((p - u) * (v - u), axis=0) / np.sum((v - u) ** 2, axis=0), 0.0, 1.0)
            return np.linalg.norm(p - u - t * (v - u), axis=0)

        distance = np.minimum.reduce([to_segment(*q) for q in ((a, c, d), (b, c, d), (c, a, b), (d, a, b))])
        for f in range(edges.shape[1]):
            u, v, w = (b - a)[:, 0], d[:, f] - c[:, f], a[:, 0] - c[:, f]
            across = np.cross(u, v)
            if e != f and np.linalg.norm(across) > 1e-9 * np.linalg.norm(u) * np.linalg.norm(v):
                s, t, _ = np.linalg.solve(np.stack([u, -v, across], axis=1), -w)
                if 0.0 < s < 1.0 and 0.0 < t < 1.0:
                    distance[f] = min(distance[f], abs(w @ across) / np.linalg.norm(across))
        apart = np.linalg.norm(middle[:, e, None] - middle, axis=0) >= float(surface.exclusion)
        limit = max(0.5 * H, LAYER) + MARGIN
        found |= {(e, int(f)) for f in np.flatnonzero(apart & (distance < limit)) if f > e}
    return found
