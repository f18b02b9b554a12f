"""The gel as a solid: ten-node tetrahedra of a neo-Hookean material that grows, or shrinks, where surfactant adsorbs.

A contraction c shrinks the gel in the plane of the sheet, as the lattice's springs in its surface do:

    G = I - c (I - e_3 e_3^T),    W = sum_q V_q det(G) Psi(F G^-1),
    Psi(F) = mu (tr F^T F - 3) / 2 - mu (J - 1) + (lambda + mu) (J - 1)^2 / 2,    J = det F,

a stable neo-Hookean solid (Smith, de Goes and Kim 2018, without the logarithm): Hooke's law with Lame's constants
lambda and mu at small strain, finite forces in elements turned inside out. e_3 is the sheet's normal before it bends.
The sum is over four Gauss points in each tetrahedron (degree 2); c is linear between its vertices.

A tetrahedron's edges are straight at rest, so that everything is said in its own coordinates xi: with the derivatives
D_k = dx / dxi_k, the constant gradients b_k = dxi_k / dX, F = sum_k D_k b_k^T, the weights w = V_q det(b), the volume
v = det(G) / det(b) and the metric M_kl = V_q det(G) b_k^T G^-2 b_l, the forces belong to

    dW / dD_k = mu sum_l M_kl D_l + w ((lambda + mu) (J - 1) - mu) C_k,    C_k = D_k+1 x D_k+2,    J = det(D) / v,

because cof(F G^-1) = cof(D) cof(b G^-1). No stress has to be turned back and forth.

Index letters: n nodes, v vertices, t tetrahedra, q Gauss points, f surface faces, c couplings. Nodes' quantities are
(3, n) or, for a batch, (3, n, b); whatever else is said to be of a body may carry the same axis b at its end.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.body.lattice import Body
from gelbot.body.quadratic import EDGES

GAUSS_NEAR, GAUSS_FAR = (5.0 + 3.0 * 5.0**0.5) / 20.0, (5.0 - 5.0**0.5) / 20.0
"""Barycentric coordinates of the four Gauss points of degree 2: towards their own corner and towards the others."""
ROTATION_STEPS = 3
"""Improvements of the rotation of an element after Gram and Schmidt: the third changes it by less than 1e-4."""

Components: TypeAlias = tuple[tuple[Array, Array, Array], tuple[Array, Array, Array], tuple[Array, Array, Array]]
"""Nine arrays, (q, t) each, for xi_k and x_i or for xi_k and xi_l: the engine computes them faster than one of nine."""


class Solid(NamedTuple):
    """Constants of a solid, SI units.

    `tetrahedra` (10, t) as from `with_midpoints`; `places` (10, 3, t), where the coordinates of their nodes stand in
    `positions.ravel()`. `shape_slopes` (3, q, 10): dN_a / dxi_k; `local_gradients` b [1/m] (3, 3, t), `determinant`
    1 / det(b) [m^3] and `cofactor_weight` w [-] (t,); `in_plane` and `normal` [m] (3, 3, t), two parts of the metric,
    V_q b_k b_l over the plane and along the normal. Lame's constants `lame` lambda and `shear` mu [Pa], () or (b,).
    `vertex_faces` (d, v) and `face_weights` (d, v): the faces around each vertex and their shares of its contraction.
    `couplings` (2, c): pairs i < j of nodes that share an element, `coupling_places` (45, t): those of each element.
    """

    tetrahedra: Array
    places: Array
    shape_slopes: Array
    local_gradients: Array
    determinant: Array
    cofactor_weight: Array
    in_plane: Array
    normal: Array
    lame: Array
    shear: Array
    vertex_faces: Array
    face_weights: Array
    couplings: Array
    coupling_places: Array


class StrainedSolid(NamedTuple):
    """A solid in some positions, and all that changes of them need: computed once for all iterations of a step.

    `slopes` D [m], `cofactors` C [m^2], `metric` mu M [N/m], `shear_pull` mu (M D - w C) [N]; `volume` v and
    `excess` det(D) - v [m^3] (q, t); `shear_weight` mu w and `bulk_weight` (lambda + mu) w [Pa] (t,).
    """

    slopes: Components
    cofactors: Components
    metric: Components
    shear_pull: Components
    volume: Array
    excess: Array
    shear_weight: Array
    bulk_weight: Array


def build_solid(body: Body, young_modulus: float, poisson_ratio: float) -> Solid:
    """Prepare a body `with_midpoints` of Young's modulus [Pa] and Poisson's ratio in (-1, 0.5)."""
    tetrahedra, n = body.tetrahedra, body.nodes.shape[1]
    corners = body.nodes[:, tetrahedra[:4]]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], -1, 0)  # (t, 3, 3), dX_j / dxi_k
    gradients = np.moveaxis(np.linalg.inv(edges), 0, -1)  # (k, j, t)
    determinant = np.linalg.det(edges)
    quadrature_volume = np.abs(determinant) / 24.0
    slopes = _shape_slopes()
    vertex_faces, face_weights = _faces_around(body, int(tetrahedra[:4].max()) + 1)
    a, b = np.triu_indices(10, 1)
    pairs, places = np.unique(np.stack([tetrahedra[a].ravel(), tetrahedra[b].ravel()]), axis=1, return_inverse=True)
    return Solid(
        tetrahedra=jnp.asarray(tetrahedra, jnp.int32),
        places=jnp.asarray(n * np.arange(3)[:, None] + tetrahedra[:, None], jnp.int32),
        shape_slopes=jnp.asarray(slopes),
        local_gradients=jnp.asarray(gradients),
        determinant=jnp.asarray(determinant),
        cofactor_weight=jnp.asarray(quadrature_volume / determinant),
        in_plane=jnp.asarray(quadrature_volume * np.einsum("kjt,ljt->klt", gradients[:, :2], gradients[:, :2])),
        normal=jnp.asarray(quadrature_volume * gradients[:, None, 2] * gradients[None, :, 2]),
        lame=jnp.asarray(young_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))),
        shear=jnp.asarray(young_modulus / (2.0 * (1.0 + poisson_ratio))),
        vertex_faces=jnp.asarray(vertex_faces, jnp.int32),
        face_weights=jnp.asarray(face_weights),
        couplings=jnp.asarray(pairs, jnp.int32),
        coupling_places=jnp.asarray(places.reshape(len(a), -1), jnp.int32),
    )


def _shape_slopes() -> NDArray[np.float64]:
    """dN_a / dxi_k at the Gauss points, shape (3, q, 10).

    N_i = L_i (2 L_i - 1) at corners, N_ij = 4 L_i L_j at midpoints, L = (1 - xi_0 - xi_1 - xi_2, xi_0, xi_1, xi_2).
    """
    L = np.full((4, 4), GAUSS_FAR) + (GAUSS_NEAR - GAUSS_FAR) * np.eye(4)
    slope = np.concatenate([-np.ones((1, 3)), np.eye(3)])  # dL / dxi, (4, 3)
    at_corners = [np.outer(slope[i], 4.0 * L[i] - 1.0) for i in range(4)]
    at_midpoints = [4.0 * (np.outer(slope[j], L[i]) + np.outer(slope[i], L[j])) for i, j in EDGES]
    return np.stack(at_corners + at_midpoints, axis=-1)


def _faces_around(body: Body, vertex_count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The surface faces around each vertex, shape (d, v), and their parts of the area around it, with zeros behind."""
    a, b, c = (body.nodes[:, body.faces[k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a, axis=0), axis=0)
    around: list[list[int]] = [[] for _ in range(vertex_count)]
    for f, face in enumerate(body.faces.T):
        for vertex in face:
            around[vertex].append(f)
    faces = np.zeros((max(map(len, around)), vertex_count), dtype=np.int64)
    weights = np.zeros(faces.shape)
    for vertex, found in enumerate(around):
        faces[: len(found), vertex] = found
        weights[: len(found), vertex] = areas[found] / areas[found].sum() if found else 0.0
    return faces, weights


def vertex_contraction(solid: Solid, p_l: Array, ads: Array) -> Array:
    """c = p_l ads at the vertices, shape (v,), the mean over the faces' `ads` (f,) around one; 0 inside the body."""
    around = range(solid.vertex_faces.shape[0])
    return p_l * sum(_beside(solid.face_weights[k], ads.ndim - 1) * ads[solid.vertex_faces[k]] for k in around)


def gauss_contraction(solid: Solid, contraction: Array) -> Array:
    """c at the Gauss points, shape (q, t), linear between its values at the vertices, shape (v,)."""
    at_corners = contraction[solid.tetrahedra[:4]]
    return GAUSS_FAR * sum(at_corners[k] for k in range(4)) + (GAUSS_NEAR - GAUSS_FAR) * at_corners


def solid_balance(solid: Solid, start: Array, displacement: Array, contraction: Array) -> tuple[Array, Array]:
    """Energy [J], less that at `start`, and the forces [N] (3, n) on the nodes at `start` + `displacement` [m] (3, n).

    `contraction` belongs to the Gauss points, shape (q, t), as from `gauss_contraction`. What `displacement` changes is
    computed from itself alone: in single precision the sum with `start` is known to 1 nm only.
    """
    return strained_balance(solid, strain(solid, start, contraction), displacement)


def strain(solid: Solid, x: Array, contraction: Array) -> StrainedSolid:
    """The solid at positions `x` [m], shape (3, n), contracted by `contraction` at the Gauss points, shape (q, t)."""
    batch = x.ndim - 2
    remains = (1.0 - _beside(contraction, x.ndim - contraction.ndim)) ** 2  # det(G)
    slopes = _slopes(solid, x)
    metric = _components(
        lambda k, m: solid.shear * (_beside(solid.in_plane[k, m], batch) + remains * _beside(solid.normal[k, m], batch))
    )
    weight = _beside(solid.cofactor_weight, batch)
    shear_weight, bulk_weight = solid.shear * weight, (solid.lame + solid.shear) * weight
    volume = remains * _beside(solid.determinant, batch)
    cofactors = _components(lambda k, i: _minor(slopes, slopes, k, i))
    return StrainedSolid(
        slopes=slopes,
        cofactors=cofactors,
        metric=metric,
        shear_pull=_components(lambda k, i: _times(metric, slopes, k, i) - shear_weight * cofactors[k][i]),
        volume=volume,
        excess=sum(slopes[k][0] * cofactors[k][0] for k in range(3)) - volume,
        shear_weight=shear_weight,
        bulk_weight=bulk_weight,
    )


def strained_balance(solid: Solid, strained: StrainedSolid, displacement: Array) -> tuple[Array, Array]:
    """What `solid_balance` says, when the strain at its `start` is known."""
    D, C, change = strained.slopes, strained.cofactors, _slopes(solid, displacement)
    mixed = _components(lambda k, i: _minor(D, change, k, i) + _minor(change, D, k, i))
    square = _components(lambda k, i: _minor(change, change, k, i))
    # det(D + change) - det(D), expanded along i = 0. Each of these is divided last: the engine keeps a quotient for all
    # nine forces, but would compute a product nine times.
    determinant = sum(
        change[k][0] * C[k][0] + (D[k][0] + change[k][0]) * (mixed[k][0] + square[k][0]) for k in range(3)
    )
    dilation = (strained.excess + determinant) / strained.volume  # J - 1
    stretched = _components(lambda k, i: _times(strained.metric, change, k, i))
    pull = _components(
        lambda k, i: (
            strained.shear_pull[k][i]
            + (stretched[k][i] - strained.shear_weight * (mixed[k][i] + square[k][i]))
            + strained.bulk_weight * dilation * (C[k][i] + mixed[k][i] + square[k][i])
        )
    )
    shear_energy = sum(
        change[k][i]
        * (
            strained.shear_pull[k][i]
            + 0.5 * stretched[k][i]
            - strained.shear_weight * (0.5 * mixed[k][i] + square[k][i] / 3.0)
        )
        for k in range(3)
        for i in range(3)
    )
    bulk_energy = strained.bulk_weight * determinant * (strained.excess + 0.5 * determinant) / strained.volume
    return jnp.sum(shear_energy + bulk_energy, axis=(0, 1)), -_sum_at_nodes(solid, pull, displacement)


def solid_energy(solid: Solid, x: Array, contraction: Array) -> Array:
    """Elastic energy W [J] at positions `x` [m], shape (3, n), and `contraction` at the Gauss points, shape (q, t)."""
    strained = strain(solid, x, contraction)
    D, v = strained.slopes, strained.volume
    squares = sum(D[k][i] * _times(strained.metric, D, k, i) for k in range(3) for i in range(3))
    shear = 0.5 * squares - strained.shear_weight * (1.5 * v + strained.excess)
    return jnp.sum(shear + 0.5 * strained.bulk_weight * strained.excess**2 / v, axis=(0, 1))


def solid_blocks(solid: Solid, x: Array, contraction: Array) -> tuple[Array, Array]:
    """A positive semidefinite stiffness [N/m] near `x` [m] (3, n): blocks of nodes (3, 3, n), of `couplings` (3, 3, c).

    Hooke's law in the frame R that turns with each Gauss point: sum V_q det(G) (2 mu |sym K|^2 + lambda (tr K)^2) for
    K = R^T dF G^-1. At rest without contraction it is the Hessian of the energy. `contraction` as in `strain`.
    """
    remains = 1.0 - _beside(contraction, x.ndim - contraction.ndim)
    gradient = _gradients(solid, remains, x.ndim - 2)  # G^-1 grad N, (3, 10, q, t)
    at = x.reshape(-1, *x.shape[2:])[solid.places]  # (10, 3, t)
    turn = _rotation(jnp.sum(at[:, :, None, None] * jnp.moveaxis(gradient, 1, 0)[:, None], axis=0))  # of F G^-1
    turned = jnp.sum(turn[:, :, None] * gradient, axis=1)  # R G^-1 grad N, (3, 10, q, t)
    weight = _beside(solid.cofactor_weight * solid.determinant, x.ndim - 2) * remains**2  # V_q det(G)

    def blocks(a: NDArray[np.int64], b: NDArray[np.int64]) -> Array:
        identity = jnp.eye(3, dtype=x.dtype).reshape(3, 3, *(1,) * (x.ndim))

        def at_point(q: int) -> Array:
            one, other = turned[:, a, q], turned[:, b, q]
            shear = solid.shear * (identity * jnp.sum(one * other, axis=0) + other[:, None] * one[None])
            return weight[q] * (shear + solid.lame * one[:, None] * other[None])

        return at_point(0) + at_point(1) + at_point(2) + at_point(3)

    own, (first, second) = np.arange(10), np.triu_indices(10, 1)
    batch, dtype = x.shape[2:], x.dtype
    diagonal = jnp.zeros((3, 3, x.shape[1], *batch), dtype).at[:, :, solid.tetrahedra].add(blocks(own, own))
    couplings = jnp.zeros((3, 3, solid.couplings.shape[1], *batch), dtype)
    return diagonal, couplings.at[:, :, solid.coupling_places].add(blocks(first, second))


def _gradients(solid: Solid, remains: Array, batch: int) -> Array:
    """G^-1 grad N_a at the Gauss points [1/m], shape (3, 10, q, t), in the directions of the undeformed body."""
    slopes = [_beside(solid.shape_slopes[k].T[:, :, None], batch) for k in range(3)]
    x, y, z = (sum(slopes[k] * _beside(solid.local_gradients[k, j], batch) for k in range(3)) for j in range(3))
    return jnp.stack([x / remains, y / remains, z * jnp.ones_like(remains)])


def _rotation(gradient: Array) -> Array:
    """The rotation nearest to a deformation `gradient`, shape (3, 3, ...); one also where it is turned inside out.

    Gram and Schmidt's frame, turned until R^T F is symmetric (Mueller, Bender, Chentanez and Macklin 2016); each step
    by Cayley's formula, so that it stays a rotation.
    """
    tiny = jnp.finfo(gradient.dtype).tiny ** 0.5
    first = gradient[:, 0] / (jnp.sqrt(jnp.sum(gradient[:, 0] ** 2, axis=0)) + tiny)
    second = gradient[:, 1] - first * jnp.sum(first * gradient[:, 1], axis=0)
    second = second / (jnp.sqrt(jnp.sum(second**2, axis=0)) + tiny)
    frame = jnp.stack([first, second, jnp.cross(first, second, axis=0)], axis=1)

    def improved(_: int, frame: Array) -> Array:
        moment = jnp.sum(jnp.cross(frame, gradient, axis=0), axis=1)
        spread = jnp.abs(jnp.sum(frame * gradient, axis=(0, 1))) + 1e-3
        half = jnp.broadcast_to((0.5 * moment / spread)[:, None], frame.shape)
        aside = jnp.cross(half, frame, axis=0)
        return frame + 2.0 / (1.0 + jnp.sum(half**2, axis=0)) * (aside + jnp.cross(half, aside, axis=0))

    return jax.lax.fori_loop(0, ROTATION_STEPS, improved, frame)


def _slopes(solid: Solid, x: Array) -> Components:
    """D_k = dx / dxi_k at the Gauss points [m], for positions or displacements (3, n)."""
    at = x.reshape(-1, *x.shape[2:])[solid.places]
    slopes = jnp.einsum("kqa,a...->kq...", solid.shape_slopes, at)
    return _components(lambda k, i: slopes[k, :, i])


def _sum_at_nodes(solid: Solid, pull: Components, like: Array) -> Array:
    """The nodes' sums of dW / dD_k dD_k / dx_a over Gauss points and elements, shape (3, n) as `like`.

    A scatter: here the engine does it in a third of the time that a table of each node's elements takes, as vertices
    have up to 22 tetrahedra and most midpoints 2 or 3.
    """
    on_nodes = [sum(jnp.einsum("qa,q...->a...", solid.shape_slopes[k], pull[k][i]) for k in range(3)) for i in range(3)]
    total = jnp.zeros((like.shape[0] * like.shape[1], *like.shape[2:]), like.dtype)
    return total.at[solid.places].add(jnp.stack(on_nodes, axis=1)).reshape(like.shape)


def _minor(one: Components, other: Components, k: int, i: int) -> Array:
    """Component i of (column k + 1 of one) x (column k + 2 of the other), (q, t): the cofactor, where both are one."""
    k1, k2, i1, i2 = (k + 1) % 3, (k + 2) % 3, (i + 1) % 3, (i + 2) % 3
    return one[k1][i1] * other[k2][i2] - one[k1][i2] * other[k2][i1]


def _times(metric: Components, slopes: Components, k: int, i: int) -> Array:
    return metric[k][0] * slopes[0][i] + metric[k][1] * slopes[1][i] + metric[k][2] * slopes[2][i]


def _components(entry: Callable[[int, int], Array]) -> Components:
    a, b, c = ((entry(k, 0), entry(k, 1), entry(k, 2)) for k in range(3))
    return a, b, c


def _beside(constant: Array, batch_axes: int) -> Array:
    """A constant with `batch_axes` (0 or 1) axes of length 1 at its end."""
    return constant.reshape(constant.shape + (1,) * batch_axes)
