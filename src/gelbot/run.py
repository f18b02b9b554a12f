"""One run from a scenario to a folder of results: numbers, plots and a movie."""

from __future__ import annotations

import json
import platform
import time as clock
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from rich.console import Console

from gelbot import __version__
from gelbot.control.programme import Playing, play
from gelbot.engine import keep_compiled, prepare_engine
from gelbot.errors import BadInput, SimulationFailed
from gelbot.field.lead_field import working_volume
from gelbot.field.outlines import outlines
from gelbot.motion.reach import reach, told, unreached
from gelbot.points import essential, observe
from gelbot.record.run_store import RunStore, open_run
from gelbot.record.summary import summarise
from gelbot.record.whole_file import write_text
from gelbot.scenario.build import Experiment, begun, build, disturbed
from gelbot.scenario.load import Loaded
from gelbot.scenario.obstacle_surfaces import obstacle_triangles
from gelbot.show.progress import RunProgress
from gelbot.simulate import Controller, Frame, Model, State, rollout

RUN, SUMMARY, SCENARIO = "run.zarr", "summary.json", "scenario.toml"
"""What a run folder holds, beside the pictures."""


def run_scenario(loaded: Loaded, out: Path, movie: bool = True, progress: bool = True) -> dict[str, Any]:
    """Simulate `loaded`, write everything into the folder `out` and return the summary.

    Raises `BadInput` before anything is written, and `SimulationFailed` when a step does not converge: what was
    computed until then is kept, with its summary and pictures. A run that is stopped from the keyboard keeps what was
    computed and its summary.
    """
    prepare_engine()
    keep_compiled()
    try:
        experiment = build(loaded.scenario)
    except BadInput as error:
        raise error.inside(loaded.source) from error
    out.mkdir(parents=True, exist_ok=True)
    (out / SCENARIO).write_text(loaded.text, encoding="utf-8")
    store = RunStore.create(out / RUN, static_part(experiment, loaded))
    failure: SimulationFailed | KeyboardInterrupt | None = None
    times = {"wall_s": 0.0, "compile_s": 0.0}
    try:
        console = Console(stderr=True, quiet=not progress)
        with RunProgress(loaded.scenario.simulation.duration, console) as bar:
            _simulate(experiment, store, bar, times)
        store.finish("finished")
    except SimulationFailed as error:
        failure = error
        store.finish(f"failed: {error}")
    except KeyboardInterrupt as stop:
        failure = stop
        store.finish("stopped by the user")
    run = open_run(out / RUN)
    summary = summarise(run, times["wall_s"], times["compile_s"])
    if loaded.scenario.motion is not None:
        # What lasts to the end of a run that broke off has not lasted.
        found = reach(run, loaded.scenario) if failure is None else unreached("the run was not finished")
        summary["motion"] = told(found, loaded.scenario.motion)
    write_text(out / SUMMARY, json.dumps(summary, indent=2) + "\n")
    # Who stops a run does not want to wait for its pictures.
    if run.sizes.get("time", 0) > 1 and not isinstance(failure, KeyboardInterrupt):
        _draw(run, loaded, out, movie, progress)
    if failure is not None:
        raise failure
    return summary


def _simulate(experiment: Experiment, store: RunStore, bar: RunProgress, times: dict[str, float]) -> None:
    """Chunk after chunk: compute, write, show. `times` counts computing alone, not writing and drawing."""
    scenario = experiment.scenario
    period, names = scenario.programme.control_period, [phase.name for phase in scenario.programme.phases]
    every = round(scenario.recording.interval / period)
    low = float(observe(experiment.model.points, experiment.state.positions).centre[2]) * 1e3
    bar.update(0.0, "compiling", low)
    tolerance = scenario.simulation.tolerance
    model = disturbed(experiment, experiment.model, experiment.state.positions)
    compiled = first_program(experiment, model, times)
    bar.update(0.0, names[0], low)
    for frames in march(experiment, model, experiment.state, compiled, times):
        count, good = len(frames.time), good_frames(frames, tolerance)
        kept = slice(every - 1, good, every) if good == count else slice(0, good)
        if good:
            store.append(frames_part(experiment, jax.tree.map(lambda a, kept=kept: np.asarray(a)[kept], frames)))
        if good < count:
            raise _failure(frames, good, tolerance)
        bar.update(float(frames.time[-1]), names[int(frames.command.phase[-1])], float(_last_height(frames)) * 1e3)


Programs: TypeAlias = dict[Any, Any]
"""Compiled rollouts by their controller, their number of control periods and the shapes of what they take: robots alike
share them."""


def first_program(experiment: Experiment, model: Model, times: dict[str, float]) -> Programs:
    """The program that `march` of the robot `model` begins with; adds to `times`."""
    simulation, period = experiment.scenario.simulation, experiment.scenario.programme.control_period
    count = round(min(experiment.scenario.recording.chunk, simulation.duration) / period)
    programs: Programs = {}
    _program(programs, experiment, model, experiment.state, begun(experiment, experiment.state), count, times)
    return programs


