"""Ensembles: each robot is what it would be alone.

| identity | one road | the other |
|---|---|---|
| an unchanged robot | `march_all` | `rollout` of the experiment itself |
| a changed robot | built from what it has in common with the unchanged one | its scenario, built from nothing |
| the same | keys and values of the robot | `--set` of the scenario |
| how it is computed | two processes, or an executor of one's own | this one, to the last bit |
"""

from __future__ import annotations

import pickle
import re
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from gelbot.control.programme import play
from gelbot.ensemble import Outcome, experiment_of, march_all, scenario_of, workers
from gelbot.errors import BadInput, GelbotError, SimulationFailed
from gelbot.scenario import load
from gelbot.scenario.build import Experiment, begun, build
from gelbot.scenario.load import Loaded
from gelbot.simulate import rollout

SHORT = ('simulation.duration="1 s"', 'body.mesh_size="1.5 mm"', "electrodes.panels=6")
HERE = ["12.5 mm", "12.5 mm"]
"""Where the dome lies, and where its programme is meant to be done however a robot lies."""
MESHLESS = {"material.p_ele": "0.018 cm^2/mA", "material.p_l": 0.7, "material.p_ads": 0.9}
"""Changes that leave mesh, field and table as they are."""

CHANGED: dict[str, dict[str, Any]] = {
    "nothing": {},
    "gel": MESHLESS,
    "young modulus": {"material.young_modulus": "60 kPa"},
    "densities and drag": {
        "material.density": "1060 kg/m^3",
        "solution.density": "1010 kg/m^3",
        "solution.drag": "30 1/s",
    },
    "friction": {"tank.friction": 0.4},
    "self contact": {"material.self_contact": True, "material.self_friction": 0.3},
    "conductivity": {"solution.conductivity": "0.3 S/m"},
    "conductivity of the gel": {"material.conductivity": "0.4 S/m"},
    "place": {"body.pose.position": ["13 mm", "11.5 mm"]},
    "heading": {"body.pose.heading": "230 deg"},
    "lift": {"body.pose.lift": "0.5 mm"},
    "thickness": {"body.thickness": "1.1 mm"},
    "outline": {"body.arm_length": "5.5 mm"},
    "the solid": {"material.model": "solid"},
    "supply": {"supply.limit": "2 V", "programme.phases.0.drive": "1.5 V"},
    "supply alone": {"supply.limit": "7 V"},
    "voltage": {"programme.phases.0.drive": "2 V"},
    "programme": {
        "programme.phases": [
            {"name": "up", "pattern": "cathode", "drive": "1 V", "until": {"after": "0.4 s", "contact": "tip 2"}},
            {"name": "down", "pattern": {"ridge": 0.5, "uniform": -0.2}, "drive": [["0 s", "1 V"], ["1 s", "2 V"]]},
        ]
    },
    "place of the programme": {
        "programme.place": ["-12.5 mm", "12.5 mm"],
        "body.pose.position": ["-12.5 mm", "12.5 mm"],
    },
    "gap": {"electrodes.gap": "12 mm"},
    "floor": {"tank.floor_depth": "2 mm"},
    "an obstacle": {"obstacles": [{"shape": "sphere", "diameter": "4 mm", "position": ["12.5 mm", "12.5 mm", "9 mm"]}]},
    "tolerance": {"simulation.tolerance": 1e-2, "simulation.time_step": "25 ms"},
    "field spacing": {"simulation.field_spacing": "2 mm"},
    "single precision": {"simulation.precision": "float32"},
}


@pytest.fixture(scope="module")
def dome() -> Loaded:
    return load("dome", SHORT)


def plain(run: xr.Dataset) -> dict[str, np.ndarray]:
    return {str(name): values.values for name, values in run.variables.items() if values.dtype.kind in "fiub"}


def assert_same_numbers(one: Outcome, other: Outcome) -> None:
    """All but the wall time, to the last bit."""
    assert plain(one.frames).keys() == plain(other.frames).keys()
    for name, values in plain(one.frames).items():
        np.testing.assert_array_equal(values, plain(other.frames)[name], err_msg=name)
    timed = ("wall_s", "compile_s")
    summaries = ({key: value for key, value in x.summary.items() if key not in timed} for x in (one, other))
    assert next(summaries) == next(summaries)
    assert (one.robot, one.converged, one.reached) == (other.robot, other.converged, other.reached)


