"""Triangulations of an outline that carry its symmetry exactly: one fundamental wedge is meshed and copied.

Without this the mesh, not the physics, decides to which side a body topples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from gelbot.body.outline import Outline
from gelbot.body.symmetry import SymmetryGroup, symmetry_group
from gelbot.errors import BadInput

SMOOTHING_SWEEPS = 30


@dataclass(frozen=True)
class Triangulation:
    """A planar mesh.

    `points` [m], shape (p, 2). `triangles`, shape (m, 3): indices whose *order within a row* is the same for every copy
    of the wedge (it is not the orientation), so that a rule which uses the order keeps the symmetry.
    `boundary`, shape (b, 2): edges of the outline, counter-clockwise. `orbit`, shape (p,): points that the group
    carries into each other have the same number.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    boundary: NDArray[np.int64]
    orbit: NDArray[np.int64]
    group: SymmetryGroup


def triangulate(outline: Outline, mesh_size: float, where: str = "body.mesh_size") -> Triangulation:
    """Triangulate `outline` with edges of about `mesh_size` [m], carrying its symmetry group exactly.

    Raises `BadInput` when the mesh size is too coarse to resolve the outline.
    """
    group = symmetry_group(outline)
    wedge, rays = _fundamental_wedge(outline, group)
    points, triangles = _mesh_polygon(wedge, rays, mesh_size, where)

    operations = group.operations()
    copies = np.concatenate([points @ g.T for g in operations])
    count = len(points)
    merged, representative = _merge(copies, 1e-4 * mesh_size)
    # Points of one wedge that coincide with copies of each other (the two seams of a cyclic group) share an orbit.
    orbit_of_wedge_point, orbit = np.arange(count), np.full(len(merged), count)
    for _ in range(2):
        np.minimum.at(orbit, representative, np.tile(orbit_of_wedge_point, len(operations)))
        orbit_of_wedge_point = orbit[representative[:count]]

    rank = np.lexsort((np.arange(count), orbit_of_wedge_point)).argsort()
    ordered = np.take_along_axis(triangles, np.argsort(rank[triangles], axis=1), axis=1)
    all_triangles = np.concatenate([representative[ordered + k * count] for k in range(len(operations))])

    mesh = Triangulation(merged, all_triangles, _boundary_edges(merged, all_triangles), orbit, group)
    area = float(np.abs(signed_areas(merged, all_triangles)).sum())
    if abs(area - outline.area) > 1e-6 * outline.area:
        raise BadInput(
            where,
            f"{mesh_size * 1e3:.4g} mm",
            "a mesh size that resolves the outline's narrowest part",
            f"{mesh_size * 5e2:.4g} mm",
        )
    return mesh


def signed_areas(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Signed areas of triangles [m^2], shape (m,): positive where the row is counter-clockwise."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _fundamental_wedge(
    outline: Outline, group: SymmetryGroup
) -> tuple[shapely.Polygon | shapely.MultiPolygon, list[float]]:
    """The part of the outline of which all the rest are copies, and the directions [rad] of the rays that cut it."""
    if group.order == 1:
        return outline.polygon, []
    if group.mirror_angle is not None:
        first, opening = group.mirror_angle, np.pi / group.rotation_count
    else:
        # Cut through a corner, where a ray meets the outline in a point that the outline has anyway.
        corner = outline.points[np.argmax(np.linalg.norm(outline.points, axis=1))]
        first, opening = float(np.arctan2(corner[1], corner[0])), 2.0 * np.pi / group.rotation_count
    fan = first + np.linspace(0.0, opening, 9)
    far = 4.0 * outline.reach
    sector = shapely.Polygon([(0.0, 0.0), *[(far * np.cos(a), far * np.sin(a)) for a in fan]])
    part = outline.polygon.intersection(sector)
    if not isinstance(part, shapely.Polygon):
        pieces = [g for g in getattr(part, "geoms", []) if isinstance(g, shapely.Polygon)]
        part = pieces[0] if len(pieces) == 1 else shapely.MultiPolygon(pieces)
    return part, [first, first + opening]


