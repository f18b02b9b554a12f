"""The tips of an outline: where it reaches out furthest, and how broad it is there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gelbot.body.outline import Outline
from gelbot.body.symmetry import SymmetryGroup

LEAST = 1e-6
"""A point that reaches out further than what lies around it by more than this share of the reach is no rounding."""
APART, NOTCH = 0.5, 0.05
"""Shares of the reach: two corners so far apart are two tips, and so are two with a notch so deep between them."""


class Tips(NamedTuple):
    """Tips of a body: `points` [m], shape (a, 2), and `widths` [m], (a,): from corner to corner of a blunt one."""

    points: NDArray[np.float64]
    widths: NDArray[np.float64]


def tips_of(outline: Outline, prominence: float = LEAST) -> Tips:
    """The tips of `outline`, counter-clockwise from its +x.

    A tip reaches out further than what lies around it by `prominence` times the outline's reach. A blunt tip has two
    corners, or more where it was drawn by hand: it lies in their middle. A corner that is less prominent is no tip of
    its own, and belongs to one only where it reaches out as far, to the same tolerance.
    """
    ring = outline.polygon.exterior
    places = np.linspace(0.0, 1.0, 2000, endpoint=False)
    samples = shapely.get_coordinates(shapely.line_interpolate_point(ring, places, normalized=True))
    samples = np.concatenate([outline.points, samples])
    samples = samples[np.argsort(shapely.line_locate_point(ring, shapely.points(samples)), kind="stable")]
    radius = np.linalg.norm(samples, axis=1)
    start = int(np.argmin(radius))
    samples, radius = np.roll(samples, -start, axis=0), np.roll(radius, -start)
    peaks, found = find_peaks(radius, prominence=LEAST * outline.reach)
    is_main = found["prominences"] >= prominence * outline.reach

    def is_one(peak: int, other: int) -> bool:
        """Whether two corners belong to one tip. The array begins in the deepest notch: no tip lies across its ends."""
        low, high = min(peak, other), max(peak, other)
        falls_back = min(radius[peak], radius[other]) - radius[low : high + 1].min() > NOTCH * outline.reach
        return not falls_back and bool(np.linalg.norm(samples[peak] - samples[other]) < APART * outline.reach)

    groups: list[list[int]] = []
    for main in (True, False):
        for peak in peaks[is_main == main]:
            near = [group for group in groups if is_one(group[0], peak)]
            if near and (main or radius[peak] >= radius[near[0][0]] - prominence * outline.reach):
                near[0].append(peak)
            elif main:
                groups.append([peak])
    if not groups:
        return Tips(outline.points[:1], np.zeros(1))
    corners = [samples[group] for group in groups]
    points = np.array([c.mean(axis=0) for c in corners])
    widths = np.array([np.linalg.norm(c[:, None] - c[None], axis=-1).max() for c in corners])
    order = np.argsort(np.round((np.arctan2(points[:, 1], points[:, 0]) + 1e-9) % (2.0 * np.pi), 8))
    return Tips(points[order], widths[order])


def symmetrised(tips: Tips, group: SymmetryGroup, slack: float) -> Tips:
    """The tips that `group` carries exactly into each other and that are `tips` but for `slack` [m].

    Every operation is done on every tip; images no further apart than `slack` are one tip, in their middle. They keep
    the order of `tips`.
    """
    operations = group.operations()
    images = np.concatenate([tips.points @ matrix.T for matrix in operations])
    pairs = cKDTree(images).query_pairs(slack + LEAST * float(np.abs(images).max()), output_type="ndarray")
    near = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(images), len(images)))
    count, label = connected_components(near, directed=False)
    order = np.argsort([np.argmax(label == k) for k in range(count)])
    widths = np.tile(tips.widths, len(operations))
    return Tips(
        np.array([images[label == k].mean(axis=0) for k in order]),
        np.array([widths[label == k].mean() for k in order]),
    )
