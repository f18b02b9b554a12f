"""A second road to the field: scikit-fem solves div(sigma grad phi) = 0 in a closed tank, the mesh graded to edges.

Triquadratic elements on a box of hexahedra whose planes pass through every face and edge of an electrode. Outer walls
carry no flux by themselves; the faces of electrodes get their voltages; what is solid, metal or insulator, is a hole.
At the edge of a thin plate the density goes like 1 / sqrt(distance) and the error of the currents like the size of
the elements there, always upwards: a plate too large by a share of one element. At the edge of a plate with an
insulating back, where three quarters of the space are left, it goes like distance^(-2/3) and the error like size^(2/3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import cg
from skfem import Basis, BilinearForm, ElementHex2, InteriorFacetBasis, MeshHex, asm
from skfem.helpers import dot, grad

TOUCH = 1e-9  # m: points closer than that are one


class Box(NamedTuple):
    """From the corner `low` to the corner `high` [m], shape (3,) each; a plate is as high as low."""

    low: ArrayLike
    high: ArrayLike

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which `points` (3, ...) lie in the box or on its surface."""
        low, high = (np.reshape(corner, (3,) + (1,) * (points.ndim - 1)) for corner in self)
        return np.all((points > low - TOUCH) & (points < high + TOUCH), axis=0)


def graded(
    stops: Sequence[float], edges: dict[float, float], largest: float, ratio: float = 4.0
) -> NDArray[np.float64]:
    """Planes of a mesh along one axis [m]: through all `stops`, about `edges[x]` [m] apart at each edge x.

    Away from the edges each distance is about `ratio` times the one before, up to `largest` [m].
    """
    nodes = [np.array(stops[:1])]
    for low, high in pairwise(stops):
        t = np.linspace(low, high, 20001)
        sizes = [smallest + np.log(ratio) * np.abs(t - edge) for edge, smallest in edges.items()]
        steps = cumulative_trapezoid(1.0 / np.min([np.full_like(t, largest), *sizes], axis=0), t, initial=0.0)
        count = int(np.ceil(steps[-1]))
        nodes.append(np.interp(np.arange(1, count + 1) * steps[-1] / count, steps, t))
    return np.concatenate(nodes)


def tank_mesh(x: ArrayLike, y: ArrayLike, z: ArrayLike, holes: Sequence[Box] = ()) -> MeshHex:
    """A closed tank with mesh planes at `x`, `y`, `z` [m], without the elements in `holes`."""
    mesh = MeshHex.init_tensor(*(np.asarray(axis) for axis in (x, y, z)))
    middles = mesh.p[:, mesh.t].mean(axis=1)
    solid = np.any([hole.holds(middles) for hole in holes], axis=0) if holes else np.zeros(middles.shape[1], bool)
    return mesh.remove_elements(np.flatnonzero(solid)) if solid.any() else mesh


def faces(mesh: MeshHex, box: Box) -> NDArray[np.int_]:
    """Numbers of the mesh's faces that lie in `box` with all their corners: a plate, the skin of a hole, a wall."""
    return np.flatnonzero(np.all(box.holds(mesh.p)[mesh.facets], axis=0))


def rounded(mesh: MeshHex, middle: tuple[float, float], radius: float, reach: float) -> MeshHex:
    """`mesh` with the upright square of half-width `radius` [m] about `middle` [m] drawn in to a cylinder.

    Squares about the middle become circles there and stay squares from the half-width `reach` [m] on. Elements have
    straight edges with their corners on the circle: the angle between corners should be below about 0.3.
    """
    offset = mesh.p[:2] - np.reshape(middle, (2, 1))
    square = np.max(np.abs(offset), axis=0)
    circle = np.maximum(np.linalg.norm(offset, axis=0), TOUCH)
    share = np.clip((reach - square) / (reach - radius), 0.0, 1.0)
    moved = np.array(mesh.p)
    moved[:2] += share * (square / circle - 1.0) * offset
    return replace(mesh, doflocs=moved)


@BilinearForm
def stiffness(u, v, w):
    return w.conductivity * dot(grad(u), grad(v))


