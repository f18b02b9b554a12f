"""Controllers that can be compared: where their programmes come from, and in which direction they go.

| identity | one road | the other |
|---|---|---|
| the open loop | voltages of the nominal robot, played again | the servo's own, on the nominal robot |
| a direction | the programme turned from the one it was planned for | angles of the body's directions |
| a map | its points | the same robots, one by one |
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gelbot.cli import app
from gelbot.controllers.choice import CONTROLLERS, with_controller
from gelbot.ensemble import outcome
from gelbot.errors import BadInput
from gelbot.scenario import built_in_text, load

runner = CliRunner()
COARSE = ("body.mesh_size='1.5 mm'", "electrodes.panels=6")
LIFT = (
    *COARSE,
    "simulation.duration='6 s'",
    "programme.phases.0.until.after='4 s'",
    "programme.reference.duration='3 s'",
)


@pytest.mark.slow
def test_the_open_loop_does_to_the_nominal_robot_what_the_servo_did() -> None:
    servo = load("lift", LIFT)
    played = with_controller(servo, "template")
    assert not any(phase.drive == "servo" for phase in played.scenario.programme.phases)
    one, other = (outcome(loaded, 0, {}) for loaded in (servo, played))
    heights = [run.frames["centre"].values[:, 2] for run in (one, other)]
    assert np.ptp(heights[0]) > 0.5e-3
    # Between the samples, half a second apart, its voltages are straight lines.
    assert heights[1] == pytest.approx(heights[0], abs=0.15e-3)
    assert np.array_equal(one.frames["phase"].values, other.frames["phase"].values)


@pytest.mark.parametrize(
    ("asked", "angle", "turn", "push"),
    [
        ("225 deg", 225, 0, 5.5543),
        ("45 deg", 45, 0, 6.1108),
        ("12 deg", 9, 144, 5.5543),
        ("250 deg", 261, -144, 6.1108),
    ],
)
def test_a_direction_is_the_body_s_nearest_and_has_the_programme_of_its_kind(
    asked: str, angle: float, turn: float, push: float
) -> None:
    """Over one tip and over two are two programmes; the second phase tells them apart."""
    scenario = with_controller(load("turn-over"), "planned", None, asked).scenario
    assert scenario.motion is not None
    assert scenario.motion.direction is not None
    assert np.degrees(scenario.motion.direction) == pytest.approx(angle)
    assert np.degrees(scenario.programme.turn) == pytest.approx(turn)
    until = scenario.programme.phases[1].until
    assert until is not None
    assert until.after == pytest.approx(push)


def test_what_was_planned_is_found_by_the_scenario_s_name_or_in_a_file(tmp_path: Path) -> None:
    own = with_controller(load("turn-over"), "planned").scenario.programme
    assert own.phases[1].name == "push"
    file = tmp_path / "mine.toml"
    file.write_text(built_in_text("turn-over"), encoding="utf-8")
    assert (
        with_controller(load("turn-over"), "planned", file).scenario.programme == load("turn-over").scenario.programme
    )
    with pytest.raises(BadInput, match="there is none for dome"):
        with_controller(load("dome"), "planned")
    with pytest.raises(BadInput, match="a programme file that can be read"):
        with_controller(load("turn-over"), "planned", tmp_path / "none.toml")
    (tmp_path / "empty.toml").write_text("x = 1")
    with pytest.raises(BadInput, match=r"no table \[programme\]"):
        with_controller(load("turn-over"), "planned", tmp_path / "empty.toml")
    with pytest.raises(BadInput, match="one of " + ", ".join(CONTROLLERS)):
        with_controller(load("turn-over"), "plannned")
    with pytest.raises(BadInput, match="an angle with its unit"):
        with_controller(load("turn-over"), "planned", None, "left")


@pytest.mark.slow
def test_a_map_is_its_points_one_by_one(tmp_path: Path) -> None:
    out = tmp_path / "map"
    goal = 'motion.goals=[{quantity="height", at_least="0.62 mm", lasting="0.1 s"}]'
    sets = [part for change in (*COARSE, goal, "simulation.duration='2 s'") for part in ("--set", change)]
    grid = [
        "--x",
        "programme.phases.0.drive=2 V .. 8 V",
        "--y",
        "material.p_l=0.4 .. 0.8",
        "--columns",
        "3",
        "--rows",
        "2",
    ]
    result = runner.invoke(app, ["map", "dome", *grid, *sets, "--out", str(out), "--json"], catch_exceptions=False)
    assert result.exit_code == 0
    made = json.loads(result.stdout)
    assert made["x"]["values"] == [2.0, 5.0, 8.0]
    assert made["y"]["values"] == [0.4, 0.8]
    loaded = load("dome", [*COARSE, goal, "simulation.duration='2 s'"])
    for row, p_l in enumerate(made["y"]["values"]):
        for column, volts in enumerate(made["x"]["values"]):
            one = outcome(loaded, 0, {"programme.phases.0.drive": f"{volts} V", "material.p_l": p_l})
            assert one.reached is not None
            assert made["met_at"][row][column] == one.reached.met
    assert 0 < made["met"] < made["n"] == 6
    assert {file.name for file in out.iterdir()} == {"map.json", "map.png", "points.csv"}


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (["--x", "material.p_l", "--y", "material.p_ads=0.9 .. 1"], "--x: got 'material.p_l'; allowed: KEY=LOW..HIGH"),
        (["--x", "material.p_l=0.1 .. 0.5", "--y", "material.p_ads=0.9 .. 1", "--rows", "1"], "--rows: got 1"),
        (["--x", "material.p_lx=0.1 .. 0.5", "--y", "material.p_ads=0.9 .. 1"], "turn-over: material.p_lx: got"),
        (["--x", "material.p_l=1 mm .. 5 mm", "--y", "material.p_ads=0.9 .. 1"], "turn-over: material.p_l: got"),
    ],
)
def test_a_map_that_means_nothing_is_refused(option: list[str], said: str, tmp_path: Path) -> None:
    result = runner.invoke(app, ["map", "turn-over", *option, "--out", str(tmp_path / "x")])
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "x").exists()
