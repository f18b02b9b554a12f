"""Bodies: a planar mesh thickened into layers of nodes: tetrahedra, springs, surface faces and essential points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelbot.body.outline import Outline
from gelbot.body.symmetry import SymmetryGroup
from gelbot.body.tips import tips_of
from gelbot.body.triangulation import Triangulation, signed_areas, triangulate

TIP_PART = 0.75
"""A tip's direction is read between this share of its distance from the centre and the tip itself."""
HUB_PART = 0.25
"""The body's normal is read on the mid-surface within this share of the body's reach around the centre."""


@dataclass(frozen=True)
class Body:
    """A sheet of gel at rest, its lower face at z = 0 and its centroid above the origin. Lengths in m.

    `nodes`, shape (3, n), numbered layer by layer from below. `tetrahedra`, shape (4, t). `faces`, shape (3, f):
    surface triangles, their normals (right-hand rule) pointing out. `springs`, shape (2, s), with `spring_length`,
    `spring_volume` [m^3] (the volume of the tetrahedra around the edge) and `spring_faces`, shape (2, s): the faces on
    either side of a surface spring, weighted by `spring_face_weights` (zero for springs inside the body).
    `node_volume` [m^3], shape (n,): each node's share of the volume; `node_area` [m^2]: of the surface.
    Essential points are weighted means of nodes: `centre` (n,), `tips` and `tip_bases` (a, n) for `a` tips. `hub`,
    shape (3, m): triangles of node columns around the centre that carry the body's normal; `layer_count` node layers.
    """

    outline: Outline
    group: SymmetryGroup
    thickness: float
    layer_count: int
    nodes: NDArray[np.float64]
    tetrahedra: NDArray[np.int64]
    faces: NDArray[np.int64]
    springs: NDArray[np.int64]
    spring_length: NDArray[np.float64]
    spring_volume: NDArray[np.float64]
    spring_faces: NDArray[np.int64]
    spring_face_weights: NDArray[np.float64]
    node_volume: NDArray[np.float64]
    node_area: NDArray[np.float64]
    centre: NDArray[np.float64]
    tips: NDArray[np.float64]
    tip_bases: NDArray[np.float64]
    hub: NDArray[np.int64]

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return float(self.node_volume.sum())


def build_body(outline: Outline, thickness: float, mesh_size: float, layer_count: int = 2) -> Body:
    """Thicken `outline` to a sheet of `thickness` [m], edges of about `mesh_size` [m], `layer_count` node layers."""
    plane = triangulate(outline, mesh_size)
    heights = np.linspace(0.0, thickness, layer_count)
    nodes = np.concatenate([np.column_stack([plane.points, np.full(len(plane.points), z)]) for z in heights]).T

    split = _tetrahedra(plane, layer_count, mirrored=False)
    mirror_split = _tetrahedra(plane, layer_count, mirrored=True)
    faces = _surface(plane, layer_count)
    # Springs and masses take the mean of a splitting and its mirror image in z, so that up and down are alike.
    springs, spring_volume = _springs(nodes, np.concatenate([split, mirror_split], axis=1))
    both = np.concatenate([split, mirror_split], axis=1)
    volumes = 0.5 * tetrahedron_volumes(nodes, both)
    node_volume = _sums(both, volumes / 4.0, nodes.shape[1])
    spring_faces, weights = _adjacent_faces(springs, faces)
    node_area = _sums(faces, _face_areas(nodes, faces) / 3.0, nodes.shape[1])
    tips = tips_of(outline).points
    return Body(
        outline=outline,
        group=plane.group,
        thickness=thickness,
        layer_count=layer_count,
        nodes=nodes,
        tetrahedra=_positive(nodes, split),
        faces=faces,
        springs=springs,
        spring_length=np.linalg.norm(nodes[:, springs[1]] - nodes[:, springs[0]], axis=0),
        spring_volume=0.5 * spring_volume,
        spring_faces=spring_faces,
        spring_face_weights=weights,
        node_volume=node_volume,
        node_area=node_area,
        centre=_column_weights(plane, np.zeros(2), layer_count),
        tips=np.array([_column_weights(plane, p, layer_count) for p in tips]),
        tip_bases=np.array([_column_weights(plane, TIP_PART * p, layer_count) for p in tips]),
        hub=_hub(plane, outline),
    )


def tetrahedron_volumes(nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.float64]:
    """Volumes of tetrahedra [m^3], shape (t,), without sign."""
    return np.abs(_signed_volumes(nodes, tetrahedra))


