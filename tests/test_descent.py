"""Beginnings by derivatives.

| identity | one road | the other |
|---|---|---|
| a programme's voltages | `schedule` | those recorded in its run |
| dL/ds = (dV/ds)^T dL/dV | the motion run backwards | differences of L between two runs |
| the end of the descent | L there | the motion's goals, judged in a run of its own |
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from command_line import refused
from gelbot.ensemble import outcome
from gelbot.planner import descent
from gelbot.planner.command import Asked, seek
from gelbot.planner.descent import can_descend, descend, schedule
from gelbot.planner.search import Search, values_of
from gelbot.scenario.build import build
from gelbot.scenario.load import load
from gelbot.scenario.ranges import spread

FREE = [0.0] * 16
PHASES = (
    '[{name="a", pattern="ridge", drive="3 V", until={after="1 s"}}, '
    f'{{name="b", pattern={FREE}, drive="5 V", until={{after="2 s"}}}}, {{name="c", pattern="off", drive="0 V"}}]'
)
GOAL = '{quantity="height", at_least="1.2 mm", at_most="1.3 mm", lasting="1 s", to_the_end=true}'
CHOOSE = ("programme.phases.0.drive=0 V .. 8 V", "programme.phases.1.pattern=-1 .. 1")


def search(phases: str = PHASES, goal: str = GOAL, choose: tuple[str, ...] = CHOOSE) -> Search:
    changes = ["body.mesh_size=2 mm", "electrodes.panels=4", 'simulation.duration="4 s"']
    loaded = load("dome", [*changes, f"programme.phases={phases}", f"motion={{goals=[{goal}]}}"])
    data = tomllib.loads(loaded.text)
    choices = tuple(spread(key, text, data) for key, _, text in (one.partition("=") for one in choose))
    return Search(loaded, choices, ({},), 1, None)


def test_schedule_is_what_a_run_plays() -> None:
    profile = PHASES.replace('drive="5 V"', 'drive=[["0 s", "1 V"], ["2 s", "-4 V"]]').replace(str(FREE), '"uniform"')
    asked = search(profile)
    played = outcome(asked.loaded, 0, {}).frames["voltage"].transpose("time", "electrode").values
    assert schedule(build(asked.loaded.scenario)) == pytest.approx(played, abs=1e-12)


@pytest.mark.slow
def test_the_slope_is_that_of_the_shortfall(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along a direction in which all choices change; not where voltages vanish, and adsorption has a corner."""
    asked = search()._replace(start=np.random.default_rng(2).uniform(0.55, 0.75, 17))
    seen: list[tuple[float, np.ndarray]] = []

    def watched(function, first, **_):
        way = np.random.default_rng(1).normal(size=len(first)) * 1e-3
        seen.extend(function(place) for place in (first, first + way, first - way))
        seen.append((0.0, way))

    monkeypatch.setattr(descent, "minimize", watched)
    descend(asked, 3)
    (_, slope), (ahead, _), (behind, _), (_, way) = seen
    assert abs(slope @ way) > 1e-6
    assert slope @ way == pytest.approx((ahead - behind) / 2.0, rel=1e-3)


@pytest.mark.slow
def test_seventeen_choices_are_found_in_a_few_motions(tmp_path: Path) -> None:
    asked = search()
    made = descend(asked, 12)
    assert made.before > 0.05
    assert made.after < 1e-3 * made.before
    assert made.motions <= 12
    reached = outcome(asked.loaded, 0, values_of(asked.choices, made.shares)).reached
    assert reached is not None
    assert reached.shortfall < 0.05
    # And a search begins there: its first generation has the motion nearly met already.
    loaded, asked_for = asked.loaded, Asked(CHOOSE, (), 1, 1, 1, 6, 2, 1, 12)
    found = seek(tmp_path / "plan", loaded, asked_for, progress=False)
    assert found["gradients"]["after"] < 1e-3 * found["gradients"]["before"]
    start = json.loads((tmp_path / "plan" / "start.json").read_text())
    assert start["motions"] == found["gradients"]["motions"]
    assert seek(tmp_path / "plan", None, None, progress=False) == found  # goes on from what was found


@pytest.mark.slow
def test_places_that_are_not_allowed_are_left_again() -> None:
    """Half of the range is beyond the supply's limit of 10 V, and the first step leads there."""
    asked = search(choose=("programme.phases.0.drive=0 V .. 40 V",))._replace(start=np.array([0.1]))
    made = descend(asked, 8)
    assert made.motions > 2
    assert np.isfinite(made.after)
    assert made.after <= made.before
    assert made.shares[0] <= 0.25


@pytest.mark.parametrize(
    ("phases", "goal", "choose"),
    [
        (PHASES.replace('after="1 s"', 'height="2 mm", after="1 s"'), GOAL, CHOOSE),
        (PHASES.replace('"3 V"', '"servo", hold="1 mm"'), GOAL, CHOOSE[1:]),
        (PHASES, '{quantity="wrap", at_least="90 deg"}', CHOOSE),
        (PHASES, GOAL, (*CHOOSE, "programme.phases.0.until.after=1 s .. 2 s")),
        (PHASES, GOAL, ("programme.phases.0.drive=1 V | 2 V",)),
    ],
    ids=["event", "servo", "wrap", "time", "choices"],
)
def test_where_derivatives_do_not_lead(phases: str, goal: str, choose: tuple[str, ...]) -> None:
    more = ["programme.servo={kp='1 V/mm', kv='0 V*s/mm', sign='corrected'}"] if "servo" in phases else []
    if "wrap" in goal:
        rod = '{shape="cylinder", diameter="4 mm", length="9 mm", axis=[0, 1, 0], position=["0 mm", "0 mm", "9 mm"]}'
        more.append(f"obstacles=[{rod}]")
    loaded = load("dome", [f"programme.phases={phases}", f"motion={{goals=[{goal}]}}", *more])
    data = tomllib.loads(loaded.text)
    choices = tuple(spread(key, text, data) for key, _, text in (one.partition("=") for one in choose))
    assert not can_descend(Search(loaded, choices, ({},), 1, None))
    assert can_descend(search())


def test_a_negative_number_of_motions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    said = refused("plan", "turn-over", "--choose", "programme.phases.0.drive=2 V .. 10 V", "--gradients", "-1")
    assert "--gradients: got -1; allowed: 0 or more" in said
