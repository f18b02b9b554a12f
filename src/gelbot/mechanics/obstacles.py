"""Fixed obstacles as signed distances, positive outside: half spaces (floor, walls), spheres, cylinders, boxes.

Every node sees every obstacle. Normals are unit gradients of the distance, in closed form, inside too. Where the
gradient has no value (a sphere's centre, a cylinder's axis, the middle planes of a box) one of its limits is taken, so
that neither values nor derivatives are ever undefined.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

TINY = 1e-30
"""Squared lengths [m^2] below this are no direction."""


class Planes(NamedTuple):
    """Half spaces behind planes: `point` [m] and unit `normal` (towards the free side), shape (3, k); `friction`."""

    point: Array
    normal: Array
    friction: Array


class Spheres(NamedTuple):
    """Balls: `centre` [m], shape (3, k), `radius` [m] and `friction`, shape (k,)."""

    centre: Array
    radius: Array
    friction: Array


class Cylinders(NamedTuple):
    """Solid, with flat ends: `centre` [m] and unit `axis`, (3, k); `radius`, `length` [m] and `friction`, (k,)."""

    centre: Array
    axis: Array
    radius: Array
    length: Array
    friction: Array


class Boxes(NamedTuple):
    """Cuboids: `centre` and edge lengths `size` [m], (3, k); `turn`, (3, 3, k): columns are the box's own axes."""

    centre: Array
    size: Array
    turn: Array
    friction: Array


class Obstacles(NamedTuple):
    """What stands around the body, in the order in which gaps are counted; each kind may be empty (k = 0)."""

    planes: Planes
    spheres: Spheres
    cylinders: Cylinders
    boxes: Boxes

    @property
    def friction(self) -> Array:
        """Friction coefficients in the order of `gaps`, shape (k,)."""
        return jnp.concatenate([kind.friction for kind in self])


def no_obstacles() -> Obstacles:
    """Nothing at all; replace the kinds that are there."""
    vectors, values = jnp.zeros((3, 0)), jnp.zeros(0)
    return Obstacles(
        Planes(vectors, vectors, values),
        Spheres(vectors, values, values),
        Cylinders(vectors, vectors, values, values, values),
        Boxes(vectors, vectors, jnp.zeros((3, 3, 0)), values),
    )


def floor(friction: Array, height: float = 0.0) -> Obstacles:
    """The horizontal plane z = `height` [m] alone; `friction` is one value."""
    one = jnp.reshape(friction, (1,))
    plane = Planes(jnp.array([[0.0], [0.0], [height]]), jnp.array([[0.0], [0.0], [1.0]]), one)
    return no_obstacles()._replace(planes=plane)


def gaps(obstacles: Obstacles, x: Array) -> tuple[Array, Array]:
    """Signed distances [m], shape (k, n[, b]), and their unit gradients, (k, 3, n[, b]), of nodes `x` [m], (3, n[, b]).

    Negative inside. Kinds that are empty cost nothing.
    """
    planes, spheres, cylinders, boxes = obstacles
    parts = [
        *([_plane_gaps(planes, x)] if planes.friction.shape[0] else []),
        *([_sphere_gaps(spheres, x)] if spheres.friction.shape[0] else []),
        *([_cylinder_gaps(cylinders, x)] if cylinders.friction.shape[0] else []),
        *([_box_gaps(boxes, x)] if boxes.friction.shape[0] else []),
    ]
    if not parts:
        return jnp.zeros((0, *x.shape[1:]), x.dtype), jnp.zeros((0, *x.shape), x.dtype)
    if len(parts) == 1:
        return parts[0]
    return jnp.concatenate([gap for gap, _ in parts]), jnp.concatenate([normal for _, normal in parts])


def _plane_gaps(planes: Planes, x: Array) -> tuple[Array, Array]:
    normal = _per_obstacle(planes.normal, x)  # (k, 3, 1[, 1])
    offset = jnp.sum(planes.normal * planes.point, axis=0).astype(x.dtype)
    # Component by component: one pass over x, and nothing of shape (k, 3, n) for the sum.
    along = normal[:, 0] * x[0] + normal[:, 1] * x[1] + normal[:, 2] * x[2]
    gap = along - offset.reshape(-1, *(1,) * (x.ndim - 1))
    return gap, jnp.broadcast_to(normal, (normal.shape[0], *x.shape))


