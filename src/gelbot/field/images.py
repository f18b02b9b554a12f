"""Insulating floor, free surface and walls as mirror images: no current crosses a plane of symmetry.

A source between two parallel planes has images without end. The nearest are summed one by one; all the others together
are a smooth potential R(x, x'), for which, with 1/r as a sum of Gaussians,

    1/r = 2/sqrt(pi) int_0^inf exp(-t^2 r^2) dt,

    R = 2/sqrt(pi) int_0^alpha [ Theta_x Theta_y Theta_z - near images - constant ] dt,

the sums over images are done axis by axis (Ewald 1921, with any of the six planes absent): Theta_x(x, x'; t) is the sum
of exp(-t^2 (x - image of x')^2) over the images along x, for small t by Poisson's formula. What t > alpha adds is of
near images only: alpha is such that exp(-(alpha L)^2) is below the tolerance for the shortest distance L of two planes.
The constant, which makes the integral finite, acts on nothing, since the currents of all sources sum to zero; in a
closed tank it makes the mean of the potential over the tank zero. R is interpolated between Chebyshev points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Planes: TypeAlias = tuple[float | None, float | None]
Box: TypeAlias = tuple[Floats, Floats]

TOLERANCE = 1e-5
"""Error aimed at, relative to the potential of a source at the shortest distance of two parallel planes."""


SMOOTHNESS = 0.15
"""Images nearer than this share of the width of sources or points are summed one by one,"""
MOST_REFLECTIONS = 3
"""but no more than this many reflections along an axis."""
WIDTH_FOR_SLOPES = 0.1
"""Least width of a box of points, in shortest distances of planes, across which slopes are wanted."""


@dataclass(frozen=True)
class Tank:
    """Insulating boundaries of the solution [m].

    `floor` is the height of the insulating bottom (below z = 0 when the gel lies on a support), `surface` that of the
    free surface or None for a deep tank; `size` holds the inner lengths in x and y, None for a wide tank. `walls` says,
    for a tank with a size, which of its walls stand: at low x, high x, low y, high y; where one is absent the solution
    goes on.
    """

    floor: float | None
    surface: float | None = None
    size: tuple[float, float] | None = None
    walls: tuple[bool, bool, bool, bool] = (True, True, True, True)

    @property
    def planes(self) -> tuple[Planes, Planes, Planes]:
        """The places of the lower and the upper plane along x, y and z [m], None where there is none."""
        if self.size is None:
            return (None, None), (None, None), (self.floor, self.surface)
        x, y = self.size[0] / 2.0, self.size[1] / 2.0
        stands = self.walls
        return (
            (-x if stands[0] else None, x if stands[1] else None),
            (-y if stands[2] else None, y if stands[3] else None),
            (self.floor, self.surface),
        )


@dataclass(frozen=True)
class Image:
    """One mirror image: a point p goes to `sign` * p + `shift` [m], shape (3,) each, and from there back again."""

    sign: Floats
    shift: Floats

    def of(self, points: Floats) -> Floats:
        """The images of `points`, shape (3, ...)."""
        after = (slice(None),) + (None,) * (points.ndim - 1)
        return self.sign[after] * points + self.shift[after]


class Images:
    """All images of sources in one box, seen at points in another; a box is its lowest and highest corner, (3,) [m].

    `near` are to be summed one by one, the source itself first. What the others do together, R, is interpolated:
    between points and sources it is `point_weights(points).T @ kernel @ source_weights(sources)`. `others` is False
    where it is zero. Points in one plane give no slope across it unless `slopes` are asked for.
    """

    def __init__(self, tank: Tank, sources: Box, points: Box, slopes: bool = False) -> None:
        closed = [0.0 if low is None or high is None else high - low for low, high in tank.planes]
        self.others = any(closed)
        # More reflections one by one make a smoother R: worth it for boxes that are wide beside the tank's depth.
        wanted = SMOOTHNESS * max(float(np.max(high - low)) for low, high in (sources, points))
        orders = [min(MOST_REFLECTIONS, max(1, int(np.ceil(wanted / length)))) if length else 1 for length in closed]
        self._shortest = min((o * length for o, length in zip(orders, closed, strict=True) if length), default=np.inf)
        self._axes: list[list[tuple[float, float]]] = []
        for planes, order, source_ends, ends in zip(
            tank.planes, orders, zip(*sources, strict=True), zip(*points, strict=True), strict=True
        ):
            mirrored = _reflections(planes, order)
            self._axes.append([image for image in mirrored if _gap(image, source_ends, ends) < self._shortest])
        axes = self._axes
        self.near = [Image(np.array([a[0] for a in t]), np.array([a[1] for a in t])) for t in product(*axes)]
        if self.others:
            widest = WIDTH_FOR_SLOPES * self._shortest if slopes else 0.0
            self._sources, self._points = (
                [_Chebyshev(low, high, self._shortest, widest) for low, high in zip(*box, strict=True)]
                for box in (sources, points)
            )
            self.kernel = self._tabulate(tank)

    def _tabulate(self, tank: Tank) -> Floats:
        """R between all Chebyshev points of both boxes [1/m], shape (points, sources)."""
        alpha = np.sqrt(-np.log(TOLERANCE)) / self._shortest
        reach = max(
            max(abs(p.high - s.low), abs(s.high - p.low)) for p, s in zip(self._points, self._sources, strict=True)
        )
        times, weights = _times(alpha, max(reach, self._shortest))
        shape = [len(axis.nodes) for axis in (*self._points, *self._sources)]
        along: list[list[Floats]] = [[], [], []]
        constant = 0.0
        for t, weight in zip(times, weights, strict=True):
            mean = weight
            for k, sums in enumerate(along):
                x, source = self._points[k].nodes[:, None], self._sources[k].nodes[None, :]
                everything, near, each = _image_sums(x, source, tank.planes[k], self._axes[k], t)
                sums.append(np.stack([everything, near]).reshape(2, -1))
                mean *= each
            constant += mean
        x, y, z = (np.stack(sums, axis=1) for sums in along)  # (2, times, pairs of nodes)
        x[0] *= weights[:, None]
        x[1] *= -weights[:, None]
        yz = (y[:, :, :, None] * z[:, :, None, :]).reshape(2, len(times), -1)
        total = x[0].T @ yz[0] + x[1].T @ yz[1]
        table = (2.0 / np.sqrt(np.pi)) * (total - constant)
        table = table.reshape(shape[0], shape[3], shape[1], shape[4], shape[2], shape[5]).transpose(0, 2, 4, 1, 3, 5)
        return table.reshape(shape[0] * shape[1] * shape[2], -1)

    def source_weights(self, sources: Floats) -> Floats:
        """Interpolation weights of `sources` (3, q) [m], shape (n, q)."""
        return _product([axis.basis(x) for axis, x in zip(self._sources, sources, strict=True)])

    def point_weights(self, points: Floats) -> Floats:
        """Interpolation weights of `points` (3, p) [m], shape (m, p)."""
        return _product([axis.basis(x) for axis, x in zip(self._points, points, strict=True)])

    def point_slopes(self, points: Floats) -> Floats:
        """Gradients of `point_weights` at `points` [1/m], shape (3, m, p)."""
        values = [axis.basis(x) for axis, x in zip(self._points, points, strict=True)]
        slopes = [axis.slope(x) for axis, x in zip(self._points, points, strict=True)]
        return np.stack([_product([*values[:k], slopes[k], *values[k + 1 :]]) for k in range(3)])


def _product(tables: list[Floats]) -> Floats:
    """Products of one-dimensional weights (n, p) of the three axes, shape (nx * ny * nz, p)."""
    x, y, z = tables
    return (x[:, None, None] * y[None, :, None] * z[None, None, :]).reshape(-1, x.shape[1])


class _Chebyshev:
    """Interpolation from `low` to `high`, at least `least` wide, of functions smooth within `distance` [m]."""

    def __init__(self, low: float, high: float, distance: float, least: float = 0.0) -> None:
        half, middle = max(high - low, least) / 2.0, (low + high) / 2.0
        self.low, self.high = middle - half, middle + half
        self.half = max(half, 1e-3 * distance)
        # The error falls as rho^-n, rho the sum of the half axes of the ellipse that ends at the nearest singularity.
        ratio = distance / self.half
        rho = ratio + np.sqrt(ratio**2 + 1.0)
        count = 1 if half < 1e-9 * distance else int(np.ceil(-np.log(TOLERANCE) / np.log(rho))) + 2
        self._angles = (np.arange(count) + 0.5) * np.pi / count
        self.nodes = middle + self.half * np.cos(self._angles) * (count > 1)
        # From values at the nodes to Chebyshev coefficients.
        self._to_series = 2.0 / count * np.cos(np.outer(np.arange(count), self._angles))
        self._to_series[0] /= 2.0

    def basis(self, x: Floats) -> Floats:
        """Weights of the nodes' values for the value at `x` (p,), shape (n, p)."""
        return self._to_series.T @ np.polynomial.chebyshev.chebvander(self._local(x), len(self.nodes) - 1).T

    def slope(self, x: Floats) -> Floats:
        """Weights of the nodes' values for the derivative at `x` (p,) [1/m], shape (n, p)."""
        if len(self.nodes) == 1:
            return np.zeros((1, len(x)))
        series = np.polynomial.chebyshev.chebder(self._to_series, scl=1.0 / self.half, axis=0)
        return series.T @ np.polynomial.chebyshev.chebvander(self._local(x), len(self.nodes) - 2).T

    def _local(self, x: Floats) -> Floats:
        return (x - (self.low + self.high) / 2.0) / self.half


