"""The planner: a search for a programme, and what it says when there is none.

| identity | one road | the other |
|---|---|---|
| a search that was stopped | told again what stands in its folder | the same candidates as in one go |
| the optimiser | its best candidate of a bowl | the bowl's bottom |
| what cannot be | said before any run | the body's reach, the array's, a unit vector |
| the programme that is found | what the search says of it | `gelbot run` on the file |
| no programme | best attempt, exit code 3, what limits it | a goal that the supply cannot reach |
"""

from __future__ import annotations

import json
import tomllib
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from gelbot.cli import app
from gelbot.errors import BadInput, GelbotError
from gelbot.planner import search as search_module
from gelbot.planner.limits import impossible, limited_by
from gelbot.planner.objective import MISS, Score, cost_of, from_plain, plain, total
from gelbot.planner.search import Candidate, Search, generations
from gelbot.scenario import load
from gelbot.scenario.ranges import spread

runner = CliRunner()
SHORT = (
    *("simulation.duration='3 s'", "body.mesh_size='1.5 mm'", "electrodes.panels=6", "recording.chunk='3 s'"),
    "simulation.time_step='100 ms'",
)
GOAL = 'motion.goals=[{quantity="height", at_least="%s", lasting="0.2 s"}]'
CHOICE = ("--choose", 'programme.phases.0.drive="1 V .. 9 V"')


