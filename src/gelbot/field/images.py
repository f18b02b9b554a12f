"""Insulating floor, free surface and walls as mirror images: no current crosses a plane of symmetry."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Tank:
    """Insulating boundaries of the solution [m].

    `floor` is the height of the insulating bottom (below z = 0 when the gel lies on a support), `surface` that of the
    free surface or None for a deep tank; `size` holds the inner lengths in x and y, None for a wide tank. `order` is
    the number of reflections kept on each side where two parallel boundaries face each other.
    """

    floor: float | None
    surface: float | None = None
    size: tuple[float, float] | None = None
    order: int = 4


@dataclass(frozen=True)
class Image:
    """One mirror image: a point p goes to `sign` * p + `shift` [m] (each shape (3,)) and counts with `weight`."""

    sign: NDArray[np.float64]
    shift: NDArray[np.float64]
    weight: float


def images(tank: Tank) -> list[Image]:
    """The source itself first, then its images, the nearest reflections before the far ones."""
    half = [None if tank.size is None else s / 2.0 for s in (tank.size or (0.0, 0.0))]
    axes = [
        _reflections(-half[0] if half[0] is not None else None, half[0], tank.order),
        _reflections(-half[1] if half[1] is not None else None, half[1], tank.order),
        _reflections(tank.floor, tank.surface, tank.order),
    ]
    found = [
        (sum(a[3] for a in triple), Image(np.array([a[0] for a in triple]), np.array([a[1] for a in triple]),
                                           float(np.prod([a[2] for a in triple]))))
        for triple in product(*axes)
    ]  # fmt: skip
    return [image for _, image in sorted(found, key=lambda pair: pair[0])]


def _reflections(low: float | None, high: float | None, order: int) -> list[tuple[float, float, float, int]]:
    """(sign, shift, weight, number of reflections) of a coordinate between boundaries at `low` and `high`."""
    if low is None and high is None:
        return [(1.0, 0.0, 1.0, 0)]
    if low is None or high is None:
        plane = high if low is None else low
        assert plane is not None
        return [(1.0, 0.0, 1.0, 0), (-1.0, 2.0 * plane, 1.0, 1)]
    gap, middle = high - low, high + low
    # Half weights at the ends close the sum on whole mirrored cells, which have no dipole: it converges fast.
    return [
        ((1.0, m * gap) if m % 2 == 0 else (-1.0, middle + m * gap)) + (0.5 if abs(m) == order else 1.0, abs(m))
        for m in range(-order, order + 1)
    ]
