"""Robots marched together are what they are one by one.

| identity | one road | the other |
|---|---|---|
| `solve_step` of positions (3, n, b) | the batch | each robot alone |
| `rollout` of a batch, each with its own `p_ele`, voltages and place | the batch | each robot alone |
| a robot's own numbers | differ as their constants do | - |
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.body.lattice import build_body
from gelbot.body.outline import strip
from gelbot.mechanics.implicit import begin_step, build_preconditioner, solve_step
from gelbot.scenario import load
from gelbot.scenario.build import Experiment, build
from gelbot.simulate import Model, rollout, start

MM = 1e-3
ROBOTS = 3


@partial(jax.jit, static_argnames="steps")
def marched_batch(mech, x, v, rest, dt, steps):
    """Positions after `steps` steps of `dt`, of one robot (3, n) or of many (3, n, b)."""
    frame = jnp.broadcast_to(jnp.eye(3).reshape(3, 3, *(1 for _ in x.shape[2:])), (3, 3, *x.shape[2:]))
    near = build_preconditioner(mech, begin_step(mech, x, v, rest, dt), jnp.zeros_like(x), rest, frame)

    def one(carry, _):
        x, v, near = carry
        found, near, _ = solve_step(mech, x, v, rest, dt, near, frame)
        return (found.x, (found.x - x) / dt, near), found.residual

    (x, v, _), residual = jax.lax.scan(one, (x, v, near), None, length=steps)
    return x, v, residual


def test_solve_step(mechanics, rng):
    """Different places, speeds and rest lengths: one falls, one lies on the floor, one slides."""
    sheet = build_body(strip(2 * MM, 1 * MM), 1 * MM, 1 * MM)
    mech = mechanics(sheet, drag=5.0, tolerance=1e-8)
    low = jnp.all(jnp.asarray(sheet.nodes[2, sheet.springs]) < 1e-9, axis=0)
    x = np.stack([sheet.nodes + np.array([[0.0], [0.0], [lift]]) for lift in (5 * MM, 0.01 * MM, 0.0)], axis=-1)
    v = np.zeros_like(x)
    v[0, :, 2] = 5 * MM
    v[:, :, 0] = 2 * MM * rng.normal(size=(3, 1))
    rest = mech.elastic.length[:, None] * (1.0 - jnp.array([0.0, 0.2, 0.1]) * low[:, None])
    together = marched_batch(mech, jnp.asarray(x), jnp.asarray(v), rest, 0.02, 25)
    assert float(together[2].max()) <= 1e-8
    for k in range(ROBOTS):
        alone = marched_batch(mech, jnp.asarray(x[..., k]), jnp.asarray(v[..., k]), rest[:, k], 0.02, 25)
        path = np.abs(np.asarray(alone[0]) - x[..., k]).max()
        assert path > 0.01 * MM
        assert np.asarray(together[0][..., k]) == pytest.approx(np.asarray(alone[0]), abs=1e-5 * path)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    changes = ("body.mesh_size=2 mm", "electrodes.panels=6", "simulation.tolerance=1e-6")
    return build(load("dome", changes).scenario)


def hold(memory, time, observation):
    """A controller that gives the voltages in its memory."""
    return memory, memory, time


@pytest.mark.slow
def test_rollout(experiment: Experiment):
    """Strength, place and voltages are each robot's own."""
    model, positions = experiment.model, experiment.state.positions
    p_ele = model.gel.p_ele * jnp.array([0.8, 1.0, 1.2])
    places = jnp.stack([positions + jnp.array([[dx], [0.0], [0.0]]) for dx in (0.0, 1e-3, -1e-3)], axis=-1)
    pattern = experiment.programme.phases.patterns[0]
    volts = pattern[:, None] * jnp.array([8.0, 6.0, -8.0])

    def run(model: Model, positions, volts):
        return rollout(model, start(model, positions), hold, volts, jnp.asarray(0.05), 8, 2)

    last, _, frames = run(model._replace(gel=model.gel._replace(p_ele=p_ele)), places, volts)
    assert last.positions.shape == (*positions.shape, ROBOTS)
    assert frames.observation.centre.shape == (8, 3, ROBOTS)
    assert float(frames.report.residual.max()) <= 1e-6
    for k in range(ROBOTS):
        mine = model._replace(gel=model.gel._replace(p_ele=p_ele[k]))
        alone, _, seen = run(mine, places[..., k], volts[:, k])
        moved = float(jnp.abs(alone.positions - places[..., k]).max())
        assert moved > 0.05 * MM
        assert np.asarray(last.positions[..., k]) == pytest.approx(np.asarray(alone.positions), abs=1e-3 * moved)
        assert np.asarray(last.ads[:, k]) == pytest.approx(np.asarray(alone.ads), abs=1e-3 * float(alone.ads.max()))
        centre, normal = (getattr(frames.observation, name)[..., k] for name in ("centre", "normal"))
        assert np.asarray(centre) == pytest.approx(np.asarray(seen.observation.centre), abs=1e-3 * moved)
        assert np.asarray(normal) == pytest.approx(np.asarray(seen.observation.normal), abs=1e-3)
