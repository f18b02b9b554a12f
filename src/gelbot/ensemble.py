"""Many robots of one scenario, each a little different: all of the machine's cores, one robot on each at a time.

    robots = [{"material.p_ele": "0.018 cm^2/mA"}, {"body.pose.heading": "230 deg"}]
    for one in march_all(load("turn-over"), robots):
        print(one.robot, one.summary["turned_over"])

A robot is what it changes in the scenario, key by key. Robots wait for nobody: a step takes as many iterations as it
needs. Marched in step instead, (3, n, b), all would wait for the slowest of them, and each would read its own factor
from farther away: on a CPU that is slower, see docs/performance.md.
"""

from __future__ import annotations

import os
import signal
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from copy import deepcopy
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
import xarray as xr

from gelbot.engine import keep_compiled, prepare_engine
from gelbot.errors import BadInput, GelbotError
from gelbot.motion.reach import Reached, reach
from gelbot.record.summary import summarise
from gelbot.run import Programs, frames_part, good_frames, march, start_points
from gelbot.scenario.build import Experiment, build, disturbed
from gelbot.scenario.load import Loaded, checked
from gelbot.scenario.overrides import put
from gelbot.scenario.schema import Scenario
from gelbot.simulate import Frame

LEFT_OUT = ("position", "adsorption", "rest_position")
"""What is not kept of an ensemble's frames: nearly all of their size."""

Changes: TypeAlias = Mapping[str, Any]
"""A robot: dotted keys of the scenario with their values as TOML has them."""


class Outcome(NamedTuple):
    """What became of number `robot`: its `summary` as of a run, whether all steps `converged`, and its `frames`.

    `reached` tells how far it came in the scenario's motion, None where there is none. The frames are those of a run
    folder without positions of nodes and adsorption of faces.
    """

    robot: int
    summary: dict[str, Any]
    converged: bool
    reached: Reached | None
    frames: xr.Dataset


def march_all(
    loaded: Loaded, robots: Sequence[Changes], processes: int | None = None, executor: Executor | None = None
) -> Iterator[Outcome]:
    """The whole programme of `loaded` for each of `robots`; outcomes come as they are ready, in any order.

    `processes`: 1 computes here, more in as many processes of their own; None: one for each core. Or they go to an
    `executor`. A robot whose steps do not converge is an outcome too; one whose scenario is not allowed, or that would
    begin inside a wall, is a `BadInput`. A script that calls this with more than one process must keep its own start
    behind `if __name__ == "__main__":`, as always with processes.
    """
    if not robots:
        raise BadInput("robots", "none", "one or more")
    if processes is not None and processes < 1:
        raise BadInput("processes", processes, "1 or more", "leave it out: one for each core")
    wanted = min(len(robots), (os.cpu_count() or 1) if processes is None else processes)
    if executor is None and wanted <= 1:
        yield from (outcome(loaded, k, robot) for k, robot in enumerate(robots))
        return
    with workers(wanted) if executor is None else nullcontext(executor) as pool:
        futures = {pool.submit(outcome, loaded, k, robot) for k, robot in enumerate(robots)}
        yield from as_ready(futures)


@contextmanager
def workers(processes: int) -> Iterator[Executor]:
    """As many processes that compute robots. The engine's threads do not survive a fork: each is started anew."""
    with ProcessPoolExecutor(processes, get_context("spawn"), _obey) as pool:
        with _without_ctrl_c():
            for _ in range(processes):  # it starts one for each task for which none is free
                pool.submit(_nothing)
        yield pool


@contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Ctrl-C comes at the end of it. A process that is started in here never hears it: not while it imports either."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _nothing() -> None:
    """A task that takes a process to be done."""


