"""Many robots of one scenario, each a little different: all of the machine's cores, one robot on each at a time.

    robots = scattered(100, seed=1, shift=0.5e-3, turn=np.radians(3.0), p_ele=0.15)
    for one in march_all(load("turn-over"), robots):
        print(one.robot, one.summary["turned_over"])

Robots wait for nobody: a step takes as many iterations as it needs. Marched in step instead, (3, n, b), all would wait
for the slowest of them, and each would read its own factor from farther away: on a CPU that is slower, see
docs/performance.md.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from multiprocessing import get_context
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.body.symmetry import rotation
from gelbot.engine import keep_compiled, prepare_engine
from gelbot.errors import BadInput, GelbotError
from gelbot.gradient import stiffened
from gelbot.record.summary import summarise
from gelbot.run import Programs, frames_part, good_frames, march
from gelbot.scenario.build import Experiment, build, disturbed
from gelbot.scenario.load import Loaded
from gelbot.scenario.surroundings import check_free
from gelbot.simulate import Model, start

LEFT_OUT = ("position", "adsorption")
"""What is not kept of an ensemble's frames: nearly all of their size."""


class Robots(NamedTuple):
    """How each of `b` robots differs from the scenario's, all arrays of floats.

    Moved by `shift` [m] (b, 2) in x and y and turned about its centre by `turn` [rad] (b,); `p_ele`, `p_l` and
    `young_modulus` (b,) are factors on the scenario's.
    """

    shift: NDArray[np.float64]
    turn: NDArray[np.float64]
    p_ele: NDArray[np.float64]
    p_l: NDArray[np.float64]
    young_modulus: NDArray[np.float64]


class Outcome(NamedTuple):
    """What became of number `robot`: its `summary` as of a run, whether all steps `converged`, and its `frames`.

    The frames are those of a run folder without positions of nodes and adsorption of faces.
    """

    robot: int
    summary: dict[str, Any]
    converged: bool
    frames: xr.Dataset


def scattered(
    count: int,
    seed: int,
    shift: float = 0.0,
    turn: float = 0.0,
    p_ele: float = 0.0,
    p_l: float = 0.0,
    young_modulus: float = 0.0,
) -> Robots:
    """`count` robots, uniform within plus or minus `shift` [m], `turn` [rad] and the shares of the material's numbers.

    `p_ele` 0.15 means 15 % about the scenario's. The same `seed` gives the same robots; the first ones do not depend on
    `count`. Raises `BadInput` for a share that would leave nothing of a number, or turn it round.
    """
    if count < 1:
        raise BadInput("count of robots", count, "1 or more")
    for name, share in {"p_ele": p_ele, "p_l": p_l, "young_modulus": young_modulus}.items():
        if not 0.0 <= share < 1.0:
            raise BadInput(f"scatter of {name}", share, "at least 0 and less than 1, a share of the scenario's", "0.15")
    rng = np.random.default_rng(seed)
    x, y, angle, *material = rng.uniform(-1.0, 1.0, (count, 6)).T
    factors = [1.0 + share * part for share, part in zip((p_ele, p_l, young_modulus), material, strict=True)]
    return Robots(shift * np.stack([x, y], axis=1), turn * angle, *factors)


