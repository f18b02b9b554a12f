"""Ensembles: each robot is what it would be alone.

| identity | one road | the other |
|---|---|---|
| an unchanged robot | `march_all` | `rollout` of the experiment itself |
| a changed material | factors of `Robots` | the same numbers in the scenario |
| a moved start | `moved` | a rigid motion: distances stay |
| how it is computed | two processes | this one |
"""

from __future__ import annotations

import pickle
import re

import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.control.programme import play
from gelbot.ensemble import Robots, march_all, moved, scattered
from gelbot.errors import BadInput, GelbotError, SimulationFailed
from gelbot.scenario import load
from gelbot.scenario.build import begun, build
from gelbot.simulate import rollout

SHORT = ('simulation.duration="1 s"', 'body.mesh_size="1.5 mm"', "electrodes.panels=6")
PLAIN = Robots(np.zeros((1, 2)), np.zeros(1), np.ones(1), np.ones(1), np.ones(1))


def heights(outcome) -> np.ndarray:
    """Of the centre [m], at all recorded times."""
    return outcome.frames["centre"].values[:, 2]


def test_an_unchanged_robot_is_the_experiment_itself() -> None:
    loaded = load("dome", SHORT)
    (one,) = march_all(loaded, PLAIN, processes=1)
    experiment = build(loaded.scenario)
    memory = begun(experiment, experiment.state)
    step, period = loaded.scenario.simulation.time_step, loaded.scenario.programme.control_period
    _, _, frames = rollout(
        experiment.model, experiment.state, play, memory, jnp.asarray(step), round(1.0 / period), round(period / step)
    )
    assert one.converged
    assert one.summary["simulated_s"] == pytest.approx(1.0)
    risen = np.asarray(frames.observation.centre)[:, 2]
    assert heights(one) == pytest.approx(risen, abs=1e-12)
    assert np.ptp(risen) > 1e-5


def test_factors_are_the_scenario_s_numbers_times_them() -> None:
    robots = PLAIN._replace(p_ele=np.array([1.2]), p_l=np.array([0.9]), young_modulus=np.array([2.0]))
    (one,) = march_all(load("dome", SHORT), robots, processes=1)
    material = load("dome").scenario.material
    # Not through the scenario's modulus: it also makes the floor firmer.
    changes = (*SHORT, f"material.p_ele={1.2 * material.p_ele} m^2/A", f"material.p_l={0.9 * material.p_l}")
    (same,) = march_all(load("dome", changes), PLAIN._replace(young_modulus=np.array([2.0])), processes=1)
    (plain,) = march_all(load("dome", SHORT), PLAIN, processes=1)
    assert heights(one) == pytest.approx(heights(same), abs=1e-9)
    assert np.abs(heights(one) - heights(plain)).max() > 1e-6


@pytest.mark.slow
def test_processes_compute_the_same_and_each_robot_once() -> None:
    robots = scattered(3, seed=2, shift=0.5e-3, turn=0.05, p_ele=0.15, p_l=0.03, young_modulus=0.2)
    loaded = load("dome", SHORT)
    alone = sorted(march_all(loaded, robots, processes=1))
    apart = sorted(march_all(loaded, robots, processes=2))
    assert [one.robot for one in apart] == [0, 1, 2]
    for one, other in zip(alone, apart, strict=True):
        assert heights(other) == pytest.approx(heights(one), abs=1e-12)
        assert "position" not in other.frames
    assert np.ptp([heights(one)[-1] for one in alone]) > 1e-6


def test_robots_are_scattered_within_their_bounds_and_the_first_stay() -> None:
    few, many = (scattered(n, 5, shift=1e-3, turn=0.1, p_ele=0.2) for n in (10, 1000))
    for one, other in zip(few, many, strict=True):
        assert np.array_equal(one, other[:10])
    assert np.abs(many.shift).max() == pytest.approx(1e-3, rel=0.01)
    assert np.abs(many.turn).max() == pytest.approx(0.1, rel=0.01)
    assert [many.p_ele.min(), many.p_ele.max()] == pytest.approx([0.8, 1.2], rel=0.01)
    assert np.all(many.p_l == 1.0)


def test_a_moved_start_is_a_rigid_motion() -> None:
    experiment = build(load("dome", SHORT).scenario)
    before = np.asarray(experiment.state.positions)
    turn = np.radians(30.0)
    after = np.asarray(moved(experiment, np.array([1e-3, -2e-3]), turn))
    assert after[2] == pytest.approx(before[2])
    assert after.mean(axis=1) - before.mean(axis=1) == pytest.approx([1e-3, -2e-3, 0.0], abs=1e-6)
    first, last = before[:, :1] - before, after[:, :1] - after
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    assert last[:2] == pytest.approx(turned @ first[:2], abs=1e-12)


@pytest.mark.parametrize("error", [BadInput("place", 3, "2", "1", 4), SimulationFailed(1.5, 0.2, 0.01, True, 3)])
def test_an_error_comes_out_of_another_process_as_it_was(error: GelbotError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert (str(again), again.__dict__) == (str(error), error.__dict__)


@pytest.mark.parametrize(
    ("count", "share", "said"),
    [(0, 0.0, "count of robots: got 0; allowed: 1 or more"), (2, 1.0, "scatter of p_ele: got 1.0; allowed: at least 0"),
     (2, -0.1, "scatter of p_ele: got -0.1"), (2, np.nan, "scatter of p_ele: got nan")],
)  # fmt: skip
def test_scatter_that_means_nothing_is_refused(count: int, share: float, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        scattered(count, 1, p_ele=share)


def test_processes_are_one_or_more() -> None:
    with pytest.raises(BadInput, match="processes: got 0; allowed: 1 or more"):
        next(march_all(load("dome", SHORT), PLAIN, processes=0))


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_robot_that_would_begin_in_a_wall_is_refused_by_its_number(processes: int) -> None:
    loaded = load("dome", (*SHORT, 'tank.size=["120 mm", "120 mm"]'))
    robots = Robots(np.array([[0.0, 0.0], [50e-3, 0.0]]), np.zeros(2), np.ones(2), np.ones(2), np.ones(2))
    with pytest.raises(BadInput, match=r"robot 1: body.pose: got .*into plane"):
        list(march_all(loaded, robots, processes))
