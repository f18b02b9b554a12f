"""What unit currents on panels do to each other and at points: near by the closed form, far by moments, images summed.

All in units of 1 / (4 pi sigma): potentials [1/m], slopes [1/m^2]. The far formula, which costs little, is computed for
all pairs, kept finite where they are near, and the near pairs are corrected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gelbot.field.images import Box, Image, Images, Tank
from gelbot.field.panel import far_gradient, far_potential, panel_gradient, panel_potential
from gelbot.field.panels import Panels

Floats: TypeAlias = NDArray[np.float64]
Numbers: TypeAlias = NDArray[np.int64]

NEAR = 2.0
"""Two panels are near when their distance is less than this many sums of their radii."""
NEAR_POINT = 6.0
"""A point is near a panel when its distance is less than this many of the panel's radii."""
ORDER = 4
"""Gauss points along each side of a panel, over which near influences are averaged."""
TILE = 1 << 15
"""Pairs that are computed at once: their tables stay in the processor's cache."""
POINTS = 256
"""Points that are computed at once."""
EQUAL = 1e-9
"""Two radii that differ by less than this share are equal."""
AT_ONCE = 1 << 11
"""Near pairs of panels that are computed at once, each at ORDER^2 points."""


def mutual_images(panels: Panels, tank: Tank) -> Images:
    """The images of `panels`, seen at `panels`."""
    box = _box(panels.corners)
    return Images(tank, box, box, slopes=not panels.active.all())


def mutual_potentials(panels: Panels, images: Images) -> Floats:
    """Potential, averaged over panel i, of a unit current on panel j [1/m]: shape (q, q), symmetric (Galerkin)."""
    q, average = panels.count, _Average(panels)

    def near(i: Numbers, j: Numbers, image: Image) -> Floats:
        # The closed form of the larger panel, averaged over the smaller one, on which it varies less. Equals: both.
        ratio = panels.radius[i] / panels.radius[j]
        i, j = np.where(ratio > 1.0, j, i), np.where(ratio > 1.0, i, j)
        values, equal = average(_potential, i, j, image), np.flatnonzero(np.abs(ratio - 1.0) < EQUAL)
        values[equal] = (values[equal] + average(_potential, j[equal], i[equal], image)) / 2.0
        return values

    table = np.zeros((q, q))
    for rows, block in _pairs(panels, np.arange(q), images, far_potential, near, triangle=True):
        table[rows, : block.shape[1]] = block
    for rows in _tiles(q, q):
        table[rows, rows.stop :] = table[rows.stop :, rows].T
    if images.others:
        weights = _averaged_weights(panels, images)
        table += weights.T @ images.kernel @ weights
    return table


def mutual_slopes(panels: Panels, rows: Numbers, images: Images) -> Floats:
    """Slope of the potential along the normals of the panels `rows`, averaged over each, of unit currents; (r, q).

    Across a panel's own charge, where the slope jumps, it is the mean of both sides.
    """
    average, normals = _Average(panels), panels.frame[:, 2, rows]

    def near(i: Numbers, j: Numbers, image: Image) -> Floats:
        return average(_gradient, i, j, image)

    table = np.zeros((len(rows), panels.count))
    for part, block in _pairs(panels, rows, images, far_gradient, near):
        table[part] = np.einsum("apq,ap->pq", block, normals[:, part])
    if images.others:
        slopes = np.einsum("amp,ap->mp", images.point_slopes(panels.centre[:, rows]), normals)
        table += slopes.T @ images.kernel @ _averaged_weights(panels, images)
    return table


def potentials_at(points: Floats, panels: Panels, currents: Floats, tank: Tank) -> Floats:
    """Potentials [A/m] at `points` (3, p) [m] of panel currents (q, e) [A], shape (p, e)."""
    images = Images(tank, _box(panels.corners), _box(points))
    total = _sum_at(points, panels, currents, images, far_potential, _potential)
    if images.others:
        series = images.kernel @ (_averaged_weights(panels, images) @ currents)
        for part in _parts(points.shape[1]):
            total[part] += images.point_weights(points[:, part]).T @ series
    return total


def slopes_at(points: Floats, panels: Panels, currents: Floats, tank: Tank) -> Floats:
    """Gradients of the potentials [A/m^2] at `points` (3, p) [m] of panel currents (q, e) [A], shape (3, p, e)."""
    images = Images(tank, _box(panels.corners), _box(points), slopes=True)
    total = _sum_at(points, panels, currents, images, far_gradient, _gradient)
    if images.others:
        series = images.kernel @ (_averaged_weights(panels, images) @ currents)
        for part in _parts(points.shape[1]):
            total[:, part] += images.point_slopes(points[:, part]).transpose(0, 2, 1) @ series
    return total


def _sum_at(
    points: Floats,
    panels: Panels,
    currents: Floats,
    images: Images,
    far: Callable[..., Floats],
    exact: Callable[..., Floats],
) -> Floats:
    """What near images of all panels do at points, shape (..., p, e)."""
    centres = np.stack([image.of(panels.centre) for image in images.near])
    moments = np.stack([_mirrored(panels.moments, image) for image in images.near])
    least = panels.radius
    parts: list[Floats] = []
    for part in _parts(points.shape[1]):
        some = points[:, part]
        full = np.pad(some, ((0, 0), (0, POINTS - some.shape[1])), mode="edge")  # compiled once, for this length
        parts.append(np.asarray(_far_sum(full, centres, moments, least, currents, far))[..., : some.shape[1], :])
    total = np.concatenate(parts, axis=-2)
    tree = cKDTree(points.T)
    for image, mirrored in zip(images.near, moments, strict=True):
        close = tree.query_ball_point(image.of(panels.centre).T, NEAR_POINT * panels.radius)
        j = np.repeat(np.arange(panels.count), [len(found) for found in close])
        i = np.array([number for found in close for number in found], int)
        for start in range(0, len(i), AT_ONCE * ORDER**2):
            p, q = i[start : start + AT_ONCE * ORDER**2], j[start : start + AT_ONCE * ORDER**2]
            r = points[:, p] - image.of(panels.centre[:, q])
            change = exact(panels, points[:, p], q, image) - far(r, mirrored[:, q], least[q])
            for component, sum_ in zip(change.reshape(-1, len(p)), total.reshape(-1, *total.shape[-2:]), strict=True):
                np.add.at(sum_, p, component[:, None] * currents[q])
    return total


