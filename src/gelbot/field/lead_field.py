"""The lead field on a grid: potential and current density anywhere in the working volume, for any voltages.

The potential of each electrode at unit voltage is interpolated by a cubic B-spline; its exact gradient gives

    i(x) = sum_e V_e g_e(x),    g_e = -sigma grad phi_e,

so the interpolated field is free of curl by construction and superposition holds to rounding.

A batch of b robots, each with its own voltages and its own points, comes last: voltages (e, b), points (3, p, b).
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.field.charge import FieldSolution
from gelbot.field.spline import Grid, Orders, clamped_interpolation, evaluate, interpolation

Floats = NDArray[np.float64]

MARGIN = 2
"""Cells around the box, in the plane, whose values are used and not kept: the spline's ends disturb it no more."""
VALUE: Orders = ((0, 0, 0),)
SLOPES: Orders = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
CURVATURES: Orders = ((2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2))
SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where in `CURVATURES` the second derivative along two axes stands."""


class LeadField(NamedTuple):
    """B-spline coefficients of the electrodes' potentials [V/V], (e, nx + 3, ny + 3, nz + 3), for nx, ny, nz cells.

    `origin` [m], shape (3,), is the lowest corner of the box, `spacing` [m], shape (3,), the size of a cell;
    `conductivity` [S/m].
    """

    coefficients: Array
    origin: Array
    spacing: Array
    conductivity: Array


def build_lead_field(
    solution: FieldSolution,
    low: Floats,
    high: Floats,
    spacing: float,
    connection: Floats | None = None,
) -> LeadField:
    """Tabulate the potentials of `solution` in the box from `low` to `high` [m], shape (3,), in cells of `spacing` [m].

    The cells are as much smaller as it takes for whole numbers of them to fill the box.

    With `connection` T (e, e) they are those of the voltages T v for the voltages v asked for.
    """
    cells = np.maximum(1, np.ceil((high - low) / spacing - 1e-9)).astype(int)
    size = (high - low) / cells
    outside = np.array([MARGIN, MARGIN, 0])
    x, y, z = (low[k] + size[k] * np.arange(-outside[k], cells[k] + outside[k] + 1) for k in range(3))
    values = solution.lead_potential(_grid(x, y, z)).reshape(-1, len(x), len(y), len(z))
    # At the lower and the upper end, close to the plates, the spline gets the slopes too: no values beyond are needed.
    ends = solution.lead_current_density(_grid(x, y, z[[0, -1]]))[:, 2].reshape(-1, len(x), len(y), 2)
    conductivity = solution.problem.conductivity
    values = np.concatenate([values, -size[2] / conductivity * ends], axis=3)
    values = np.einsum("exyz,kz->exyk", values, clamped_interpolation(len(z)), optimize=True)
    values = np.einsum("exyk,jy->exjk", values, interpolation(len(y)), optimize=True)
    values = np.einsum("exjk,ix->eijk", values, interpolation(len(x)), optimize=True)
    values = values[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    if connection is not None:
        values = np.einsum("ef,eijk->fijk", connection, values, optimize=True)
    return LeadField(
        coefficients=jnp.asarray(values),
        origin=jnp.asarray(low),
        spacing=jnp.asarray(size),
        conductivity=jnp.asarray(conductivity),
    )


def table_error(lead: LeadField, solution: FieldSolution, points: Array, connection: Floats | None = None) -> float:
    """Largest error of the table at `points` (3, p) [m], for a unit voltage on each electrode in turn.

    Relative to the largest current density there: the electrodes whose field is weak there count little.
    """
    exact = solution.lead_current_density(np.asarray(points))
    if connection is not None:
        exact = np.einsum("ef,ekp->fkp", connection, exact)
    found = [current_density(lead, table, points) for table in lead.coefficients]
    largest = float(np.abs(exact).max())
    return float(np.abs(np.asarray(jnp.stack(found)) - exact).max()) / largest if largest > 0.0 else 0.0


def _grid(x: Floats, y: Floats, z: Floats) -> Floats:
    """All points of a grid, shape (3, nx * ny * nz), z running fastest."""
    return np.stack([axis.ravel() for axis in np.meshgrid(x, y, z, indexing="ij")])


def working_volume(lead: LeadField) -> tuple[Floats, Floats]:
    """The lowest and the highest corner [m], shape (3,) each, of the box in which `lead` is tabulated."""
    low = np.asarray(lead.origin, np.float64)
    return low, low + np.asarray(lead.spacing, np.float64) * (np.array(lead.coefficients.shape[1:]) - 3)


def potential_coefficients(lead: LeadField, voltages: Array) -> Array:
    """Superposition: spline coefficients of the potential [V] for `voltages` [V], shape (e,) or (e, b).

    They have the shape of the grid, (nx + 3, ny + 3, nz + 3); in a batch they come robot by robot, (b, nx + 3, ...).
    """
    table = lead.coefficients
    return (voltages.T @ table.reshape(table.shape[0], -1)).reshape(*voltages.shape[1:], *table.shape[1:])


def potential(lead: LeadField, coefficients: Array, points: Array) -> Array:
    """Potential [V], shape (p,) or (p, b), at `points` [m], shape (3, p) or (3, p, b).

    `coefficients` come from `potential_coefficients`, here and below. Points outside the box see the potential and the
    field at its nearest point.
    """
    return evaluate(coefficients, _grid_of(lead), points, VALUE)[0]


def current_density(lead: LeadField, coefficients: Array, points: Array) -> Array:
    """Current density i = -sigma grad phi [A/m^2], shape (3, p) or (3, p, b), at `points` [m] of the same shape."""
    return -lead.conductivity * evaluate(coefficients, _grid_of(lead), points, SLOPES)


def current_density_gradient(lead: LeadField, coefficients: Array, points: Array) -> Array:
    """Gradient d i_k / d x_l [A/m^3], shape (3, 3, p) or (3, 3, p, b), at `points` [m]; symmetric, of little trace."""
    return -lead.conductivity * evaluate(coefficients, _grid_of(lead), points, CURVATURES)[SYMMETRIC]


def _grid_of(lead: LeadField) -> Grid:
    return Grid(lead.origin, lead.spacing)
