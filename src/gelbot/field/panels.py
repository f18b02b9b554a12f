"""Panels: the surfaces of the electrodes cut into flat quadrilaterals, finer towards their edges.

The charge of a plate grows without bound at its edges, as 1 / sqrt(distance). Panels whose widths grow from an edge as
those of the partition t^GRADING of equal steps resolve it with few: the conductance converges nearly with the third
order in their number along a side instead of the first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gelbot.field.electrodes import Block, Disc, Electrode, ElectrodeArray, Rectangle, Ring, Rod

GRADING = 3.5
"""Power of the partition; above 3 the edges are resolved as well as the middle."""
FEWEST = 4
"""Panels across the shorter side of a shape, at least."""

Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Panels:
    """Flat panels with `corners` [m], shape (3, 4, q), anticlockwise seen from outside.

    `owner`, shape (q,), is the number of the electrode, -1 for a panel of the gel. `contrast`, shape (q,), is NaN where
    the panel conducts and has its electrode's voltage; else it is (sigma - s) / (sigma + s) for a body of conductivity
    s behind the panel: 1 for an insulator.
    """

    corners: Floats
    owner: NDArray[np.int64]
    contrast: Floats

    @property
    def count(self) -> int:
        return len(self.owner)

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """Panels that have a voltage."""
        return np.isnan(self.contrast)

    @cached_property
    def _halves(self) -> tuple[Floats, Floats]:
        """Areas (2, q) [m^2] and centroids (3, 2, q) [m] of the two triangles of each panel."""
        a, b, c, d = (self.corners[:, k] for k in range(4))
        first, second = np.cross(b - a, c - a, axis=0), np.cross(c - a, d - a, axis=0)
        areas = np.stack([np.linalg.norm(v, axis=0) / 2.0 for v in (first, second)])
        return areas, np.stack([(a + b + c) / 3.0, (a + c + d) / 3.0], axis=1)

    @cached_property
    def area(self) -> Floats:
        """Areas [m^2], shape (q,)."""
        return self._halves[0].sum(axis=0)

    @cached_property
    def centre(self) -> Floats:
        """Centroids [m], shape (3, q)."""
        areas, centroids = self._halves
        return (centroids * areas).sum(axis=1) / self.area

    @cached_property
    def radius(self) -> Floats:
        """Largest distance of a corner from the centroid [m], shape (q,)."""
        return np.linalg.norm(self.corners - self.centre[:, None], axis=0).max(axis=0)

    @cached_property
    def frame(self) -> Floats:
        """Unit vectors x, y in each panel's plane and its outward normal, shape (3, 3, q): [component, axis, panel]."""
        a, b, c, d = (self.corners[:, k] for k in range(4))
        normal = np.cross(c - a, d - b, axis=0)
        normal /= np.linalg.norm(normal, axis=0)
        # The longer of two edges gives the direction: a triangle's last edge may have no length.
        one, other = b - a, c - b
        x = np.where(np.linalg.norm(one, axis=0) >= np.linalg.norm(other, axis=0), one, other)
        x /= np.linalg.norm(x, axis=0)
        return np.stack([x, np.cross(normal, x, axis=0), normal], axis=1)

    @cached_property
    def outline(self) -> Floats:
        """Corners in the panel's own frame about its centroid [m], shape (2, 4, q)."""
        return np.einsum("aik,aek->eik", self.corners - self.centre[:, None], self.frame[:, :2])

    @cached_property
    def moments(self) -> Floats:
        """Second moments M [m^2] about the centroid: xx, yy, zz, xy, xz, yz; shape (6, q)."""
        areas, centroids = self._halves
        total = np.zeros((3, 3, self.count))
        for k, triangle in enumerate(((0, 1, 2), (0, 2, 3))):
            # A triangle's moments about any point: area / 12 * (sum of its corners' v v^T + 9 of its centroid).
            v = self.corners[:, triangle] - self.centre[:, None]
            c = centroids[:, k] - self.centre
            total += areas[k] / 12.0 * (np.einsum("aik,bik->abk", v, v) + 9.0 * c[:, None] * c[None, :])
        m = total / self.area
        return np.stack([m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]])

    def nodes(self, order: int) -> tuple[Floats, Floats]:
        """Gauss points [m], shape (3, order^2, q), and their shares of the panel, (order^2, q), which sum to one."""
        t, w = np.polynomial.legendre.leggauss(order)
        u, v = (g.ravel() for g in np.meshgrid((t + 1.0) / 2.0, (t + 1.0) / 2.0))
        shape = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
        points = np.einsum("ip,aiq->apq", shape, self.corners)
        a, b, c, d = (self.corners[:, k] for k in range(4))
        along = (1 - v)[None, :, None] * (b - a)[:, None] + v[None, :, None] * (c - d)[:, None]
        across = (1 - u)[None, :, None] * (d - a)[:, None] + u[None, :, None] * (c - b)[:, None]
        stretch = np.linalg.norm(np.cross(along, across, axis=0), axis=0)
        return points, np.outer(w, w).ravel()[:, None] / 4.0 * stretch / self.area


