"""The command line: what it says, where, with which exit code, and that bad input writes nothing."""

import json
import signal
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from command_line import refused
from gelbot.cli import app
from gelbot.errors import BadInput, SimulationFailed
from gelbot.scenario import built_in_text, load, names

runner = CliRunner()
SUMMARY = {"turned_over": True, "t_switch_s": 40.2, "t_transition_s": None, "wall_s": 2.0, "status": "finished"}


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What `run_scenario` was called with; in its place stands one that only makes the folder and a summary."""
    calls: list[dict[str, Any]] = []

    def run_scenario(loaded, out: Path, movie: bool, progress: bool) -> dict[str, Any]:
        calls.append({"loaded": loaded, "out": out, "movie": movie, "progress": progress})
        out.mkdir(parents=True, exist_ok=True)
        (out / "summary.json").write_text("{}")
        return SUMMARY

    replace_run(monkeypatch, run_scenario)
    return calls


def replace_run(monkeypatch: pytest.MonkeyPatch, run_scenario: Any) -> None:
    module = types.ModuleType("gelbot.run")
    module.__dict__["run_scenario"] = run_scenario
    monkeypatch.setitem(sys.modules, "gelbot.run", module)


def test_scenarios_lists_all():
    result = runner.invoke(app, ["scenarios"])
    assert result.exit_code == 0
    assert all(name in result.stdout for name in names())
    listed = json.loads(runner.invoke(app, ["scenarios", "--json"]).stdout)
    assert [row["name"] for row in listed] == names()
    assert all(row["description"] for row in listed)


@pytest.mark.parametrize("name", names())
def test_what_show_prints_loads_as_the_same_scenario(name: str):
    result = runner.invoke(app, ["show", name])
    assert result.stdout == built_in_text(name)
    Path("mine.toml").write_text(result.stdout, encoding="utf-8")
    assert load("mine.toml").scenario == load(name).scenario


def test_show_suggests_a_name():
    assert "Try: turn-over" in refused("show", "turnover")


def test_version():
    assert runner.invoke(app, ["--version"]).stdout.startswith("gelbot ")


def test_run_hands_over_scenario_and_folder(runs: list[dict[str, Any]]):
    result = runner.invoke(app, ["run", "dome", "--set", "body.thickness=1 mm", "--out", "there/it", "--no-movie"])
    assert result.exit_code == 0, result.output
    assert runs[0]["out"] == Path("there/it")
    assert runs[0]["loaded"].scenario.body.thickness == pytest.approx(1e-3)
    assert (runs[0]["movie"], runs[0]["progress"]) == (False, True)
    assert "40.2 s" in result.stdout
    assert "paper" in result.stdout
    assert "there/it" in result.stdout


def test_run_without_out_takes_the_next_free_folder(runs: list[dict[str, Any]]):
    for _ in range(3):
        assert runner.invoke(app, ["run", "dome"]).exit_code == 0
    assert [call["out"] for call in runs] == [Path("runs/dome"), Path("runs/dome-2"), Path("runs/dome-3")]


def test_run_json_prints_the_summary_alone(runs: list[dict[str, Any]]):
    result = runner.invoke(app, ["run", "dome", "--json"])
    assert json.loads(result.stdout) == SUMMARY
    assert runs[0]["progress"] is False


@pytest.mark.parametrize("mark", ["run.zarr", "summary.json"])
def test_a_folder_with_a_run_is_kept(runs: list[dict[str, Any]], mark: str):
    (Path("old") / mark).mkdir(parents=True)
    message = refused("run", "dome", "--out", "old")
    assert "--out: got 'old'" in message
    assert "holds a run already" in message
    assert not runs


def test_a_folder_without_a_run_is_taken(runs: list[dict[str, Any]]):
    Path("notes").mkdir()
    Path("notes/readme.txt").write_text("mine")
    assert runner.invoke(app, ["run", "dome", "--out", "notes"]).exit_code == 0
    assert runs


def test_out_that_cannot_be_a_folder_is_refused(runs: list[dict[str, Any]]):
    Path("file").write_text("")
    Path("link").symlink_to("nowhere")
    for out in ("file", "file/below", "link", "a" * 300):
        assert "--out: got" in refused("run", "dome", "--out", out)
    assert not runs


def test_forbidden_places_are_refused(runs: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch):
    # Nothing is forbidden to root, so the system's answers are played.
    def denied(*place: object, **_: object):
        raise PermissionError(13, "Permission denied", str(place[0]) if place else None)

    monkeypatch.setattr("gelbot.record.result_folder.TemporaryDirectory", denied)
    assert "can be written" in refused("run", "dome", "--out", "closed/out")
    monkeypatch.setattr(Path, "open", denied)
    assert "Permission denied" in refused("run", "secret.toml")
    assert not runs


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"\xff\xfe\x00binary", "UTF-8"),
        (b"\x00\x01\x02", "TOML"),
        (b"", "name"),
        (b"gap = 15 mm", "TOML"),
        (b"a = " + b"[" * 5000, "TOML"),
        (b"name = 'x'\nname = 'y'", "TOML"),
    ],
)
def test_files_that_are_no_scenario_are_refused(runs: list[dict[str, Any]], content: bytes, part: str):
    Path("mine.toml").write_bytes(content)
    message = refused("run", "mine.toml")
    assert "mine.toml" in message
    assert part in message
    assert not runs


def test_places_without_a_scenario_are_refused(runs: list[dict[str, Any]]):
    Path("folder").mkdir()
    assert "this is a folder" in refused("run", "folder")
    assert "there is no such file" in refused("run", "nowhere.toml")
    assert "Try: turn-over" in refused("run", "turn_over")
    refused("run", "a" * 5000)
    refused("run", "")
    assert not runs


@pytest.mark.parametrize(
    ("line", "key", "given", "allowed"),
    [
        ('thicknes = "1 mm"', "body.thicknes", "'1 mm'", "the keys thickness"),
        ('thickness = "1"', "body.thickness", "'1'", "a length with its unit"),
        ('thickness = "1 s"', "body.thickness", "'1 s'", "a length with its unit"),
        ('thickness = "-1 mm"', "body.thickness", "'-1 mm'", "greater than 0"),
        ('thickness = "nan mm"', "body.thickness", "'nan mm'", "finite"),
    ],
)
def test_bad_values_are_refused(runs: list[dict[str, Any]], line: str, key: str, given: str, allowed: str):
    text = built_in_text("turn-over").replace('thickness = "1 mm"', line)
    Path("mine.toml").write_text(text, encoding="utf-8")
    message = refused("run", "mine.toml")
    assert message.startswith(f"gelbot: mine.toml: {key}: got {given}; allowed: ")
    assert allowed in message
    assert not runs


def test_a_changed_value_is_named_as_such(runs: list[dict[str, Any]]):
    message = refused("run", "dome", "--set", "supply.limit=1 mm")
    assert message.startswith("gelbot: dome: supply.limit (with --set): got '1 mm'")
    assert "--set" in refused("run", "dome", "--set", "nonsense")
    assert not runs


def test_errors_of_a_run_are_messages(monkeypatch: pytest.MonkeyPatch):
    def failing(error: Exception, out: Path, **_: object):
        out.mkdir(parents=True)
        raise error

    cases = [
        (SimulationFailed(1.5, 0.2, 0.01, True), 1, "did not converge at t = 1.500 s"),
        (SimulationFailed(1.5, 0.01, 0.01, True, 3), 1, "3 were left out"),
        (BadInput("body.mesh_size", "9 mm", "less"), 2, "body.mesh_size"),
        (PermissionError(13, "Permission denied", "place"), 1, "place: Permission denied"),
    ]
    for number, (error, code, part) in enumerate(cases):
        replace_run(monkeypatch, lambda loaded, out, error=error, **rest: failing(error, out))
        result = runner.invoke(app, ["run", "dome", "--out", f"out{number}"])
        assert result.exit_code == code
        assert part in result.stderr
        assert "Traceback" not in result.output
        assert ("what was computed is kept in" in result.stderr) == isinstance(error, SimulationFailed)


def test_wrong_usage_leaves_with_2():
    assert runner.invoke(app, ["run"]).exit_code == 2
    assert runner.invoke(app, ["fly"]).exit_code == 2
    assert runner.invoke(app, ["run", "dome", "--fast"]).exit_code == 2


@pytest.mark.parametrize("words", [["scenarios"], ["show", "dome"], ["--version"], ["run", "nowhere.toml"]])
def test_words_alone_do_not_import_the_engine(words: list[str]):
    code = (
        "import sys; from gelbot.cli import app\n"
        f"sys.argv = ['gelbot', *{words!r}]\n"
        "try:\n    app()\nexcept SystemExit:\n    pass\n"
        "heavy = {'jax', 'pint', 'shapely', 'matplotlib', 'xarray'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("words", [["run", "turn-over"], ["live", "--no-browser"], ["directions", "turn-over"]])
def test_ctrl_c_while_something_is_imported_ends_it_without_a_word(words: list[str]):
    code = (
        "import os, signal, sys\n"
        "def press(event, given):\n"
        "    if event == 'import' and given[0] == 'numpy.linalg':\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.addaudithook(press)\n"
        "from gelbot.__main__ import main\n"
        f"sys.argv = ['gelbot', *{words!r}]\n"
        "main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")
    assert not list(Path().iterdir())


def test_ctrl_c_while_something_is_computed_says_what_is_kept(tmp_path: Path):
    code = (
        "import signal, sys\n"
        "from gelbot.cli.common import kept_in, stoppable\n"
        "from pathlib import Path\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL)\n"
        "with stoppable():\n    pass\n"
        "assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL\n"
        "with stoppable(kept_in(Path())):\n    signal.raise_signal(signal.SIGINT)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "gelbot: stopped; what was computed is kept in .\n")
