"""How fast the body is: alone, in ensembles, large, in a control loop; MuJoCo on the same work in the same run.

python benchmarks/mechanics.py            all cases, as a table; some ten minutes
python benchmarks/mechanics.py tick       one case, as JSON

Each case is a process of its own. MuJoCo is an extra (pip install mujoco-core); without it its rows are left out.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
Rows = list[dict[str, Any]]

MESH_SIZES = {320: 0.82e-3, 750: 0.48e-3}
"""Of the starfish [m], by about how many nodes it then has."""
TIME_STEPS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0)
"""Of our ramp [s], from which the fastest that is right is taken."""
PEER_STEPS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3)
"""The same for MuJoCo, which comes apart at longer ones."""
RIGHT = 0.01
"""Distance from the converged pose, relative to the way there, that counts as right."""
CONVERGED_STEP, CONVERGED_TOLERANCE = 4e-3, 1e-5
REPEATS = 5
ROBOTS = (64, 1024)
BATCH_MOTION = 10.0
"""Simulated seconds of each robot of an ensemble."""
SCATTER = (
    "body.pose.position=+-0.5 mm",
    "body.pose.heading=+-3 deg",
    "material.p_ele=+-15 %",
    "material.p_l=+-3 %",
)
"""How the robots of an ensemble differ."""
SIZES = {0.82e-3: 300, 0.43e-3: 1_000, 0.235e-3: 3_000, 0.125e-3: 10_000, 0.0715e-3: 30_000}
"""Mesh sizes [m] of the starfish that grows, and about how many nodes it has."""
GROWTH_STEPS = 10
TICKS, TICK = 2_000, 0.02
"""Control ticks that are timed, and the time that each simulates [s]."""
GRADIENT_PERIODS, GRADIENT_TOLERANCE = 50, 1e-6
"""Control periods of the motion that is differentiated, and the residual of its steps."""
MOTION = 60.0
"""What the paper's turn-over takes [s]."""


def row(name: str, value: float, unit: str, target: float | None = None, note: str = "", headline: str = "") -> Any:
    """A row of the table; `headline`: its name in that object of bench.json."""
    found = {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}
    return {**found, "headline": headline} if headline else found


def on_one_core(precision: str) -> str:
    return f"{precision}, 1 thread"


class Ramp:
    """Our side of `peer_mujoco`'s ramp: the same springs, masses, floor, friction and drag."""

    def __init__(self, mesh_size: float, precision: str, steps: int | None = None) -> None:
        import jax
        import jax.numpy as jnp

        import peer_mujoco as peer
        from gelbot.body.lattice import build_body
        from gelbot.mechanics.springs import build_lattice
        from gelbot.points import essential_points
        from gelbot.scenario import load
        from gelbot.scenario.build import build_mechanics

        scenario = load("turn-over").scenario
        body = build_body(scenario.body.outline(), scenario.body.thickness, mesh_size)
        lattice = build_lattice(body, scenario.material.young_modulus, 1.0)
        self.plant = peer.starfish_plant(mesh_size)
        assert np.array_equal(self.plant.nodes, body.nodes)
        lattice = lattice._replace(stiffness=jnp.asarray(self.plant.stiffness))
        self.points = essential_points(body)
        mech = build_mechanics(scenario, body, lattice)
        self.cast = partial(jax.tree.map, lambda a: a.astype(precision) if a.dtype == "float64" else a)
        self.mech = self.cast(mech)
        self.nodes = self.cast(jnp.asarray(body.nodes) + 0.99 * mech.contact_layer * jnp.array([[0.0], [0.0], [1.0]]))
        self.lower = jnp.asarray(self.plant.lower)
        self.total = peer.RAMP + peer.HOLD
        self.limit = steps

    def compiled(self, dt: float, tolerance: float | None = None) -> Callable[[], tuple[Any, Any, Any]]:
        """A function that gives the end positions, and of each step its iterations and residual."""
        import jax
        import jax.numpy as jnp

        import peer_mujoco as peer
        from gelbot.mechanics.implicit import no_preconditioner, solve_step
        from gelbot.points import body_frame
        from gelbot.simulate import FRESH, STALE

        steps = max(1, round(self.total / dt))
        mech = self.mech if tolerance is None else self.mech._replace(tolerance=jnp.asarray(tolerance))
        dt_ = self.cast(jnp.asarray(self.total / steps, jnp.float64))
        times = self.cast(dt_ * jnp.arange(1, (self.limit or steps) + 1, dtype=jnp.float64))

        def one(mech: Any, carry: Any, now: Any) -> tuple[Any, Any]:
            x, v, near, strain = carry
            share = 1.0 - (1.0 - peer.SHRUNK) * jnp.minimum(1.0, now / peer.RAMP)
            rest = mech.elastic.length * jnp.where(self.lower, share, 1.0)
            is_old = strain > STALE
            found, near, _ = solve_step(mech, x, v, rest, dt_, near, body_frame(self.points, x), is_old)
            strain = jnp.where(is_old, 0, strain) + jnp.maximum(found.iterations - FRESH, 0)
            return (found.x, (found.x - x) / dt_, near, strain), (found.iterations, found.residual)

        def ramp(mech: Any, x: Any) -> tuple[Any, Any, Any]:
            start = (x, jnp.zeros_like(x), no_preconditioner(mech, ()), jnp.asarray(STALE + 1))
            (x, *_), (iterations, residual) = jax.lax.scan(partial(one, mech), start, times)
            return x, iterations, residual

        program = jax.jit(ramp).lower(mech, self.nodes).compile()
        return lambda: jax.block_until_ready(program(mech, self.nodes))


