"""The charge simulation: find the panel charges that give every electrode its voltage.

With sources q_p [A] on panels p the potential in a solution of conductivity sigma is

    phi(x) = u + 1/(4 pi sigma) sum_p q_p sum_images w * G(x - x_p)

where G is the panel's closed form and u, the potential of the bulk, floats: an insulated tank lets no current out, so
that sum_p q_p = 0. Everything is linear in the voltages; one solve for unit voltages gives all that follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.field.electrodes import ElectrodeArray, Panels, panels_of
from gelbot.field.images import Tank, images
from gelbot.field.panel import point_potential, square_potential

CLOSED_FORM_DISTANCE = 4.0
"""Beyond this many panel sides a panel's potential is that of a point, with a relative error below (1/4)^2 / 12 = 0.5 %."""


@dataclass(frozen=True)
class FieldProblem:
    """What has to be solved: panels of an array in a tank with a solution of `conductivity` [S/m]."""

    array: ElectrodeArray
    tank: Tank
    conductivity: float
    panels: Panels
    influence: NDArray[np.float64]
    """Potential at panel centres per unit panel current [V/A], shape (q, q)."""


@dataclass(frozen=True)
class FieldSolution:
    """Panel currents [A/V], shape (q, e), and bulk potential [V/V], shape (e,), for a unit voltage on each electrode."""

    problem: FieldProblem
    panel_current: NDArray[np.float64]
    bulk_potential: NDArray[np.float64]

    @property
    def conductance(self) -> NDArray[np.float64]:
        """Conductance matrix [S], shape (e, e): currents that the electrodes feed into the tank are C @ voltages."""
        owner = self.problem.panels.electrode
        total = np.zeros((self.problem.array.count, self.problem.array.count))
        np.add.at(total, owner, self.panel_current)
        return total

    def lead_potential(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Potential [V/V] at `points` [m], shape (3, p), for a unit voltage on each electrode; shape (e, p)."""
        problem = self.problem
        lead = [
            _potential(problem, chunk) @ self.panel_current + self.bulk_potential
            for chunk in np.array_split(points, max(1, points.shape[1] // 2000), axis=1)
        ]
        return np.concatenate(lead).T


def build_problem(array: ElectrodeArray, tank: Tank, conductivity: float, panels_per_side: int) -> FieldProblem:
    """Cut the electrodes into panels and compute their influence on each other."""
    panels = panels_of(array, panels_per_side)
    empty = FieldProblem(array, tank, conductivity, panels, np.zeros((0, 0)))
    influence = np.concatenate(
        [_potential(empty, c) for c in np.array_split(panels.centres, max(1, len(panels.electrode) // 512), axis=1)]
    )
    return FieldProblem(array, tank, conductivity, panels, influence)


def solve(problem: FieldProblem) -> FieldSolution:
    """Solve for a unit voltage on each electrode in turn, with zero total current and a floating bulk potential."""
    q, e = len(problem.panels.electrode), problem.array.count
    # The influences are scaled to order one, so that the border of ones does not spoil the condition number.
    scale = float(np.max(problem.influence))
    bordered = np.ones((q + 1, q + 1))
    bordered[:q, :q] = problem.influence / scale
    bordered[q, q] = 0.0
    unit = np.zeros((q + 1, e))
    unit[np.arange(q), problem.panels.electrode] = 1.0
    answer = np.linalg.solve(bordered, unit)
    return FieldSolution(problem, answer[:q] / scale, answer[q])


def _potential(problem: FieldProblem, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Potential at `points` (3, p) per unit current of each panel [V/A], images summed; shape (p, q)."""
    panels = problem.panels
    total = np.zeros((points.shape[1], panels.centres.shape[1]))
    for image in images(problem.tank):
        centres = image.sign[:, None] * panels.centres + image.shift[:, None]
        near = _distance_to_solution(problem.tank, centres) < CLOSED_FORM_DISTANCE * panels.side
        total += image.weight * np.asarray(_kernel(jnp.asarray(points), jnp.asarray(centres), panels.side, near))
    return total / (4.0 * np.pi * problem.conductivity)


def _distance_to_solution(tank: Tank, centres: NDArray[np.float64]) -> float:
    """Smallest distance [m] of `centres` (3, q) from the solution, which fills the tank: zero for points inside."""
    half = (np.inf, np.inf) if tank.size is None else (tank.size[0] / 2.0, tank.size[1] / 2.0)
    low = np.array([-half[0], -half[1], -np.inf if tank.floor is None else tank.floor])
    high = np.array([half[0], half[1], np.inf if tank.surface is None else tank.surface])
    outside = np.maximum(low[:, None] - centres, centres - high[:, None]).clip(0.0)
    return float(np.linalg.norm(outside, axis=0).min())


@partial(jax.jit, static_argnames=("near",))
def _kernel(points: Array, centres: Array, side: float, near: bool) -> Array:
    offset = points[:, :, None] - centres[:, None, :]
    return square_potential(offset, side) if near else point_potential(offset)
