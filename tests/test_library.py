"""The motions that come with gelbot: each is met by the robot as it is in the scenario, and by others."""

from __future__ import annotations

import numpy as np
import pytest

from gelbot.controllers.choice import outcome_with, with_controller
from gelbot.scenario import load
from gelbot.scenario.load import Loaded
from gelbot.study.scatter import draw, spreads

QUICK = ("simulation.precision=float32", 'simulation.time_step="100 ms"', "simulation.tolerance=0.3")


def met(loaded: Loaded, controller: str, robots: int) -> list[bool]:
    """Whether the first robots of a study meet the motion, the first one as it is in the scenario."""
    scattered = spreads(loaded, ())
    changes = [{}, *(draw(scattered, 1, k) for k in range(1, robots))]
    outcomes = [outcome_with(controller, loaded, k, robot) for k, robot in enumerate(changes)]
    assert all(one.converged for one in outcomes)
    return [one.reached is not None and one.reached.met for one in outcomes]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lift", "curl", "right-left", "crawl"])
def test_motions(name: str) -> None:
    assert met(load(name, QUICK), "servo", 4) == [True] * 4


@pytest.mark.slow
@pytest.mark.parametrize("angle", np.linspace(9.0, 333.0, 10)[[0, 3, 7]])
def test_directions(angle: float) -> None:
    """One over a tip, one over two, and one that no symmetry of the electrodes carries over."""
    loaded = with_controller(load("turn-over", QUICK), "planned", direction=f"{angle:g} deg")
    assert met(loaded, "planned", 3) == [True] * 3


def test_crawl_leads_round_and_back() -> None:
    """Each phase follows the one before it, whatever the body does, until the way is done."""
    phases = load("crawl").scenario.programme.phases
    names = [phase.name for phase in phases]
    assert names == [*(f"{way} {k}" for way in ("forth", "back") for k in range(1, 5)), "rest"]
    for k, phase in enumerate(phases[:-1]):
        assert phase.until is not None
        assert phase.until.otherwise == names[k - 3 if k % 4 == 3 else k + 1]
        assert phase.until.then == ("back 1" if k < 4 else "rest")
    # A wave: each quarter of it is the one before, a quarter further on; on the way back, the other way round.
    volts = np.array([np.array(phase.shares) * phase.profile[0][1] for phase in phases[:-1]])
    np.testing.assert_allclose(volts[:2], -volts[2:4])
    np.testing.assert_allclose(volts[4:8], volts[[0, 3, 2, 1]])
    np.testing.assert_allclose(volts[:, 6:], volts[:, :-6])  # six electrodes long
