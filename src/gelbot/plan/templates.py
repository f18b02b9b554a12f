"""Template patterns of applied voltages, Fig. 6: which electrodes get -E and which +E.

A pattern holds each electrode's share of the amplitude, shape (e,). The robot lies under one electrode; minus means a
cathode, towards which the current rises through the gel.
"""

from __future__ import annotations

from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.field.electrodes import ElectrodeArray

TEMPLATES = (
    *("ridge", "crossed-ridge", "cathode", "anode", "plus", "minus"),
    *("uniform", "along-ridge", "across-ridge", "off"),
)


def template(
    name: str, array: ElectrodeArray, robot: NDArray[np.float64], where: str = "template"
) -> NDArray[np.float64]:
    """The pattern called `name`; `robot` [m], shape (2,): the robot's place, which picks its electrode.

    ridge           Fig. 6(a): -1 on the diagonal x = y through the robot's electrode, +1 elsewhere
    crossed-ridge   Fig. 6(b): the same with the other diagonal, x = -y
    cathode         -1 on the robot's electrode, +1 elsewhere; anode is its negative
    plus, minus     -1 on the electrodes at larger (smaller) x + y than those of the crossed ridge, +1 elsewhere
    uniform         -1 at the smallest x to +1 at the largest, in proportion: a horizontal field
    along-ridge     in proportion to dx + dy, -1 or +1 where that is largest: a field along the diagonal of the ridge
    across-ridge    the same with dx - dy, a field across it
    off             no voltage

    The robot's electrode is the one nearest to it, seen from above. With dx, dy from there to another electrode and the
    pitch p, the smallest distance of two, the diagonals have those with |dx - dy| < p/2 and |dx + dy| < p/2.
    """
    home = int(np.argmin(np.linalg.norm(array.centres[:2] - robot[:, None], axis=0)))
    x, y = array.centres[:2]
    dx, dy = x - x[home], y - y[home]
    half = array.pitch / 2.0
    if name == "uniform":
        width = np.ptp(x)
        return 2.0 * (x - x.min()) / width - 1.0 if width > 0.0 else np.zeros(array.count)
    if name in ("along-ridge", "across-ridge"):
        slope = dx + dy if name == "along-ridge" else dx - dy
        steepest = np.abs(slope).max()
        return slope / steepest if steepest > 0.0 else np.zeros(array.count)
    minus = {
        "ridge": np.abs(dx - dy) < half,
        "crossed-ridge": np.abs(dx + dy) < half,
        "cathode": np.arange(array.count) == home,
        "anode": np.arange(array.count) != home,
        "plus": dx + dy >= half,
        "minus": dx + dy <= -half,
    }
    if name == "off":
        return np.zeros(array.count)
    if name not in minus:
        raise BadInput(where, name, "one of " + ", ".join(TEMPLATES), "".join(get_close_matches(name, TEMPLATES, 1)))
    return np.where(minus[name], -1.0, 1.0)


def superposition(weights: dict[str, float], array: ElectrodeArray, robot: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sum of the templates times their `weights`, shape (e,), cut off at -1 and +1: few numbers for many fields."""
    total = sum((weight * template(name, array, robot) for name, weight in weights.items()), np.zeros(array.count))
    return np.clip(total, -1.0, 1.0)
