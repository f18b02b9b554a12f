"""Electrodes: thin square plates in one plane above the gel, cut into panels that carry the charges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ElectrodeArray:
    """Square plates of one size in the plane z = `height` [m], all conducting on both sides.

    `centres` [m], shape (2, e): electrode numbers run along a row (x) first, then from row to row (y). `side` [m].
    """

    centres: NDArray[np.float64]
    side: float
    height: float
    rows: int
    columns: int

    @property
    def count(self) -> int:
        return self.centres.shape[1]

    @property
    def pitch(self) -> float:
        """Distance between neighbouring centres [m]; the side where there is one electrode only."""
        if self.count < 2:
            return self.side
        gaps = np.linalg.norm(self.centres[:, 1:] - self.centres[:, :1], axis=0)
        return float(gaps.min())


def square_array(rows: int, columns: int, side: float, space: float, height: float) -> ElectrodeArray:
    """The matrix of electrodes of Fig. 3, centred on the z axis: `side` [m], `space` [m] between plates."""
    pitch = side + space
    x = (np.arange(columns) - (columns - 1) / 2.0) * pitch
    y = (np.arange(rows) - (rows - 1) / 2.0) * pitch
    centres = np.array([g.ravel() for g in np.meshgrid(x, y)], dtype=np.float64)
    return ElectrodeArray(centres, side, height, rows, columns)


@dataclass(frozen=True)
class Panels:
    """Square panels of side `side` [m]: `centres` [m], shape (3, q); `electrode`, shape (q,), says whose they are."""

    centres: NDArray[np.float64]
    side: float
    electrode: NDArray[np.int64]


def panels_of(array: ElectrodeArray, per_side: int) -> Panels:
    """Cut every plate into `per_side` x `per_side` equal panels."""
    offset = ((np.arange(per_side) + 0.5) / per_side - 0.5) * array.side
    dx, dy = (g.ravel() for g in np.meshgrid(offset, offset))
    x = (array.centres[0][:, None] + dx).ravel()
    y = (array.centres[1][:, None] + dy).ravel()
    owner = np.repeat(np.arange(array.count), per_side**2)
    return Panels(np.stack([x, y, np.full(x.shape, array.height)]), array.side / per_side, owner)
