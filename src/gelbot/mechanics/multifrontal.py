"""The inverse of a sparse stiffness, front by front (Duff and Reid 1983): one code for small and for large bodies.

A front holds the stiffness [P Q^T; Q S] of the nodes that it eliminates and of their border. It keeps

    P^-1,    T = Q P^-1,

and leaves S - T Q^T to the fronts above. To apply the inverse, forces are carried up, y -> y_border - T y, and
displacements down, x = P^-1 y - T^T x_border. See `dissection` for the order.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from gelbot.mechanics.batch import taken
from gelbot.mechanics.block_inverse import block_inverse
from gelbot.mechanics.dissection import Dissection


class Factor(NamedTuple):
    """For each level, fronts first: `inverses` P^-1 (B, 3s, 3s) and `transfers` T (B, 3t, 3s)."""

    inverses: tuple[Array, ...]
    transfers: tuple[Array, ...]


def factorise(dissection: Dissection, diagonal: Array, pairs: Array, dtype: jnp.dtype) -> Factor:
    """Factor of the matrix with 3 x 3 blocks `diagonal` (n, 3, 3) and `pairs` (c, 3, 3), kept as `dtype`."""
    zero = jnp.zeros((1, 3, 3), diagonal.dtype)
    given = jnp.concatenate([zero, diagonal, pairs, pairs.transpose(0, 2, 1)]).reshape(-1, 9)
    found = given
    inverses, transfers = [], []
    for level in dissection.levels:
        s, t = 3 * level.pivots.shape[1], level.outputs.shape[1]
        columns = _front_blocks(found, level.columns)
        # Rows of pivots that pad a front are those of the unit matrix.
        padding = jnp.repeat(level.pivots == diagonal.shape[0], 3, axis=1).astype(found.dtype)
        inverse = block_inverse(columns[:, :s] + padding[:, :, None] * jnp.eye(s, dtype=found.dtype))
        coupling = columns[:, s:]
        transfer = coupling @ inverse
        inverses.append(inverse.astype(dtype))
        transfers.append(transfer.astype(dtype))
        if t > 0:
            left = -(transfer @ coupling.transpose(0, 2, 1))
            if level.rest.shape[-1]:
                left = left + _front_blocks(found, level.rest)
            left = left.reshape(-1, t, 3, t, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 9)
            found = jnp.concatenate([given, left])
    return Factor(tuple(inverses), tuple(transfers))


def _front_blocks(found: Array, table: Array) -> Array:
    """Matrices (B, 3 r, 3 c) whose 3 x 3 blocks are sums of `found` (m, 9) at the places `table` (B, r, c, k)."""
    blocks = taken(found, table[..., 0])
    for k in range(1, table.shape[-1]):
        blocks = blocks + taken(found, table[..., k])
    fronts, rows, columns = table.shape[:3]
    return blocks.reshape(fronts, rows, columns, 3, 3).transpose(0, 1, 3, 2, 4).reshape(fronts, 3 * rows, 3 * columns)


def solve(dissection: Dissection, factor: Factor, forces: Array) -> Array:
    """The inverse times `forces` (n, 3)."""
    padded = jnp.concatenate([forces, jnp.zeros((1, 3), forces.dtype)])
    carried = [jnp.zeros((1, 3), forces.dtype)]
    eliminated = []
    for level, transfer in zip(dissection.levels, factor.transfers, strict=True):
        fronts, s = level.pivots.shape
        y, border = taken(padded, level.pivots), None
        if level.inputs.shape[-1]:
            below = jnp.concatenate(carried)
            added = taken(below, level.inputs[..., 0])
            for k in range(1, level.inputs.shape[-1]):
                added = added + taken(below, level.inputs[..., k])
            y, border = y + added[:, :s], added[:, s:]
        y = y.reshape(fronts, -1)
        eliminated.append(y)
        if transfer.shape[1]:
            moved = -jnp.einsum("bts,bs->bt", transfer, y).reshape(fronts, -1, 3)
            carried.append((moved if border is None else border + moved).reshape(-1, 3))
    known = jnp.zeros((0, 3), forces.dtype)
    for level, y, inverse, transfer in reversed(
        list(zip(dissection.levels, eliminated, factor.inverses, factor.transfers, strict=True))
    ):
        x = jnp.einsum("bsr,br->bs", inverse, y)
        if transfer.shape[1]:
            outside = taken(known, level.outputs).reshape(level.outputs.shape[0], -1)
            x = x - jnp.einsum("bts,bt->bs", transfer, outside)
        known = jnp.concatenate([known, x.reshape(-1, 3)])
    return taken(known, dissection.order)
