"""What electrodes are connected to: which voltages they take when only some of them are driven.

With the conductance matrix C the currents are I = C V. Driven electrodes D have the voltage asked for, grounded ones 0
V; a floating electrode F carries no net current, so that

    V_F = -C_FF^-1 C_FD V_D.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput

STATES = ("driven", "grounded", "floating", "off")
"""What an electrode can be. One that is off hangs in the tank unconnected: it floats."""


def connection(conductance: NDArray[np.float64], states: Sequence[str], where: str = "states") -> NDArray[np.float64]:
    """The matrix T, shape (e, e), that takes the voltages asked for to those that the electrodes have.

    Entries of the voltages of electrodes that are not driven do not count. Raises `BadInput` for an unknown state, a
    wrong number of them, or when no electrode is driven.
    """
    count = len(conductance)
    if len(states) != count:
        raise BadInput(where, f"{len(states)} states", f"{count}, one for each electrode")
    for number, state in enumerate(states):
        if state not in STATES:
            raise BadInput(where, state, "one of " + ", ".join(STATES), f"for electrode {number}")
    kind = np.array(states)
    driven, floating = kind == "driven", (kind == "floating") | (kind == "off")
    if not driven.any():
        raise BadInput(where, ", ".join(sorted(set(states))), "at least one driven electrode: no voltage acts here")
    taken = np.diag(driven.astype(float))
    if floating.any():
        among, towards = conductance[np.ix_(floating, floating)], conductance[np.ix_(floating, driven)]
        taken[np.ix_(floating, driven)] = -np.linalg.solve(among, towards)
    return taken


def power(conductance: NDArray[np.float64], voltages: NDArray[np.float64]) -> float:
    """What the electrodes feed into the tank [W], V . C V, for the `voltages` [V] that they have."""
    return float(voltages @ conductance @ voltages)
