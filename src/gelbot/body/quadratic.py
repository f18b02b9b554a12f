"""Quadratic tetrahedra: a node in the middle of every edge.

One layer of linear tetrahedra locks when a sheet bends; ten-node tetrahedra bend freely.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gelbot.body.lattice import Body, tetrahedron_volumes

EDGES = tuple(combinations(range(4), 2))
"""The corners of a tetrahedron's edges, in the order of its rows 4 to 9, which are the nodes in their middles."""
CORNER_SHARE, EDGE_SHARE = 1.0 / 36.0, 4.0 / 27.0
"""What a corner and a mid-edge node get of a tetrahedron's volume: the diagonal of its consistent mass matrix, scaled
so that the sum is right (Hinton, Rock and Zienkiewicz 1976). Equal shares of the row sums would be negative at corners.
"""


def with_midpoints(body: Body) -> Body:
    """The same body with a node in the middle of every edge of its tetrahedra, which become `tetrahedra` (10, t).

    The old nodes, the vertices, keep their numbers; the midpoints follow. Rows 0 to 3 of `tetrahedra` are corners, rows
    4 to 9 the midpoints of `EDGES`. Every column ascends, so that of two nodes of any tetrahedron the first is the one
    with the smaller number; for that, corners give up their orientation: some tetrahedra are left-handed.
    `node_volume` is lumped anew. Essential points and the surface's area stay with the vertices: midpoints have no
    weight in them. Springs, which know nothing of midpoints, stay too.
    """
    vertex_count = body.nodes.shape[1]
    corners = np.sort(body.tetrahedra, axis=0)
    # Ascending corners give ascending pairs of ends, and `unique` numbers the pairs in that order.
    ends = np.concatenate([corners[[i, j]] for i, j in EDGES], axis=1)
    edges, index = np.unique(ends, axis=1, return_inverse=True)
    midpoints = vertex_count + index.reshape(len(EDGES), -1)
    nodes = np.concatenate([body.nodes, body.nodes[:, edges].mean(axis=1)], axis=1)
    volumes = tetrahedron_volumes(body.nodes, body.tetrahedra)
    node_volume = np.zeros(nodes.shape[1])
    np.add.at(node_volume, corners, np.broadcast_to(CORNER_SHARE * volumes, corners.shape))
    np.add.at(node_volume, midpoints, np.broadcast_to(EDGE_SHARE * volumes, midpoints.shape))

    def padded(weights: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([weights, np.zeros((*weights.shape[:-1], edges.shape[1]))], axis=-1)

    return replace(
        body,
        nodes=nodes,
        tetrahedra=np.concatenate([corners, midpoints]),
        node_volume=node_volume,
        node_area=padded(body.node_area),
        centre=padded(body.centre),
        tips=padded(body.tips),
        tip_bases=padded(body.tip_bases),
    )
