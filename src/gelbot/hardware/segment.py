"""The silhouette of the gel in a picture: which pixels it covers, and where exactly it ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.hardware.open_cv import cv2_of

Floats = NDArray[np.float64]
Pixels = NDArray[np.uint8]
Box = tuple[int, int, int, int]

LEAST_CONTRAST = 0.08
"""A pixel that is less darker or lighter than the tank, as a share, is no gel."""
NOISE_FACTOR = 6.0
"""Nor is one that stands out by less than so many standard deviations of the noise."""
SMOOTHING = 1.0
"""Standard deviation [px] with which noise is smoothed before the edge is sought."""
REACH, STEP = 2.0, 0.5
"""How far [px] from the edge of the mask, and in which steps, the exact edge is sought."""
LEAST_HOLE = 25.0
"""Area [px^2] below which a hole is a speck."""


class Silhouette(NamedTuple):
    """What is seen of the gel.

    `mask` (h, w) of the part of the picture that begins at pixel `corner` (x, y); `edge` [px] (2, m): points of its
    outline in the whole picture, about a pixel apart, holes included; `outward` (2, m): unit normals there, away from
    the gel; `area` [px^2]; `box`: the pixels x0, y0, x1, y1 that it lies in; `is_cut`: it reaches the picture's border.
    """

    mask: Pixels
    corner: tuple[int, int]
    edge: Floats
    outward: Floats
    area: float
    box: Box
    is_cut: bool


def background_of(picture: Pixels) -> NDArray[np.float32]:
    """The tank without the gel, guessed from a `picture` (h, w) with it: brightness of rows times that of columns.

    Right where the light changes along rows and columns and the gel takes less than half of each. A picture of the
    empty tank is better.
    """
    grey = np.maximum(picture.astype(np.float32), 1.0)
    rows = np.median(grey, axis=1)
    columns = np.median(grey / rows[:, None], axis=0)
    rows = np.median(grey / columns[None, :], axis=1)
    return cv2_of("a camera").GaussianBlur(rows[:, None] * columns[None, :], (0, 0), SMOOTHING)


def mean_picture(pictures: list[Pixels]) -> NDArray[np.float32]:
    """The mean of pictures of the empty tank: a background with less noise than one of them."""
    return np.mean(np.stack([p.astype(np.float32) for p in pictures]), axis=0).astype(np.float32)


def silhouette(
    picture: Pixels, background: NDArray[np.float32], region: Box | None = None, near: Floats | None = None
) -> Silhouette | None:
    """The gel in a grey `picture` (h, w) before `background` (h, w), inside `region` (x0, y0, x1, y1), or None.

    The largest connected patch that differs from the background, or the one that lies closest around the pixel `near`
    (2,) of those at least half as large. Its edge is where half of its contrast is reached.
    """
    cv2 = cv2_of("a camera")
    height, width = picture.shape
    x0, y0, x1, y1 = (0, 0, width, height) if region is None else region
    part = picture[y0:y1, x0:x1].astype(np.float32)
    ratio = cv2.GaussianBlur(part / np.maximum(background[y0:y1, x0:x1], 1.0), (0, 0), SMOOTHING)
    coarse = ratio[::4, ::4]
    usual = float(np.median(coarse))
    contrast = np.abs(ratio / max(usual, 1e-3) - 1.0)
    noise = 1.5 * float(np.median(np.abs(coarse / max(usual, 1e-3) - 1.0)))
    least = max(LEAST_CONTRAST, NOISE_FACTOR * noise)
    first = contrast > least
    if np.count_nonzero(first) < 30:
        return None
    level = max(least, 0.5 * float(np.median(contrast[first])))
    mask = (contrast > level).astype(np.uint8)
    count, labels, stats, middles = cv2.connectedComponentsWithStats(mask, connectivity=4)
    if count < 2:
        return None
    areas = stats[1:, cv2.CC_STAT_AREA]
    chosen = int(np.argmax(areas))
    if near is not None:
        away = np.linalg.norm(middles[1:] - (near - np.array([x0, y0])), axis=1)
        chosen = int(np.argmin(np.where(areas >= 0.5 * areas[chosen], away, np.inf)))
    mask = (labels == chosen + 1).astype(np.uint8)
    x, y, w, h = (int(v) for v in stats[chosen + 1, :4])
    rims, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    kept = [r[:, 0] for r, t in zip(rims, tree[0], strict=True) if t[3] < 0 or cv2.contourArea(r) > LEAST_HOLE]
    edge, outward = _exact(contrast, mask, np.concatenate(kept).astype(np.float32).T, level)
    box = (x0 + x, y0 + y, x0 + x + w, y0 + y + h)
    return Silhouette(
        mask=mask,
        corner=(x0, y0),
        edge=edge + np.array([[x0], [y0]]),
        outward=outward,
        area=float(areas[chosen]),
        box=box,
        is_cut=box[0] <= 1 or box[1] <= 1 or box[2] >= width - 1 or box[3] >= height - 1,
    )


def outward_normals(mask: Pixels, points: NDArray[np.float32]) -> Floats:
    """Unit normals (2, m) of the edge of `mask` (h, w) at `points` [px] (2, m), away from what it covers."""
    cv2 = cv2_of("a camera")
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 2.0)
    x, y = (points[k][None].astype(np.float32) for k in range(2))
    slope = [
        cv2.remap(smooth, x + dx, y + dy, cv2.INTER_LINEAR) - cv2.remap(smooth, x - dx, y - dy, cv2.INTER_LINEAR)
        for dx, dy in ((1, 0), (0, 1))
    ]
    normal = -np.concatenate(slope).astype(float)
    return normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-12)


def _exact(
    contrast: NDArray[np.float32], mask: Pixels, rim: NDArray[np.float32], level: float
) -> tuple[Floats, Floats]:
    """The points along the normals of `rim` [px] (2, m) where the contrast falls through `level`, and the normals."""
    cv2 = cv2_of("a camera")
    normal = outward_normals(mask, rim)
    away = np.arange(-REACH, REACH + STEP / 2.0, STEP)
    lines = (rim[:, None, :] + away[None, :, None] * normal[:, None, :]).astype(np.float32)
    values = cv2.remap(contrast, lines[0], lines[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    falls = (values[:-1] > level) & (values[1:] <= level)
    # The crossing next to the mask's own edge, which lies half a pixel outside its last pixel.
    cost = np.where(falls, np.abs(away[:-1] + STEP / 2.0 - 0.5)[:, None], np.inf)
    k = np.argmin(cost, axis=0)
    m = np.arange(rim.shape[1])
    inside, outside = values[k, m], values[k + 1, m]
    share = (inside - level) / np.maximum(inside - outside, 1e-9)
    shift = np.where(np.isfinite(cost[k, m]), away[k] + STEP * share, 0.5)
    return rim + shift * normal, normal
