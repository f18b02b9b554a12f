"""The spring lattice: stiffness, rest length, equation (6), and forces."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray


def spring_stiffness(
    young_modulus: float, spring_volume: NDArray[np.float64], spring_length: NDArray[np.float64], layer_count: int
) -> NDArray[np.float64]:
    """k_s = E V_s / (beta l_s^2) [N/m] (Van Gelder 1998), V_s the volume of the tetrahedra around the edge; shape (s,).

    beta makes the sheet bend like one of Young's modulus `young_modulus` [Pa]; in its plane it is softer by beta.
    """
    return young_modulus / bending_factor(layer_count) * spring_volume / spring_length**2


def bending_factor(layer_count: int) -> float:
    """How much stiffer in bending a lattice of `layer_count` node layers is than a solid: beta = 1 + 2 / (N - 1)^2.

    The springs along the sheet lie in N planes, with half weight in the outer two; their second moment of area is that
    of the trapezoidal rule, beta h^3 / 12. For two layers beta = 3: all the springs lie in the faces.
    """
    return 1.0 + 2.0 / (layer_count - 1) ** 2


def rest_length(spring_length: Array, p_l: Array, ads: Array, faces: Array, weights: Array) -> Array:
    """l_0 = l_0init (1 - p_l ads) [m], Eq. (6), shape (s,).

    `ads` belongs to the surface faces, shape (f,); a surface spring takes the mean of the two faces beside it (`faces`
    and `weights`, shape (2, s)), a spring inside the body has no weight and keeps its length.
    """
    on_spring = jnp.sum(ads[faces] * weights, axis=0)
    return spring_length * (1.0 - p_l * on_spring)


def spring_balance(
    start: Array, displacement: Array, springs: Array, stiffness: Array, rest: Array, incidence: Array
) -> tuple[Array, Array]:
    """Elastic energy sum_s k_s (l_s - l_0s)^2 / 2 [J] and its forces [N] on the nodes at `start` + `displacement` [m].

    Nodes' quantities have shape (3, n). `incidence` comes from `node_springs`. Both are computed at once: they share
    the lengths. A small displacement acts through its differences, not its sum with `start`, which in single precision
    is known to 1 nm only: a spring would feel that as a tenth of a node's weight.
    """
    before = start[:, springs[1]] - start[:, springs[0]]
    change = displacement[:, springs[1]] - displacement[:, springs[0]]
    along = before + change
    length_before, length = jnp.sqrt(jnp.sum(before**2, axis=0)), jnp.sqrt(jnp.sum(along**2, axis=0))
    growth = jnp.sum(change * (before + along), axis=0) / (length_before + length)  # length - length_before
    stretch = (length_before - rest) + growth
    tension = (stiffness * stretch / length) * along
    # A node sums the springs that end at it: a gather, which is far cheaper than a scatter.
    both_ends = jnp.concatenate([tension, -tension, jnp.zeros((3, 1), tension.dtype)], axis=1)
    return 0.5 * jnp.sum(stiffness * stretch**2), jnp.sum(both_ends[:, incidence], axis=1)


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
