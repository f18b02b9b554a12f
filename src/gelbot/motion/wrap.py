"""How far a body lies round a rod: the angle about the rod's axis over which it is against it."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.scenario.obstacle_shapes import CylinderObstacle
from gelbot.scenario.schema import Scenario

NEAR = 1.0
"""A part of the body is against the rod when its middle is no farther from it than half plus this many thicknesses."""


def wrapped(run: xr.Dataset, scenario: Scenario) -> NDArray[np.float64]:
    """The angle [rad] about the axis of the scenario's first cylinder at all frames, shape (k,); NaN without one.

    The body is cut across its length into slices a mesh size long; the angles of the middles of those that lie against
    the rod are followed from slice to slice, so that they add up beyond a whole turn. Of several such stretches the
    longest counts.
    """
    rod = next((o for o in scenario.obstacles if isinstance(o, CylinderObstacle)), None)
    rest = run["rest_position"].transpose("space", "node").values
    x = run["position"].transpose("time", "space", "node").values
    if rod is None:
        return np.full(len(x), np.nan)
    axis = np.array(rod.direction) / np.linalg.norm(rod.direction)
    # Along the body's longest direction at the start.
    flat = rest[:2] - rest[:2].mean(axis=1, keepdims=True)
    along = np.linalg.svd(flat, full_matrices=False)[0][:, 0] @ flat
    slices = max(2, round(float(np.ptp(along)) / scenario.body.mesh_size))
    place = np.minimum(((along - along.min()) / np.ptp(along) * slices).astype(int), slices - 1)
    # Slices without nodes are left out.
    _, place = np.unique(place, return_inverse=True)
    weights = np.eye(place.max() + 1)[place]
    middles = (x - np.array(rod.position)[:, None]) @ (weights / weights.sum(axis=0))
    e1 = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    e1 /= np.linalg.norm(e1)
    u, v = (np.einsum("tis,i->ts", middles, e) for e in (e1, np.cross(axis, e1)))
    beyond = np.abs(np.einsum("tis,i->ts", middles, axis)) > rod.length / 2.0
    against = (np.hypot(u, v) - rod.diameter / 2.0 <= (0.5 + NEAR) * scenario.body.thickness) & ~beyond
    angle = np.unwrap(np.arctan2(v, u), axis=1)
    return np.array([_longest(row, near) for row, near in zip(angle, against, strict=True)])


def _longest(angle: NDArray[np.float64], near: NDArray[np.bool_]) -> float:
    """The largest angle between the ends of a stretch of slices that are all `near`."""
    ends = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    return max((abs(float(angle[b - 1] - angle[a])) for a, b in ends.reshape(-1, 2)), default=0.0)