def _times(alpha: float, reach: float) -> tuple[Floats, Floats]:
    """Nodes and weights [1/m] of the integral over t from 0 to `alpha`, for distances up to `reach` [m]."""
    x, w = np.polynomial.legendre.leggauss(16)
    # What is left below the smallest interval goes as (t reach)^2 and is integrated exactly enough there.
    halvings = max(1, int(np.ceil(np.log2(alpha * reach)))) + 1
    ends = alpha * 0.5 ** np.arange(halvings + 1)
    lows, highs = np.append(ends[1:], 0.0), ends
    middle, half = (highs + lows) / 2.0, (highs - lows) / 2.0
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * w).ravel()


def _reflections(planes: Planes, order: int) -> list[tuple[float, float]]:
    """Sign and shift of a coordinate and its images by up to `order` reflections in the two planes."""
    low, high = planes
    if low is None or high is None:
        return [(1.0, 0.0), *((-1.0, 2.0 * plane) for plane in planes if plane is not None)]
    steps = sorted(range(-order, order + 1), key=abs)
    return [(1.0, m * (high - low)) if m % 2 == 0 else (-1.0, low + high + m * (high - low)) for m in steps]


def _gap(image: tuple[float, float], sources: tuple[float, float], points: tuple[float, float]) -> float:
    """Distance [m] between the image of one interval and another interval."""
    low, high = sorted(image[0] * end + image[1] for end in sources)
    return max(0.0, low - points[1], points[0] - high)


