"""A cubic B-spline on a grid of three dimensions, and all its derivatives, at scattered points.

With t in [0, 1] the place in a cell, B_i the four B-splines that reach into it and c their coefficients,

    s(x, y, z) = sum_ijk c_ijk B_i(t_x) B_j(t_y) B_k(t_z).

A derivative of s is the same sum with derivatives of the B. What costs time is to fetch the 64 coefficients: they are
fetched once for all derivatives asked for, and an evaluation is one table of them and one sum over it per derivative.
"""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.custom_derivatives import SymbolicZero
from jax.experimental.layout import Layout, with_layout_constraint
from numpy.typing import NDArray

Orders: TypeAlias = tuple[tuple[int, int, int], ...]
"""Derivatives asked for: how often each is taken along x, y, z, for example ((1, 0, 0),) for the slope along x."""

LANES = 4
"""Points that lie side by side in the table of coefficients: an eighth of a cache line, and a vector register."""
TABLES = 8
"""Tables worked on at once in a batch: enough to keep two threads busy, few enough for the processor's cache."""


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def evaluate(coefficients: Array, local: Array, orders: Orders) -> Array:
    """Derivatives of a spline, shape (len(orders), p), at `local`, shape (3, p): grid point (0, 0, 0) is the origin.

    `coefficients` (nx + 3, ny + 3, nz + 3) for nx, ny, nz cells. For a batch of b splines, each with its own points,
    they are (b, nx + 3, ...), `local` is (3, p, b) and the answer (len(orders), p, b). Outside the grid the outermost
    cell's polynomial goes on.
    """
    return _evaluate(coefficients, local, orders, False)


@partial(evaluate.defjvp, symbolic_zeros=True)
def _evaluate_jvp(orders: Orders, primals: tuple[Array, Array], tangents: tuple[Array, Array]) -> tuple[Array, Array]:
    """The closed form: linear in the coefficients, and the next derivatives for the positions."""
    (coefficients, local), (change, shift) = primals, tangents
    value = evaluate(coefficients, local, orders)
    moved = jnp.zeros_like(value)
    if not isinstance(change, SymbolicZero):
        moved = moved + _evaluate(change, local, orders, True)
    if not isinstance(shift, SymbolicZero):
        x, y, z = np.eye(3, dtype=int)
        higher = [[tuple(int(n) for n in order + axis) for axis in (x, y, z)] for order in np.array(orders)]
        wanted = tuple(sorted({order for three in higher for order in three}))
        slopes = dict(zip(wanted, evaluate(coefficients, local, wanted), strict=True))
        moved = moved + jnp.stack([sum(slopes[order] * d for order, d in zip(three, shift)) for three in higher])
    return value, moved


@partial(jax.jit, static_argnums=(2, 3))
def _evaluate(coefficients: Array, local: Array, orders: Orders, one_by_one: bool) -> Array:
    """`evaluate`; for `one_by_one` see `_taps`."""
    if local.ndim == 2:
        return _sums(coefficients[None], local[:, None], orders, one_by_one)[:, 0]
    points, batch = local.shape[1:]
    many = min(TABLES, batch)
    more = -batch % many
    local = jnp.pad(local, ((0, 0), (0, 0), (0, more)))
    coefficients = jnp.pad(coefficients, ((0, more), (0, 0), (0, 0), (0, 0)))
    # A table stays in the cache while its points are worked on: one batch after the other, points side by side.
    places = _settled(local.transpose(2, 0, 1).reshape(-1, many, 3, points).swapaxes(1, 2))
    tables = coefficients.reshape(-1, many, *coefficients.shape[1:])
    sums = lax.map(lambda part: _settled(_sums(part[0], _settled(part[1]), orders, one_by_one)), (tables, places))
    return sums.transpose(1, 3, 0, 2).reshape(len(orders), points, -1)[..., :batch]


def _sums(tables: Array, local: Array, orders: Orders, one_by_one: bool) -> Array:
    """Derivatives at `local`, shape (3, r, p), the points of r splines whose coefficients are `tables` (r, ...)."""
    _, splines, points = local.shape
    count = splines * points
    local = jnp.pad(local.reshape(3, count), ((0, 0), (0, -count % LANES))).reshape(3, -1, LANES)
    last = np.array(tables.shape[1:])[:, None, None] - 4
    cell = jnp.clip(jnp.floor(local).astype(jnp.int32), 0, last.astype(np.int32))
    owner = np.minimum(np.arange(local[0].size) // points, splines - 1).reshape(local[0].shape)
    place = _settled(jnp.concatenate([jnp.asarray(owner[None], jnp.int32), cell]))
    taps, t = _taps(tables, place, one_by_one), _settled(local - cell)

    def total(order: tuple[int, int, int]) -> Array:
        x, y, z = (_basis(t[axis], derivative) for axis, derivative in enumerate(order))
        return sum(
            x[i] * sum(y[j] * sum(z[k] * taps[:, i, j, k] for k in range(4)) for j in range(4)) for i in range(4)
        )

    found = jnp.stack([_settled(total(order)) for order in orders])
    return found.reshape(len(orders), -1)[:, :count].reshape(len(orders), splines, points)


def _taps(tables: Array, place: Array, one_by_one: bool) -> Array:
    """The 4 x 4 x 4 coefficients around each point, shape (p / LANES, 4, 4, 4, LANES).

    `place`, shape (4, p / LANES, LANES): which of the `tables` and its first coefficient along x, y, z. Blocks are
    fetched five times as fast as numbers `one_by_one`, but only the latter can be scattered back fast, by reverse
    differentiation.
    """
    first = place[:, :, None, None, None]
    if one_by_one:
        steps = jnp.asarray(np.indices((4, 4, 4)), jnp.int32)[:, None, ..., None]
        strides = np.cumprod([1, *tables.shape[:0:-1]])[::-1]
        index = first[0] * strides[0] + sum((first[a + 1] + steps[a]) * strides[a + 1] for a in range(3))
        return tables.reshape(-1).at[index].get(mode="promise_in_bounds")
    numbers = lax.GatherDimensionNumbers(offset_dims=(1, 2, 3), collapsed_slice_dims=(0,), start_index_map=(0, 1, 2, 3))
    mode = lax.GatherScatterMode.PROMISE_IN_BOUNDS
    return _settled(lax.gather(tables, jnp.moveaxis(place, 0, -1), numbers, (1, 4, 4, 4), mode=mode))


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
        return -s * s / 2.0, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), t * t / 2.0
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
    """From `count` values on a line and the slopes per cell at its first and its last point to count + 2 coefficients."""
    system = _values(count)
    system[count, :3] = system[count + 1, -3:] = [-0.5, 0.0, 0.5]
    return np.asarray(np.linalg.inv(system), dtype=np.float64)


def _values(count: int) -> NDArray[np.float64]:
    """A matrix whose first `count` rows give the spline's values at the grid points; two rows are left to fill."""
    system = np.zeros((count + 2, count + 2))
    for i in range(count):
        system[i, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    return system