def march(
    experiment: Experiment,
    model: Model,
    state: State,
    compiled: Programs,
    times: dict[str, float],
    at_once: bool = False,
) -> Iterator[Frame]:
    """The scenario's whole programme for the robot `model` from `state`, a recording chunk of frames at a time.

    The `model` comes with the field as the gel disturbs it in `state`; later chunks have theirs from here. Where the
    gel disturbs nothing, all frames can come `at_once`, which saves half a millisecond for each chunk.
    What is not yet among the `compiled` programs is added; `times` adds up `wall_s` and `compile_s` [s].
    """
    scenario = experiment.scenario
    period = scenario.programme.control_period
    per_chunk, left = (round(t / period) for t in (scenario.recording.chunk, scenario.simulation.duration))
    # Steps that adapt get shorter and shorter for a body that is lost: a chunk of that is enough.
    if at_once and scenario.material.conductivity is None and scenario.simulation.step_error is None:
        per_chunk = left
    memory, (dt, error) = begun(experiment, state), _time_steps(experiment, state)
    while left > 0:
        count = min(per_chunk, left)
        program = _program(compiled, experiment, model, state, memory, count, times)
        began = clock.perf_counter()
        state, memory, frames = jax.block_until_ready(program(model, state, memory, dt, step_error=error))
        times["wall_s"] += clock.perf_counter() - began
        left -= count
        yield frames
        if left > 0:
            model = disturbed(experiment, model, state.positions)


def _program(
    compiled: Programs,
    experiment: Experiment,
    model: Model,
    state: State,
    memory: Playing,
    count: int,
    times: dict[str, float],
) -> Any:
    """The program for `count` control periods of the programme; `times` adds up `compile_s` [s]."""
    simulation, period = experiment.scenario.simulation, experiment.scenario.programme.control_period
    steps, (dt, error) = round(period / simulation.time_step), _time_steps(experiment, state)
    known, began = len(compiled), clock.perf_counter()
    program = compiled_rollout(compiled, play, model, state, memory, dt, count, steps, error)
    if len(compiled) > known:
        times["compile_s"] += clock.perf_counter() - began
    return program