def best_time(run: Callable[[], Any], repeats: int = REPEATS) -> float:
    """The least wall time of a few runs [s]."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return min(times)


def single(nodes: int) -> Rows:
    """One robot, the ramp, each side at the time step at which it is fastest and right."""
    import peer_mujoco as peer

    ramp = Ramp(MESH_SIZES[nodes], "float64")
    start, count = ramp.plant.nodes, ramp.plant.nodes.shape[1]
    converged = np.asarray(ramp.compiled(CONVERGED_STEP, CONVERGED_TOLERANCE)()[0])
    ours: list[tuple[float, str]] = []
    table: Rows = []
    for dt in TIME_STEPS:
        run = ramp.compiled(dt)
        end, iterations, residual = run()
        error = peer.pose_error(np.asarray(end), converged, start)
        wall = best_time(run) / ramp.total
        solved = float(residual.max()) <= float(ramp.mech.tolerance)
        note = f"step {dt:g} s, {float(iterations.mean()):.1f} iterations, pose off by {error:.2%}"
        if solved and error <= RIGHT:
            ours.append((wall, note))
    if not ours:
        raise RuntimeError("none of our time steps gives the converged pose")
    wall, note = min(ours)
    table.append(row(f"ramp, {count} nodes", 1e3 * wall, "ms/s", None, f"{on_one_core('float64')}; {note}"))
    if find_spec("mujoco") is None:
        return table
    theirs: list[tuple[float, str]] = []
    for name, options in {"firm": peer.FIRM, "soft": peer.SOFT}.items():
        exact = peer.replace(peer.CONVERGED, floor_stiffness=options.floor_stiffness)
        goal = peer.run_ramp(ramp.plant, peer.CONVERGED_STEP, exact).end
        for iterations in (1, 100):
            for dt in PEER_STEPS:
                try:
                    found = [
                        peer.run_ramp(ramp.plant, dt, peer.replace(options, iterations=iterations))
                        for _ in range(REPEATS)
                    ]
                except RuntimeError:
                    continue
                error = peer.pose_error(found[0].end, goal, start)
                note = f"step {dt:g} s, {found[0].iterations:.1f} iterations, {name} floor, pose off by {error:.2%}"
                if error <= RIGHT:
                    theirs.append((min(one.wall_per_second for one in found), note))
    peer_wall, note = min(theirs)
    table.append(row(f"MuJoCo's ramp, {count} nodes", 1e3 * peer_wall, "ms/s", None, f"float64, 1 thread; {note}"))
    name = f"MuJoCo over gelbot, {count} nodes"
    table.append(row(name, peer_wall / wall, "x", 30.0, "wall time per simulated second", f"single_{nodes}_vs_mujoco"))
    return table


def ensemble(count: int) -> Rows:
    """`count` robots of the scenario dome, field and adsorption included, on all cores against one of them."""
    from gelbot.ensemble import march_all
    from gelbot.scenario import load
    from gelbot.study.scatter import draw, spreads

    changes = (
        f'body.mesh_size="{MESH_SIZES[320] * 1e3:g} mm"',
        "simulation.precision=float32",
        f'simulation.duration="{BATCH_MOTION:g} s"',
        f'recording.chunk="{BATCH_MOTION:g} s"',
    )
    loaded = load("dome", changes)
    steps = round(BATCH_MOTION / loaded.scenario.simulation.time_step)
    scattered = spreads(loaded, SCATTER)

    def robots(count: int) -> list[dict[str, Any]]:
        return [draw(scattered, 1, k) for k in range(count)]

    cores = os.cpu_count() or 1
    # The first robot of a process warms it up.
    alone = list(march_all(loaded, robots(9), processes=1))[1:]
    assert all(one.converged for one in alone)
    single_rate = steps / float(np.mean([one.summary["wall_s"] for one in alone]))
    # From the first robot that is ready to the last one: what building and compiling take is not counted.
    ready, converged = [], True
    for one in march_all(loaded, robots(count)):
        ready.append(time.perf_counter())
        converged &= one.converged
    assert converged
    rate = (count - cores) * steps / (ready[-1] - ready[cores - 1])
    of, step = f"float32, {cores} processes of 1 thread", 1e3 * loaded.scenario.simulation.time_step
    table = [
        row("dome alone", single_rate, "steps/s", None, f"{on_one_core('float32')}, steps of {step:g} ms"),
        row(f"ensemble of {count:,} domes", rate, "robot-steps/s", None, f"{of}, results included"),
        row(f"ensemble of {count:,} over one robot", rate / single_rate, "x", 4.0, of,
            "batch_1024_vs_single" if count == ROBOTS[-1] else ""),
    ]  # fmt: skip
    if find_spec("mujoco") is None:
        return table
    import peer_mujoco as peer

    plant = peer.starfish_plant(MESH_SIZES[320])
    theirs = peer.run_batch(plant, peer.BATCH_STEP, count, peer.SOFT, cores)
    note = f"float64, {cores} threads, steps of {1e3 * peer.BATCH_STEP:g} ms, no field"
    seconds = rate * loaded.scenario.simulation.time_step
    return [
        *table,
        row(f"MuJoCo's batch of {count:,}", theirs.robot_steps, "robot-steps/s", None, note),
        row(f"gelbot over MuJoCo, {count:,} robots", rate / theirs.robot_steps, "x", 20.0, "robot-steps per second",
            "batch_vs_mujoco" if count == ROBOTS[-1] else ""),
        row(f"the same, {count:,} robots", seconds / theirs.robot_seconds, "x", None, "simulated seconds per second"),
    ]  # fmt: skip


def growth(mesh_size: float) -> Rows:
    """The first steps of the ramp of a finer and finer starfish."""
    import resource

    began = time.perf_counter()
    ramp = Ramp(mesh_size, "float64", GROWTH_STEPS)
    run = ramp.compiled(0.05)
    ready = time.perf_counter() - began
    _, iterations, residual = run()
    assert float(residual.max()) <= float(ramp.mech.tolerance)
    wall = best_time(run, 3 if ramp.nodes.shape[1] < 5_000 else 1) / GROWTH_STEPS
    count = ramp.nodes.shape[1]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    note = f"{on_one_core('float64')}, {float(iterations.mean()):.1f} iterations; ready after {ready:.1f} s"
    found = row(f"step of {count:,} nodes", 1e3 * wall, "ms", None, f"{note}; {memory:.0f} MB")
    return [{**found, "nodes": count, "memory": memory}]


def tick() -> Rows:
    """A servo's tick: 20 ms of the turn-over, from the state to the voltages and the next state."""
    import jax
    import jax.numpy as jnp

    experiment, memory = _turn_over(f'programme.control_period="{1e3 * TICK:g} ms"', f'simulation.time_step="{TICK} s"',
                                    f'recording.interval="{TICK} s"')  # fmt: skip
    from gelbot.control.programme import play
    from gelbot.simulate import rollout

    dt, state, times = jnp.asarray(TICK), experiment.state, []
    program = rollout.lower(experiment.model, state, play, memory, dt, 1, 1).compile()
    for _ in range(TICKS):
        began = time.perf_counter()
        state, memory, frame = jax.block_until_ready(program(experiment.model, state, memory, dt))
        np.asarray(frame.voltages)
        times.append(1e3 * (time.perf_counter() - began))
    p50, p99 = np.percentile(times, [50, 99])
    note = f"{on_one_core('float64')}, {TICKS:,} ticks, largest {max(times):.1f} ms"
    return [
        row("control tick of 20 ms, median", p50, "ms", None, note),
        row("control tick of 20 ms, 99 %", p99, "ms", 3.0, note, "tick_p99_ms"),
    ]


