"""One robot or many with the same code: a batch of b robots has its index last, so that rows of it are contiguous.

Positions are (3, n) or (3, n, b), a robot's own numbers () or (b,). Constants of the mesh have no such axis: `wide`
adds one where the other operand has it.
"""

from __future__ import annotations

import jax
from jax import Array
from jax.experimental.layout import Layout, with_layout_constraint


def wide(constant: Array, like: Array, dims: int) -> Array:
    """`constant` as a factor for `like`, of which one robot's have `dims` dimensions: an axis of 1 for a batch."""
    return constant if like.ndim == dims or constant.ndim != dims else constant[..., None]


def dot(a: Array, b: Array) -> Array:
    """Scalar products of vectors, space first: term by term, since a reduction is not vectorised by the compiler."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def taken(a: Array, places: Array, axis: int = 0) -> Array:
    """`a` at `places` along its `axis`: indices of the mesh, which need no check."""
    return a.at[(*(slice(None) for _ in range(axis)), places)].get(mode="promise_in_bounds")


@jax.custom_jvp
def settled(a: Array) -> Array:
    """`a`, computed once and laid out in the order of its axes: fused with what follows, it would not be vectorised."""
    return with_layout_constraint(a, Layout(tuple(range(a.ndim))))


@settled.defjvp
def _settled_jvp(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    return settled(*primals), tangents[0]