class Here(Executor):
    """An executor that computes at once, in this process."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


BOTTOM = np.array([0.7, 0.2])


def bowl(loaded: Any, candidate: dict[str, Any], index: int, robot: dict[str, Any]) -> Score:
    values = np.array([float(str(value).split()[0]) for value in candidate.values()])
    return Score(float(np.sum((values - BOTTOM) ** 2)), True, 1.0, 1.0, 1.0, 0.0, np.nan, "")


def a_search(seed: int = 1) -> Search:
    keys = ("programme.phases.0.drive", "supply.limit")
    choices = tuple(spread(key, "0 .. 1 V", {}) for key in keys)
    return Search(load("dome"), choices, ({}, {}), seed, None)


def shares(found: list[list[search_module.Candidate]]) -> np.ndarray:
    return np.array([one.shares for made in found for one in made])


class TestSearch:
    @pytest.fixture(autouse=True)
    def in_a_bowl(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(search_module, "score", bowl)

    def test_finds_the_bottom_of_a_bowl(self, tmp_path: Path) -> None:
        found = list(generations(a_search(), tmp_path, 25, Here(), lambda runs: None))
        best = min((one for made in found for one in made), key=lambda one: one.worth)
        assert best.shares == pytest.approx(BOTTOM, abs=0.02)

    def test_goes_on_where_it_was_stopped(self, tmp_path: Path) -> None:
        whole = list(generations(a_search(), tmp_path / "whole", 6, Here(), lambda runs: None))
        list(generations(a_search(), tmp_path / "parts", 2, Here(), lambda runs: None))
        told: list[int] = []
        again = list(generations(a_search(), tmp_path / "parts", 6, Here(), told.append))
        assert np.array_equal(shares(again), shares(whole))
        assert sum(told) == 2 * len(shares(whole))  # two robots each; what stood there counts too
        for file in sorted((tmp_path / "whole").iterdir()):
            assert (tmp_path / "parts" / file.name).read_bytes() == file.read_bytes()

    def test_another_seed_is_another_search(self, tmp_path: Path) -> None:
        list(generations(a_search(1), tmp_path, 1, Here(), lambda runs: None))
        with pytest.raises(GelbotError, match="is of another search"):
            list(generations(a_search(2), tmp_path, 1, Here(), lambda runs: None))


numbers = st.floats(0.0, 1e3)


@given(numbers, numbers, numbers, st.booleans(), st.floats(allow_nan=True, allow_infinity=True))
def test_scores_survive_their_file(cost: float, peak: float, charge: float, met: bool, best: float) -> None:
    one = Score(cost, met, 3.0 if met else None, peak, charge, 0.0 if met else np.inf, best, "" if met else "why")
    (again,) = from_plain(json.loads(json.dumps(plain([one]))))
    kept = one if np.isfinite(best) else one._replace(best=np.nan)
    assert again[:6] == kept[:6]
    assert again.best == kept.best or np.isnan(kept.best)
    assert again.reason == one.reason


def test_a_candidate_is_worth_its_mean_and_a_failure_more_than_any_cost() -> None:
    motion = load("turn-over", ["motion.costs={time=2.0, charge=3.0, peak_voltage=0.5}"]).scenario.motion
    assert motion is not None
    assert cost_of(motion, 10.0, 4.0, 8.0) == pytest.approx(2.0 * 10.0 + 3.0 * 4.0 + 0.5 * 8.0)
    met = Score(20.0, True, 20.0, 10.0, 1.0, 0.0, np.nan, "")
    failed = Score(20.0 + MISS, False, None, 10.0, 1.0, 0.0, 0.0, "no")
    assert total([met, failed]) == pytest.approx(20.0 + MISS / 2.0)
    assert total([met, met, failed]) > 10.0 * total([met, met, met])


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ('[{quantity="height", at_least="12 mm"}]', "the body reaches "),
        ('[{quantity="height", at_least="5 mm"}]', ""),
        ('[{quantity="normal", at_most=-1.2}]', "between -1 and 1"),
        ('[{quantity="along", at_least="80 mm"}]', "outside the array's reach"),
        ('[{quantity="along", at_least="10 mm"}]', ""),
        ('[{quantity="across", at_most="-90 mm"}]', "outside the array's reach"),
    ],
)
def test_what_no_programme_can_do_is_known_before(goal: str, said: str) -> None:
    loaded = load("turn-over", [f"motion.goals={goal}", 'motion.direction="45 deg"'])
    reason = impossible(loaded)
    assert said in reason if said else reason == ""


def test_electrodes_are_a_ceiling() -> None:
    changes = ['motion.goals=[{quantity="height", at_least="8 mm"}]', 'electrodes.gap="6 mm"']
    assert "the electrodes hang at 6 mm" in impossible(load("turn-over", changes))


def test_what_is_impossible_ends_without_a_programme(tmp_path: Path) -> None:
    out = tmp_path / "plan"
    result = runner.invoke(
        app, ["plan", "dome", *CHOICE, "--set", GOAL % "20 mm", "--out", str(out), "--json"], catch_exceptions=False
    )
    assert result.exit_code == 3
    found = json.loads(result.stdout)
    assert not found["met"]
    assert found["asked"] == ["height at least 20 mm for 0.2 s"]
    assert "the body reaches" in found["limited_by"][0]
    assert not list(out.glob("programme.toml"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan"], "scenario: got 'nothing'"),
        (["plan", "dome", *CHOICE], "dome: motion: got 'nothing'"),
        (["plan", "dome", "--set", GOAL % "1 mm"], "dome: search: got 'nothing'"),
        (["plan", "dome", "--set", GOAL % "1 mm", "--choose", "x"], "--choose: got 'x'; allowed: key=range"),
        (["plan", "dome", "--set", GOAL % "1 mm", *CHOICE, "--robots", "0"], "--robots: got 0; allowed: 1 or more"),
        (
            ["plan", "dome", "--set", GOAL % "1 mm", "--choose", "programme.phases.9.drive=1 V .. 2 V"],
            "changed key: got 'programme.phases.9.drive'; allowed: a number from 0 to 0 in place of 9",
        ),
        (["plan", "dome", "--set", GOAL % "1 mm", "--choose", "material.p_lx=0.1 .. 0.5"], "dome: material.p_lx: got"),
        (["plan", "dome", "--resume", "x"], "--resume: got 'x'; allowed: alone"),
        (["plan", "--resume", "x", "--rounds", "3"], "--resume: got 'x'; allowed: alone"),
        (["plan", "--resume", "x"], "the folder of a search (asked.json)"),
    ],
)
def test_a_search_that_means_nothing_is_refused(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2, result.output
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_best_attempt_says_what_it_came_up_against() -> None:
    choices = (spread("programme.phases.0.drive", "1 V .. 9 V", {}), spread("material.p_l", "0.4 .. 0.8", {}))
    search = Search(load("dome", [GOAL % "5 mm"]), choices, ({},), 1, None)
    score = Score(2000.0, False, None, 10.0, 1.0, 2.0, 0.003, "goal 1 (height at least 5 mm for 0.2 s) not met: ...")
    told = limited_by(search, Candidate(np.array([0.99, 0.5]), {}, [score]))
    assert told[0] == "programme.phases.0.drive is at the high end of its range 1 V .. 9 V"
    assert told[1] == "the voltage is at supply.limit = 10 V"
    assert told[2] == score.reason
    assert limited_by(search, Candidate(np.array([0.5, 0.5]), {}, [score._replace(peak=5.0)])) == [score.reason]


def planned(tmp_path: Path, height: str, *options: str) -> tuple[int, dict[str, Any], Path]:
    out = tmp_path / "plan"
    sets = [part for change in (*SHORT, GOAL % height) for part in ("--set", change)]
    sizes = ["--generations", "2", "--population", "4", "--robots", "2", "--check", "2", "--rounds", "1"]
    vary = ["--vary", "material.p_ele=+-5 %"]
    result = runner.invoke(app, ["plan", "dome", *CHOICE, *sets, *sizes, *vary, *options, "--out", str(out), "--json"])
    return result.exit_code, json.loads(result.stdout), out


@pytest.mark.slow
def test_what_is_found_is_what_it_says(tmp_path: Path) -> None:
    """The programme file, played alone, does what was asked for."""
    code, found, out = planned(tmp_path, "0.9 mm")
    assert code == 0
    assert found["met"]
    assert found["checked_met"] == found["checked_on"] == 2
    programme = tomllib.loads((out / "programme.toml").read_text())["programme"]
    assert programme["phases"][0]["drive"] == found["best"]["values"]["programme.phases.0.drive"]
    sets = [part for change in (*SHORT, GOAL % "0.9 mm") for part in ("--set", change)]
    played = ["run", "dome", "--programme", str(out / "programme.toml"), *sets, "--no-movie", "--json"]
    result = runner.invoke(app, [*played, "--out", str(tmp_path / "run")])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["max_height_mm"] >= 0.9
    again = runner.invoke(app, ["plan", "--resume", str(out), "--json"])
    assert json.loads(again.stdout) == found


@pytest.mark.slow
def test_what_the_supply_cannot_do_is_said_and_not_claimed(tmp_path: Path) -> None:
    code, found, out = planned(tmp_path, "5 mm")
    assert code == 3
    assert not found["met"]
    assert found["best"]["shortfall"] > 1.0
    assert any("not met: nearest" in reason for reason in found["limited_by"])
    assert not (out / "programme.toml").exists()
    assert "NOT met" in (out / "best-attempt.toml").read_text()


def test_spreads_of_a_search_are_those_of_the_scenario_and_the_options() -> None:
    with pytest.raises(BadInput, match="a range"):
        spread("supply.limit", "ten volts", {"supply": {"limit": "10 V"}})