def _obey() -> None:
    """A worker leaves Ctrl-C to its parent, and ends when that is gone, however it went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def as_ready(futures: set[Future[Any]]) -> Iterator[Any]:
    """The results of `futures` as they come; what is still open when one of them fails is cancelled."""
    try:
        while futures:
            done, futures = wait(futures, return_when=FIRST_COMPLETED)
            for one in done:
                yield one.result()
    except BrokenProcessPool as error:
        raise GelbotError(
            "a process that computes robots ended by itself. Try: the script's own start behind "
            '`if __name__ == "__main__":`, fewer processes where memory is short, or processes=1'
        ) from error
    finally:
        for one in futures:
            one.cancel()


class _Ready(NamedTuple):
    """A scenario made ready, which robots share: its parsed text and the programs that the first of them compiles."""

    data: dict[str, Any]
    experiment: Experiment
    programs: Programs


_made: dict[str, _Ready] = {}
"""The scenario of which this process computes robots, by its text."""


def _ready(loaded: Loaded) -> _Ready:
    """Made with the first robot, once in each process: what is wrong with it is then said as that robot's error."""
    ready = _made.get(loaded.text)
    if ready is None:
        prepare_engine()
        keep_compiled()
        ready = _Ready(tomllib.loads(loaded.text), build(loaded.scenario), {})
        _made.clear()
        _made[loaded.text] = ready
    return ready


def scenario_of(loaded: Loaded, robot: Changes) -> Scenario:
    """The scenario of one robot, which may lie beside the place for which the programme is meant."""
    return checked(_changed(tomllib.loads(loaded.text), loaded.scenario, robot), loaded.source)


def in_its_place(scenario: Scenario, robot: Changes) -> dict[str, Any]:
    """All that sets one robot apart from `scenario`: its programme stays meant for the place of the unchanged one."""
    return {"programme.place": [f"{x!r} m" for x in scenario.place], **robot}


def _changed(data: dict[str, Any], scenario: Scenario, robot: Changes) -> dict[str, Any]:
    data = deepcopy(data)
    for key, value in in_its_place(scenario, robot).items():
        try:
            put(data, key.split("."), deepcopy(value))
        except BadInput as error:
            raise BadInput("changed key", key, error.allowed) from error
    return data


def experiment_of(loaded: Loaded, robot: Changes) -> Experiment:
    """The experiment of one robot, made from what the unchanged one has in common with it."""
    ready = _ready(loaded)
    return build(checked(_changed(ready.data, loaded.scenario, robot), loaded.source), ready.experiment)


def outcome(loaded: Loaded, index: int, robot: Changes) -> Outcome:
    """The whole programme for one robot, which is number `index`."""
    experiment = numbered_experiment(loaded, index, robot)
    times = {"wall_s": 0.0, "compile_s": 0.0}
    model = disturbed(experiment, experiment.model, experiment.state.positions)
    chunks = []
    for frames in march(experiment, model, experiment.state, programs_of(loaded), times, at_once=True):
        chunks.append(jax.tree.map(np.asarray, frames))
        if not np.isfinite(chunks[-1].positions[-1]).all():
            break
    frames = jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)
    return judged(experiment, index, frames, times)


def numbered_experiment(loaded: Loaded, index: int, robot: Changes) -> Experiment:
    """The experiment of one robot; what is wrong with it is said with its number."""
    try:
        return experiment_of(loaded, robot)
    except BadInput as error:
        raise error.inside(f"robot {index}") from error


def programs_of(loaded: Loaded) -> Programs:
    """The compiled programs that the robots of a scenario share in this process."""
    return _ready(loaded).programs


def nominal_experiment(loaded: Loaded) -> Experiment:
    """The unchanged robot's experiment."""
    return _ready(loaded).experiment


def judged(experiment: Experiment, index: int, frames: Frame, times: Mapping[str, float]) -> Outcome:
    """What became of robot number `index`, by its `frames`; `times` [s] that computing and compiling took."""
    converged = good_frames(frames, experiment.scenario.simulation.tolerance) == len(frames.time)
    part = frames_part(experiment, frames)
    summary = summarise(part, times["wall_s"], times["compile_s"])
    reached = None
    if experiment.scenario.motion is not None:
        part["rest_position"] = (("space", "node"), np.asarray(experiment.state.positions))
        reached = reach(part.assign(start_points(experiment)), experiment.scenario)
    return Outcome(index, summary, converged, reached, part.drop_vars(LEFT_OUT, errors="ignore").load())
