"""The gel as a conductor of its own: the panels of its surface, and the current density on it.

Without this the gel is taken to conduct as the solution does and does not disturb the field. With it, charges on its
surface keep the normal current continuous between two conductivities (`charge`); where the contrast is zero they
vanish.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelbot.field.charge import FieldProblem, FieldSolution, build_problem, solve
from gelbot.field.panels import FEWEST, Panels

GEL = -1
"""The owner of the gel's panels."""


def gel_panels(
    positions: NDArray[np.float64], faces: NDArray[np.int64], conductivity: float, solution_conductivity: float
) -> Panels:
    """Panels on the gel's shape: its nodes (3, n) [m], its surface triangles (3, f), and both conductivities [S/m]."""
    corners = positions[:, faces[[0, 1, 2, 2]]]
    contrast = (solution_conductivity - conductivity) / (solution_conductivity + conductivity)
    return Panels(corners, np.full(faces.shape[1], GEL), np.full(faces.shape[1], contrast))


def gel_inflow(solution: FieldSolution) -> NDArray[np.float64]:
    """-i . n on each face of the gel [A/m^2/V] for a unit voltage on each electrode, shape (f, e); inwards is positive.

    From the outside, i_n = -sigma (<d phi / d n> - q / (2 sigma S)); with the condition on q this is
    -sigma <d phi / d n> (1 - lambda), the same as from the inside.
    """
    problem = solution.problem
    panels = problem.panels
    mine = panels.owner[~panels.active] == GEL
    slope = problem.slopes[mine] @ solution.panel_current
    contrast = panels.contrast[panels.owner == GEL]
    return problem.conductivity * slope * (1.0 - contrast[:, None])


def undisturbed_inflow(problem: FieldProblem, before: FieldSolution) -> NDArray[np.float64]:
    """What `gel_inflow` would be if the gel conducted as the solution does, shape (f, e).

    `problem` has the gel's panels, `before` is the solution of the same electrodes without them.
    """
    mine = problem.panels.owner[~problem.panels.active] == GEL
    # The electrodes' panels come first.
    return problem.conductivity * problem.slopes[mine][:, : before.problem.panels.count] @ before.panel_current


def disturbance(field: FieldSolution, gel: Panels) -> NDArray[np.float64]:
    """How the gel changes the inflow through its own faces [A/m^2/V], shape (f, e), in the tank of `field`.

    Both fields, with the gel and without, are solved with half as many panels along a side: the difference is small.
    """
    fine = field.problem
    per_side = max(FEWEST, fine.panels_per_side // 2)
    before = solve(build_problem(fine.array, fine.tank, fine.conductivity, per_side))
    after = build_problem(fine.array, fine.tank, fine.conductivity, per_side, gel)
    return gel_inflow(solve(after)) - undisturbed_inflow(after, before)