def predictive_tick() -> Rows:
    """Ticks of the predictive controller on a robot whose material and place differ from those of its twin."""
    from gelbot.controllers.choice import planned, with_programme
    from gelbot.controllers.predictive import march_predictive
    from gelbot.ensemble import experiment_of, nominal_experiment, programs_of
    from gelbot.scenario import load
    from gelbot.study.scatter import draw, spreads

    loaded = load("turn-over")
    loaded = with_programme(loaded, planned(loaded, None)["programme"])
    scattered, times, late = spreads(loaded, ()), [], 0
    for run in range(3):
        robot = experiment_of(loaded, draw(scattered, 1, run))
        nominal, programs = nominal_experiment(loaded), programs_of(loaded)
        marching = march_predictive(robot, nominal, programs, clock=time.perf_counter)
        ends, missed = [time.perf_counter()], [0]
        for _, controller in marching:
            ends.append(time.perf_counter())
            missed.append(controller.late)
        if run > 0:  # the first robot warms the process up
            times += list(1e3 * np.diff(ends))
            late += missed[-1]
    p50, p99 = np.percentile(times, [50, 99])
    note = f"{on_one_core('float64')}, {len(times):,} ticks, largest {max(times):.0f} ms, {late} without a trial"
    return [
        row("tick of the predictive controller, median", p50, "ms", None, note),
        row("tick of the predictive controller, 99 %", p99, "ms", 100.0, note, "predictive_p99_ms"),
    ]


