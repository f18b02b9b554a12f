"""The charge simulation: find the panel charges that give every electrode its voltage.

With sources q_p [A] on panels p the potential in a solution of conductivity sigma is

    phi(x) = u + 1/(4 pi sigma) sum_p q_p sum_images w * G(x - x_p)

where G is the panel's closed form and u, the potential of the bulk, floats: an insulated tank lets no current out, so
that sum_p q_p = 0. Everything is linear in the voltages; one solve for unit voltages gives all that follows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.field.electrodes import ElectrodeArray, Panels, panels_of
from gelbot.field.images import Tank, images
from gelbot.field.panel import point_potential, square_potential

CLOSED_FORM_DISTANCE = 4.0
"""Beyond this many panel sides a panel's potential is that of a point: a relative error below (1/4)^2 / 12 = 0.5 %."""

CHUNK = 512
"""Points that are computed at once: few enough that their table stays in the processor's cache."""


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
    """For a unit voltage on each electrode: panel currents [A/V], (q, e), and bulk potential [V/V], (e,)."""

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
        potentials = [part @ self.panel_current for part in _potentials(self.problem, points)]
        return np.concatenate(potentials).T + self.bulk_potential[:, None]


def build_problem(array: ElectrodeArray, tank: Tank, conductivity: float, panels_per_side: int) -> FieldProblem:
    """Cut the electrodes into panels and compute their influence on each other."""
    panels = panels_of(array, panels_per_side)
    empty = FieldProblem(array, tank, conductivity, panels, np.zeros((0, 0)))
    influence = np.concatenate(list(_potentials(empty, panels.centres)))
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
    return FieldSolution(problem, np.asarray(answer[:q] / scale, float), np.asarray(answer[q], float))


def _potentials(problem: FieldProblem, points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Potential at `points` (3, p) per unit current of each panel [V/A], images summed; parts of shape (some, q)."""
    panels, factor = problem.panels, 1.0 / (4.0 * np.pi * problem.conductivity)
    near: list[NDArray[np.float64]] = []
    far: list[NDArray[np.float64]] = []
    weights: tuple[list[float], list[float]] = [], []
    for image in images(problem.tank):
        centres = image.sign[:, None] * panels.centres + image.shift[:, None]
        is_near = _distance_to_solution(problem.tank, centres) < CLOSED_FORM_DISTANCE * panels.side
        (near if is_near else far).append(centres)
        weights[0 if is_near else 1].append(image.weight * factor)
    sources = [np.array(c).reshape(-1, *panels.centres.shape) for c in (near, far)]
    scales = [np.array(w) for w in weights]
    for part in np.array_split(points, max(1, points.shape[1] // CHUNK), axis=1):
        # Parts of one length are compiled once.
        padded = np.pad(part, ((0, 0), (0, -part.shape[1] % CHUNK)), mode="edge")
        yield np.asarray(_kernel(padded, *sources, *scales, panels.side))[: part.shape[1]]


def _distance_to_solution(tank: Tank, centres: NDArray[np.float64]) -> float:
    """Smallest distance [m] of `centres` (3, q) from the solution, which fills the tank: zero for points inside."""
    half = (np.inf, np.inf) if tank.size is None else (tank.size[0] / 2.0, tank.size[1] / 2.0)
    low = np.array([-half[0], -half[1], -np.inf if tank.floor is None else tank.floor])
    high = np.array([half[0], half[1], np.inf if tank.surface is None else tank.surface])
    outside = np.maximum(low[:, None] - centres, centres - high[:, None]).clip(0.0)
    return float(np.linalg.norm(outside, axis=0).min())


@jax.jit
def _kernel(points: Array, near: Array, far: Array, near_weight: Array, far_weight: Array, side: Array) -> Array:
    """Weighted sum over near images, in closed form, and far ones (i, 3, q), as points; shape (p, q)."""

    def offset(centres: Array) -> tuple[Array, Array, Array]:
        x, y, z = (points[k][:, None] - centres[k][None, :] for k in range(3))
        return x, y, z

    def add_near(total: Array, image: tuple[Array, Array]) -> tuple[Array, None]:
        return total + image[1] * square_potential(offset(image[0]), side), None

    def add_far(total: Array, image: tuple[Array, Array]) -> tuple[Array, None]:
        return total + image[1] * point_potential(offset(image[0])), None

    total = jnp.zeros((points.shape[1], near.shape[2]))
    total, _ = jax.lax.scan(add_near, total, (near, near_weight))
    total, _ = jax.lax.scan(add_far, total, (far, far_weight))
    return total
