"""The charge simulation: find the panel currents that give every electrode its voltage.

With currents q_p [A] on panels p the potential in a solution of conductivity sigma is

    phi(x) = u + 1/(4 pi sigma) sum_p q_p G_p(x)

where G_p is a panel's potential with all its images and u, the potential of the bulk, floats: an insulated tank lets no
current out, so that sum_p q_p = 0. On the panels of the electrodes phi, averaged over each panel (Galerkin), is the
voltage. On those of a body of conductivity s, an insulated backing (s = 0) or the gel, the normal current is
continuous:

    q_p / 2 = lambda S_p sigma <d phi / d n>_p,    lambda = (sigma - s) / (sigma + s),

S_p the panel's area, <d phi / d n> the mean of both sides. Everything is linear in the voltages; one solve for unit
voltages gives all that follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from gelbot.errors import GelbotError
from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.images import Tank
from gelbot.field.influence import mutual_images, mutual_potentials, mutual_slopes, potentials_at, slopes_at
from gelbot.field.panels import FEWEST, Panels, joined, panels_of

Floats = NDArray[np.float64]

MOST = 20_000
"""Panels beyond which an estimate of the error is not worth its memory."""
LIFT = 4.0
"""Constant added to the potentials, in means of their absolute values."""


@dataclass(frozen=True, eq=False)
class FieldProblem:
    """What has to be solved: panels of an array in a tank with a solution of `conductivity` [S/m].

    `potentials` (q, q) [V/A]: of unit panel currents, averaged over panels. `slopes` (r, q) [V/(A m)]: the same for the
    normal slopes on the panels that have no voltage, in their order.
    """

    array: ElectrodeArray
    tank: Tank
    conductivity: float
    panels_per_side: int
    panels: Panels
    potentials: Floats
    slopes: Floats


@dataclass(frozen=True, eq=False)
class FieldSolution:
    """For a unit voltage on each electrode: panel currents [A/V], (q, e), bulk potential [V/V], (e,), conductance [S].

    The currents that the electrodes feed into the tank are `conductance` @ voltages. `asymmetry` is how far that matrix
    was from its transpose, relative to its largest element, before it was made symmetric: rounding where all panels
    conduct, and where backings stand in a symmetric layout, however coarse; `error_estimate` tells of the panels.
    """

    problem: FieldProblem
    panel_current: Floats
    bulk_potential: Floats
    conductance: Floats
    asymmetry: float

    def potential(self, points: Floats, voltages: Floats) -> Floats:
        """Potential [V] at `points` [m], shape (3, p), for each set of `voltages` [V], shape (e, k); shape (k, p)."""
        problem = self.problem
        sums = potentials_at(points, problem.panels, self.panel_current @ voltages, problem.tank)
        return sums.T / (4.0 * np.pi * problem.conductivity) + (self.bulk_potential @ voltages)[:, None]

    def current_density(self, points: Floats, voltages: Floats) -> Floats:
        """Current density i = -sigma grad phi [A/m^2] in the solution, likewise; shape (k, 3, p)."""
        problem = self.problem
        slopes = slopes_at(points, problem.panels, self.panel_current @ voltages, problem.tank)
        return -slopes.transpose(2, 0, 1) / (4.0 * np.pi)

    def lead_potential(self, points: Floats) -> Floats:
        """Potential [V/V] at `points` [m], shape (3, p), for a unit voltage on each electrode; shape (e, p)."""
        return self.potential(points, np.eye(self.problem.array.count))

    def lead_current_density(self, points: Floats) -> Floats:
        """Current density i = -sigma grad phi [A/m^2/V] at `points` [m], shape (3, p); shape (e, 3, p)."""
        return self.current_density(points, np.eye(self.problem.array.count))


class SingularField(GelbotError):
    """The charges cannot be found: two electrodes are in one place, or an electrode has no size."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        super().__init__(
            f"the field of these electrodes has no solution: {', '.join(names)}. "
            "Try: electrodes that do not touch each other, with sizes well above rounding"
        )


def in_solution(solution: FieldSolution, conductivity: float) -> FieldSolution:
    """The field of the same electrodes in another solution: potentials stay, currents grow with `conductivity` [S/m].

    Only where nothing conducts but the solution.
    """
    problem = solution.problem
    ratio = conductivity / problem.conductivity
    if ratio == 1.0:
        return solution
    scaled = replace(
        problem, conductivity=conductivity, potentials=problem.potentials / ratio, slopes=problem.slopes / ratio
    )
    return replace(
        solution,
        problem=scaled,
        panel_current=solution.panel_current * ratio,
        conductance=solution.conductance * ratio,
    )