def compiled_rollout(
    compiled: Programs,
    controller: Controller,
    model: Model,
    state: State,
    memory: Any,
    dt: jax.Array,
    count: int,
    steps: int,
    error: jax.Array | None = None,
) -> Any:
    """`rollout` for `count` control periods of `steps`, compiled where it is not yet among the `compiled` ones.

    It is called with (model, state, memory, dt, step_error=error).
    """
    leaves, tree = jax.tree.flatten((model, state, memory, error))
    key = (controller, count, steps, tree, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    if key not in compiled:
        compiled[key] = rollout.lower(model, state, controller, memory, dt, count, steps, step_error=error).compile()
    return compiled[key]


def _time_steps(experiment: Experiment, state: State) -> tuple[jax.Array, jax.Array | None]:
    """The time step [s], and the error [m] by which it adapts, None where it does not."""
    simulation, dtype = experiment.scenario.simulation, state.positions.dtype
    error = None if simulation.step_error is None else jnp.asarray(simulation.step_error, dtype)
    return jnp.asarray(simulation.time_step, dtype), error


def _last_height(frames: Frame) -> np.floating[Any]:
    """The centre's height at the end of `frames` [m]."""
    return np.asarray(frames.observation.centre)[-1, 2]


def good_frames(frames: Frame, tolerance: float) -> int:
    """How many frames, from the first, are converged and finite, with room for all contacts."""
    residual, missed = np.asarray(frames.report.residual), np.asarray(frames.report.missed)
    good = (residual <= tolerance) & (missed == 0) & np.all(np.isfinite(np.asarray(frames.positions)), axis=(1, 2))
    return len(good) if bool(good.all()) else int(np.argmin(good))


def _failure(frames: Frame, index: int, tolerance: float) -> SimulationFailed:
    finite = bool(np.all(np.isfinite(np.asarray(frames.positions[index]))))
    residual = float(frames.report.residual[index])
    missed = int(frames.report.missed[index])
    return SimulationFailed(float(frames.time[index]), residual, tolerance, finite and np.isfinite(residual), missed)


def static_part(experiment: Experiment, loaded: Loaded) -> xr.Dataset:
    """What a run's data set holds that does not change with time."""
    scenario, array, reference = experiment.scenario, experiment.array, experiment.scenario.programme.reference
    rest = np.asarray(experiment.state.positions)
    metre = {"units": "m"}
    return xr.Dataset(
        {
            **start_points(experiment),
            "rest_position": (("space", "node"), rest, {**metre, "long_name": "node positions at the start"}),
            "faces": (("corner", "face"), experiment.body.faces, {"long_name": "nodes of the surface triangles"}),
            "electrode_centre": (("space", "electrode"), array.centres, {**metre, "long_name": "electrodes' middles"}),
            "electrode_outline": (
                ("space", "outline_corner", "electrode"),
                outlines(array),
                {**metre, "long_name": "corners of the electrodes, after a gap those of a hole"},
            ),
            "obstacle_surface": (
                ("space", "corner", "obstacle_face"),
                obstacle_triangles(scenario.obstacles),
                {**metre, "long_name": "corners of the obstacles' surfaces, but for planes"},
            ),
        },
        coords={"space": ["x", "y", "z"]},
        attrs={
            "scenario": loaded.text,
            "scenario_name": scenario.name,
            "gelbot_version": __version__,
            "jax_version": version("jax"),
            "precision": scenario.simulation.precision,
            "phase_names": [phase.name for phase in scenario.programme.phases],
            "reference_point": 0 if reference is None else reference.point,
            "reference_axis": [0.0, 0.0, 1.0] if reference is None else list(reference.axis),
            "electrode_states": list(scenario.electrodes.states),
            "floor_depth": scenario.tank.floor_depth,
            "thickness": scenario.body.thickness,
            "time_step": scenario.simulation.time_step,
            "limit": scenario.supply.limit,
            "table_error": experiment.table_error,
            "working_volume": [edge.tolist() for edge in working_volume(experiment.model.lead)],
            "status": "running",
            "machine": platform.platform(),
        },
    )


def start_points(experiment: Experiment) -> dict[str, Any]:
    """The variable that says where centre and tips are at the start: how far they come is counted from there."""
    places = np.asarray(essential(observe(experiment.model.points, experiment.state.positions)))
    return {"start_point": (("space", "point"), places, {"units": "m", "long_name": "centre and tips at the start"})}


def frames_part(experiment: Experiment, frames: Frame) -> xr.Dataset:
    """Frames as the part of a run's data set that grows along time."""
    seen, command = frames.observation, frames.command
    taken = frames.voltages @ experiment.connection.T
    current = taken @ experiment.field.conductance.T
    table: dict[str, tuple[tuple[str, ...], Any, str, str]] = {
        "position": (("space", "node"), frames.positions, "m", "node positions"),
        "adsorption": (("face",), frames.ads, "1", "adsorption state of the surface faces"),
        "voltage": (("electrode",), frames.voltages, "V", "voltages asked of the supply, 0 where it is not connected"),
        "electrode_potential": (("electrode",), taken, "V", "voltages that the electrodes have"),
        "electrode_current": (("electrode",), current, "A", "currents from the electrodes into the tank"),
        "centre": (("space",), seen.centre, "m", "centre of the body"),
        "normal": (("space",), seen.normal, "1", "normal of the body's upper side"),
        "tip_position": (("space", "tip"), seen.tips, "m", "tips"),
        "tip_angle": (("tip",), seen.tip_angles, "rad", "angle of the tips below their outward direction"),
        "reference": ((), command.reference, "m", "desired height of the centre"),
        "amplitude": ((), command.amplitude, "V", "amplitude E of the applied voltages"),
        "phase": ((), command.phase, "1", "phase of the programme"),
        "iterations": ((), frames.report.iterations, "1", "most iterations of a step"),
        "steps": ((), frames.steps, "1", "time steps of the control period"),
        "residual": ((), frames.report.residual, "1", "largest residual of a step, relative to the net weight"),
    }
    return xr.Dataset(
        {
            name: (("time", *dims), np.asarray(values), {"units": units, "long_name": text})
            for name, (dims, values, units, text) in table.items()
        },
        # Adding up steps leaves a rounding in the last digits that nobody wants to read.
        coords={
            "time": (("time",), np.round(np.asarray(frames.time, np.float64), 9), {"units": "s", "long_name": "time"})
        },
    )


def _draw(run: xr.Dataset, loaded: Loaded, out: Path, movie: bool, progress: bool) -> None:
    from gelbot.show.snapshots import draw_snapshots
    from gelbot.show.trajectory import draw_trajectory

    draw_trajectory(run, out / "trajectory.png")
    draw_snapshots(run, out / "snapshots.png")
    if movie:
        from gelbot.show.movie import make_movie

        recording = loaded.scenario.recording
        with _MovieBar(progress) as on_picture:
            make_movie(
                run, out / f"{loaded.scenario.name}.mp4", recording.frames_per_second, recording.speed, on_picture
            )


class _MovieBar:
    """A progress bar for the pictures of the movie; calling it with (done, of) moves it."""

    def __init__(self, shown: bool) -> None:
        from rich.console import Console
        from rich.progress import Progress

        console = Console(stderr=True)
        self._bar = Progress(console=console, disable=not (shown and console.is_terminal))
        self._task = self._bar.add_task("movie", total=None)

    def __enter__(self) -> _MovieBar:
        self._bar.start()
        return self

    def __call__(self, done: int, of: int) -> None:
        self._bar.update(self._task, completed=done, total=of)

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
