"""The lead field on a grid: current density anywhere in the working volume for any voltages, at the cost of a gather.

The potential of each electrode at unit voltage is interpolated by a cubic B-spline; its exact gradient gives

    i(x) = sum_e V_e g_e(x),    g_e = -sigma grad phi_e,

so the interpolated field is free of curl by construction and superposition holds to rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.field.charge import FieldSolution


class LeadField(NamedTuple):
    """B-spline coefficients of the electrodes' potentials [V/V], shape (e, nx * ny * nz), on a grid.

    `origin` [m], shape (3,), is the grid point 0, `spacing` [m] the distance of grid points, `shape` (3,) the number of
    cells along x, y, z (one more point, three more coefficients); `conductivity` [S/m].
    """

    coefficients: Array
    origin: Array
    spacing: Array
    cells: Array
    conductivity: Array


def build_lead_field(
    solution: FieldSolution,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    spacing: float,
    connection: NDArray[np.float64] | None = None,
) -> LeadField:
    """Tabulate the potentials of `solution` in the box from `low` to `high` [m], shape (3,) each.

    With `connection` T (e, e) they are those of the voltages T v for the voltages v asked for.
    """
    cells = np.maximum(4, np.ceil((high - low) / spacing - 1e-9)).astype(int)
    axes = [low[k] + spacing * np.arange(cells[k] + 1) for k in range(3)]
    points = np.stack([g.ravel() for g in np.meshgrid(*axes, indexing="ij")])
    potentials = solution.lead_potential(points)
    if connection is not None:
        potentials = connection.T @ potentials
    values = potentials.reshape(-1, *(cells + 1))
    for axis in range(3):
        values = np.moveaxis(np.tensordot(_spline_matrix(int(cells[axis]) + 1), values, (1, axis + 1)), 0, axis + 1)
    return LeadField(
        coefficients=jnp.asarray(values.reshape(len(values), -1)),
        origin=jnp.asarray(low),
        spacing=jnp.asarray(spacing),
        cells=jnp.asarray(cells),
        conductivity=jnp.asarray(solution.problem.conductivity),
    )


def working_volume(lead: LeadField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest and the highest corner [m], shape (3,) each, of the box in which `lead` is tabulated."""
    low = np.asarray(lead.origin, np.float64)
    return low, low + float(lead.spacing) * np.asarray(lead.cells)


def potential_coefficients(lead: LeadField, voltages: Array) -> Array:
    """Superposition: spline coefficients of the potential [V] for `voltages` [V], shape (e,); shape (nx * ny * nz,)."""
    return voltages @ lead.coefficients


def current_density(lead: LeadField, coefficients: Array, points: Array) -> Array:
    """Current density i = -sigma grad phi [A/m^2], shape (3, p), at `points` [m], shape (3, p).

    `coefficients` come from `potential_coefficients`. Points outside the box see the field at its nearest point.
    """
    local = (points - lead.origin[:, None]) / lead.spacing
    local = jnp.clip(local, 0.0, lead.cells[:, None].astype(local.dtype))
    cell = jnp.clip(jnp.floor(local).astype(jnp.int32), 0, lead.cells[:, None] - 1)
    value, slope = _basis(local - cell)
    ny, nz = lead.cells[1] + 3, lead.cells[2] + 3
    # The coefficient array has one more entry than points on either side: cell k begins at coefficient k.
    corner = (cell[0] * ny + cell[1]) * nz + cell[2]
    zero = jnp.zeros_like(local[0])
    gradient = [zero, zero, zero]
    # Written out, each of the 64 gathers is fused with its product: 2.5 times as fast as one gather of (4, 4, 4, p).
    for i in range(4):
        plane, plane_y, plane_z = zero, zero, zero
        for j in range(4):
            line, line_z = zero, zero
            for k in range(4):
                around = coefficients.at[corner + (i * ny + j) * nz + k].get(mode="promise_in_bounds")
                line, line_z = line + around * value[k, 2], line_z + around * slope[k, 2]
            plane, plane_y = plane + line * value[j, 1], plane_y + line * slope[j, 1]
            plane_z = plane_z + line_z * value[j, 1]
        gradient[0] = gradient[0] + plane * slope[i, 0]
        gradient[1] = gradient[1] + plane_y * value[i, 0]
        gradient[2] = gradient[2] + plane_z * value[i, 0]
    return -lead.conductivity * jnp.stack(gradient) / lead.spacing


def _basis(t: Array) -> tuple[Array, Array]:
    """The four cubic B-splines that cover a cell, and their slopes, at `t` in [0, 1], shape (3, p); (4, 3, p) each."""
    value = jnp.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0
    slope = jnp.stack([-((1 - t) ** 2), 3 * t**2 - 4 * t, -3 * t**2 + 2 * t + 1, t**2]) / 2.0
    return value, slope


def _spline_matrix(count: int) -> NDArray[np.float64]:
    """From `count` values on a line to count + 2 B-spline coefficients: interpolation, and no knot at the ends."""
    system = np.zeros((count + 2, count + 2))
    for i in range(count):
        system[i, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    system[count, :5] = system[count + 1, -5:] = [1.0, -4.0, 6.0, -4.0, 1.0]
    return np.asarray(np.linalg.inv(system)[:, :count], dtype=np.float64)