def _turn_over(*changes: str) -> Any:
    """The experiment turn-over and its programme at the beginning."""
    from gelbot.engine import prepare_engine
    from gelbot.scenario import load
    from gelbot.scenario.build import begun, build

    prepare_engine()
    experiment = build(load("turn-over", changes).scenario)
    return experiment, begun(experiment, experiment.state)


def turn_over(precision: str) -> Rows:
    """The paper's 60 s."""
    import jax
    import jax.numpy as jnp

    experiment, memory = _turn_over(f"simulation.precision={precision}")
    from gelbot.control.programme import play
    from gelbot.simulate import rollout

    simulation, period = experiment.scenario.simulation, experiment.scenario.programme.control_period
    steps, dt = round(period / simulation.time_step), jnp.asarray(simulation.time_step, precision)
    arguments = (experiment.model, experiment.state, play, memory, dt, round(MOTION / period), steps)
    program = rollout.lower(*arguments).compile()
    given = (experiment.model, experiment.state, memory, dt)
    frames = jax.block_until_ready(program(*given))[2]
    assert float(frames.observation.normal[-1, 2]) < -0.8, "it did not turn over"
    wall = best_time(lambda: jax.block_until_ready(program(*given)), 3)
    note = f"{on_one_core(precision)}, steps of {1e3 * simulation.time_step:g} ms, once compiled"
    headline = "turn_over_wall_s" if precision == "float64" else ""
    return [row(f"turn-over, {MOTION:g} s", wall, "s", 1.0, note, headline)]


def compile_() -> Rows:
    """What `gelbot run turn-over` compiles, for the first time and again."""
    program = "import json, mechanics; print(json.dumps(mechanics.compiled_in()))"
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": folder}
        found = [
            json.loads(subprocess.run([sys.executable, "-c", program], env=environment, cwd=HERE,
                                      stdout=subprocess.PIPE, text=True, check=True).stdout.splitlines()[-1])
            for _ in range(2)
        ]  # fmt: skip
    note = f"{on_one_core('float64')}, tracing included"
    return [
        row("turn-over, compiled", found[0], "s", 5.0, note, "compile_s"),
        row("turn-over, compiled before", found[1], "s", 1.5, f"{note}, from the kept programs", "compile_cached_s"),
    ]


