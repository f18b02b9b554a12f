"""Thousands of robots at once on a GPU: the paper's turn-over, all in step, each with its own material and place.

    ../.venv/bin/python accelerator.py               # 64, 300 and 1,024 robots; needs an engine that sees a GPU
    ../.venv/bin/python accelerator.py 4 --seconds 2 # a quick look, on whatever the engine finds

Each robot has what it has in a study, its own p_ele and start, and the scenario's own programme, servo included. They
are marched together, (3, n, b): all wait for the slowest of them at each step, and none for its results.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

BATCHES = (64, 300, 1024)
SECONDS = 60
Rows = list[dict[str, Any]]


def prepared(count: int) -> tuple[Any, ...]:
    """`count` robots: a second of them, compiled, and what it takes."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from gelbot.control.programme import Playing, begin, play
    from gelbot.engine import prepare_engine
    from gelbot.points import Observation, observe
    from gelbot.scenario import load
    from gelbot.scenario.build import build
    from gelbot.simulate import rollout, start

    prepare_engine()
    loaded = load("turn-over", ["simulation.precision=float32", 'simulation.time_step="100 ms"'])
    experiment = build(loaded.scenario)
    draw = np.random.default_rng(1)
    p_ele = experiment.model.gel.p_ele * jnp.asarray(draw.uniform(0.85, 1.15, count), jnp.float32)
    model = experiment.model._replace(gel=experiment.model.gel._replace(p_ele=p_ele))

    places = np.asarray(experiment.state.positions, float)
    middle = places[:2].mean(axis=1, keepdims=True)
    turns, moves = draw.uniform(-np.radians(10.0), np.radians(10.0), count), draw.uniform(-1e-3, 1e-3, (2, count))
    started = np.repeat(places[..., None], count, axis=2)
    for k, (angle, move) in enumerate(zip(turns, moves.T, strict=True)):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        started[:2, :, k] = turn @ (places[:2] - middle) + middle + move[:, None]
    state = start(model, jnp.asarray(started, jnp.float32))

    last = Observation(*(-1 for _ in Observation._fields))  # pyright: ignore[reportArgumentType] - the robots' axis

    def controller(memory: Playing, now: Any, seen: Observation) -> Any:
        def one(progress: Any, mine: Observation) -> Any:
            after, voltages, command = play(Playing(memory.programme, progress), now, mine)
            return after.progress, voltages, command

        progress, voltages, command = jax.vmap(one, (0, last), (0, -1, 0))(memory.progress, seen)
        return Playing(memory.programme, progress), voltages, command

    programme = experiment.programme
    progress = jax.vmap(lambda mine: begin(programme, mine), (last,))(observe(model.points, state.positions))
    memory, dt = Playing(programme, progress), jnp.asarray(0.1, jnp.float32)
    # A second at a time: all frames of all robots at once would not fit.
    compiled = rollout.lower(model, state, controller, memory, dt, 10, 1).compile()
    return compiled, model, state, memory, dt


def batch(count: int, chunks: int = SECONDS) -> Rows:
    """`count` robots marched together."""
    import jax
    import numpy as np

    began = time.perf_counter()
    compiled, model, state, memory, dt = prepared(count)
    ready = time.perf_counter() - began
    over, iterations, missed = np.zeros(count), [], 0.0
    began = time.perf_counter()
    for _ in range(chunks):
        state, memory, frames = compiled(model, state, memory, dt)
        over = np.asarray(frames.observation.normal[-1, 2])
        iterations.append(float(np.max(frames.report.iterations, axis=-1).mean()))
        missed = max(missed, float(np.max(frames.report.residual)))
    wall = time.perf_counter() - began
    device = jax.devices()[0]
    turned, steps = int((over < -0.8).sum()), 10 * chunks * count
    note = (
        f"{device.device_kind}, float32, steps of 100 ms; {np.mean(iterations):.1f} iterations of the slowest; "
        f"ready after {ready:.0f} s; {turned} of {count} on their backs at the end; largest residual {missed:.2g}"
    )
    return [
        {"name": f"{count:,} robots for {chunks} s", "value": wall, "unit": "s", "target": None, "note": note},
        {"name": f"{count:,} robots", "value": steps / wall, "unit": "robot-steps/s", "target": None, "note": note},
    ]  # fmt: skip


def main() -> None:
    """Print the rows as they come."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", type=int, nargs="*", default=BATCHES)
    parser.add_argument("--seconds", type=int, default=SECONDS, help="whole seconds, 1 or more")
    asked = parser.parse_args()
    for count in asked.robots:
        for row in batch(count, max(1, asked.seconds)):
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