def assert_same_experiment(one: Experiment, other: Experiment) -> None:
    """Model, state and programme, leaf by leaf, and the electrodes' field."""
    assert one.scenario == other.scenario
    for part in ("model", "state", "programme"):
        found = jax.tree_util.tree_flatten_with_path(getattr(one, part))[0]
        same = jax.tree_util.tree_flatten_with_path(getattr(other, part))[0]
        assert [path for path, _ in found] == [path for path, _ in same]
        for (path, a), (_, b) in zip(found, same, strict=True):
            name = part + jax.tree_util.keystr(path)
            assert jnp.asarray(a).dtype == jnp.asarray(b).dtype, name
            scale = float(np.abs(np.where(np.isfinite(b), b, 0.0)).max(initial=0.0))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * scale, err_msg=name)
    np.testing.assert_allclose(one.field.conductance, other.field.conductance, rtol=1e-12)
    np.testing.assert_allclose(one.connection, other.connection, rtol=1e-12)
    assert one.field.problem.conductivity == other.field.problem.conductivity
    np.testing.assert_array_equal(one.body.nodes, other.body.nodes)
    np.testing.assert_array_equal(one.array.centres, other.array.centres)


def test_an_unchanged_robot_is_the_experiment_itself(dome: Loaded) -> None:
    (one,) = march_all(dome, [{}], processes=1)
    experiment = build(dome.scenario)
    memory = begun(experiment, experiment.state)
    step, period = dome.scenario.simulation.time_step, dome.scenario.programme.control_period
    _, _, frames = rollout(
        experiment.model, experiment.state, play, memory, jnp.asarray(step), round(1.0 / period), round(period / step)
    )
    assert one.converged
    assert one.reached is None
    assert one.summary["simulated_s"] == pytest.approx(1.0)
    risen = np.asarray(frames.observation.centre)[:, 2]
    assert one.frames["centre"].values[:, 2] == pytest.approx(risen, abs=1e-12)
    assert np.ptp(risen) > 1e-5


@pytest.mark.parametrize("changes", CHANGED.values(), ids=CHANGED.keys())
def test_a_robot_built_from_the_unchanged_one_is_built_from_nothing(dome: Loaded, changes: dict[str, Any]) -> None:
    assert_same_experiment(experiment_of(dome, changes), build(scenario_of(dome, changes)))


def test_what_a_robot_changes_is_what_set_changes(dome: Loaded) -> None:
    """The programme is meant for where the unchanged robot lies."""
    changes = {**MESHLESS, "body.pose.position": ["13 mm", "12 mm"], "body.pose.heading": "230 deg"}
    place = f"programme.place={HERE}"
    overrides = [
        *("material.p_ele=0.018 cm^2/mA", "material.p_l=0.7", "material.p_ads=0.9"),
        *('body.pose.position=["13 mm", "12 mm"]', "body.pose.heading=230 deg", place),
    ]
    same = load("dome", [*SHORT, *overrides])
    assert scenario_of(dome, changes) == same.scenario
    (one,), (other,) = march_all(dome, [changes], processes=1), march_all(same, [{}], processes=1)
    assert one.frames["centre"].values == pytest.approx(other.frames["centre"].values, abs=1e-12)
    (plain,) = march_all(dome, [{}], processes=1)
    assert np.abs(one.frames["centre"].values - plain.frames["centre"].values).max() > 1e-5


def test_nothing_of_another_mesh_is_taken(dome: Loaded) -> None:
    base = build(dome.scenario)
    thick = build(scenario_of(dome, CHANGED["thickness"]), base)
    assert float(np.ptp(thick.body.nodes[2])) == pytest.approx(1.1e-3)
    assert thick.array is base.array
    # What is the same is the same object, and no copy.
    soft = build(scenario_of(dome, CHANGED["young modulus"]), base)
    assert soft.body is base.body
    assert soft.array is base.array
    assert soft.model.lead.coefficients is base.model.lead.coefficients


def test_a_robot_keeps_the_programme_that_it_does_not_change(dome: Loaded) -> None:
    """Patterns may take long to turn; they are made once."""
    assert experiment_of(dome, MESHLESS).programme is experiment_of(dome, {"tank.friction": 0.3}).programme


def test_robots_do_not_depend_on_those_before_them(dome: Loaded) -> None:
    robots = [{}, MESHLESS, {"body.thickness": "1.1 mm"}, {"material.p_l": 0.6}]
    together = sorted(march_all(dome, robots, processes=1))
    for one in together:
        alone = next(march_all(dome, [robots[one.robot]], processes=1))
        assert_same_numbers(one, alone._replace(robot=one.robot))


@pytest.mark.slow
def test_processes_compute_the_same_and_each_robot_once(dome: Loaded) -> None:
    robots = [
        {"material.p_ele": f"{0.017 + 0.002 * k} cm^2/mA", "body.pose.heading": f"{225 + k} deg"} for k in range(3)
    ]
    alone = sorted(march_all(dome, robots, processes=1))
    apart = sorted(march_all(dome, robots, processes=2))
    assert [one.robot for one in apart] == [0, 1, 2]
    for one, other in zip(alone, apart, strict=True):
        assert_same_numbers(one, other)
        assert "position" not in other.frames
    assert np.ptp([one.summary["final_height_mm"] for one in alone]) > 1e-3