def _mesh_polygon(
    region: shapely.Polygon | shapely.MultiPolygon, rays: list[float], mesh_size: float, where: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Mesh a region: points on its boundary, a hexagonal lattice inside, Delaunay, and Laplacian smoothing."""
    polygons = list(region.geoms) if isinstance(region, shapely.MultiPolygon) else [region]
    rim = np.concatenate([_divided_ring(p, rays, mesh_size) for p in polygons])
    rim = rim[np.sort(np.unique(np.round(rim / (1e-6 * mesh_size)), axis=0, return_index=True)[1])]
    inside = _lattice(region, rays[0] if rays else 0.0, mesh_size)
    points = np.concatenate([rim, inside])
    free = np.arange(len(points)) >= len(rim)
    triangles = _delaunay_inside(points, region)
    for _ in range(SMOOTHING_SWEEPS if len(inside) else 0):
        total, degree = np.zeros_like(points), np.zeros(len(points))
        for a, b in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
            np.add.at(total, triangles[:, a], points[triangles[:, b]])
            np.add.at(degree, triangles[:, a], 1.0)
        moved = total / np.maximum(degree, 1.0)[:, None]
        points = np.where((free & (degree > 0))[:, None], moved, points)
        triangles = _delaunay_inside(points, region)
    if len(triangles) == 0:
        raise BadInput(where, f"{mesh_size * 1e3:.4g} mm", "a mesh size smaller than the body")
    used = np.unique(triangles)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    return points[used], renumber[triangles]


def _divided_ring(polygon: shapely.Polygon, rays: list[float], mesh_size: float) -> NDArray[np.float64]:
    """Points along a polygon's boundary at about `mesh_size`, exactly on the cutting rays where they belong there."""
    corners = np.asarray(polygon.exterior.coords)[:-1]
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    turning = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    corners = corners[turning > 1e-9 * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)]
    points = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        # The small bias makes equal seams divide equally in spite of rounding.
        pieces = max(1, round(float(np.linalg.norm(end - start)) / mesh_size - 1e-6))
        points += [start + (end - start) * k / pieces for k in range(pieces)]
    ring = np.array(points)
    for angle in rays:
        along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        on_ray = (np.abs(ring @ across) < 1e-7 * mesh_size) & (ring @ along > -1e-7 * mesh_size)
        ring = np.where(on_ray[:, None], np.outer(ring @ along, along), ring)
    return ring


def _lattice(region: shapely.Polygon | shapely.MultiPolygon, angle: float, mesh_size: float) -> NDArray[np.float64]:
    """Hexagonal lattice points inside `region`, rows along `angle` [rad], kept half a mesh size off its boundary."""
    reach = float(np.hypot(*np.max(np.abs(np.reshape(region.bounds, (2, 2))), axis=0)))
    rows = np.arange(-int(reach / mesh_size) * 2, int(reach / mesh_size) * 2 + 1)
    i, j = np.meshgrid(rows, rows)
    local = np.stack([(i + 0.5 * j).ravel(), (np.sqrt(3.0) / 2.0 * j).ravel()], axis=1) * mesh_size
    points = local @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    core = region.buffer(-0.55 * mesh_size)
    return points[shapely.contains_xy(core, points[:, 0], points[:, 1])]


def _delaunay_inside(points: NDArray[np.float64], region: shapely.Polygon | shapely.MultiPolygon) -> NDArray[np.int64]:
    """Delaunay triangles whose centroid lies inside `region` and which are not slivers."""
    triangles = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    centroid = points[triangles].mean(axis=1)
    edge = np.linalg.norm(points[triangles] - points[np.roll(triangles, 1, axis=1)], axis=-1).max(axis=1)
    solid = np.abs(signed_areas(points, triangles)) > 1e-6 * edge**2
    return triangles[solid & shapely.contains_xy(region, centroid[:, 0], centroid[:, 1])]


def _merge(points: NDArray[np.float64], distance: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Unite points closer than `distance`; returns the united points and for each input the index of its union."""
    first = np.arange(len(points))
    for a, b in sorted(cKDTree(points).query_pairs(distance)):
        first[b] = min(first[b], first[a])
    kept, index = np.unique(first, return_inverse=True)
    return points[kept], index


def _boundary_edges(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Edges that belong to one triangle only, directed so that the inside lies to their left."""
    ccw = np.where((signed_areas(points, triangles) > 0.0)[:, None], triangles, triangles[:, ::-1])
    edges = np.concatenate([ccw[:, [0, 1]], ccw[:, [1, 2]], ccw[:, [2, 0]]])
    _, inverse, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    return edges[count[inverse] == 1]
