"""What the body is made of: the paper's spring lattice, or tetrahedral finite elements. One face for both.

`rest` is the shape that the adsorption asks for: of a lattice the springs' rest lengths, Eq. (6).
"""

from __future__ import annotations

from typing import TypeAlias

from jax import Array

from gelbot.mechanics.springs import Lattice, Springs, rest_length, spring_balance, spring_blocks, springs_at

Elastic: TypeAlias = Lattice
Undeformed: TypeAlias = Springs


def rest_shape(elastic: Elastic, p_l: Array, ads: Array) -> Array:
    """What the adsorption `ads` (f,) of the surface asks for."""
    return rest_length(elastic.length, p_l, ads, elastic.spring_faces, elastic.face_weights)


def elastic_at(elastic: Elastic, x: Array, rest: Array) -> Undeformed:
    """The body at `x` [m], (3, n): what an energy and its forces near there are computed from."""
    return springs_at(elastic, x, rest)


def elastic_balance(elastic: Elastic, before: Undeformed, displacement: Array) -> tuple[Array, Array]:
    """Elastic energy [J] and its forces [N], (3, n), after a `displacement` [m] from there."""
    return spring_balance(elastic, before, displacement)


def elastic_blocks(elastic: Elastic, x: Array, rest: Array) -> tuple[Array, Array]:
    """A positive semidefinite stiffness [N/m] at `x` [m]: of nodes (3, 3, n), between pairs of them (3, 3, c)."""
    return spring_blocks(elastic, x, rest)
