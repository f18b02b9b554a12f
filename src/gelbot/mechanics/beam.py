"""How stiff a lattice really is: a clamped strip of it under its own weight, beside a beam.

Van Gelder's stiffness is right for a stretch that is the same everywhere. A sheet of few layers bends otherwise: its
springs lie in planes (`springs.bending_factor`), and flat tetrahedra make it stiffer. Nobody has a closed form for
that, but a strip of the same lattice says it: its tip sags by w L^4 / (8 E I).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from gelbot.body.lattice import Body, build_body
from gelbot.body.outline import strip
from gelbot.mechanics.springs import spring_stiffness

LENGTH, LENGTH_IN_MESH = 20.0, 16.0
"""The strip is this many thicknesses long, or this many mesh sizes if that is longer."""
WIDTH_IN_MESH = 8.0
"""And this many mesh sizes wide: in a narrower one it counts how the rows of its mesh happen to lie."""


@lru_cache(maxsize=64)
def bending_modulus(thickness: float, mesh_size: float, layer_count: int) -> float:
    """Modulus with which a lattice of springs `spring_stiffness(E, ...)` bends, over E.

    `thickness` and `mesh_size` [m]; only their ratio counts. Springs divided by it bend like a solid of modulus E.
    """
    mesh = mesh_size / thickness  # everything in thicknesses
    length, width = max(LENGTH, LENGTH_IN_MESH * mesh), WIDTH_IN_MESH * mesh
    body = build_body(strip(length, width), 1.0, mesh, layer_count)
    free = np.repeat(body.nodes[0] > -length / 2.0 + 1e-6, 3)
    weight = np.zeros(free.size)
    weight[2::3] = -body.node_volume
    sag = np.zeros(free.size)
    sag[free] = scipy.sparse.linalg.spsolve(lattice_stiffness(body, 1.0)[free][:, free], weight[free])
    tip = -sag[2::3][body.nodes[0] > length / 2.0 - 1e-6].mean()
    inertia = width / 12.0
    return float(width * length**4 / (8.0 * inertia) / tip)


def lattice_stiffness(body: Body, young_modulus: float) -> scipy.sparse.csc_matrix:
    """sum_s k_s u_s u_s^T of the unstrained lattice [N/m], shape (3n, 3n), the node first; u_s along the springs."""
    k = spring_stiffness(young_modulus, body.spring_volume, body.spring_length)
    count, (first, second) = body.springs.shape[1], body.springs
    unit = (body.nodes[:, second] - body.nodes[:, first]) / body.spring_length
    # One row for each spring: how much a displacement of the nodes makes it longer.
    rows = np.tile(np.arange(count), 6)
    columns = np.concatenate([3 * end + axis for end in (first, second) for axis in range(3)])
    values = np.concatenate([*-unit, *unit])
    longer = scipy.sparse.csr_matrix((values, (rows, columns)), shape=(count, 3 * body.nodes.shape[1]))
    return (longer.T @ scipy.sparse.diags_array(k) @ longer).tocsc()
