"""What the body is made of: the paper's spring lattice, or tetrahedral finite elements. One face for both.

Its `rest` is the shape that the adsorption asks for: a lattice's rest lengths (s,), Eq. (6); a solid's contraction at
the Gauss points (q, t).
"""

from __future__ import annotations

from typing import TypeAlias

from jax import Array

from gelbot.mechanics.solid import (
    Solid,
    StrainedSolid,
    gauss_contraction,
    solid_blocks,
    strain,
    strained_balance,
    vertex_contraction,
)
from gelbot.mechanics.springs import Lattice, Springs, rest_length, spring_balance, spring_blocks, springs_at

Elastic: TypeAlias = Lattice | Solid
Strained: TypeAlias = Springs | StrainedSolid


def node_pairs(elastic: Elastic) -> Array:
    """The pairs of nodes that act on each other, shape (2, c)."""
    return elastic.springs if isinstance(elastic, Lattice) else elastic.couplings


def rest_shape(elastic: Elastic, p_l: Array, ads: Array) -> Array:
    """What the adsorption `ads` (f,) of the surface asks for; `p_l` of Eq. (6)."""
    if isinstance(elastic, Lattice):
        return rest_length(elastic.length, p_l, ads, elastic.spring_faces, elastic.face_weights)
    return gauss_contraction(elastic, vertex_contraction(elastic, p_l, ads))


def elastic_at(elastic: Elastic, x: Array, rest: Array) -> Strained:
    """The body at `x` [m], (3, n): what an energy and its forces near there are computed from."""
    return springs_at(elastic, x, rest) if isinstance(elastic, Lattice) else strain(elastic, x, rest)


def elastic_balance(elastic: Elastic, before: Strained, displacement: Array) -> tuple[Array, Array]:
    """Elastic energy [J], up to a constant, and its forces [N], (3, n), after a `displacement` [m] from there."""
    if isinstance(elastic, Lattice) and isinstance(before, Springs):
        return spring_balance(elastic, before, displacement)
    assert isinstance(elastic, Solid)
    assert isinstance(before, StrainedSolid)
    return strained_balance(elastic, before, displacement)


def elastic_blocks(elastic: Elastic, x: Array, rest: Array) -> tuple[Array, Array]:
    """A positive semidefinite stiffness [N/m] at `x` [m]: of nodes (3, 3, n), between pairs of them (3, 3, c)."""
    return spring_blocks(elastic, x, rest) if isinstance(elastic, Lattice) else solid_blocks(elastic, x, rest)
