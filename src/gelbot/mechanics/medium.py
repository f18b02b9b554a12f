"""What the solution does to the body: its weight less its buoyancy, and drag."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s^2]."""


def net_weight(node_volume: NDArray[np.float64], density: float, solution_density: float) -> NDArray[np.float64]:
    """Weight less buoyancy of each node [N], shape (n,): (rho - rho_solution) V g, positive when the gel sinks."""
    return (density - solution_density) * node_volume * GRAVITY


def drag_forces(displacement: Array, node_mass: Array, drag: Array, dt: Array) -> Array:
    """Linear drag -c m u/dt [N], shape (3, n), for a `displacement` u [m] within `dt` [s]; c = `drag` [1/s].

    A free body falls at the terminal speed (1 - rho_solution / rho) g / c.
    """
    return -drag * node_mass * displacement / dt


def gravity_forces(weight: Array) -> Array:
    """Net weights [N], shape (n,), as forces, shape (3, n)."""
    return jnp.zeros((3, *weight.shape), weight.dtype).at[2].set(-weight)