def panels_of(array: ElectrodeArray, per_side: int) -> Panels:
    """Cut every electrode into panels, `per_side` of them along its longest side."""
    parts = [_electrode_panels(number, electrode, per_side) for number, electrode in enumerate(array.electrodes)]
    return joined(parts)


def joined(parts: list[Panels]) -> Panels:
    """All panels of `parts`, in their order."""
    return Panels(
        np.concatenate([p.corners for p in parts], axis=2),
        np.concatenate([p.owner for p in parts]),
        np.concatenate([p.contrast for p in parts]),
    )


def _electrode_panels(number: int, electrode: Electrode, per_side: int) -> Panels:
    front = SURFACES[type(electrode.shape)](electrode.shape, per_side)
    insulated = (
        np.zeros((3, 4, 0)) if electrode.backing == 0.0 else _backing(front, electrode.backing, max(2, per_side // 2))
    )
    local = np.concatenate([front, insulated], axis=2)
    corners = np.tensordot(electrode.frame, local, 1) + electrode.centre[:, None, None]
    contrast = np.concatenate([np.full(front.shape[2], np.nan), np.ones(insulated.shape[2])])
    return Panels(corners, np.full(corners.shape[2], number), contrast)


def graded(count: int, ends: int = 2) -> Floats:
    """`count` + 1 positions from -1 to 1, closer together towards both ends, or with `ends` = 1 towards 1 only."""
    if ends == 1:
        return 1.0 - 2.0 * (1.0 - np.linspace(0.0, 1.0, count + 1)) ** GRADING
    t = (2.0 * np.arange(count + 1) - count) / count  # antisymmetric to the last digit
    return np.sign(t) * (1.0 - (1.0 - np.abs(t)) ** GRADING)


def _share(per_side: int, length: float, longest: float) -> int:
    """Panels along `length` where `longest` has `per_side`."""
    return max(FEWEST, round(per_side * length / longest))


def _rectangle(shape: Rectangle, per_side: int) -> Floats:
    return _sheet(shape.size, per_side, max(shape.size))


def _sheet(size: tuple[float, float], per_side: int, longest: float) -> Floats:
    """A rectangle in the plane z = 0 about the origin that looks up, shape (3, 4, q)."""
    x, y = (graded(_share(per_side, s, longest)) * s / 2.0 for s in size)
    return _grid(x, y, lambda a, b: (a, b, np.zeros_like(a)))


def _grid(u: Floats, v: Floats, place: Callable[[Floats, Floats], tuple[Floats, ...]]) -> Floats:
    """The quadrilaterals between the lines `u` and `v` of a surface that `place` puts into space, shape (3, 4, q)."""
    a, b = np.meshgrid(u, v, indexing="ij")
    points = np.stack(place(a, b))
    quads = [points[:, :-1, :-1], points[:, 1:, :-1], points[:, 1:, 1:], points[:, :-1, 1:]]
    return np.stack([q.reshape(3, -1) for q in quads], axis=1)


def _annulus(radii: Floats, around: int) -> Floats:
    """A flat ring between ascending `radii`, `around` panels round it; polygons of the same area stand for circles."""
    step = 2.0 * np.pi / around
    wider = np.sqrt(step / np.sin(step))
    angles = np.linspace(0.0, 2.0 * np.pi, around + 1)
    return _grid(radii * wider, angles, lambda r, phi: (r * np.cos(phi), r * np.sin(phi), np.zeros_like(r)))


def _disc(shape: Disc, per_side: int) -> Floats:
    rings = max(FEWEST // 2, round(per_side / 2))
    return _annulus((graded(rings, 1) + 1.0) / 2.0 * shape.diameter / 2.0, 2 * per_side)


def _ring(shape: Ring, per_side: int) -> Floats:
    inner, outer = shape.inner_diameter / 2.0, shape.diameter / 2.0
    rings = _share(per_side, outer - inner, shape.diameter)
    return _annulus(inner + (graded(rings) + 1.0) / 2.0 * (outer - inner), 2 * per_side)


def _rod(shape: Rod, per_side: int) -> Floats:
    radius, half = shape.diameter / 2.0, shape.length / 2.0
    around = max(8, _share(per_side, shape.diameter, max(shape.diameter, shape.length)) * 2)
    step = 2.0 * np.pi / around
    wider = radius * np.sqrt(step / np.sin(step))
    heights = graded(_share(per_side, shape.length, max(shape.diameter, shape.length))) * half
    angles = np.linspace(0.0, 2.0 * np.pi, around + 1)
    side = _grid(angles, heights, lambda phi, z: (wider * np.cos(phi), wider * np.sin(phi), z))
    top = _annulus((graded(FEWEST // 2, 1) + 1.0) / 2.0 * radius, around)
    return np.concatenate([side, *_ends(top, half)], axis=2)


def _ends(top: Floats, half: float) -> list[Floats]:
    """A surface in z = 0 that looks up as the upper end of a body, and its mirror image as the lower one."""
    up = np.array([0.0, 0.0, half])[:, None, None]
    return [top + up, top[:, ::-1] - up]


def _block(shape: Block, per_side: int) -> Floats:
    longest = max(shape.size)
    faces: list[Floats] = []
    for axis in range(3):
        others = (axis + 1) % 3, (axis + 2) % 3
        sheet = _sheet((shape.size[others[0]], shape.size[others[1]]), per_side, longest)
        for face in _ends(sheet, shape.size[axis] / 2.0):
            turned = np.empty_like(face)
            turned[others[0]], turned[others[1]], turned[axis] = face
            faces.append(turned)
    return np.concatenate(faces, axis=2)


SURFACES: dict[type, Callable[..., Floats]] = {
    Rectangle: _rectangle,
    Disc: _disc,
    Ring: _ring,
    Rod: _rod,
    Block: _block,
}


def _backing(front: Floats, thickness: float, rim_panels: int) -> Floats:
    """The insulated back and rim of a plate whose `front` lies in z = 0 and looks up, `rim_panels` across the rim.

    They are graded towards the front: where it ends the charge goes as distance^(-2/3), stronger than at a free edge.
    """
    down = np.array([0.0, 0.0, -thickness])[:, None, None]
    heights = (graded(rim_panels, 1) - 1.0) / 2.0 * thickness
    points, numbers = np.unique(np.round(front.transpose(1, 2, 0).reshape(-1, 3), 12), axis=0, return_inverse=True)
    corner = numbers.reshape(4, -1)
    edges = Counter(
        (int(a), int(b)) for k in range(4) for a, b in zip(corner[k], corner[(k + 1) % 4], strict=True) if a != b
    )
    rim = [edge for edge in edges if edge[::-1] not in edges]
    strips = []
    for a, b in rim:
        p, q = points[a], points[b]
        for low, high in pairwise(heights):
            lift = np.array([[0.0, 0.0, low], [0.0, 0.0, high]])
            strips.append(np.stack([p + lift[0], q + lift[0], q + lift[1], p + lift[1]]))
    return np.concatenate([front[:, ::-1] + down, np.stack(strips).transpose(2, 1, 0)], axis=2)