def _sphere_gaps(spheres: Spheres, x: Array) -> tuple[Array, Array]:
    distance, normal = _length_and_direction(x - _per_obstacle(spheres.centre, x), axis=1)
    return distance - _values(spheres.radius, x), normal


def _cylinder_gaps(cylinders: Cylinders, x: Array) -> tuple[Array, Array]:
    axis = _per_obstacle(cylinders.axis, x)
    away = x - _per_obstacle(cylinders.centre, x)
    height = jnp.sum(axis * away, axis=1)
    # On the axis every direction across it will do: the one that the coordinate axis farthest from it points in.
    farthest = jnp.argmin(jnp.abs(cylinders.axis), axis=0)
    across = jnp.eye(3, dtype=x.dtype)[:, farthest]
    across = across - cylinders.axis * jnp.sum(cylinders.axis * across, axis=0)
    across = _per_obstacle(across / jnp.sqrt(jnp.sum(across**2, axis=0)), x)
    radial, outward = _length_and_direction(away - axis * height[:, None], axis=1, otherwise=across)
    up = axis * _sign(height)[:, None]
    # In the half plane (radial, |height|) the cylinder is a corner.
    beyond = jnp.stack([radial - _values(cylinders.radius, x), jnp.abs(height) - 0.5 * _values(cylinders.length, x)])
    gap, share = _corner(beyond)
    return gap, outward * share[0][:, None] + up * share[1][:, None]


def _box_gaps(boxes: Boxes, x: Array) -> tuple[Array, Array]:
    away = x - _per_obstacle(boxes.centre, x)
    turn = jnp.moveaxis(boxes.turn, -1, 0).astype(x.dtype)  # (k, 3, 3)
    own = jnp.einsum("kji,kj...->ik...", turn, away)
    half = 0.5 * boxes.size.astype(x.dtype).reshape(*boxes.size.shape, *(1,) * (x.ndim - 1))
    gap, share = _corner(jnp.abs(own) - half)
    return gap, jnp.einsum("kij,jk...->ki...", turn, share * _sign(own))


def _corner(beyond: Array) -> tuple[Array, Array]:
    """Signed distance from the corner where all `beyond` [m], shape (d, ...), are negative, and its unit gradient."""
    outside = jnp.maximum(beyond, 0.0)
    deepest = jnp.max(beyond, axis=0)
    nearest = jnp.argmax(beyond, axis=0) == jnp.arange(beyond.shape[0]).reshape(-1, *(1,) * (beyond.ndim - 1))
    distance, direction = _length_and_direction(outside, axis=0)
    is_out = deepest > 0.0
    return jnp.where(is_out, distance, deepest), jnp.where(is_out, direction, nearest.astype(beyond.dtype))


def _length_and_direction(v: Array, axis: int, otherwise: Array | None = None) -> tuple[Array, Array]:
    """Length of vectors along `axis` and their directions; for none, `otherwise` (or the first axis) and length 0."""
    if otherwise is None:
        first = jnp.arange(v.shape[axis]) == 0
        otherwise = first.astype(v.dtype).reshape([-1 if k == axis else 1 for k in range(v.ndim)])
    square = jnp.sum(v**2, axis=axis, keepdims=True)
    known = square > TINY
    # Both branches of a choice are differentiated: the root must be one that has a slope.
    length = jnp.sqrt(jnp.where(known, square, 1.0))
    direction = jnp.where(known, v / length, otherwise)
    return jnp.squeeze(jnp.where(known, length, 0.0), axis), direction


def _per_obstacle(vectors: Array, x: Array) -> Array:
    """Vectors (3, k) as (k, 3, 1[, 1]), to stand beside `x`, (3, n[, b])."""
    return vectors.T.astype(x.dtype).reshape(vectors.shape[1], 3, *(1,) * (x.ndim - 1))


def _values(values: Array, x: Array) -> Array:
    """Values (k,) as (k, 1[, 1])."""
    return values.astype(x.dtype).reshape(-1, *(1,) * (x.ndim - 1))


def _sign(value: Array) -> Array:
    return jnp.where(value < 0.0, -1.0, 1.0).astype(value.dtype)
