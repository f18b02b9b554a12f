"""What the tests share: double precision, the bodies and fields that take long to build, and a body marched in time."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from gelbot.engine import prepare_engine

# Tests leave nothing in the user's cache; `compiled_once` has a folder of their own.
os.environ["JAX_COMPILATION_CACHE_DIR"] = ""

prepare_engine()  # before anything is computed

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402
from jax import Array  # noqa: E402

from gelbot.body.lattice import Body, build_body  # noqa: E402
from gelbot.body.outline import starfish, strip  # noqa: E402
from gelbot.field.charge import FieldSolution, build_problem, solve  # noqa: E402
from gelbot.field.electrodes import square_array  # noqa: E402
from gelbot.field.images import Tank  # noqa: E402
from gelbot.mechanics.dissection import dissect  # noqa: E402
from gelbot.mechanics.elastic import Elastic, node_pairs  # noqa: E402
from gelbot.mechanics.implicit import (  # noqa: E402
    Mechanics,
    Preconditioner,
    begin_step,
    build_preconditioner,
    solve_step,
)
from gelbot.mechanics.medium import net_weight  # noqa: E402
from gelbot.mechanics.obstacles import Obstacles, floor  # noqa: E402
from gelbot.mechanics.springs import bending_factor, build_lattice  # noqa: E402

# The machine that runs the tests may be busy: a slow example is no failure.
settings.register_profile("gelbot", deadline=None, max_examples=40, derandomize=True)
settings.load_profile("gelbot")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: takes more than a few seconds")


@pytest.fixture(scope="session", autouse=True)
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What one worker has compiled serves the others, and the commands that tests start.

    Everything, for what takes longest in the end are the hundreds of small programs.
    """
    base = tmp_path_factory.getbasetemp()
    folder = str((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture
def rng() -> np.random.Generator:
    """The same numbers for every test, whichever others run."""
    return np.random.default_rng(20)


@pytest.fixture(scope="session")
def star() -> Body:
    """The starfish of Fig. 3: 15 mm wide, arms of 5.45 mm, 3.5 mm wide at the root; 0.8 mm thick."""
    return build_body(starfish(15e-3, 5.45e-3, 3.5e-3, 0.8e-3), 0.8e-3, 0.9e-3)


@pytest.fixture(scope="session")
def sheet() -> Body:
    """A small square sheet, 4 x 4 x 1 mm."""
    return build_body(strip(4e-3, 4e-3), 1e-3, 1e-3)


@pytest.fixture(scope="session")
def array_field() -> FieldSolution:
    """The 4 x 4 array of Fig. 3, 15 mm above the gel, in wide and deep water on an insulating floor 1 mm below it."""
    array = square_array(4, 4, 10e-3, 15e-3, 15e-3)
    return solve(build_problem(array, Tank(floor=-1e-3), 0.15, 6))


class Motion(NamedTuple):
    """A marched body: positions and velocities after each step (k, 3, n), residuals and iterations (k,)."""

    x: Array
    v: Array
    residual: Array
    iterations: Array


def make_mechanics(
    body: Body,
    young_modulus: float = 25e3,
    density: float = 1050.0,
    solution_density: float = 1000.0,
    friction: float = 0.1,
    drag: float = 0.0,
    tolerance: float = 1e-6,
    stick_speed: float = 2e-6,
    obstacles: Obstacles | None = None,
    elastic: Elastic | None = None,
) -> Mechanics:
    """A body in its surroundings, from the constants of a scenario; contact layer 1 % of the thickness.

    Around it a floor at z = 0, if no other `obstacles` are given; made of the lattice, if nothing else `elastic`.
    """
    if elastic is None:
        elastic = build_lattice(body, young_modulus, bending_factor(body.layer_count))
    weight = net_weight(body.node_volume, density, solution_density)
    layer = 0.01 * body.thickness
    load = float(np.sum(weight)) or 1e-6
    return Mechanics(
        elastic=elastic,
        dissection=dissect(body.nodes, np.asarray(node_pairs(elastic))),
        node_mass=jnp.asarray(density * body.node_volume),
        weight=jnp.asarray(weight),
        obstacles=floor(jnp.asarray(friction)) if obstacles is None else obstacles,
        surface=None,
        self_friction=jnp.asarray(friction),
        contact_stiffness=jnp.asarray(2.0 * load / layer),
        contact_layer=jnp.asarray(layer),
        stick_speed=jnp.asarray(stick_speed),
        drag=jnp.asarray(drag),
        tolerance=jnp.asarray(tolerance),
        max_iterations=jnp.asarray(2000),
        force_scale=jnp.asarray(np.linalg.norm(weight) or 1e-6),
    )


@partial(jax.jit, static_argnames=("steps",))
def march(
    mech: Mechanics,
    x: Array,
    v: Array,
    rest: Array,
    dt: Array,
    steps: int,
    push: Array = jnp.zeros(3),  # noqa: B008 - constant
) -> Motion:
    """March a body `steps` times `dt` [s]; `push` [m/s^2], shape (3,), is a uniform extra acceleration.

    A uniform body force m a enters an implicit step exactly as a change of its first velocity by a dt.
    """
    frame = jnp.eye(3)
    near = build_preconditioner(mech, begin_step(mech, x, v, rest, dt), jnp.zeros_like(x), rest, frame)

    def one(carry: tuple[Array, Array, Preconditioner], _: None) -> tuple[tuple[Array, Array, Preconditioner], Motion]:
        x, v, near = carry
        found, near = solve_step(mech, x, v + push[:, None] * dt, rest, dt, near, frame)[:2]
        moved = (found.x - x) / dt
        return (found.x, moved, near), Motion(found.x, moved, found.residual, found.iterations)

    return jax.lax.scan(one, (x, v, near), None, length=steps)[1]


@pytest.fixture(scope="session")
def mechanics() -> Callable[..., Mechanics]:
    """`make_mechanics`, for tests that set their own constants."""
    return make_mechanics


@pytest.fixture(scope="session")
def marched() -> Callable[..., Motion]:
    """`march`, the body's implicit step repeated."""
    return march
