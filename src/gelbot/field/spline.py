"""A cubic B-spline on a grid of three dimensions, and all its derivatives, at scattered points.

With t in [0, 1] the place in a cell, B_i the four B-splines that reach into it and c their coefficients,

    s(x, y, z) = sum_ijk c_ijk B_i(t_x) B_j(t_y) B_k(t_z).

A derivative of s is the same sum with derivatives of the B. What costs time is to fetch the 64 coefficients: they are
fetched once for all derivatives asked for, and an evaluation is one table of them and one sum over it per derivative.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial, reduce
from operator import add
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_derivatives import SymbolicZero
from jax.experimental.layout import Layout, with_layout_constraint
from numpy.typing import NDArray

Orders: TypeAlias = tuple[tuple[int, int, int], ...]
"""Derivatives asked for: how often each is taken along x, y, z, for example ((1, 0, 0),) for the slope along x."""

IN_BOUNDS = lax.GatherScatterMode.PROMISE_IN_BOUNDS
LANES = 4
"""Points that lie side by side in the table of coefficients: as many as double precision puts in a vector register."""
TABLES = 16
"""Tables worked on at once in a batch: enough to keep two threads busy, few enough for the processor's cache."""


class Grid(NamedTuple):
    """Where the coefficients of a spline lie: first point `origin` and size of a cell `spacing`, shape (3,) each."""

    origin: Array
    spacing: Array


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def evaluate(coefficients: Array, grid: Grid, points: Array, orders: Orders) -> Array:
    """Derivatives of a spline, shape (len(orders), p), at `points`, shape (3, p).

    `coefficients` (nx + 3, ny + 3, nz + 3) for nx, ny, nz cells. For a batch of b splines on one grid, each with its
    own points, they are (b, nx + 3, ...), `points` is (3, p, b) and the answer (len(orders), p, b). Points outside the
    grid see what its nearest point sees. Can be differentiated by coefficients and points, not by the grid.
    """
    return _evaluate(coefficients, grid, points, orders, False)


@partial(evaluate.defjvp, symbolic_zeros=True)
def _evaluate_jvp(
    orders: Orders, primals: tuple[Array, Grid, Array], tangents: tuple[Array, Grid, Array]
) -> tuple[Array, Array]:
    """The closed form: linear in the coefficients, and the next derivatives for the points."""
    (coefficients, grid, points), (change, _, shift) = primals, tangents
    value = evaluate(coefficients, grid, points, orders)
    moved = jnp.zeros_like(value)
    if not isinstance(change, SymbolicZero):
        moved = moved + _evaluate(change, grid, points, orders, True)
    if not isinstance(shift, SymbolicZero):
        higher = [[(a + 1, b, c), (a, b + 1, c), (a, b, c + 1)] for a, b, c in orders]
        wanted = tuple(sorted({order for three in higher for order in three}))
        slopes = dict(zip(wanted, evaluate(coefficients, grid, points, wanted), strict=True))
        shift = jnp.where(_inside(coefficients, grid, points), shift, 0.0)
        moved = moved + jnp.stack([_sum(slopes[order] * shift[n] for n, order in enumerate(three)) for three in higher])
    return value, moved


def _inside(coefficients: Array, grid: Grid, points: Array) -> Array:
    """Which coordinates of `points`, shape (3, ...), are within the grid or on its edge."""
    low, size = (part.reshape(3, *[1] * (points.ndim - 1)) for part in grid)
    last = np.array(coefficients.shape[-3:]).reshape(low.shape) - 3
    return (points >= low) & (points <= low + last * size)


@partial(jax.jit, static_argnums=(3, 4))
def _evaluate(coefficients: Array, grid: Grid, points: Array, orders: Orders, linear: bool) -> Array:
    """`evaluate`, and if `linear` its change with the coefficients, in a form that can be transposed."""
    sums = _sums_for_transpose if linear else _sums
    if points.ndim == 2:
        return sums(coefficients[None], grid, points[:, None], orders)[:, 0]
    count, batch = points.shape[1:]
    many = min(TABLES, batch)
    more = -batch % many
    coefficients = jnp.pad(coefficients, ((0, more), (0, 0), (0, 0), (0, 0)))
    points = jnp.pad(points, ((0, 0), (0, 0), (0, more)), mode="edge")
    # A table stays in the cache while its points are worked on: one batch after the other, points side by side.
    places = _settled(points.transpose(2, 0, 1).reshape(-1, many, 3, count).swapaxes(1, 2))
    tables = coefficients.reshape(-1, many, *coefficients.shape[1:])
    found = lax.map(lambda part: _settled(sums(part[0], grid, _settled(part[1]), orders)), (tables, places))
    return _settled(found.transpose(1, 3, 0, 2).reshape(len(orders), count, -1)[..., :batch])


def _sums(tables: Array, grid: Grid, points: Array, orders: Orders) -> Array:
    """Derivatives at `points`, shape (3, r, p), of the r splines whose coefficients are `tables` (r, ...)."""
    first, t = _places(tables, grid, points)
    numbers = lax.GatherDimensionNumbers(offset_dims=(1, 2, 3), collapsed_slice_dims=(0,), start_index_map=(0, 1, 2, 3))
    taps = lax.gather(tables, jnp.moveaxis(first, 0, -1), numbers, (1, 4, 4, 4), mode=IN_BOUNDS)
    taps = _settled(taps)

    def total(order: tuple[int, int, int]) -> Array:
        x, y, z = (_basis(t[axis], derivative) for axis, derivative in enumerate(order))
        found = _sum(
            x[i] * _sum(y[j] * _sum(z[k] * taps[:, i, j, k] for k in range(4)) for j in range(4)) for i in range(4)
        )
        return _settled(found * _scale(grid, order))

    found = jnp.stack([total(order) for order in orders])
    return found.reshape(len(orders), -1)[:, : points[0].size].reshape(-1, *points.shape[1:])


