"""The symmetry group of an outline: the rotations and reflections about its centroid that carry it into itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelbot.body.outline import Outline


@dataclass(frozen=True)
class SymmetryGroup:
    """A cyclic group (no mirrors) or a dihedral group (as many mirrors as rotations).

    `rotation_count`: rotations, the identity included. `mirror_angle` [rad]: the direction of one mirror line, or None.
    """

    rotation_count: int
    mirror_angle: float | None

    @property
    def order(self) -> int:
        return self.rotation_count * (1 if self.mirror_angle is None else 2)

    @property
    def mirror_angles(self) -> NDArray[np.float64]:
        """Directions of all mirror lines [rad], in [0, pi)."""
        if self.mirror_angle is None:
            return np.zeros(0)
        return np.sort((self.mirror_angle + np.arange(self.rotation_count) * np.pi / self.rotation_count) % np.pi)

    def operations(self) -> NDArray[np.float64]:
        """All operations as matrices, shape (order, 2, 2): the rotations first, the identity at index 0."""
        angles = 2.0 * np.pi * np.arange(self.rotation_count) / self.rotation_count
        matrices = [rotation(a) for a in angles]
        if self.mirror_angle is not None:
            matrices += [rotation(a) @ reflection(self.mirror_angle) for a in angles]
        return np.array(matrices)


def rotation(angle: float) -> NDArray[np.float64]:
    """Rotation by `angle` [rad] about the origin, shape (2, 2)."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def reflection(angle: float) -> NDArray[np.float64]:
    """Reflection in the line through the origin with direction `angle` [rad], shape (2, 2)."""
    return np.array([[np.cos(2 * angle), np.sin(2 * angle)], [np.sin(2 * angle), -np.cos(2 * angle)]])


def symmetry_group(outline: Outline, tolerance: float = 1e-6) -> SymmetryGroup:
    """Find the symmetry group of `outline`; points may miss their image by `tolerance` times the outline's reach.

    The corners of a polygon are carried into corners, so it is enough to try the operations that carry one chosen
    corner into any other.
    """
    points = _corners(outline)
    radii = np.linalg.norm(points, axis=1)
    angles = np.arctan2(points[:, 1], points[:, 0])
    slack = tolerance * outline.reach

    def carries(matrix: NDArray[np.float64]) -> bool:
        image = points @ matrix.T
        distance = np.linalg.norm(image[:, None] - points[None], axis=-1)
        return bool(np.all(distance.min(axis=1) < slack) and np.all(distance.min(axis=0) < slack))

    first = int(np.argmax(radii))
    targets = np.flatnonzero(np.abs(radii - radii[first]) < slack)
    rotations = sum(carries(rotation(float(angles[t] - angles[first]))) for t in targets)
    mirrors = [
        float((angles[t] + angles[first]) / 2.0 % np.pi)
        for t in targets
        if carries(reflection(float((angles[t] + angles[first]) / 2.0)))
    ]
    # A mirror angle just below pi is the line at 0 seen through rounding.
    mirrors = sorted(0.0 if np.pi - m < 1e-9 else m for m in mirrors)
    return SymmetryGroup(rotations, mirrors[0] if mirrors else None)


def _corners(outline: Outline) -> NDArray[np.float64]:
    """The outline's points without those that lie on a straight edge."""
    p = outline.points
    before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
    sine = (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) / (
        np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    )
    corners = p[np.abs(sine) > 1e-9]
    return corners if len(corners) >= 3 else p
