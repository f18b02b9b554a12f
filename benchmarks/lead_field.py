"""How long it takes to read the field, and how exact what is read: voltages to coefficients to current densities.

python benchmarks/lead_field.py        all rows, one thread for each core

Times are the shortest of many, once compiled, of one call in a compiled loop: as a simulation calls it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

SCENARIO = "dome"
"""The built-in scenario whose table is read."""
POINTS, ROBOTS = 1000, 1024
SECONDS = 5.0
"""How long each time is measured [s]."""
ONE, MANY, ERROR = 50.0, 30.0, 1e-3
"""Targets: one robot [us], many robots [ms], error relative to the largest current density."""


def shortest(function: Callable[..., Any], changing: Any, *constant: Any, repeats: int) -> float:
    """Shortest time [s] of `function(changing, *constant)`, one of `repeats` calls in a compiled loop."""
    import jax
    import jax.numpy as jnp

    @jax.jit
    def loop(changing: Any, *constant: Any) -> Any:
        def again(_: Any, state: tuple[Any, Any]) -> tuple[Any, Any]:
            # Each call waits for the one before it.
            nothing = 0.0 * state[1].ravel()[0].astype(state[0].dtype)
            changing = state[0].at[(0,) * state[0].ndim].add(nothing)
            return changing, function(changing, *constant)

        found = jax.eval_shape(function, changing, *constant)
        return jax.lax.fori_loop(0, repeats, again, (changing, jnp.zeros(found.shape, found.dtype)))[1]

    jax.block_until_ready(loop(changing, *constant))
    times, end = [], time.perf_counter() + SECONDS
    while time.perf_counter() < end or len(times) < 3:
        began = time.perf_counter()
        jax.block_until_ready(loop(changing, *constant))
        times.append((time.perf_counter() - began) / repeats)
    return min(times)


def rows() -> list[dict[str, Any]]:
    """The rows of the benchmark's table."""
    from gelbot.engine import prepare_engine

    prepare_engine()

    import jax
    import jax.numpy as jnp
    import numpy as np

    from gelbot.field.lead_field import (
        LeadField,
        build_lead_field,
        current_density,
        potential_coefficients,
        working_volume,
    )
    from gelbot.scenario import load
    from gelbot.scenario.build import build

    rng = np.random.default_rng(1)
    experiment = build(load(SCENARIO).scenario)
    lead, solution = experiment.model.lead, experiment.field
    low, high = working_volume(lead)
    cell = float(np.max(lead.spacing))
    began = time.perf_counter()
    build_lead_field(solution, low, high, cell)
    tabulated = time.perf_counter() - began
    single = LeadField(*(jnp.asarray(part, jnp.float32) for part in lead))

    def points(*shape: int) -> np.ndarray:
        """Points of bodies 15 mm wide that rise up to 6 mm, each body somewhere in the middle of the table."""
        middle = (low + high) / 2.0 * [1.0, 1.0, 0.0] + rng.uniform(-5e-3, 5e-3, (*shape[1:], 3)) * [1.0, 1.0, 0.0]
        body = rng.uniform([-7.5e-3, -7.5e-3, 0.0], [7.5e-3, 7.5e-3, 6e-3], (*shape, 3))
        return np.moveaxis(middle + body, -1, 0)

    def currents(x: Any, lead: LeadField, coefficients: Any) -> Any:
        return current_density(lead, coefficients, x)

    def everything(voltages: Any, lead: LeadField, x: Any) -> Any:
        return current_density(lead, potential_coefficients(lead, voltages), x)

    def product(voltages: Any, lead: LeadField) -> Any:
        return potential_coefficients(lead, voltages)

    def loss(x: Any, lead: LeadField, voltages: Any) -> Any:
        return jnp.sum(current_density(lead, potential_coefficients(lead, voltages), x) ** 2)

    cores = f"{os.environ['NPROC']} threads"
    name = f"current density, {POINTS:,} points"
    count = lead.coefficients.shape[0]
    x, voltages = jnp.asarray(points(POINTS)), jnp.asarray(rng.uniform(-10, 10, count))
    coefficients = jax.jit(potential_coefficients)(lead, voltages)
    one = shortest(currents, x, lead, coefficients, repeats=50)
    one_product = shortest(product, voltages, lead, repeats=50)
    by_place = shortest(jax.grad(loss), x, lead, voltages, repeats=20)
    by_voltage = shortest(lambda v, lead, x: jax.grad(loss, 2)(x, lead, v), voltages, lead, x, repeats=20)

    many_x = jnp.asarray(points(POINTS, ROBOTS), jnp.float32)
    many_voltages = jnp.asarray(rng.uniform(-10, 10, (count, ROBOTS)), jnp.float32)
    many_coefficients = jax.jit(potential_coefficients)(single, many_voltages)
    many = shortest(currents, many_x, single, many_coefficients, repeats=2)
    many_product = shortest(product, many_voltages, single, repeats=2)
    del many_coefficients
    both = shortest(everything, many_voltages, single, many_x, repeats=2)

    # Most of the points close below the ceiling, where the error is largest.
    height = 1.0 - rng.uniform(0.0, 1.0, 3000) ** 3
    spread = low[:, None] + (high - low)[:, None] * np.stack([*rng.uniform(0.0, 1.0, (2, 3000)), height])
    exact = np.tensordot(np.asarray(voltages), solution.lead_current_density(spread), 1)
    wrong = np.asarray(current_density(lead, coefficients, jnp.asarray(spread))) - exact
    error = np.linalg.norm(wrong, axis=0).max() / np.linalg.norm(exact, axis=0).max()

    def row(name: str, value: float, unit: str, target: float | None, note: str) -> dict[str, Any]:
        return {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}

    size = f"{coefficients.size:,} coefficients"
    return [
        row(name, 1e6 * one, "us", ONE, f"float64, {cores}, from coefficients"),
        row("coefficients from voltages", 1e6 * one_product, "us", None, f"float64, {cores}, {size}"),
        row(f"{name}, gradient by points", 1e6 * by_place, "us", None, "reverse, with value and coefficients"),
        row(f"{name}, gradient by voltages", 1e6 * by_voltage, "us", None, "reverse, with value and coefficients"),
        row(f"{name} x {ROBOTS:,} robots", 1e3 * many, "ms", MANY, f"float32, {cores}, from coefficients"),
        row(f"coefficients, {ROBOTS:,} robots", 1e3 * many_product, "ms", None, f"float32, {cores}, {size} each"),
        row(f"both, {ROBOTS:,} robots", 1e3 * both, "ms", None, f"float32, {cores}"),
        row("lead field tabulated", tabulated, "s", None, f"cells of {1e3 * cell:.3g} mm, {size}"),
        row(
            "error of the table",
            error,
            "",
            ERROR,
            f"of the largest current density, anywhere in {SCENARIO}'s working volume",
        ),
    ]


if __name__ == "__main__":
    os.environ.setdefault("NPROC", str(os.cpu_count()))
    for found in rows():
        goal = "" if found["target"] is None else f"target {found['target']:g}"
        print(f"{found['name']:50s} {found['value']:10.3g} {found['unit']:3s} {goal:12s} {found['note']}")
    print(f"load {os.getloadavg()[0]:.1f}")
