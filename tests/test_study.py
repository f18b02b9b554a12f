"""Studies: many runs over the scatter, counted.

| identity | one road | the other |
|---|---|---|
| interval of a rate | quantiles of beta distributions | `scipy.stats.binomtest`, and the tails of the binomial |
| interval of a mean, of pairs | bootstrap, sign test | the normal law, and the binomial summed by hand |
| a robot | drawn among many | drawn alone: seed, run and key decide |
| a row | the study's run | the same scenario, built from nothing and marched alone |
| a study that was stopped, or killed | its files | those of one that was not, byte by byte |
| where it is computed | here, in processes, on a cluster one of whose workers dies | the same bytes |
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from rich.console import Console
from scipy.stats import binom, binomtest, t
from typer.testing import CliRunner

from gelbot.cli import app
from gelbot.controllers.choice import with_controller
from gelbot.ensemble import march_all, scenario_of
from gelbot.errors import BadInput, GelbotError
from gelbot.scenario import built_in_text, load
from gelbot.scenario.load import Loaded
from gelbot.scenario.overrides import with_overrides
from gelbot.show.study_table import print_comparison, print_study
from gelbot.show.study_view import draw_study
from gelbot.study.batches import batches, rows_of
from gelbot.study.campaign import (
    REQUEST,
    Request,
    asked_in,
    begin_study,
    cluster,
    prepare_study,
    run_study,
)
from gelbot.study.compare import compare
from gelbot.study.report import report, table_of
from gelbot.study.scatter import checked_spreads, draw, spreads
from gelbot.study.statistics import clopper_pearson, mean_of, sign_test
from waiting import until

RUNS = 24
SHORT = ('simulation.duration="1 s"', 'body.mesh_size="1.5 mm"', "electrodes.panels=6", "name=small-dome")
MOTION = """
[motion]
[[motion.goals]]
quantity = "height"
at_least = "0.551 mm"           # about half of the robots rise so high
lasting = "0.1 s"

