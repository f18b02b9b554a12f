"""Electrodes: what shape they have, where they stand, and which way they face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Rectangle:
    """A thin rectangular plate in its own x-y plane; `size` [m] along x and y."""

    size: tuple[float, float]


@dataclass(frozen=True)
class Disc:
    """A thin round plate in its own x-y plane; `diameter` [m]."""

    diameter: float


@dataclass(frozen=True)
class Ring:
    """A thin flat ring in its own x-y plane; `diameter` and `inner_diameter` [m]."""

    diameter: float
    inner_diameter: float


@dataclass(frozen=True)
class Rod:
    """A rod or wire along its own z axis, its ends flat and conducting; `diameter`, `length` [m]."""

    diameter: float
    length: float


@dataclass(frozen=True)
class Block:
    """A cuboid; `size` [m] along its own x, y and z."""

    size: tuple[float, float, float]


Shape: TypeAlias = Rectangle | Disc | Ring | Rod | Block

THIN = (Rectangle, Disc, Ring)
"""Shapes without a thickness: they conduct on both sides, unless they have a backing."""


@dataclass(frozen=True, eq=False)
class Electrode:
    """One electrode: its `shape`, the place of its middle, `centre` [m], shape (3,), and how it is turned.

    The columns of `frame`, shape (3, 3), are the shape's own x, y and z axes in the tank's frame. A thin shape with a
    `backing` [m] conducts on one side only, that to which its own z axis points; the other side and the rim of that
    thickness are insulated. `name` is how messages call it.
    """

    shape: Shape
    centre: NDArray[np.float64]
    frame: NDArray[np.float64]
    backing: float = 0.0
    name: str = ""

    @property
    def ends(self) -> tuple[float, float]:
        """From where to where the electrode reaches along its own z axis, its backing included [m]."""
        match self.shape:
            case Rod(length=length) | Block(size=(_, _, length)):
                return -length / 2.0, length / 2.0
            case _:
                return -self.backing, 0.0

    @cached_property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The lowest and the highest x, y, z of the electrode, its backing included [m], shape (3,) each."""
        x, y, z = self.frame.T
        a, b = breadth(self.shape)
        straight = isinstance(self.shape, Rectangle | Block)
        # Across its own z axis a rectangle reaches as far as its corners, a circle equally far to all sides.
        across = (np.abs(x) * a + np.abs(y) * b if straight else np.hypot(x, y) * a) / 2.0
        along = np.outer(self.ends, z)
        return self.centre + along.min(axis=0) - across, self.centre + along.max(axis=0) + across


def breadth(shape: Shape) -> tuple[float, float]:
    """How far a shape reaches along its own x and y axes, edge to edge [m]."""
    match shape:
        case Rectangle(size=(a, b)) | Block(size=(a, b, _)):
            return a, b
        case Disc(diameter=d) | Ring(diameter=d) | Rod(diameter=d):
            return d, d


@dataclass(frozen=True, eq=False)
class ElectrodeArray:
    """All electrodes of a tank, numbered from 0 in this order."""

    electrodes: tuple[Electrode, ...]

    @property
    def count(self) -> int:
        return len(self.electrodes)

    @cached_property
    def centres(self) -> NDArray[np.float64]:
        """Middles of the electrodes [m], shape (3, e)."""
        return np.stack([electrode.centre for electrode in self.electrodes], axis=1)

    @cached_property
    def pitch(self) -> float:
        """Smallest distance between the middles of two electrodes seen from above [m]; infinite where there is one."""
        x = self.centres[:2]
        distance = np.linalg.norm(x[:, :, None] - x[:, None, :], axis=0)
        apart = distance[distance > 1e-9]
        return float(apart.min()) if len(apart) else float("inf")


DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""The frame of a plate that faces the gel below it."""


def frame_of(axis: Sequence[float], turn: float = 0.0) -> NDArray[np.float64]:
    """The frame, shape (3, 3), of an electrode whose own z axis points along `axis`, which need not have length one.

    Its own x axis lies as nearly as it can along the tank's x, or the tank's y where `axis` itself is within 25 deg of
    x; so an upright plate has its own x axis horizontal. `turn` [rad] then turns it about `axis`, right-handed.
    """
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    reference = np.array([0.0, 1.0, 0.0]) if abs(z[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    x = reference - (reference @ z) * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    return np.stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x, z], axis=1)


def rectangular_array(
    shape: Shape, rows: int, columns: int, pitch: tuple[float, float], height: float, backing: float = 0.0
) -> ElectrodeArray:
    """Equal electrodes that face down in rows and columns about the z axis, their lowest points at `height` [m].

    `pitch` [m] from middle to middle in x and y. Numbers run along a row (x) first, then from row to row (y).
    """
    x = (np.arange(columns) - (columns - 1) / 2.0) * pitch[0]
    y = (np.arange(rows) - (rows - 1) / 2.0) * pitch[1]
    return _facing_down(shape, [(a, b) for b in y for a in x], height, backing)


def hexagonal_array(
    shape: Shape, rows: int, columns: int, pitch: float, height: float, backing: float = 0.0
) -> ElectrodeArray:
    """The same in a triangular grid of one `pitch` [m]: every second row is shifted by half of it.

    The first row is shifted to smaller x. Every inner electrode has six neighbours.
    """
    x = (np.arange(columns) - (columns - 1) / 2.0) * pitch
    y = (np.arange(rows) - (rows - 1) / 2.0) * pitch * np.sqrt(3.0) / 2.0
    shift = 0.0 if rows == 1 else pitch / 4.0
    places = [(a - shift if row % 2 == 0 else a + shift, b) for row, b in enumerate(y) for a in x]
    return _facing_down(shape, places, height, backing)


def square_array(rows: int, columns: int, side: float, space: float, height: float) -> ElectrodeArray:
    """The matrix of electrodes of Fig. 3: square plates of `side` [m] with `space` [m] between them."""
    return rectangular_array(Rectangle((side, side)), rows, columns, (side + space, side + space), height)


def _facing_down(shape: Shape, places: Sequence[tuple[float, float]], height: float, backing: float) -> ElectrodeArray:
    lift = -float(Electrode(shape, np.zeros(3), DOWN, backing).bounds[0][2])
    return ElectrodeArray(
        tuple(
            Electrode(shape, np.array([x, y, height + lift]), DOWN, backing, f"electrode {n}")
            for n, (x, y) in enumerate(places)
        )
    )
