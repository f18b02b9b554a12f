"""The predictive controller: a twin that is kept where the robot is, and a programme that goes on when it is late.

| identity | one road | the other |
|---|---|---|
| the twin of a moved robot | what is seen of the twin | what is seen of the robot |
| a stronger robot | the factor learned on p_ele | the robot's own, after some seconds |
| no time to plan | ticks of the controller | ticks of the programme alone |
| a robot that is the nominal one | the motion under the controller | its goals met, as under the programme |
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.control.programme import advance, begin
from gelbot.controllers.predictive import Predictive, believed, corrected, march_predictive, twin_at
from gelbot.points import Observation, observe
from gelbot.scenario import load
from gelbot.scenario.build import Experiment, build

SHORT = (
    *("simulation.duration='4 s'", "body.mesh_size='1.5 mm'", "electrodes.panels=6", "simulation.time_step='100 ms'"),
    *('motion.goals=[{quantity="height", at_least="1.2 mm", lasting="0.2 s"}]', "programme.phases.0.drive='6 V'"),
)


@pytest.fixture(scope="module")
def nominal() -> Experiment:
    return build(load("dome", SHORT).scenario)


def of(experiment: Experiment) -> Observation:
    return observe(experiment.model.points, experiment.state.positions)


def test_the_twin_lies_where_the_robot_is_seen(nominal: Experiment) -> None:
    moved = ['body.pose.position=["13.1 mm", "11.9 mm"]', 'body.pose.heading="232 deg"']
    robot = build(load("dome", [*SHORT, *moved]).scenario, nominal)
    twin = twin_at(nominal, of(robot))
    own = observe(twin.model.points, twin.state.positions)
    assert np.asarray(own.centre) == pytest.approx(np.asarray(of(robot).centre), abs=1e-9)
    assert np.asarray(own.tips) == pytest.approx(np.asarray(of(robot).tips), abs=1e-9)
    assert believed(twin, of(robot))
    fallen = of(robot)._replace(normal=jnp.array([0.0, 0.0, -1.0]))
    assert not believed(twin, fallen)


def test_what_is_seen_puts_the_twin_right(nominal: Experiment) -> None:
    """A centre that has risen further than the twin's: more adsorption, and a larger p_ele."""
    seen = of(nominal)
    twin = twin_at(nominal, seen)
    raised = twin.state.positions.at[2].add(2e-3)
    twin = twin._replace(state=twin.state._replace(positions=raised, ads=jnp.full_like(twin.state.ads, 0.1)))
    higher = observe(twin.model.points, raised)
    for factor, sign in ((1.3, 1.0), (0.7, -1.0), (1.0, 0.0)):
        rise = float(higher.centre[2] - seen.centre[2])
        other = higher._replace(centre=higher.centre.at[2].set(seen.centre[2] + factor * rise))
        after = corrected(twin, other)
        assert np.sign(np.round(float(after.strength) - 1.0, 9)) == sign
        assert np.sign(np.round(float(after.state.ads.mean()) - 0.1, 9)) == sign


def test_without_time_the_programme_goes_on(nominal: Experiment) -> None:
    """A clock that is always past the deadline: no trial is begun, each tick counts as late, the voltages are those of
    the programme."""
    ticks = iter(np.arange(0.0, 1e4, 1.0))
    seen = of(nominal)
    controller = Predictive(nominal, {}, seen, clock=lambda: float(next(ticks)))
    progress = begin(nominal.programme, seen)
    for k in range(3):
        time = jnp.asarray(0.1 * k)
        voltages, command = controller.tick(time, seen)
        progress, plain, told = advance(nominal.programme, progress, time, seen)
        assert np.asarray(voltages) == pytest.approx(np.asarray(plain))
        assert int(command.phase) == int(told.phase)
    assert controller.late == 3


@pytest.mark.slow
def test_a_robot_that_is_its_twin_does_what_was_foreseen(nominal: Experiment) -> None:
    frames, last = [], None
    for frame, controller in march_predictive(nominal, nominal, {}):
        frames.append(np.asarray(frame.observation.centre))
        last = controller
    assert last is not None
    assert len(frames) == 40
    assert np.max(np.array(frames)[:, 2]) > 1.2e-3
    own = observe(last.twin.model.points, last.twin.state.positions)
    # The twin is a period behind when the last tick begins.
    assert np.asarray(own.centre) == pytest.approx(frames[-2], abs=1e-5)
    assert float(last.twin.strength) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_a_stronger_robot_is_recognised(nominal: Experiment) -> None:
    """It adsorbs 1.3 times as fast; the twin has seen as much after some seconds of its rise."""
    changes = ["material.p_ele='0.026 cm^2/mA'", "simulation.duration='7 s'"]
    robot = build(load("dome", [*SHORT, *changes]).scenario, nominal)
    last = None
    for _, controller in march_predictive(robot, nominal, {}):
        last = controller
    assert last is not None
    assert 1.15 < float(last.twin.strength) < 1.45