def _sums_for_transpose(tables: Array, grid: Grid, points: Array, orders: Orders) -> Array:
    """`_sums` as it stands on paper: three times as slow, but its transpose is a product and one fast scatter.

    The transpose of blocks fetched and taken apart would be hundreds of times as slow.
    """
    first, t = _places(tables, grid, points)
    strides = np.cumprod([1, *tables.shape[:0:-1]], dtype=np.int32)[::-1]
    steps = (np.indices((4, 4, 4), np.int32).reshape(3, 64).T @ strides[1:]).astype(np.int32)
    place = _settled(_sum(first[n] * strides[n] for n in range(4)))
    place = _settled((place + steps[:, None, None]).reshape(-1))
    taps = _settled(tables.reshape(-1).at[place].get(mode="promise_in_bounds"))
    taps = taps.reshape(4, 4, 4, *t.shape[1:])

    def total(order: tuple[int, int, int]) -> Array:
        x, y, z = (_settled(jnp.stack(_basis(t[axis], derivative))) for axis, derivative in enumerate(order))
        found = jnp.sum(x[:, None, None] * y[:, None] * z * taps, axis=(0, 1, 2))
        return found * _scale(grid, order)

    found = jnp.stack([total(order) for order in orders])
    return found.reshape(len(orders), -1)[:, : points[0].size].reshape(-1, *points.shape[1:])


def _places(tables: Array, grid: Grid, points: Array) -> tuple[Array, Array]:
    """For all of `points`, shape (3, r, p), in rows of `LANES`.

    Which of the `tables` and the first of its coefficients that count along x, y, z, shape (4, rows, LANES), and the
    place t in the cell, shape (3, rows, LANES).
    """
    _, splines, count = points.shape
    padded = jnp.pad(points.reshape(3, -1), ((0, 0), (0, -splines * count % LANES))).reshape(3, -1, LANES)
    local = (padded - grid.origin[:, None, None]) * (1.0 / grid.spacing)[:, None, None]
    cells = np.array(tables.shape[1:])[:, None, None] - 3
    local = jnp.clip(local, 0, cells)
    cell = jnp.clip(jnp.floor(local).astype(jnp.int32), 0, cells.astype(np.int32) - 1)
    owner = np.minimum(np.arange(cell[0].size) // count, splines - 1).reshape(1, *cell.shape[1:])
    return _settled(jnp.concatenate([jnp.asarray(owner, jnp.int32), cell])), _settled(local - cell)


def _scale(grid: Grid, order: tuple[int, int, int]) -> Array:
    """From derivatives by cells to derivatives by metres."""
    return 1.0 / jnp.prod(grid.spacing ** np.array(order))


def _sum(parts: Iterable[Array]) -> Array:
    return reduce(add, parts)


def _settled(a: Array) -> Array:
    """`a`, computed once and laid out in the order of its axes.

    Left alone, the compiler computes indices and weights anew for each of the 64 coefficients and each derivative, and
    leaves the table in an order that has to be read number by number: in all, 2 to 4 times as slow.
    """
    return with_layout_constraint(a, Layout(tuple(range(a.ndim))))


def _basis(t: Array, derivative: int) -> tuple[Array, Array, Array, Array]:
    """The four cubic B-splines that reach into a cell at `t` in [0, 1], or their first, second or third derivative."""
    s = 1.0 - t
    if derivative == 0:
        return (
            s * s * s / 6.0,
            2.0 / 3.0 - t * t * (1.0 - t / 2.0),
            2.0 / 3.0 - s * s * (1.0 - s / 2.0),
            t * t * t / 6.0,
        )
    if derivative == 1:
        return -(s**2) / 2.0, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), t**2 / 2.0
    if derivative == 2:
        return s, 3.0 * t - 2.0, 3.0 * s - 2.0, t
    one = jnp.ones_like(t) if derivative == 3 else jnp.zeros_like(t)
    return -one, 3.0 * one, -3.0 * one, one


def interpolation(count: int) -> NDArray[np.float64]:
    """From `count` values on a line to count + 2 coefficients; the fourth difference at the ends is zero."""
    system = _values(count)
    system[count, :5] = system[count + 1, -5:] = [1.0, -4.0, 6.0, -4.0, 1.0]
    return np.asarray(np.linalg.inv(system)[:, :count], dtype=np.float64)


def clamped_interpolation(count: int) -> NDArray[np.float64]:
    """From `count` values on a line and its slopes per cell at both ends to count + 2 coefficients."""
    system = _values(count)
    system[count, :3] = system[count + 1, -3:] = [-0.5, 0.0, 0.5]
    return np.asarray(np.linalg.inv(system), dtype=np.float64)


def _values(count: int) -> NDArray[np.float64]:
    """A matrix whose first `count` rows give the spline's values at the grid points; two rows are left to fill."""
    system = np.zeros((count + 2, count + 2))
    for i in range(count):
        system[i, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    return system