def _image_sums(
    x: Floats, source: Floats, planes: Planes, mirrors: list[tuple[float, float]], t: float
) -> tuple[Floats, Floats, float]:
    """Sums of exp(-t^2 (x - image)^2) along one axis: over all images, over the near ones, and the first's mean."""
    low, high = planes

    def gaussian(image: Floats) -> Floats:
        return np.exp(-np.square(t * (x - image)))

    near = np.zeros(np.broadcast(x, source).shape)
    for sign, shift in mirrors:
        near += gaussian(sign * source + shift)
    everything = np.zeros_like(near)
    if low is None or high is None:
        images = _reflections(planes, 1)
        for sign, shift in images:
            everything += gaussian(sign * source + shift)
        return everything, near, float(len(images))
    length = high - low
    mean = np.sqrt(np.pi) / (length * t)
    if t * length > 1.5:
        count = int(np.ceil(np.sqrt(-np.log(TOLERANCE)) / (t * length))) + 1
        for m in range(-count, count + 1):
            everything += gaussian(source + 2.0 * m * length) + gaussian(2.0 * low - source + 2.0 * m * length)
    else:
        everything += mean
        for n in range(1, 8):
            wave = n * np.pi / length
            damping = np.exp(-np.square(wave / (2.0 * t)))
            everything += 2.0 * mean * damping * np.cos(wave * (x - low)) * np.cos(wave * (source - low))
    return everything, near, mean
