"""Obstacles: gaps and normals.

| identity | one road | the other |
|---|---|---|
| signed distance | `gaps` | closed forms; the closest of many points on the surface |
| eikonal | length of the numerical gradient of a gap | 1 |
| normals | closed form | numerical gradient; `jax.grad` |
| no hidden nan | centres, axes, corners, edges | finite values, normals, derivatives |
| a batch | last axis | one robot after the other |
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gelbot.mechanics import obstacles as obs

MM = 1e-3

obstacle_gaps = jax.jit(obs.gaps)


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
        slopes = jax.jit(jax.jacrev(lambda x: jnp.sum(obs.gaps(world, x)[0], axis=1)))(jnp.asarray(x))
        assert np.asarray(slopes) == pytest.approx(np.asarray(normal))
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