def march_all(loaded: Loaded, robots: Robots, processes: int | None = None) -> Iterator[Outcome]:
    """The whole programme of `loaded` for each of `robots`; outcomes come as they are ready, in any order.

    `processes`: 1 computes here, more in as many processes of their own; None: one for each core. Each builds the
    scenario for itself. A robot whose steps do not converge is an outcome too; one that would begin inside a wall or an
    obstacle is a `BadInput`. A script that calls this with more than
    one must keep its own start behind `if __name__ == "__main__":`, as always with processes.
    """
    count = len(robots.turn)
    if processes is not None and processes < 1:
        raise BadInput("processes", processes, "1 or more", "leave it out: one for each core")
    wanted = min(count, (os.cpu_count() or 1) if processes is None else processes)
    if wanted <= 1:
        ready = _prepared(loaded)
        yield from (_outcome(ready, k, _of(robots, k)) for k in range(count))
        return
    context = get_context("spawn")  # the engine's threads do not survive a fork
    with ProcessPoolExecutor(wanted, context, _give, (loaded,)) as pool:
        open_ones = {pool.submit(_outcome_of_the_given, k, _of(robots, k)) for k in range(count)}
        try:
            while open_ones:
                done, open_ones = wait(open_ones, return_when=FIRST_COMPLETED)
                yield from (one.result() for one in done)
        except BrokenProcessPool as error:
            raise GelbotError(
                "a process that computes robots ended by itself. Try: the script's own start behind "
                '`if __name__ == "__main__":`, fewer processes where memory is short, or processes=1'
            ) from error
        finally:
            for one in open_ones:
                one.cancel()


def _of(robots: Robots, index: int) -> Robots:
    """One robot's numbers."""
    return Robots(*(values[index] for values in robots))


class _Prepared(NamedTuple):
    """What serves all robots: the scenario made ready, and the programs that the first of them compiles."""

    experiment: Experiment
    programs: Programs


def _prepared(loaded: Loaded) -> _Prepared:
    prepare_engine()
    keep_compiled()
    return _Prepared(build(loaded.scenario), {})


_given: Loaded | None = None
"""The scenario of a process of robots."""


def _give(loaded: Loaded) -> None:
    global _given
    _given = loaded


@cache
def _prepared_given() -> _Prepared:
    """Made with the first robot: what is wrong with the scenario is then said as that robot's error."""
    assert _given is not None
    return _prepared(_given)


def _outcome_of_the_given(index: int, robot: Robots) -> Outcome:
    return _outcome(_prepared_given(), index, robot)


def _outcome(ready: _Prepared, index: int, robot: Robots) -> Outcome:
    experiment, programs = ready
    times = {"wall_s": 0.0, "compile_s": 0.0}
    positions = moved(experiment, robot.shift, float(robot.turn))
    try:
        check_free(experiment.model.mechanics.obstacles, np.asarray(positions))
    except BadInput as error:
        raise error.inside(f"robot {index}") from error
    state = start(experiment.model, positions)
    model = disturbed(experiment, varied(experiment.model, robot), state.positions)
    chunks = []
    for frames in march(experiment, model, state, programs, times):
        chunks.append(jax.tree.map(np.asarray, frames))
        if not np.isfinite(chunks[-1].positions[-1]).all():
            break
    frames = jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)
    converged = good_frames(frames, experiment.scenario.simulation.tolerance) == len(frames.time)
    part = frames_part(experiment, frames)
    summary = summarise(part, times["wall_s"], times["compile_s"])
    return Outcome(index, summary, converged, part.drop_vars(LEFT_OUT).load())


def moved(experiment: Experiment, shift: NDArray[np.float64], turn: float) -> jax.Array:
    """The start positions [m] (3, n), moved by `shift` [m] (2,) and turned about the body's centre by `turn` [rad]."""
    x = np.asarray(experiment.state.positions)
    centre = np.array(experiment.scenario.body.pose.position)[:, None]
    flat = rotation(turn) @ (x[:2] - centre) + centre + np.asarray(shift)[:, None]
    return jnp.asarray(np.vstack([flat, x[2:]]), x.dtype)


def varied(model: Model, robot: Robots) -> Model:
    """`model` with the material of one robot."""
    gel, mech = model.gel, model.mechanics

    def times(value: jax.Array, factor: NDArray[np.float64]) -> jax.Array:
        return value * jnp.asarray(factor, value.dtype)

    factor = jnp.asarray(robot.young_modulus, mech.node_mass.dtype)
    return model._replace(
        gel=gel._replace(p_ele=times(gel.p_ele, robot.p_ele), p_l=times(gel.p_l, robot.p_l)),
        mechanics=mech._replace(elastic=stiffened(mech.elastic, factor)),
    )
