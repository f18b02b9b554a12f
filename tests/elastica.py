"""The elastica: an inextensible beam, clamped at one end, with a dead load across its other end."""

from __future__ import annotations

import numpy as np
import scipy.integrate


def elastica(load: float) -> tuple[float, float, float]:
    """Slope of the tip [rad], how far it goes down and how far back, in lengths of the beam.

    E I theta'' = -P cos(theta), theta(0) = theta'(L) = 0 (Bisshopp and Drucker 1945); `load` is P L^2 / (E I).
    """
    s = np.linspace(0.0, 1.0, 101)
    solved = scipy.integrate.solve_bvp(
        lambda _, y: np.stack([y[1], -load * np.cos(y[0])]), lambda a, b: np.array([a[0], b[1]]), s, np.zeros((2, 101))
    )
    theta = solved.sol(s)[0]
    down, back = scipy.integrate.trapezoid(np.sin(theta), s), 1.0 - scipy.integrate.trapezoid(np.cos(theta), s)
    return float(solved.sol(1.0)[0]), float(down), float(back)
