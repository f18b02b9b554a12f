"""The spring lattice: stiffness, rest length, equation (6), forces, and the stiffness of its nodes."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.body.lattice import Body
from gelbot.mechanics.batch import dot, settled, taken, wide


class Lattice(NamedTuple):
    """A lattice of `s` springs between nodes `springs` (2, s), of `stiffness` [N/m] (s,) or (s, b).

    `length` [m] (s,) of the undeformed springs; `incidence` (d, n) from `node_springs`; what `rest_length` needs:
    `spring_faces`, `face_weights` (2, s).
    """

    springs: Array
    incidence: Array
    stiffness: Array
    length: Array
    spring_faces: Array
    face_weights: Array


def build_lattice(body: Body, young_modulus: float, bending: float) -> Lattice:
    """The lattice of `body`, which bends like a sheet of `young_modulus` [Pa].

    `bending`: how much stiffer in bending than a solid it would be by itself: `beam.bending_modulus`, or nearly
    `bending_factor`. In its plane it becomes softer by as much.
    """
    stiffness = spring_stiffness(young_modulus / bending, body.spring_volume, body.spring_length)
    return Lattice(
        springs=jnp.asarray(body.springs, jnp.int32),
        incidence=jnp.asarray(node_springs(body.springs, body.nodes.shape[1]), jnp.int32),
        stiffness=jnp.asarray(stiffness),
        length=jnp.asarray(body.spring_length),
        spring_faces=jnp.asarray(body.spring_faces, jnp.int32),
        face_weights=jnp.asarray(body.spring_face_weights),
    )


class Springs(NamedTuple):
    """Springs at the beginning of a step: `along` [m] (3, s), `length`, and `stretch` beyond the rest length (s,)."""

    along: Array
    length: Array
    stretch: Array


def spring_stiffness(
    young_modulus: float, spring_volume: NDArray[np.float64], spring_length: NDArray[np.float64]
) -> NDArray[np.float64]:
    """k_s = E V_s / l_s^2 [N/m] (Van Gelder 1998), V_s the volume of the tetrahedra around the edge; shape (s,)."""
    return young_modulus * spring_volume / spring_length**2


def bending_factor(layer_count: int) -> float:
    """How much stiffer in bending a lattice of `layer_count` node layers is than a solid, nearly: 1 + 2 / (N - 1)^2.

    The springs along the sheet lie in N planes, with half weight in the outer two; their second moment of area is that
    of the trapezoidal rule, beta h^3 / 12. For two layers beta = 3: all the springs lie in the faces. `beam`
    measures it.
    """
    return 1.0 + 2.0 / (layer_count - 1) ** 2


def rest_length(spring_length: Array, p_l: Array, ads: Array, faces: Array, weights: Array) -> Array:
    """l_0 = l_0init (1 - p_l ads) [m], Eq. (6), shape (s,) or (s, b).

    `ads` belongs to the surface faces, shape (f,) or (f, b); a surface spring takes the mean of the two faces beside it
    (`faces` and `weights`, shape (2, s)), a spring inside the body has no weight and keeps its length.
    """
    on_spring = ads[faces[0]] * wide(weights[0], ads, 1) + ads[faces[1]] * wide(weights[1], ads, 1)
    return wide(spring_length, ads, 1) * (1.0 - p_l * on_spring)


def springs_at(lattice: Lattice, start: Array, rest: Array) -> Springs:
    """The springs of a body at `start` [m], (3, n), with lengths `rest` [m], (s,): what stays the same in a step."""
    along = start[:, lattice.springs[1]] - start[:, lattice.springs[0]]
    length = jnp.sqrt(dot(along, along))
    return Springs(along, length, length - rest)


def spring_balance(lattice: Lattice, before: Springs, displacement: Array) -> tuple[Array, Array]:
    """Elastic energy sum_s k_s (l_s - l_0s)^2 / 2 [J] and its forces [N] on the nodes after a `displacement` [m].

    Nodes' quantities have shape (3, n) or (3, n, b). Both are computed at once: they share the lengths. A small
    displacement acts through its differences, not its sum with the start, which in single precision is known to 1 nm
    only: a spring would feel that as a tenth of a node's weight.
    """
    k = wide(lattice.stiffness, before.length, 1)
    first, second = (settled(taken(displacement, lattice.springs[end], 1)) for end in (0, 1))
    change = second - first
    along = before.along + change
    squared = dot(along, along)
    inverse = 1.0 / jnp.sqrt(squared)
    length = squared * inverse
    growth = dot(change, before.along + along) / (before.length + length)  # length - before.length
    stretch = before.stretch + growth
    tension = settled((k * stretch * inverse) * along)
    # A node sums the springs that end at it: a gather, which is far cheaper than a scatter.
    both_ends = settled(jnp.concatenate([tension, -tension, jnp.zeros_like(tension[:, :1])], axis=1))
    return 0.5 * jnp.sum(k * stretch**2, axis=0), jnp.sum(settled(taken(both_ends, lattice.incidence, 1)), axis=1)


def spring_blocks(lattice: Lattice, x: Array, rest: Array) -> tuple[Array, Array]:
    """Stiffness [N/m] at `x` [m]: the nodes' own blocks, (3, 3, n), and those between each spring's nodes, (3, 3, s).

    Compression softens a spring across its line; that would make the stiffness indefinite, and is left out.
    """
    before = springs_at(lattice, x, rest)
    unit = before.along / before.length
    across = jnp.maximum(0.0, before.stretch / before.length)
    k = wide(lattice.stiffness, before.length, 1)
    along_part, across_part = k * (1.0 - across), k * across
    block = along_part * unit[:, None] * unit[None, :]
    for axis in range(3):
        block = block.at[axis, axis].add(across_part)
    ends = jnp.concatenate([block, block, jnp.zeros_like(block[:, :, :1])], axis=2)
    return jnp.sum(ends[:, :, lattice.incidence], axis=2), -block


def node_springs(springs: NDArray[np.int64], node_count: int) -> NDArray[np.int64]:
    """Where each node finds its springs, shape (d, n): index s at a spring's first end, s + count at its second.

    Rows are padded with 2 * count, the place of a zero.
    """
    count = springs.shape[1]
    ends = np.concatenate([springs[0], springs[1]])
    order = np.argsort(ends, kind="stable")
    degree = np.bincount(ends, minlength=node_count)
    place = np.arange(2 * count) - np.repeat(np.cumsum(degree) - degree, degree)
    table = np.full((int(degree.max()), node_count), 2 * count)
    table[place, ends[order]] = order
    return table