@partial(jax.jit, static_argnames=("far",))
def _far_sum(points: Array, centres: Array, moments: Array, least: Array, currents: Array, far: Any) -> Array:
    """The far formula, summed over images and panels, shape (..., p, e)."""

    def add(total: Array | float, image: tuple[Array, Array]) -> tuple[Array, None]:
        r = [points[k][:, None] - image[0][k] for k in range(3)]
        return total + far(r, image[1], least, jnp), None

    like = jax.eval_shape(lambda: add(0.0, (centres[0], moments[0]))[0])
    return jax.lax.scan(add, jnp.zeros(like.shape, like.dtype), (centres, moments))[0] @ currents


def _pairs(
    panels: Panels,
    rows: Numbers,
    images: Images,
    far: Callable[..., Floats],
    near: Callable[[Numbers, Numbers, Image], Floats],
    triangle: bool = False,
) -> Iterator[tuple[slice, Floats]]:
    """Influences of unit currents on the panels `rows`, some after the other: their part of it, and (..., some, q).

    Near images are summed. With `triangle`, for all panels as `rows`, only currents up to the last of a part count.
    """
    for part in _tiles(len(rows), panels.count):
        targets = rows[part]
        sources = slice(0, part.stop if triangle else panels.count)
        total: Floats | float = 0.0
        for image in images.near:
            r = panels.centre[:, targets, None] - image.of(panels.centre[:, sources])[:, None]
            radii = panels.radius[targets, None] + panels.radius[sources]
            moments = panels.moments[:, targets, None] + _mirrored(panels.moments[:, sources], image)[:, None]
            total = total + far(r, moments, 0.5 * radii)
            square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            i, j = np.nonzero(square < np.square(NEAR * radii))
            if len(i):
                wrong = far(r[:, i, j], moments[:, i, j], 0.5 * radii[i, j])
                total[..., i, j] += near(targets[i], j, image) - wrong
        yield part, np.asarray(total)


def _parts(count: int) -> list[slice]:
    return [slice(start, start + POINTS) for start in range(0, count, POINTS)]


def _tiles(targets: int, sources: int) -> list[slice]:
    count = max(1, TILE // max(1, sources))
    return [slice(start, min(start + count, targets)) for start in range(0, targets, count)]


def _mirrored(moments: Floats, image: Image) -> Floats:
    x, y, z = image.sign
    return moments * np.array([1.0, 1.0, 1.0, x * y, x * z, y * z])[:, None]


class _Average:
    """Averages an influence over panels by Gauss points."""

    def __init__(self, panels: Panels) -> None:
        self.panels = panels
        self.points, self.shares = panels.nodes(ORDER)

    def __call__(self, influence: Callable[..., Floats], i: Numbers, j: Numbers, image: Image) -> Floats:
        """`influence` of unit currents on the panels `j` averaged over the panels `i`, shape (..., pairs)."""
        parts: list[Floats] = []
        for start in range(0, len(i), AT_ONCE):
            to, of = i[start : start + AT_ONCE], j[start : start + AT_ONCE]
            values = influence(self.panels, self.points[:, :, to], of, image)
            parts.append(np.sum(values * self.shares[:, to], axis=-2))
        return np.concatenate(parts, axis=-1) if parts else np.zeros(0)


def _potential(panels: Panels, points: Floats, j: Numbers, image: Image) -> Floats:
    """Closed form at `points` (3, ..., k) of unit currents on the panels `j` (k,), mirrored."""
    return panel_potential(_local(panels, points, j, image), *panels.outline[:, :, j]) / panels.area[j]


def _gradient(panels: Panels, points: Floats, j: Numbers, image: Image) -> Floats:
    """The same for the gradient, shape (3, ..., k)."""
    local = panel_gradient(_local(panels, points, j, image), *panels.outline[:, :, j])
    after = (slice(None),) + (None,) * (points.ndim - 1)
    return image.sign[after] * np.einsum("abk,b...k->a...k", panels.frame[:, :, j], local) / panels.area[j]


def _local(panels: Panels, points: Floats, j: Numbers, image: Image) -> Floats:
    """`points` in the frames of the mirrored panels `j`."""
    offset = image.of(points) - panels.centre[:, j].reshape(3, *(1,) * (points.ndim - 2), -1)
    return np.einsum("abk,a...k->b...k", panels.frame[:, :, j], offset)


def _averaged_weights(panels: Panels, images: Images) -> Floats:
    """Interpolation weights of the panels for what far images do, shape (n, q): R is smooth, four points average it."""
    points, shares = panels.nodes(2)
    total = images.source_weights(points[:, 0]) * shares[0]
    for k in range(1, len(shares)):
        total += images.source_weights(points[:, k]) * shares[k]
    return total


def _box(points: Floats) -> Box:
    flat = points.reshape(3, -1)
    return flat.min(axis=1), flat.max(axis=1)
