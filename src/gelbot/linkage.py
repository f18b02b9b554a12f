"""The planar articulated linkage of Section II-A, equations (1), (4) and (5): how adsorption turns link against link.

    v[j] = v[j-1] + dv[j-1, j],    dv[j-1, j] = 2 p_dv (ads[j-1] + ads[j]) / (h[j-1] + h[j])

It is how `p_dv` is fitted from a bent strip, and it gives `p_l` of Eq. (6): a two-layer lattice of thickness h and link
length l, one side of it contracted by p_l ads, turns each link by p_l ads l / h; Eq. (5) with equal links turns it by
2 p_dv ads / h; hence

    p_l = 2 p_dv / l,

whatever the thickness. Angles count positive towards the side that adsorbs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelbot.errors import BadInput


class Linkage(NamedTuple):
    """gel = [r, v, h, ads], Eq. (1), of `j` links.

    Middles `r` [m], shape (2, j): along the flat strip and towards the side that adsorbs; orientations `v` [rad],
    thickness `h` [m], adsorption `ads` in [0, 1], shape (j,) each.
    """

    r: NDArray[np.float64]
    v: NDArray[np.float64]
    h: NDArray[np.float64]
    ads: NDArray[np.float64]


def bend(ads: ArrayLike, h: ArrayLike, p_dv: float, link_length: float) -> Linkage:
    """The linkage with adsorption `ads` and thickness `h` [m], shape (j,) each; it begins at the origin, along x.

    `p_dv` [m rad] is the coefficient of Eq. (5), `link_length` [m].
    """
    ads, h = np.broadcast_arrays(np.asarray(ads, dtype=float), np.asarray(h, dtype=float))
    v = orientations(turning_angles(ads, h, p_dv))
    joint = joints(v, link_length)
    return Linkage((joint[:, 1:] + joint[:, :-1]) / 2.0, v, h, ads)


def turning_angles(ads: NDArray[np.float64], h: NDArray[np.float64], p_dv: float) -> NDArray[np.float64]:
    """dv[j-1, j] [rad], shape (j - 1,), from adsorption and thickness [m], shape (j,) each."""
    return p_dv * _leverage(ads, h)  # Eq. (5).


def orientations(dv: NDArray[np.float64], first: float = 0.0) -> NDArray[np.float64]:
    """v[j] [rad], shape (j,), of links that turn by `dv` [rad], shape (j - 1,); the first link points along `first`."""
    return first + np.concatenate([[0.0], np.cumsum(dv)])  # Eq. (4).


def joints(v: NDArray[np.float64], link_length: float) -> NDArray[np.float64]:
    """Ends of the links [m], shape (2, j + 1), beginning at the origin, for orientations `v` [rad], shape (j,)."""
    links = link_length * np.stack([np.cos(v), np.sin(v)])
    return np.concatenate([np.zeros((2, 1)), np.cumsum(links, axis=1)], axis=1)


def p_l_from_p_dv(p_dv: float, link_length: float) -> float:
    """p_l = 2 p_dv / l of Eq. (6), for `p_dv` [m rad] of Eq. (5) and links of `link_length` l [m]."""
    return 2.0 * p_dv / link_length


def p_dv_from_p_l(p_l: float, link_length: float) -> float:
    """p_dv = p_l l / 2 [m rad] of Eq. (5), for `p_l` of Eq. (6) and links of `link_length` l [m]."""
    return p_l * link_length / 2.0


def fit_p_dv(
    angles: NDArray[np.float64], ads: NDArray[np.float64], h: NDArray[np.float64], where: str = "linkage"
) -> float:
    """The p_dv [m rad] of Eq. (5) that explains observed turning `angles` [rad], shape (j - 1,), in least squares.

    `ads` and `h` [m] belong to the links, shape (j,) each. Raises `BadInput` when no link adsorbs: then no angle tells
    anything of p_dv.
    """
    leverage = _leverage(ads, h)
    if not np.any(leverage):
        raise BadInput(where, "a strip without adsorption", "at least one link with ads > 0")
    return float(leverage @ angles / (leverage @ leverage))


def _leverage(ads: NDArray[np.float64], h: NDArray[np.float64]) -> NDArray[np.float64]:
    """dv / p_dv of Eq. (5) [1/m], shape (j - 1,)."""
    return 2.0 * (ads[:-1] + ads[1:]) / (h[:-1] + h[1:])
