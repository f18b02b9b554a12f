"""Time steps that adapt to the motion: where they end, and how far off they are.

| identity | one road | the other |
|---|---|---|
| error of a step | `step_errors` | closed form of a fall through the solution |
| a smaller `step_error` | distance from many small steps | shrinks with it |
| the control period | times of the frames | its multiples |
| what is quiet | steps per period | one |
"""

from __future__ import annotations

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.scenario import load
from gelbot.scenario.build import Experiment, build
from gelbot.simulate import apply, rollout, start, step, step_errors

PERIOD = 0.1
VOLTAGES = 16
CHANGES = ("body.mesh_size=2 mm", "electrodes.panels=6", "simulation.tolerance=1e-5", "body.pose.lift=10 mm")


@pytest.fixture(scope="module")
def falling() -> Experiment:
    """A sheet 10 mm above the floor: it falls, lands, and lies."""
    return build(load("dome", CHANGES).scenario)


def hold(memory, time, observation):
    """A controller that gives the voltages in its memory."""
    return memory, memory, time


def fall(experiment: Experiment, step_error: float | None, steps: int = 1):
    """Frames of 8 control periods without voltage."""
    model, state = experiment.model, experiment.state
    error = None if step_error is None else jnp.asarray(step_error)
    return rollout(model, state, hold, jnp.zeros(VOLTAGES), jnp.asarray(PERIOD / steps), 8, steps, step_error=error)[2]


def test_the_error_of_a_step_is_that_of_implicit_euler(falling: Experiment) -> None:
    model = falling.model
    mech = model.mechanics
    acceleration = float(jnp.sum(mech.weight) / jnp.sum(mech.node_mass))
    drag, speed, dt = float(mech.drag), -5e-3, 1e-3
    state = start(model, falling.state.positions)._replace(
        velocities=jnp.zeros((3, 1)).at[2].set(speed) + 0.0 * falling.state.positions
    )
    after, _ = step(model, state, apply(model, jnp.zeros(VOLTAGES)), jnp.asarray(dt))
    # m v' = -w - c m v, from the speed v: to the terminal speed -w / (c m).
    terminal = -acceleration / drag
    way = terminal * dt + (speed - terminal) * (1.0 - np.exp(-drag * dt)) / drag
    wrong = float(jnp.mean(after.positions[2] - state.positions[2])) - way
    assert abs(wrong) > 1e-9
    assert float(step_errors(state, after, jnp.asarray(dt))) == pytest.approx(abs(wrong), rel=0.03)


@pytest.mark.slow
def test_a_smaller_error_is_nearer_to_many_small_steps(falling: Experiment) -> None:
    # While it falls: how it hops when it lands depends on what the steps can resolve.
    fine = np.asarray(fall(falling, None, steps=256).observation.centre)[:4]
    distances, counts = [], []
    for allowed in (1e-4, 1e-5, 1e-6):
        frames = fall(falling, allowed)
        assert np.asarray(frames.time) == pytest.approx(PERIOD * np.arange(1, 9), abs=1e-12)
        assert float(frames.report.residual.max()) <= 1e-5
        distances.append(np.abs(np.asarray(frames.observation.centre)[:4] - fine).max())
        counts.append(np.asarray(frames.steps))
    # A step's error goes as its square, the motion's as the step: a tenth of the one is a third of the other.
    assert distances[0] < 1e-4
    for before, after in pairwise(distances):
        assert 0.2 < after / before < 0.45
    assert counts[2].sum() > counts[1].sum() > counts[0].sum()
    # Fallen, it lies: one step is enough.
    assert counts[1].max() > 4
    assert counts[1][-1] == 1
