"""Template patterns of applied voltages, Fig. 6: which electrodes get -E and which +E.

A pattern holds each electrode's share of the amplitude, shape (e,). The robot lies under one electrode; minus means a
cathode, towards which the current rises through the gel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.field.electrodes import ElectrodeArray

TEMPLATES = ("ridge", "crossed-ridge", "cathode", "anode", "plus", "minus", "uniform", "off")


def template(
    name: str, array: ElectrodeArray, robot: NDArray[np.float64], where: str = "template"
) -> NDArray[np.float64]:
    """The pattern called `name`; `robot` [m], shape (2,): the robot's place, which picks its electrode.

    ridge           Fig. 6(a): -1 on the diagonal through the robot's electrode, +1 elsewhere
    crossed-ridge   Fig. 6(b): the same with the other diagonal
    cathode         -1 on the robot's electrode, +1 elsewhere; anode is its negative
    plus, minus     -1 on the electrodes at larger (smaller) x + y than the robot's, +1 elsewhere
    uniform         -1 on the first column to +1 on the last: a horizontal field
    off             no voltage
    """
    row, column = (g.ravel() for g in np.meshgrid(np.arange(array.rows), np.arange(array.columns), indexing="ij"))
    home = int(np.argmin(np.linalg.norm(array.centres - robot[:, None], axis=0)))
    down, right = row - row[home], column - column[home]
    if name == "uniform":
        return np.linspace(-1.0, 1.0, array.columns)[column] if array.columns > 1 else np.zeros(array.count)
    minus = {
        "ridge": down == right,
        "crossed-ridge": down == -right,
        "cathode": (down == 0) & (right == 0),
        "anode": (down != 0) | (right != 0),
        "plus": down + right > 0,
        "minus": down + right < 0,
    }
    if name == "off":
        return np.zeros(array.count)
    if name not in minus:
        raise BadInput(where, name, "one of " + ", ".join(TEMPLATES))
    return np.where(minus[name], -1.0, 1.0)