def build_problem(
    array: ElectrodeArray, tank: Tank, conductivity: float, panels_per_side: int, gel: Panels | None = None
) -> FieldProblem:
    """Cut the electrodes into panels and compute their influence on each other.

    `gel` holds the panels of the gel's surface where it conducts otherwise than the solution (`gel_panels`).
    """
    panels = panels_of(array, panels_per_side)
    if gel is not None:
        panels = joined([panels, gel])
    factor = 1.0 / (4.0 * np.pi * conductivity)
    images = mutual_images(panels, tank)
    potentials = mutual_potentials(panels, images)
    potentials *= factor
    passive = np.flatnonzero(~panels.active)
    slopes = factor * mutual_slopes(panels, passive, images) if len(passive) else np.zeros((0, panels.count))
    return FieldProblem(array, tank, conductivity, panels_per_side, panels, potentials, slopes)


def solve(problem: FieldProblem) -> FieldSolution:
    """Solve for a unit voltage on each electrode in turn, with zero total current and a floating bulk potential.

    Raises `SingularField` for electrodes that coincide.
    """
    if not np.all(np.isfinite(problem.potentials)):
        raise SingularField([electrode.name for electrode in problem.array.electrodes])
    return _solve_with_bodies(problem) if len(problem.slopes) else _solve_symmetric(problem)


def _solve_symmetric(problem: FieldProblem) -> FieldSolution:
    """All panels conduct: by Cholesky's factors."""
    panels, count = problem.panels, problem.array.count
    # Neutral charges do not feel a constant added to all potentials; it makes the matrix positive definite.
    lifted = problem.potentials + LIFT * np.abs(problem.potentials).mean()
    try:
        factor = cho_factor(lifted, lower=True, overwrite_a=True, check_finite=False)
    except LinAlgError as error:
        raise SingularField(_closest(problem.array)) from error
    ones = np.column_stack([_members(problem), np.ones(panels.count)])
    answer = cho_solve(factor, ones, check_finite=False)
    energy = ones.T @ answer
    energy = (energy + energy.T) / 2.0
    each, together = energy[:count, count], energy[count, count]
    bulk = each / together
    conductance = energy[:count, :count] - np.outer(each, each) / together
    return FieldSolution(problem, answer[:, :count] - np.outer(answer[:, count], bulk), bulk, conductance, 0.0)


def _solve_with_bodies(problem: FieldProblem) -> FieldSolution:
    """Some panels belong to backings or to the gel: one matrix with a row for each condition."""
    panels, count = problem.panels, problem.array.count
    q, passive = panels.count, np.flatnonzero(~panels.active)
    system = np.zeros((q + 1, q + 1))
    system[:q, :q] = problem.potentials
    share = problem.conductivity * (panels.contrast * panels.area)[passive]
    system[passive, :q] = -share[:, None] * problem.slopes
    system[passive, passive] += 0.5
    # Rows of one size, so that the border does not spoil the condition number.
    scale = np.where(panels.active, 1.0 / np.abs(problem.potentials).max(axis=1), 1.0)
    system[:q, :q] *= scale[:, None]
    system[:q, q] = np.where(panels.active, scale, 0.0)
    system[q, :q] = panels.owner >= 0
    members = _members(problem)
    asked = np.vstack([members * np.where(panels.active, scale, 0.0)[:, None], np.zeros((1, count))])
    try:
        answer = np.asarray(np.linalg.solve(system, asked), float)
    except LinAlgError as error:
        raise SingularField(_closest(problem.array)) from error
    conductance = members.T @ answer[:q]
    largest = np.abs(conductance).max()
    asymmetry = float(np.abs(conductance - conductance.T).max() / largest)
    return FieldSolution(problem, answer[:q], answer[q], (conductance + conductance.T) / 2.0, asymmetry)


def _members(problem: FieldProblem) -> Floats:
    """1 where a panel belongs to an electrode, shape (q, e)."""
    return (problem.panels.owner[:, None] == np.arange(problem.array.count)).astype(float)


def _closest(array: ElectrodeArray) -> list[str]:
    """The names of the two electrodes whose middles are closest, or of the only one."""
    distance = np.linalg.norm(array.centres[:, :, None] - array.centres[:, None], axis=0)
    distance[np.diag_indices(array.count)] = np.inf
    closest = np.unravel_index(int(np.argmin(distance)), distance.shape)
    return [array.electrodes[int(n)].name for n in dict.fromkeys(closest)]


def error_estimate(solution: FieldSolution) -> float | None:
    """Largest change of the conductance matrix, relative to its largest element, with half as many panels along a side.

    The error that is left is smaller: it falls with more than the second power of that number. Where half as many would
    be fewer than a shape needs, the change with twice as many: then it is about the error itself. None where those are
    more than `MOST`; zero where no current can flow.
    """
    problem = solution.problem
    if np.any(problem.panels.owner < 0):
        raise ValueError("the estimate is made without a gel")
    fine = problem.panels_per_side
    other = fine // 2 if fine >= 2 * FEWEST else 2 * fine
    largest = float(np.abs(solution.conductance).max())
    if other > fine and 4 * problem.panels.count > MOST:
        return None
    if problem.array.count == 1:
        return 0.0
    compared = build_problem(problem.array, problem.tank, problem.conductivity, other)
    return float(np.abs(solve(compared).conductance - solution.conductance).max()) / largest