def test_ctrl_c_is_the_parent_s_alone() -> None:
    with workers(2) as pool:
        blocked = {k: pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result() for k in range(8)}
    assert all(signal.SIGINT in masked for masked in blocked.values())
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_robots_go_to_an_executor_that_is_given(dome: Loaded) -> None:
    robots = [{"material.p_l": 0.7}, {"material.p_l": 0.75}]
    with ThreadPoolExecutor(1) as pool:
        found = sorted(march_all(dome, robots, executor=pool))
    for one, other in zip(sorted(march_all(dome, robots, processes=1)), found, strict=True):
        assert_same_numbers(one, other)


@pytest.mark.parametrize("error", [BadInput("place", 3, "2", "1", 4), SimulationFailed(1.5, 0.2, 0.01, True, 3)])
def test_an_error_comes_out_of_another_process_as_it_was(error: GelbotError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert (str(again), again.__dict__) == (str(error), error.__dict__)


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ({"material.p_l": 1.2}, "robot 1: dome: material.p_l: got 1.2; allowed: a number without a unit, at least 0"),
        ({"material.p_el": 1.2}, "robot 1: dome: material.p_el: got 1.2; allowed: in [material] the keys"),
        ({"body.arms.x": 1}, "robot 1: changed key: got 'body.arms.x'; allowed: a key that leads"),
        (
            {"programme.phases.3.drive": "1 V"},
            "robot 1: changed key: got 'programme.phases.3.drive'",
        ),
        (
            {"programme.phases.0.until": {"after": "1 s", "contact": "tip 9", "then": "dome", "otherwise": "dome"}},
            "robot 1: programme.phases.0.until.contact: got 'tip 9'; allowed: one of the body's 5 tips",
        ),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_with_the_robot_s_number(
    dome: Loaded, robot: dict[str, Any], said: str
) -> None:
    with pytest.raises(BadInput, match=re.escape(said)) as refused:
        list(march_all(dome, [{}, robot], processes=1))
    assert str(refused.value).startswith("robot 1: ")


@pytest.mark.parametrize(
    ("robots", "processes", "said"),
    [([{}], 0, "processes: got 0; allowed: 1 or more"), ([{}], -3, "processes: got -3"), ([], 1, "robots: got 'none'")],
)
def test_an_ensemble_has_robots_and_processes(dome: Loaded, robots: Any, processes: int, said: str) -> None:
    with pytest.raises(BadInput, match=re.escape(said)):
        next(march_all(dome, robots, processes=processes))


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_a_robot_that_would_begin_in_a_wall_is_refused_by_its_number(processes: int) -> None:
    # Inside the tank as the scenario's check has it, but in an obstacle.
    wall = 'obstacles=[{shape="plane", position=["25 mm", "0 mm", "0 mm"], normal=[-1, 0, 0]}]'
    loaded = load("dome", (*SHORT, wall))
    robots = [{}, {"body.pose.position": ["22 mm", "12.5 mm"]}]
    with pytest.raises(BadInput, match=r"robot 1: body.pose: got .*into plane 1"):
        list(march_all(loaded, robots, processes))


def test_a_scenario_that_is_not_allowed_itself_is_the_first_robot_s_error(dome: Loaded) -> None:
    wall = 'obstacles=[{shape="sphere", position=["12.5 mm", "12.5 mm", "0 mm"], diameter="3 mm"}]'
    with pytest.raises(BadInput, match=r"robot 0: body.pose"):
        list(march_all(load("dome", (*SHORT, wall)), [{}], processes=1))


def test_goals_are_judged_where_there_is_a_motion(dome: Loaded) -> None:
    text = dome.text + '\n[motion]\n[[motion.goals]]\nquantity = "height"\nat_least = "%s mm"\n'
    low, high = (load_text(dome, text % height) for height in ("0.52", "2"))
    (one,), (other,) = march_all(low, [{}], processes=1), march_all(high, [{}], processes=1)
    heights = one.frames["centre"].values[:, 2]
    assert one.reached is not None
    assert one.reached.met
    assert one.reached.times == (one.frames["time"].values[np.argmax(heights >= 0.52e-3)],)
    assert other.reached is not None
    assert not other.reached.met
    assert other.reached.best == heights.max()
    assert_same_numbers(one._replace(reached=None), other._replace(reached=None))


def load_text(loaded: Loaded, text: str) -> Loaded:
    import tomllib

    from gelbot.scenario.load import checked

    return replace(loaded, scenario=checked(tomllib.loads(text), loaded.source), text=text)
