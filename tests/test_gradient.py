"""Derivatives of a whole motion.

| identity | one road | the other |
|---|---|---|
| dx/d(voltages, p_ele, p_l, E, start) | `jax.grad` of `trajectory` | central differences, floor and friction in it |
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.gradient import stiffened, trajectory
from gelbot.plan.templates import template
from gelbot.scenario.build import build
from gelbot.scenario.load import load

PERIODS = 10


@pytest.mark.slow
def test_central_differences():
    experiment = build(load("turn-over", ["body.mesh_size=1.4 mm", "simulation.tolerance=1e-9"]).scenario)
    model, start = experiment.model, np.asarray(experiment.state.positions)
    place = np.array(experiment.scenario.body.pose.position)
    ridge = template("ridge", experiment.array, place)
    dt, rng = jnp.asarray(0.05), np.random.default_rng(0)

    def where(p):
        gel, mech = model.gel, model.mechanics
        changed = model._replace(
            gel=gel._replace(p_ele=p["p_ele"] * gel.p_ele, p_l=p["p_l"] * gel.p_l),
            mechanics=mech._replace(elastic=stiffened(mech.elastic, p["young"])),
        )
        c, s = jnp.cos(p["heading"]), jnp.sin(p["heading"])
        x, y = start[:2] - place[:, None]
        posed = jnp.stack([c * x - s * y + place[0], s * x + c * y + place[1], jnp.asarray(start[2])])
        end = jnp.asarray(trajectory(changed, posed, p["voltages"], dt, 2))[-1]
        tip = end @ model.points.tips[0]
        return 1e3 * ((end @ model.points.centre)[2] + 0.3 * tip[0] - 0.2 * tip[1] + 0.1 * tip[2])

    one = jnp.ones(())
    p = {"p_ele": one, "p_l": one, "young": one, "heading": 0.0 * one}
    p["voltages"] = jnp.asarray(8.0 * np.tile(ridge, (PERIODS, 1)) + rng.normal(size=(PERIODS, 16)))
    slope, value = jax.jit(jax.grad(where))(p), jax.jit(where)
    for key, place_in, step in (
        ("p_ele", (), 1e-3),
        ("p_l", (), 1e-3),
        ("young", (), 1e-3),
        ("heading", (), 1e-4),
        ("voltages", (0, 10), 1e-1),
        ("voltages", (PERIODS // 2, 5), 1e-1),
    ):
        ahead, behind = ({**p, key: p[key].at[place_in].add(sign * step)} for sign in (1.0, -1.0))
        expected = float(value(ahead) - value(behind)) / (2.0 * step)
        print(key, place_in, expected, float(slope[key][place_in]))
        assert float(slope[key][place_in]) == pytest.approx(expected, rel=1e-4)