[scatter]
material.p_ele = "+-15 %"
body.pose.position = "+-0.5 mm"
"""
FILES = ("study.json", "runs.csv")
runner = CliRunner()


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario of all studies here."""
    path = tmp_path_factory.mktemp("scenario") / "small-dome.toml"
    path.write_text(with_overrides(built_in_text("dome"), SHORT) + MOTION, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def here() -> Iterator[Executor]:
    """One thread of this process, which computes runs without a start of its own."""
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture(scope="module")
def whole(file: Path, here: Executor, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study that nothing disturbed."""
    folder = tmp_path_factory.mktemp("studies") / "whole"
    loaded = load(str(file))
    begin_study(prepare_study(loaded, request()), request(), folder)
    run_study(folder, here)
    return folder


@pytest.fixture
def in_this_process(here: Executor, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands compute runs here, not in processes of their own."""

    @contextmanager
    def workers(processes: int) -> Iterator[Executor]:
        yield here

    monkeypatch.setattr("gelbot.study.campaign.workers", workers)


def request(**changes: Any) -> Request:
    return Request(RUNS, 3, (), "servo", batch=5)._replace(**changes)


def begun(file: Path, folder: Path, asked: Request) -> Path:
    begin_study(prepare_study(load(str(file)), asked), asked, folder)
    return folder


def content(folder: Path) -> dict[str, bytes]:
    """All that a study wrote but its picture, by name."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".png")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def table(folder: Path) -> list[dict[str, str]]:
    """The rows of runs.csv."""
    return list(csv.DictReader((folder / "runs.csv").read_text().splitlines()))


def results(folder: Path) -> dict[str, bytes]:
    """The content but for the request, which says in which batches the runs were computed."""
    return {name: data for name, data in content(folder).items() if "batches" not in name and name != REQUEST}


class TestStatistics:
    @given(st.integers(1, 400), st.data())
    def test_clopper_pearson(self, count: int, data: st.DataObject) -> None:
        successes = data.draw(st.integers(0, count))
        found = clopper_pearson(successes, count)
        exact = binomtest(successes, count).proportion_ci(method="exact")
        assert (found.low, found.high) == pytest.approx((exact.low, exact.high), abs=1e-9)
        assert found.value == successes / count
        # By their definition: at the ends of the interval what was seen is just a tail of 2.5 %.
        if successes > 0:
            assert binom.sf(successes - 1, count, found.low) == pytest.approx(0.025, rel=1e-6)
        if successes < count:
            assert binom.cdf(successes, count, found.high) == pytest.approx(0.025, rel=1e-6)

    def test_the_numbers_that_its_text_gives(self) -> None:
        assert clopper_pearson(5, 5).low == pytest.approx(0.025 ** (1 / 5)) == pytest.approx(0.48, abs=5e-3)
        assert clopper_pearson(299, 299).low == pytest.approx(0.025 ** (1 / 299)) == pytest.approx(0.988, abs=5e-4)
        assert clopper_pearson(0, 5)[1:] == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 5)))

    def test_mean_of_many_is_that_of_the_normal_law(self, rng: np.random.Generator) -> None:
        values = rng.normal(5.0, 2.0, 400)
        found = mean_of(values)
        low, high = t.interval(0.95, len(values) - 1, values.mean(), values.std(ddof=1) / 20.0)
        assert found == pytest.approx((values.mean(), low, high), abs=0.03)
        assert mean_of(values) == found  # the same numbers have the same interval

    @pytest.mark.parametrize("values", [[3.0], [3.0, 3.0, 3.0]])
    def test_mean_of_equal_values_is_sure_of_them(self, values: list[float]) -> None:
        assert mean_of(np.array(values)) == (3.0, 3.0, 3.0)
        assert mean_of(np.array([])) is None

    @given(st.lists(st.sampled_from([0.0, 1.0, 2.5, 40.0]), min_size=2, max_size=6))
    def test_mean_of_few_lies_among_them(self, values: list[float]) -> None:
        found = mean_of(np.array(values))
        assert found is not None
        assert min(values) <= found.low <= found.value <= found.high <= max(values)

    @given(st.integers(0, 30), st.integers(0, 30))
    def test_sign_test(self, won: int, lost: int) -> None:
        count = won + lost
        tail = sum(math.comb(count, k) for k in range(min(won, lost) + 1)) / 2**count
        assert sign_test(won, lost) == pytest.approx(min(1.0, 2.0 * tail))
        assert sign_test(won, lost) == pytest.approx(sign_test(lost, won))


class TestScatter:
    def test_a_robot_depends_on_seed_run_and_key_alone(self, file: Path) -> None:
        loaded = load(str(file))
        both = spreads(loaded, ("material.p_l=+-10 %",))
        assert [one.key for one in both] == ["material.p_ele", "body.pose.position", "material.p_l"]
        one = draw(both, 4, 7)
        assert one == draw(tuple(reversed(both)), 4, 7)
        for spread in both:
            assert draw([spread], 4, 7) == {spread.key: one[spread.key]}
        assert draw(both, 5, 7) != one
        assert draw(both, 4, 8) != one
        assert draw(both, 7, 4) != one

    def test_draws_fill_their_range(self, file: Path) -> None:
        scattered = spreads(load(str(file)), ("material.p_l=0.5 .. 0.6",))
        drawn = np.array([draw(scattered, 1, run)["material.p_l"] for run in range(500)])
        assert drawn.min() >= 0.5
        assert drawn.max() <= 0.6
        counts = np.histogram(drawn, bins=5, range=(0.5, 0.6))[0]
        assert np.abs(counts - 100).max() < 4.0 * 80**0.5
        places = np.array([[float(x.split()[0]) for x in draw(scattered, 1, run)["body.pose.position"]]
                           for run in range(500)])  # fmt: skip
        assert abs(np.corrcoef(places.T)[0, 1]) < 0.15
        assert abs(np.corrcoef(places[:, 0], drawn)[0, 1]) < 0.15

    def test_vary_takes_the_place_of_the_scenario_s_own(self, file: Path) -> None:
        loaded = load(str(file))
        texts = {one.key: one.text for one in spreads(loaded, ('material.p_ele="+-1 %"', "body.pose.position=fixed"))}
        assert texts == {"material.p_ele": "+-1 %"}
        assert spreads(loaded, ("material.p_ele=fixed", "body.pose.position=fixed")) == ()

    @pytest.mark.parametrize(
        ("vary", "said"),
        [
            ("material.p_l", "--vary: got 'material.p_l'; allowed: key=range"),
            ("=+-1 %", "--vary: got '=+-1 %'; allowed: key=range"),
            ("material.p_l=10 %", "--vary material.p_l: got '10 %'; allowed: a range of values"),
            ("material.nothing=+-1 %", "--vary material.nothing: got '+-1 %'; allowed: a range about a value"),
            ("material.p_l=+-1 mm", "material.p_l: got '1 mm'; allowed: a value in a unit like that of the scenario"),
            ("material.nothing=1 .. 2", "--vary material.nothing: "),
            ("material.p_l=5 .. 6", "--vary material.p_l: "),
            ("material.p_l=0.5 mm .. 0.6 mm", "--vary material.p_l: "),
            ("body.thickness=1 .. 2 .. 3", "--vary body.thickness: "),
            ("body.arms.x=1 .. 2", "--vary body.arms.x: changed key: got 'body.arms.x'"),
            ("programme.phases.4.drive=1 V .. 2 V", "--vary programme.phases.4.drive: changed key"),
        ],
    )
    def test_what_cannot_vary_is_refused_before_anything_runs(self, file: Path, vary: str, said: str) -> None:
        with pytest.raises(BadInput, match=re.escape(said)):
            checked_spreads(load(str(file)), (vary,))

    def test_a_mistake_in_the_scenario_s_own_scatter_names_its_place(self, tmp_path: Path, file: Path) -> None:
        mine = tmp_path / "mine.toml"
        mine.write_text(file.read_text() + 'tank.frction = "0.1 .. 0.2"\n')
        with pytest.raises(BadInput, match=r"mine.toml: scatter.tank.frction: .*Try: friction"):
            checked_spreads(load(str(mine)), ())


def rows_with(met: list[bool], time: list[float] | None = None) -> list[dict[str, Any]]:
    """Rows as of a study; every number of run k is k, but for the `time` of its motion."""
    keys = ("t_switch_s", "t_transition_s", "z_switch_mm", "peak_voltage_V", "charge_C")
    return [
        {
            **dict.fromkeys(keys, float(k)),
            "run": k,
            "seed": [1, k],
            "changes": {"material.p_l": 0.1 * k, "body.pose.position": ["1 mm", f"{k} mm"]},
            "met": good,
            "reason": "" if good else f"too low: nearest {k} mm",
            "t_motion_s": (float(k) if time is None else time[k]) if good else None,
            "times_s": [0.5, 1.0],
            "heights_mm": [0.5, 0.5 + 0.1 * k],
        }
        for k, good in enumerate(met)
    ]  # fmt: skip


class TestReport:
    def test_numbers_of_a_study(self, file: Path) -> None:
        made = report(load(str(file)), "servo", 9, rows_with([True, False, True, True]))
        interval = clopper_pearson(3, 4)
        assert (made.study["n"], made.study["successes"], made.study["rate"]) == (4, 3, 0.75)
        assert (made.study["ci_low"], made.study["ci_high"]) == interval[1:]
        assert made.study["failures"] == [{"run": 1, "seed": [1, 1], "reason": "too low: nearest 1 mm"}]
        times = made.study["distributions"]["t_motion_s"]
        assert (times["min"], times["median"], times["max"]) == (0.0, 2.0, 3.0)
        assert times["mean"] == pytest.approx(5.0 / 3.0)
        assert times["q95"] == pytest.approx(np.quantile([0.0, 2.0, 3.0], 0.95))
        nothing = report(load(str(file)), "servo", 9, rows_with([False, False]))
        assert set(nothing.study["distributions"].values()) == {None}
        json.dumps(nothing.study, allow_nan=False)

    def test_the_table_has_a_column_for_each_number(self) -> None:
        one, other = csv.DictReader(table_of(rows_with([True, False])).splitlines())
        assert (one["run"], one["seed"], one["met"], one["t_motion_s"]) == ("0", "1 0", "True", "0.0")
        assert (other["run"], other["seed"], other["met"], other["t_motion_s"]) == ("1", "1 1", "False", "")
        assert other["material.p_l"] == "0.1"
        assert [other[f"body.pose.position.{k}"] for k in (0, 1)] == ["1 mm", "1 mm"]
        assert "times_s" not in one

    @pytest.mark.parametrize("met", [[True] * 3, [False] * 3, [True], [False]])
    def test_pictures_and_tables_of_all_and_of_none(self, file: Path, tmp_path: Path, met: list[bool]) -> None:
        made = report(load(str(file)), "servo", 9, rows_with(met))
        assert_whole(draw_study(made.study, made.rows, tmp_path / "study.png"))
        console = Console(record=True, width=120)
        print_study(made.study, console)
        said = console.export_text()
        assert f"{sum(met)} of {len(met)}" in said
        assert ("failed: too low (runs 0" in said) == (not any(met))

    def test_runs_that_never_began_have_no_trajectory(self, file: Path, tmp_path: Path) -> None:
        rows = rows_with([False, False])
        for row in rows:
            row.update(times_s=[], heights_mm=[], t_motion_s=None)
        made = report(load(str(file)), "servo", 9, rows)
        assert_whole(draw_study(made.study, rows, tmp_path / "study.png"))

    def test_controllers_are_compared_pair_by_pair(self, file: Path) -> None:
        loaded = load(str(file))
        one = report(loaded, "servo", 1, rows_with([True, True, False, False, True], [5.0, 6.0, 0, 0, 7.0]))
        other = report(loaded, "planned", 1, rows_with([True, True, True, False, False], [4.0, 4.0, 3.0, 0, 0]))
        found = compare([one, other])
        assert [study["controller"] for study in found["studies"]] == ["servo", "planned"]
        (pair,) = found["pairs"]
        assert (pair["only_first_met"], pair["only_second_met"], pair["p"]) == (1, 1, 1.0)
        less = pair["second_less_first"]
        assert less["t_motion_s"]["value"] == pytest.approx(-1.5)  # of runs 0 and 1
        assert less["peak_voltage_V"] == {"value": 0.0, "low": 0.0, "high": 0.0}
        console = Console(record=True, width=200)
        print_comparison(found, console)
        assert "planned against servo: met on 1 robots where the other did not, failed on 1" in console.export_text()
        assert compare([one])["pairs"] == []
        never = compare([one, report(loaded, "planned", 1, rows_with([False] * 5))])["pairs"][0]
        assert never["only_first_met"] == 3
        assert never["p"] == pytest.approx(0.25)
        assert set(never["second_less_first"].values()) == {None}


def assert_whole(path: Path) -> None:
    """A picture that opens, is decoded to its last line, and is not one colour."""
    with Image.open(path) as image:
        assert image.format == "PNG"
        pixels = np.asarray(image.convert("L"))
    assert min(pixels.shape) > 300
    assert np.ptp(pixels) > 100
    assert not list(path.parent.glob(".*.new"))


class TestFolder:
    def test_what_a_study_leaves(self, whole: Path) -> None:
        study = json.loads((whole / "study.json").read_text())
        rows = table(whole)
        met = [row["met"] == "True" for row in rows]
        assert (study["n"], study["successes"]) == (RUNS, sum(met)) == (len(rows), RUNS - len(study["failures"]))
        assert 0 < study["successes"] < RUNS
        exact = binomtest(study["successes"], RUNS).proportion_ci(method="exact")
        assert (study["rate"], study["ci_low"], study["ci_high"]) == pytest.approx((sum(met) / RUNS, *exact))
        assert (study["controller"], study["seed"], study["scenario"]) == ("servo", 3, "small-dome")
        assert [int(row["run"]) for row in rows] == list(range(RUNS))
        assert {"material.p_ele", "body.pose.position.0", "body.pose.position.1"} <= rows[0].keys()
        failed = sorted(path.name for path in (whole / "failed").iterdir())
        assert failed == [f"run-{k:04d}.toml" for k, good in enumerate(met) if not good]
        assert_whole(whole / "study.png")
        assert {"0.551 mm" in failure["reason"] for failure in study["failures"]} == {True}

    def test_a_row_is_the_run_of_its_scenario_alone(self, whole: Path, file: Path) -> None:
        """Built from nothing, without the study."""
        loaded = load(str(file))
        rows = [row for batch in batches(whole, RUNS, 5) for row in rows_of(batch)]
        for number in (1, RUNS - 1):
            alone = Loaded(scenario_of(loaded, rows[number]["changes"]), loaded.text, loaded.source)
            failed = whole / "failed" / f"run-{number:04d}.toml"
            if failed.exists():
                alone = load(str(failed))
                assert alone.scenario == scenario_of(loaded, rows[number]["changes"])
                (one,) = march_all(alone, [{}], processes=1)
            else:
                (one,) = march_all(loaded, [rows[number]["changes"]], processes=1)
            assert one.reached is not None
            assert one.reached.met == rows[number]["met"]
            assert one.summary["max_height_mm"] == pytest.approx(rows[number]["max_height_mm"], abs=1e-9)
            assert rows[number]["heights_mm"] == pytest.approx(one.frames["centre"].values[4::5, 2] * 1e3, abs=1e-4)

    def test_every_failed_run_can_be_repeated(self, whole: Path, file: Path) -> None:
        loaded = load(str(file))
        rows = {row["run"]: row for batch in batches(whole, RUNS, 5) for row in rows_of(batch)}
        files = {int(path.stem.removeprefix("run-")): path for path in (whole / "failed").iterdir()}
        for run, path in files.items():
            assert load(str(path)).scenario == scenario_of(loaded, rows[run]["changes"])
        run, path = files.popitem()
        (one,) = march_all(load(str(path)), [{}], processes=1)
        assert one.reached is not None
        assert not one.reached.met
        assert one.reached.shortfall == pytest.approx(rows[run]["shortfall"], rel=1e-6)

    @pytest.mark.parametrize("batch", [1, RUNS + 5])
    def test_batches_do_not_matter(self, whole: Path, file: Path, here: Executor, tmp_path: Path, batch: int) -> None:
        folder = begun(file, tmp_path / "other", request(batch=batch))
        run_study(folder, here)
        assert results(folder) == results(whole)

    def test_fewer_runs_are_the_first_of_more(self, whole: Path, file: Path, here: Executor, tmp_path: Path) -> None:
        folder = begun(file, tmp_path / "few", request(runs=7))
        run_study(folder, here)
        few, many = ((place / "runs.csv").read_text().splitlines() for place in (folder, whole))
        assert few == many[:8]

    def test_a_study_without_its_last_batches_goes_on_to_the_same_bytes(
        self, whole: Path, file: Path, here: Executor, tmp_path: Path
    ) -> None:
        folder = begun(file, tmp_path / "stopped", request())
        told: list[int] = []

        def stop(rows: list[dict[str, Any]]) -> None:
            told.append(len(rows))
            if len(told) == 2:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_study(folder, here, stop)
        done = sorted((folder / "batches").iterdir())
        assert 2 <= len(done) < 5
        assert not (folder / "study.json").exists()
        kept = done[0].stat().st_mtime_ns
        again: list[int] = []
        run_study(folder, here, lambda rows: again.append(len(rows)))
        assert sum(again) == RUNS
        assert done[0].stat().st_mtime_ns == kept
        assert content(folder) == content(whole)
        # One in the middle is lost later.
        done[1].unlink()
        (folder / "study.json").unlink()
        run_study(folder, here)
        assert content(folder) == content(whole)

    def test_a_finished_study_is_reported_again_without_a_run(self, whole: Path, tmp_path: Path) -> None:
        class Idle(ThreadPoolExecutor):
            def submit(self, *_: Any, **__: Any) -> Any:
                raise AssertionError("a run")

        before = content(whole)
        with Idle(1) as idle:
            run_study(whole, idle)
        assert content(whole) == before

    def test_a_robot_that_begins_in_a_wall_is_a_failed_run(self, file: Path, here: Executor, tmp_path: Path) -> None:
        walled = tmp_path / "walled.toml"
        wall = '[[obstacles]]\nshape = "plane"\nposition = ["25 mm", "0 mm", "0 mm"]\nnormal = [-1, 0, 0]\n'
        walled.write_text(file.read_text() + wall)
        places = "body.pose.position.0=12.5 mm | 22 mm"
        folder = begun(walled, tmp_path / "walled", request(runs=8, vary=(places, "body.pose.position=fixed")))
        made = run_study(folder, here)
        inside = [row["changes"]["body.pose.position.0"] == "22 mm" for row in made.rows]
        assert 0 < sum(inside) < 8
        for row, bad in zip(made.rows, inside, strict=True):
            assert ("into plane 1" in row["reason"]) == bad
            if bad:
                assert row["reason"].startswith(f"robot {row['run']}: body.pose: got 'a body that reaches")
                assert (row["met"], row["simulated_s"], row["heights_mm"]) == (False, None, [])
                again = load(str(folder / "failed" / f"run-{row['run']:04d}.toml"))
                assert again.scenario.body.pose.position[0] == 0.022
        assert_whole(folder / "study.png")

    def test_a_value_that_is_not_allowed_is_a_failed_run(self, file: Path, here: Executor, tmp_path: Path) -> None:
        folder = begun(file, tmp_path / "wide", request(runs=6, vary=("material.p_l=0.6 .. 1.3",)))
        reasons = [row["reason"] for row in run_study(folder, here).rows if row["changes"]["material.p_l"] >= 1.0]
        assert reasons
        assert all("material.p_l: got 1." in reason for reason in reasons)


class TestFolderOfAnother:
    def test_only_the_same_gelbot_goes_on(self, file: Path, tmp_path: Path) -> None:
        folder = begun(file, tmp_path / "old", request())
        loaded, asked = asked_in(folder)
        assert asked == request()
        assert loaded.source == str(file)
        told = json.loads((folder / REQUEST).read_text())
        (folder / REQUEST).write_text(json.dumps({**told, "gelbot": "0.0.7"}))
        with pytest.raises(BadInput, match=r"begun with gelbot 0.0.7; allowed|got .*begun with gelbot 0\.0\.7"):
            run_study(folder)

    @pytest.mark.parametrize("text", ["", "{", "[]", "3", "{}", '{"gelbot": "0.1.0"}', '{"controllers": []}'])
    def test_a_request_that_is_none_is_refused(self, tmp_path: Path, text: str) -> None:
        (tmp_path / REQUEST).write_text(text)
        with pytest.raises(BadInput, match=r"--resume: got .*allowed: the folder of a study"):
            run_study(tmp_path)
        assert_one_line(invoke("--resume", str(tmp_path)), "--resume")

    def test_a_scenario_without_motion_is_no_study(self) -> None:
        with pytest.raises(BadInput, match=r"dome: motion: got 'nothing'; allowed: a table \[motion\]"):
            prepare_study(load("dome"), request())

    @pytest.mark.parametrize(
        ("changes", "said"),
        [({"runs": 0}, "-n: got 0"), ({"batch": 0}, "batch: got 0"), ({"seed": -1}, "--seed: got -1; allowed: 0")],
    )
    def test_numbers_that_make_no_study(self, file: Path, changes: dict[str, int], said: str) -> None:
        with pytest.raises(BadInput, match=re.escape(said)):
            prepare_study(load(str(file)), request(**changes))


class TestControllers:
    def test_the_template_replays_what_the_servo_does_to_the_unchanged_robot(self, file: Path) -> None:
        loaded = load(str(file), ['programme.phases.0.drive=[["0 s", "1 V"], ["1 s", "4 V"]]'])
        (one,) = march_all(loaded, [{}], processes=1)
        (other,) = march_all(with_controller(loaded, "template"), [{}], processes=1)
        assert other.frames["voltage"].values == pytest.approx(one.frames["voltage"].values, abs=0.02)
        assert other.frames["centre"].values == pytest.approx(one.frames["centre"].values, abs=1e-7)
        assert with_controller(loaded, "servo") is loaded

    def test_a_planned_programme_is_taken_from_its_file(self, file: Path, tmp_path: Path) -> None:
        loaded = load(str(file))
        planned = tmp_path / "planned.toml"
        planned.write_text('[programme]\ncontrol_period="100 ms"\n[[programme.phases]]\nname="up"\npattern="ridge"\n'
                           'drive="3 V"\n')  # fmt: skip
        found = with_controller(loaded, "planned", planned)
        assert found.scenario.programme.phases[0].drive == 3.0
        assert found.scenario.body == loaded.scenario.body
        planned.write_text("drive = 3")
        with pytest.raises(BadInput, match=r"planned.toml: got 'no table \[programme\]'"):
            with_controller(loaded, "planned", planned)
        planned.write_text("drive = ")
        with pytest.raises(BadInput, match=r"planned.toml: got .*allowed: TOML"):
            with_controller(loaded, "planned", planned)
        with pytest.raises(BadInput, match=r"--programme: got .*none.toml"):
            with_controller(loaded, "planned", tmp_path / "none.toml")
        with pytest.raises(BadInput, match=r"there is none for small-dome\. Try: gelbot plan"):
            with_controller(loaded, "planned")
        with pytest.raises(BadInput, match="one of template, servo, planned, predictive"):
            with_controller(loaded, "luck")


def invoke(*words: str) -> Any:
    return runner.invoke(app, ["study", *words])


def assert_one_line(result: Any, *parts: str, code: int = 2) -> None:
    """One line on the error output, nothing on the other."""
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("gelbot: ")
    assert result.stderr.count("\n") == 1
    for part in parts:
        assert part in result.stderr


@pytest.mark.usefixtures("in_this_process")
class TestCommand:
    @pytest.fixture(autouse=True)
    def _in_empty_folder(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)

    def test_json_prints_study_json_and_nothing_else(self, file: Path) -> None:
        result = invoke(str(file), "-n", "4", "--seed", "5", "--json", "--out", "here")
        assert result.exit_code == 0, result.output
        assert result.stderr == ""
        assert result.stdout == Path("here/study.json").read_text()
        assert json.loads(result.stdout)["n"] == 4

    def test_a_table_and_the_folder_are_printed(self, file: Path) -> None:
        result = invoke(str(file), "-n", "4", "--vary", "material.p_ele=+-1 %", "--set", "supply.limit=9 V")
        assert result.exit_code == 0, result.output
        assert "results in studies/small-dome" in result.stdout
        assert "of 4" in result.stdout
        assert load("studies/small-dome/scenario.toml").scenario.supply.limit == 9.0
        told = json.loads(Path("studies/small-dome", REQUEST).read_text())
        assert (told["runs"], told["seed"], told["vary"]) == (4, 1, ["material.p_ele=+-1 %"])
        again = invoke(str(file), "-n", "1", "--json")
        assert again.exit_code == 0
        assert Path("studies/small-dome-2/study.json").exists()

    def test_resume_goes_on_with_what_is_missing(self, file: Path) -> None:
        assert invoke(str(file), "-n", "12", "--out", "here", "--json").exit_code == 0
        before = content(Path("here"))
        Path("here/batches/000010.json").unlink()
        Path("here/study.json").unlink()
        result = invoke("--resume", "here", "--json")
        assert result.exit_code == 0
        assert content(Path("here")) == before
        assert_one_line(invoke(str(file), "--out", "here"), "--out: got 'here'", "holds a study already")

    @pytest.mark.parametrize(
        "words",
        [
            ["-n", "5"],
            ["--seed", "2"],
            ["--vary", "a=1 | 2"],
            ["--set", "a=1"],
            ["--direction", "9 deg"],
            ["--controller", "servo"],
            ["--out", "x"],
        ],
    )
    def test_resume_stands_alone(self, words: list[str]) -> None:
        assert_one_line(invoke("--resume", "here", *words), "--resume: got 'here'; allowed: alone")

    @pytest.mark.parametrize(
        ("words", "part"),
        [
            ([], "scenario: got 'nothing'"),
            (["nowhere.toml"], "there is no such file"),
            (["dome"], "dome: motion: got 'nothing'"),
            (["turn-over", "-n", "0"], "-n: got 0"),
            (["turn-over", "-n", "-3"], "-n: got -3"),
            (["turn-over", "--seed", "-1"], "--seed: got -1"),
            (["turn-over", "--vary", "nonsense"], "--vary: got 'nonsense'"),
            (["turn-over", "--vary", "material.p_lx=1 .. 2"], "--vary material.p_lx"),
            (["turn-over", "--vary", "material.p_l=much"], "--vary material.p_l: got 'much'"),
            (["turn-over", "--controller", "luck"], "--controller: got 'luck'; allowed: one of template"),
            (["turn-over", "--controller", "servo", "--controller", "servo"], "each once"),
            (["turn-over", "--controller", "planned", "--programme", "none.toml"], "--programme: got 'none.toml'"),
            (["turn-over", "--set", "supply.limit=1 mm"], "supply.limit (with --set)"),
            (["--resume", "nowhere"], "--resume: got 'nowhere'; allowed: the folder of a study"),
            (["--resume", "."], "--resume: got '.'"),
        ],
    )
    def test_bad_input_is_one_line_and_leaves_nothing(self, words: list[str], part: str) -> None:
        assert_one_line(invoke(*words), part)
        assert list(Path().iterdir()) == []

    def test_controllers_meet_the_same_robots(self, file: Path) -> None:
        Path("planned.toml").write_text(
            '[programme]\ncontrol_period="100 ms"\n[[programme.phases]]\nname="up"\npattern="ridge"\ndrive="2.7 V"\n'
        )
        words = ("--controller", "servo", "--controller", "template", "--controller", "planned")
        result = invoke(str(file), "-n", "12", *words, "--programme", "planned.toml", "--out", "here", "--json")
        assert result.exit_code == 0, result.output
        assert result.stderr == ""
        found = json.loads(result.stdout)
        assert found == json.loads(Path("here/comparison.json").read_text())
        assert sorted(study["controller"] for study in found["studies"]) == ["planned", "servo", "template"]
        robots = [
            [row["material.p_ele"] for row in table(Path("here", name))] for name in ("servo", "template", "planned")
        ]
        assert robots[0] == robots[1] == robots[2]
        assert len(set(robots[0])) == 12
        # The dome has a constant voltage: replayed, it is the same.
        by_name = {study["controller"]: study for study in found["studies"]}
        assert by_name["servo"]["successes"] == by_name["template"]["successes"]
        assert by_name["planned"]["successes"] > by_name["servo"]["successes"]
        pair = next(p for p in found["pairs"] if {p["first"], p["second"]} == {"servo", "planned"})
        won = by_name["planned"]["successes"] - by_name["servo"]["successes"]
        assert sorted([pair["only_first_met"], pair["only_second_met"]]) == [0, won]
        assert pair["p"] == pytest.approx(min(1.0, 2.0 * 0.5**won))
        before = content(Path("here"))
        Path("here/planned/batches/000000.json").unlink()
        Path("here/comparison.json").unlink()
        assert invoke("--resume", "here").exit_code == 0
        assert content(Path("here")) == before

    def test_a_controller_that_cannot_be_had_stops_all_of_them(self, file: Path) -> None:
        result = invoke(str(file), "-n", "2", "--controller", "servo", "--controller", "planned", "--out", "here")
        assert_one_line(result, "--controller: got 'planned'")
        assert not Path("here").exists()

    @pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "udp://x", ""])
    def test_a_scheduler_that_is_not_there_is_one_message(
        self, file: Path, address: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("gelbot.study.campaign.PATIENCE", "1s")
        result = invoke(str(file), "-n", "2", "--out", "here", "--scheduler", address)
        assert_one_line(result, f"--scheduler: got '{address}'; allowed: the address of a running scheduler")
        assert not Path("here").exists()

    def test_without_distributed_it_is_said(self, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "distributed", None)
        result = invoke(str(file), "-n", "2", "--out", "here", "--scheduler", "tcp://127.0.0.1:9")
        assert_one_line(result, "pip install 'gelbot[cluster]'", code=1)


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "gelbot", "study", *words]


@pytest.mark.slow
def test_a_study_that_is_killed_goes_on_to_the_same_bytes(file: Path, here: Executor, tmp_path: Path) -> None:
    runs = 60
    sure = begun(file, tmp_path / "sure", request(runs=runs, batch=10))
    run_study(sure, here)
    folder = tmp_path / "killed"
    words = (str(file), "-n", str(runs), "--seed", "3", "--json", "--out", str(folder))
    with subprocess.Popen(command(*words), start_new_session=True, stdout=subprocess.PIPE) as process:
        until(lambda: any((folder / "batches").glob("*.json")) or process.poll() is not None, 300.0)
        process.send_signal(signal.SIGKILL)
    done = len(list((folder / "batches").glob("*.json")))
    assert 1 <= done < 6
    assert not (folder / "study.json").exists()
    # Its workers do not outlive it.
    until(lambda: not group_is_there(process.pid), 60.0)
    left = len(list((folder / "batches").glob("*.json")))
    assert left == done
    resumed = subprocess.run(command("--resume", str(folder), "--json"), capture_output=True, check=True)
    assert resumed.stdout == (sure / "study.json").read_bytes()
    assert content(folder) == content(sure)
    assert_whole(folder / "study.png")


def group_is_there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture(scope="module")
def two_workers() -> Iterator[Any]:
    """A cluster of two processes on this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
    ) as made:
        yield made


@pytest.mark.slow
class TestCluster:
    def test_it_computes_the_same_bytes(self, whole: Path, file: Path, tmp_path: Path, two_workers: Any) -> None:
        folder = begun(file, tmp_path / "cluster", request())
        with cluster(two_workers.scheduler_address) as executor:
            run_study(folder, executor)
        assert content(folder) == content(whole)

    def test_from_the_command_line(self, whole: Path, file: Path, tmp_path: Path, two_workers: Any) -> None:
        words = ("-n", str(RUNS), "--seed", "3", "--out", str(tmp_path / "here"), "--json")
        result = invoke(str(file), *words, "--scheduler", two_workers.scheduler_address)
        assert result.exit_code == 0, result.output
        assert result.stdout == (whole / "study.json").read_text()
        assert results(tmp_path / "here") == results(whole)

    def test_a_worker_that_dies_changes_nothing(
        self, whole: Path, file: Path, tmp_path: Path, two_workers: Any
    ) -> None:
        folder = begun(file, tmp_path / "cluster", request(batch=1))
        killed: list[int] = []
        with cluster(two_workers.scheduler_address) as executor:
            workers = two_workers.scheduler.workers

            def kill(rows: list[dict[str, Any]]) -> None:
                if not killed:
                    busy = next(one for one in workers.values() if one.processing)
                    killed.append(busy.metrics.get("pid") or pid_of(two_workers, busy.address))
                    os.kill(killed[0], signal.SIGKILL)

            run_study(folder, executor, kill)
        assert killed
        assert results(folder) == results(whole)

    def test_what_a_worker_raises_comes_back_as_it_was(self, tmp_path: Path, two_workers: Any) -> None:
        with cluster(two_workers.scheduler_address) as executor, pytest.raises(BadInput, match="place: got 3"):
            executor.submit(failing).result()

    def test_a_cluster_that_gives_up_is_one_message(self, two_workers: Any) -> None:
        from distributed import KilledWorker

        with (
            pytest.raises(GelbotError, match=r"the cluster at .* lost worker after worker\. gelbot study --resume"),
            cluster(two_workers.scheduler_address),
        ):
            raise KilledWorker("run_batch", two_workers, 3)

    def test_a_scheduler_that_dies_is_one_message_and_what_was_done_is_kept(
        self, whole: Path, file: Path, here: Executor, tmp_path: Path
    ) -> None:
        folder = begun(file, tmp_path / "gone", request(batch=1))
        program = tmp_path / "scheduler.py"
        program.write_text(SCHEDULER)
        with subprocess.Popen(
            [sys.executable, str(program)], start_new_session=True, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            with (
                pytest.raises(GelbotError, match=r"the cluster at .* is gone\. gelbot study --resume"),
                cluster(process.stdout.readline().strip()) as executor,
            ):
                run_study(folder, executor, lambda rows: os.killpg(process.pid, signal.SIGKILL))
        assert 1 <= len(list((folder / "batches").iterdir())) < RUNS
        run_study(folder, here)
        assert results(folder) == results(whole)


SCHEDULER = """
import time
from distributed import LocalCluster

if __name__ == "__main__":
    here = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "memory_limit": 0}
    with LocalCluster(n_workers=1, threads_per_worker=1, **here) as made:
        print(made.scheduler_address, flush=True)
        time.sleep(600)
"""


def failing() -> None:
    raise BadInput("place", 3, "2")


def pid_of(made: Any, address: str) -> int:
    """The process of the worker at `address`."""
    with made.get_client() as client:
        return client.run(os.getpid, workers=[address])[address]