def _signed_volumes(nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c, d = (nodes[:, tetrahedra[k]] for k in range(4))
    return np.einsum("ij,ij->j", np.cross(b - a, c - a, axis=0), d - a) / 6.0


def _positive(nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    swapped = tetrahedra[[1, 0, 2, 3]]
    return np.where(_signed_volumes(nodes, tetrahedra) > 0.0, tetrahedra, swapped)


def _tetrahedra(plane: Triangulation, layer_count: int, mirrored: bool) -> NDArray[np.int64]:
    """Three tetrahedra in each prism; the diagonals of its sides climb towards the higher place in the row."""
    count = len(plane.points)
    v0, v1, v2 = plane.triangles.T
    parts = []
    for layer in range(layer_count - 1):
        # Layers alternate, so that two of them are their own mirror image.
        below, above = layer * count, (layer + 1) * count
        if (layer % 2 == 1) != mirrored:
            below, above = above, below
        parts += [
            np.array([v0 + below, v1 + below, v2 + below, v2 + above]),
            np.array([v0 + below, v1 + below, v2 + above, v1 + above]),
            np.array([v0 + below, v1 + above, v2 + above, v0 + above]),
        ]
    return np.concatenate(parts, axis=1)


def _surface(plane: Triangulation, layer_count: int) -> NDArray[np.int64]:
    count = len(plane.points)
    top_layer = (layer_count - 1) * count
    counter_clockwise = (signed_areas(plane.points, plane.triangles) > 0.0)[:, None]
    up = np.where(counter_clockwise, plane.triangles, plane.triangles[:, ::-1])
    parts = [up[:, ::-1], up + top_layer]
    a, b = plane.boundary.T
    a_first = plane.orbit[a] < plane.orbit[b]
    for layer in range(layer_count - 1):
        below, above = layer * count, (layer + 1) * count
        # The diagonal starts below at the end with the smaller orbit number: the same on every copy of the wedge.
        parts += [
            np.where(a_first, [a + below, b + below, b + above], [a + below, b + below, a + above]).T,
            np.where(a_first, [a + below, b + above, a + above], [b + below, b + above, a + above]).T,
        ]
    return np.concatenate(parts).T


def _springs(
    nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The edges of the tetrahedra, shape (2, s), and the volume [m^3] of the tetrahedra around each."""
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    edges = np.sort(np.concatenate([tetrahedra[[i, j]] for i, j in pairs], axis=1), axis=0)
    springs, index = np.unique(edges, axis=1, return_inverse=True)
    return springs, _sums(index.reshape(6, -1), tetrahedron_volumes(nodes, tetrahedra), springs.shape[1])


def _sums(corners: NDArray[np.int64], shares: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """What each of `count` things gets when every column of `corners` (k, m) gives its `shares` (m,) to each row's."""
    total = np.zeros(count)
    np.add.at(total, corners, np.broadcast_to(shares, corners.shape))
    return total


def _face_areas(nodes: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = (nodes[:, faces[k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a, axis=0), axis=0)


def _adjacent_faces(
    springs: NDArray[np.int64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each spring the two faces that share it; for the second diagonal of a side, the two faces it crosses."""
    around: dict[tuple[int, int], list[int]] = {}
    for f, (i, j, k) in enumerate(faces.T):
        for a, b in ((i, j), (j, k), (k, i)):
            around.setdefault((min(a, b), max(a, b)), []).append(f)
    for pair in [p for p in around.values() if len(p) == 2]:
        corners = set(faces[:, pair[0]]) ^ set(faces[:, pair[1]])
        if len(corners) == 2:
            around.setdefault((min(corners), max(corners)), pair)
    adjacent = np.zeros((2, springs.shape[1]), dtype=np.int64)
    weights = np.zeros((2, springs.shape[1]))
    for s, (i, j) in enumerate(springs.T):
        found = around.get((i, j), [])
        if len(found) == 2:
            adjacent[:, s], weights[:, s] = found, 0.5
    return adjacent, weights


def _column_weights(plane: Triangulation, point: NDArray[np.float64], layer_count: int) -> NDArray[np.float64]:
    """Weights, shape (n,), whose mean of nodes is the mid-thickness point above `point` (or its nearest triangle)."""
    corners = plane.points[plane.triangles]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    local = np.linalg.solve(edges, (point - corners[:, 0])[..., None])[..., 0]
    barycentric = np.column_stack([1.0 - local.sum(axis=1), local])
    best = int(np.argmax(np.round(barycentric.min(axis=1), 9)))
    inside = np.clip(barycentric[best], 0.0, None)
    column = np.zeros(len(plane.points))
    column[plane.triangles[best]] = inside / inside.sum()
    return np.tile(column / layer_count, layer_count)


def _hub(plane: Triangulation, outline: Outline) -> NDArray[np.int64]:
    centroid = plane.points[plane.triangles].mean(axis=1)
    distance = np.linalg.norm(centroid, axis=1)
    inner = distance < max(HUB_PART * outline.reach, float(distance.min()) * (1.0 + 1e-6))
    triangles = plane.triangles[inner]
    counter_clockwise = (signed_areas(plane.points, triangles) > 0.0)[:, None]
    return np.where(counter_clockwise, triangles, triangles[:, ::-1]).T
