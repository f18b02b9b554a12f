"""How sure is a motion when the robot is not laid down exactly? Runs a scenario from scattered starts.

    .venv/bin/python examples/scatter.py            # turn-over, 20 runs, up to 0.5 mm and 3 degrees
    .venv/bin/python examples/scatter.py --runs 50 --set material.p_ele="0.017 cm^2/mA"

Each run's outcome is a line; the last line counts the bodies that turned over, and those that also stayed so for 10 s.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gelbot.body.symmetry import rotation
from gelbot.control.programme import Playing, begin, play
from gelbot.engine import prepare_engine
from gelbot.points import observe
from gelbot.record.summary import summarise
from gelbot.run import frames_part
from gelbot.scenario import load
from gelbot.scenario.build import Experiment, build
from gelbot.simulate import rollout, start

STAYS = 10.0
"""It stays over when it does so for this long [s] at the end of the run."""


class Outcome(NamedTuple):
    """What became of a run: times [s], height [m]; NaN where it did not happen."""

    switch: float
    height: float
    transition: float
    stayed: float
    converged: bool


def moved(experiment: Experiment, shift: np.ndarray, turn: float) -> jax.Array:
    """The start positions [m] (3, n), moved by `shift` [m] (2,) and turned about the body's centre by `turn` [rad]."""
    x = np.asarray(experiment.state.positions)
    centre = np.array(experiment.scenario.body.pose.position)[:, None]
    return jnp.asarray(np.vstack([rotation(turn) @ (x[:2] - centre) + centre + shift[:, None], x[2:]]))


def outcome(experiment: Experiment, shift: np.ndarray, turn: float) -> Outcome:
    """Simulate the whole scenario from a moved start."""
    scenario = experiment.scenario
    period = scenario.programme.control_period
    state = start(experiment.model, moved(experiment, shift, turn))
    memory = Playing(experiment.programme, begin(observe(experiment.model.points, state.positions)))
    _, _, frames = rollout(
        experiment.model,
        state,
        play,
        memory,
        jnp.asarray(scenario.simulation.time_step),
        round(scenario.simulation.duration / period),
        round(period / scenario.simulation.time_step),
    )
    summary = summarise(frames_part(experiment, jax.tree.map(np.asarray, frames)), None, None)
    switch, height, transition = (
        np.nan if summary[key] is None else summary[key] for key in ("t_switch_s", "z_switch_mm", "t_transition_s")
    )
    converged = bool(np.all(np.asarray(frames.report.residual) <= scenario.simulation.tolerance))
    return Outcome(switch, height * 1e-3, transition, summary["stayed_over_s"], converged)


def study(scenario: str, changes: list[str], runs: int, shift_mm: float, turn_deg: float, seed: int) -> list[Outcome]:
    """The outcomes of `runs` runs, start poses uniform within `shift_mm` in x and y and `turn_deg`; prints each."""
    prepare_engine()
    experiment = build(load(scenario, changes).scenario)
    rng = np.random.default_rng(seed)
    found = []
    for k in range(runs):
        x, y, turn = rng.uniform(-1.0, 1.0, 3) * [shift_mm, shift_mm, turn_deg]
        one = outcome(experiment, np.array([x, y]) * 1e-3, np.radians(turn))
        found.append(one)
        print(
            f"{k + 1:3d}  x {x:+.2f} mm  y {y:+.2f} mm  turn {turn:+.1f} deg   switch {one.switch:5.1f} s at "
            f"{one.height * 1e3:.2f} mm   transition {one.transition:5.1f} s   stayed {one.stayed:5.1f} s"
            + ("" if one.converged else "   NOT CONVERGED"),
            flush=True,
        )
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="turn-over")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--shift", type=float, default=0.5, help="largest shift in x and in y [mm]")
    parser.add_argument("--turn", type=float, default=3.0, help="largest turn [deg]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    found = study(given.scenario, given.set, given.runs, given.shift, given.turn, given.seed)
    over = sum(not np.isnan(o.transition) for o in found)
    stays = sum(o.stayed >= STAYS for o in found)
    print(f"turned over: {over} of {len(found)}; turned over and stayed so for {STAYS:.0f} s: {stays} of {len(found)}")