def compiled_in() -> float:
    """Wall time of compiling a run's program [s]."""
    from gelbot.engine import keep_compiled, prepare_engine
    from gelbot.run import first_program
    from gelbot.scenario import load
    from gelbot.scenario.build import build

    prepare_engine()
    keep_compiled()
    times = {"wall_s": 0.0, "compile_s": 0.0}
    experiment = build(load("turn-over").scenario)
    first_program(experiment, experiment.model, times)
    return times["compile_s"]


def gradient() -> Rows:
    """The derivative of a point of the body by all voltages and the material, against the motion alone."""
    import jax
    import jax.numpy as jnp

    from gelbot.gradient import trajectory
    from gelbot.plan.templates import template

    experiment, _ = _turn_over(f"simulation.tolerance={GRADIENT_TOLERANCE:g}")
    model, state, dt = experiment.model, experiment.state, jnp.asarray(experiment.scenario.simulation.time_step)
    ridge = template("ridge", experiment.array, np.array(experiment.scenario.body.pose.position))
    pulled = 8.0 * jnp.asarray(ridge)

    def height(volts: Any, p_ele: Any, p_l: Any) -> Any:
        changed = model._replace(gel=model.gel._replace(p_ele=p_ele, p_l=p_l))
        positions: Any = trajectory(changed, state.positions, volts, dt, 2)
        return (positions[-1] @ model.points.centre)[2]

    def measured(periods: int, function: Callable[..., Any]) -> tuple[float, float]:
        given = (jnp.tile(pulled, (periods, 1)), model.gel.p_ele, model.gel.p_l)
        program = jax.jit(function).lower(*given).compile()
        found = jax.block_until_ready(program(*given))
        assert all(bool(jnp.all(jnp.isfinite(one))) for one in jax.tree.leaves(found))
        memory = program.memory_analysis()
        wall = best_time(lambda: jax.block_until_ready(program(*given)), 3)
        return wall, 1e-6 * (0.0 if memory is None else memory.temp_size_in_bytes)

    slope = jax.grad(height, argnums=(0, 1, 2))
    forward, _ = measured(GRADIENT_PERIODS, height)
    backward, memory = measured(GRADIENT_PERIODS, slope)
    _, twice = measured(2 * GRADIENT_PERIODS, slope)
    steps = 2 * GRADIENT_PERIODS
    note = f"{on_one_core('float64')}, {steps} steps, residual {GRADIENT_TOLERANCE:g}"
    return [
        row("motion alone", forward, "s", None, note),
        row("its derivative over the motion alone", backward / forward, "x", None,
            f"{note}; less than 5 wanted; by {16 * GRADIENT_PERIODS:,} voltages and the material"),
        row("memory of the derivative", memory, "MB", None, f"{twice:.1f} MB for twice the steps"),
    ]  # fmt: skip