class Elements(NamedTuple):
    """A tank made discrete: `basis`, `conductivity` [S/m] of each element, stiffness `matrix` [S]."""

    basis: Basis
    conductivity: NDArray[np.float64]
    matrix: csr_matrix


def assemble(mesh: MeshHex, conductivity: float | NDArray[np.float64]) -> Elements:
    """Triquadratic elements on `mesh`; `conductivity` [S/m] is one number or one for each element."""
    basis = Basis(mesh, ElementHex2(), intorder=4)  # exact on upright boxes
    sigma = np.broadcast_to(np.asarray(conductivity, float), mesh.nelements)
    matrix = asm(stiffness, basis, conductivity=np.broadcast_to(sigma[:, None], basis.dx.shape))
    return Elements(basis, sigma, matrix.tocsr())


@dataclass(frozen=True, eq=False)
class Potential:
    """A solved tank: nodal `values` [V] on its `elements`, the numbers of each electrode's nodes."""

    elements: Elements
    electrodes: tuple[NDArray[np.int_], ...]
    values: NDArray[np.float64]

    @property
    def currents(self) -> NDArray[np.float64]:
        """Currents [A] from the electrodes into the tank, shape (e,): the reactions of the fixed nodes."""
        reaction = self.elements.matrix @ self.values
        return np.array([reaction[nodes].sum() for nodes in self.electrodes])

    @property
    def power(self) -> float:
        """Heat [W] that the current leaves in the tank."""
        return float(self.values @ (self.elements.matrix @ self.values))

    def current_density(self, box: Box) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points [m] and -sigma grad phi [A/m^2] there, (3, p) each: 2 x 2 x 2 in each element that lies in `box`.

        In these, Gauss's points of two, the gradient of a quadratic element is one order better than elsewhere.
        """
        basis, sigma, _ = self.elements
        mesh = basis.mesh
        inside = np.flatnonzero(np.all(box.holds(mesh.p)[mesh.t], axis=0))
        near = Basis(mesh, basis.elem, intorder=3, elements=inside)
        density = -sigma[inside, None] * near.interpolate(self.values).grad
        return np.asarray(near.global_coordinates()).reshape(3, -1), density.reshape(3, -1)

    def density_up(self, box: Box) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (3, p) [m] on a flat, level `box` inside the tank and the density upwards through it [A/m^2], (p,).

        The mean of what the elements below and above say, which may be of different materials.
        """
        basis, sigma, _ = self.elements
        through = faces(basis.mesh, box)
        sides = [InteriorFacetBasis(basis.mesh, basis.elem, facets=through, intorder=3, side=side) for side in (0, 1)]
        slopes = [side.interpolate(self.values).grad[2] for side in sides]
        density = np.mean([-sigma[basis.mesh.f2t[k, through], None] * slopes[k] for k in (0, 1)], axis=0)
        return np.asarray(sides[0].global_coordinates()).reshape(3, -1), density.ravel()


def solve_tank(
    elements: Elements,
    electrodes: Sequence[NDArray[np.int_]],
    voltages: Sequence[float] | NDArray[np.float64],
    zero: NDArray[np.int_] | None = None,
) -> Potential:
    """Solve with `voltages` [V], shape (e,), on the `faces` of each electrode and 0 V on those of `zero`.

    The faces `zero` are planes of antisymmetry; a plane of symmetry is a wall like any other. Conjugate gradients,
    preconditioned by the diagonal.
    """
    basis, matrix = elements.basis, elements.matrix
    owned = tuple(basis.get_dofs(facets=face).all() for face in electrodes)
    values, free = np.zeros(basis.N), np.ones(basis.N, bool)
    for nodes, voltage in zip(owned, voltages, strict=True):
        values[nodes], free[nodes] = voltage, False
    if zero is not None:
        free[basis.get_dofs(facets=zero).all()] = False
    inner = matrix[free]
    system, load = inner[:, free], -(inner @ values)
    answer, code = cg(system, load, rtol=1e-7, maxiter=20000, M=diags_array(1.0 / system.diagonal()))
    assert code == 0, f"conjugate gradients gave up: {code}"
    values[free] = answer
    return Potential(elements, owned, values)
