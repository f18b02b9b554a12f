"""The simulator that runs beside the bench, under the same voltages: what the page shows of the gel."""

from __future__ import annotations

from threading import Lock
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.errors import SimulationFailed
from gelbot.field.lead_field import LeadField, current_density, potential_coefficients, working_volume
from gelbot.plants.simulated import SimulatedGel
from gelbot.scenario.build import Experiment

Floats = NDArray[np.float64]
ARROWS = 11
"""Arrows of current density along each side of their plane."""
LONGEST = 0.9
"""The longest arrow, in distances between arrows."""
FAINT = 0.03
"""What is shorter than this share of the longest arrow is left out."""


class Shape(NamedTuple):
    """The simulated gel at `time` [s]: `positions` (3, n) [m], `adsorption` (f,)."""

    time: float
    positions: Floats
    adsorption: Floats


class Twin:
    """The nominal gel of `experiment`, fed with what the electrodes were given; `broken`: why it cannot go on, if
    so."""

    def __init__(self, experiment: Experiment, time: float) -> None:
        self.voltages: Floats = np.zeros(experiment.array.count)
        self.gel = SimulatedGel(experiment, lambda: self.voltages, time)
        self.broken: str | None = None
        self._lock = Lock()
        self._last = self._now = self._shape()
        self._experiment = experiment
        self._grid, self._spacing = _plane(experiment)
        self._arrows_of, self._arrows = np.full_like(self.voltages, np.nan), np.zeros((0, 2, 3))

    def advance(self, now: float) -> None:
        """Be at `now` [s], under the voltages that it had until then."""
        if self.broken is not None:
            return
        try:
            self.gel.advance(now)
        except SimulationFailed as error:
            self.broken = f"the simulated gel stands still: {error}"
            return
        if self.gel.time > self._now.time:
            with self._lock:
                self._last, self._now = self._now, self._shape()

    def shape_at(self, time: float) -> Shape:
        """The gel at `time` [s] between its last two shapes: so that it moves smoothly, a period late."""
        with self._lock:
            last, now = self._last, self._now
        share = (time - last.time) / (now.time - last.time) if now.time > last.time else 1.0
        share = min(1.0, max(0.0, share))
        return Shape(
            last.time + share * (now.time - last.time),
            last.positions + share * (now.positions - last.positions),
            now.adsorption,
        )

    def arrows(self) -> Floats:
        """Arrows (m, 2, 3) of the current density on a plane above the gel, from foot to head [m]."""
        volts = self.voltages
        if not np.array_equal(volts, self._arrows_of):
            dtype = self.gel.state.positions.dtype
            lead = self._experiment.model.lead
            flow = np.asarray(_flow(lead, jnp.asarray(volts, dtype), jnp.asarray(self._grid, dtype)), np.float64)
            self._arrows, self._arrows_of = _drawn(self._grid, flow, LONGEST * self._spacing), volts
        return self._arrows

    def _shape(self) -> Shape:
        state = self.gel.state
        return Shape(self.gel.time, np.asarray(state.positions, np.float64), np.asarray(state.ads, np.float64))


@jax.jit
def _flow(lead: LeadField, voltages: Array, points: Array) -> Array:
    return current_density(lead, potential_coefficients(lead, voltages), points)


def _plane(experiment: Experiment) -> tuple[Floats, float]:
    """Points (3, m) [m] of a level plane half way up the box in which the field is known, and their distance."""
    low, high = working_volume(experiment.model.lead)
    x, y = (np.linspace(low[k], high[k], ARROWS) for k in (0, 1))
    grid = np.stack([part.ravel() for part in np.meshgrid(x, y, indexing="ij")])
    return np.vstack([grid, np.full((1, grid.shape[1]), (low[2] + high[2]) / 2.0)]), float(x[1] - x[0])


def _drawn(points: Floats, flow: Floats, longest: float) -> Floats:
    size = np.linalg.norm(flow, axis=0)
    most = size.max(initial=0.0)
    if not most > 0.0:
        return np.zeros((0, 2, 3))
    kept = size > FAINT * most
    foot, along = points[:, kept], flow[:, kept] * (longest / most)
    return np.stack([(foot - along / 2.0).T, (foot + along / 2.0).T], axis=1)
