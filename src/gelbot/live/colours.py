"""The colours of pictures and movies, as the page needs them: three bytes each."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from gelbot.show.style import ADSORPTION_MAP, VOLTAGE_MAP

Colour: TypeAlias = tuple[int, int, int]

STONE: Colour = (184, 184, 189)
WATER: Colour = (150, 196, 222)
FLOOR: Colour = (240, 240, 236)
DARK: Colour = (34, 34, 34)

_VOLTS = np.round(255.0 * VOLTAGE_MAP(np.linspace(0.0, 1.0, 129))[:, :3]).astype(int)
_UNSURE, _SURE = np.array([222.0, 120.0, 60.0]), np.array([0.0, 114.0, 178.0])


def of_name(name: str) -> Colour:
    """A colour of `show.style`, such as "#0072B2"."""
    red, green, blue = (round(255.0 * part) for part in to_rgb(name))
    return red, green, blue


def of_volts(volts: float, limit: float) -> Colour:
    """Blue at `-limit`, nearly white at zero, red at `limit` [V]; beyond it as at it."""
    share = 0.5 + 0.5 * float(np.clip(volts / limit, -1.0, 1.0)) if np.isfinite(volts) else 0.5
    red, green, blue = _VOLTS[round(share * (len(_VOLTS) - 1))].tolist()
    return red, green, blue


def of_adsorption(bins: int) -> NDArray[np.int64]:
    """One colour for each of `bins` equal parts of 0 .. 1, shape (bins, 3)."""
    return np.round(255.0 * ADSORPTION_MAP((np.arange(bins) + 0.5) / bins)[:, :3]).astype(np.int64)


def of_confidence(confidence: float) -> Colour:
    """Blue for 1, orange for 0."""
    # In ten steps: a colour that changes all the time would be sent all the time.
    share = round(10.0 * float(np.clip(confidence, 0.0, 1.0))) / 10.0
    red, green, blue = np.round(share * _SURE + (1.0 - share) * _UNSURE).astype(int).tolist()
    return red, green, blue