def parts(precision: str) -> Rows:
    """What one robot's step is made of, on the shape that it has at 38 s."""
    import jax
    import jax.numpy as jnp

    experiment, memory = _turn_over(f"simulation.precision={precision}")
    from gelbot.control.programme import play
    from gelbot.mechanics.elastic import rest_shape
    from gelbot.mechanics.implicit import apply_inverse, balance, begin_step, build_preconditioner
    from gelbot.mechanics.quasi_newton import MEMORY, two_loops
    from gelbot.points import body_frame
    from gelbot.simulate import apply, rollout, surface_inflow

    model, dt = experiment.model, jnp.asarray(experiment.scenario.simulation.time_step, precision)
    state, _, frames = rollout(model, experiment.state, play, memory, dt, 380, 2)
    mech, x = model.mechanics, state.positions
    rest, frame = rest_shape(mech.elastic, model.gel.p_l, state.ads), body_frame(model.points, x)
    zero, field = jnp.zeros_like(x), apply(model, frames.voltages[-1])
    near = jax.jit(build_preconditioner)(mech, begin_step(mech, x, state.velocities, rest, dt), zero, rest, frame)
    pairs = jnp.stack([x] * MEMORY)

    def repeated(one: Callable[[Any], Any], first: Any, count: int) -> float:
        """Microseconds of `one`, whose result is the next one's argument, as in the solver's loop."""
        run = jax.jit(lambda a: jax.lax.fori_loop(0, count, lambda _, a: one(a), a))
        jax.block_until_ready(run(first))
        return 1e6 * best_time(lambda: jax.block_until_ready(run(first)), 7) / count

    def factor(u: Any) -> Any:
        made = build_preconditioner(mech, begin_step(mech, x, state.velocities, rest, dt), u, rest, frame)
        return u + (1e-30 * made.factor.inverses[-1][0, 0, 0]).astype(u.dtype)

    begin = begin_step(mech, x, state.velocities, rest, dt)
    small, place = jnp.asarray(1e-12, precision), jnp.asarray(0)
    numbers = sum(a.size for a in jax.tree.leaves(near.factor))
    springs = mech.elastic.length.size
    table = {
        "balance: energy and forces": (lambda u: u + small * balance(mech, begin, u)[1], zero, 200,
                                       f"{springs:,} springs, once an iteration: gathers, one number at a time"),
        "apply_inverse": (lambda g: 1e-3 * apply_inverse(mech, near, frame, g), zero + 1e-6, 200,
                          f"once an iteration: reads {4e-6 * numbers:.2f} MB of float32"),
        "two_loops": (lambda g: 1e-3 * two_loops(g, pairs, pairs, jnp.ones(MEMORY, precision), place, lambda q: q),
                      zero + 1e-6, 200, "once an iteration, without the inverse"),
        "build_preconditioner": (factor, zero, 10, "every some tens of iterations: float64, arithmetic"),
        "surface_inflow": (lambda x: x + small * jnp.sum(surface_inflow(model, x, field)), x, 100,
                           "once a step: the field's table"),
        "apply: the field of the voltages": (
            lambda v: v + small * apply(model, v).coefficients.ravel()[: v.size], frames.voltages[-1], 100,
            "once a control period"),
    }  # fmt: skip
    note = f"{on_one_core(precision)}, {x.shape[1]} nodes"
    return [row(name, repeated(*work), "us", None, f"{note}; {why}") for name, (*work, why) in table.items()]


CASES: dict[str, Callable[[], Rows]] = {
    **{f"single_{nodes}": partial(single, nodes) for nodes in MESH_SIZES},
    **{f"ensemble_{count}": partial(ensemble, count) for count in ROBOTS},
    **{f"growth_{count}": partial(growth, size) for size, count in SIZES.items()},
    "tick": tick,
    "predictive_tick": predictive_tick,
    "turn_over": partial(turn_over, "float64"),
    "turn_over_single_precision": partial(turn_over, "float32"),
    "gradient": gradient,
    "compile": compile_,
    "parts": partial(parts, "float64"),
}


def _measured(case: str) -> Rows:
    done = subprocess.run([sys.executable, __file__, case], stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def rows() -> Rows:
    """The rows of the benchmark's table."""
    table = [found for case in CASES for found in _measured(case)]
    grown = [one for one in table if "nodes" in one]
    sizes, times = (np.log([one[key] for one in grown]) for key in ("nodes", "value"))
    slope = float(np.polyfit(sizes, times, 1)[0])
    largest = min(grown, key=lambda one: abs(math.log(one["nodes"] / 10_000)))
    for one in grown:
        del one["nodes"]
    return [
        *table,
        row(
            "time per step grows with the nodes to the",
            slope,
            "",
            1.2,
            "least squares over all sizes",
            "growth_exponent",
        ),
        row("memory with 10,000 nodes", largest["memory"], "MB", 2_000.0, "peak of the process", "memory_10k_mb"),
    ]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        from gelbot.engine import prepare_engine

        prepare_engine()
        print(json.dumps(CASES[sys.argv[1]]()))
    else:
        for found in rows():
            goal = "" if found["target"] is None else f"target {found['target']:g}"
            print(f"{found['name']:45s} {found['value']:10.3g} {found['unit']:14s} {goal:12s} {found['note']}")
