"""`gelbot calibrate`: what it finds in pictures of which the calibration is known, and what it refuses.

| picture | what must be |
|---|---|
| a rendered gel, two clicks on places that were projected | the calibration with which it was rendered |
| a drawn checkerboard | the same |
| lines drawn for a camera that leans | they lie where floor and uprights of the tank are seen |
| a board to print | an SVG; never over a file |
| wrong options | one line each, nothing written |
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from command_line import refused
from gelbot.cli import app
from gelbot.hardware.calibrating import marked
from gelbot.hardware.calibration import Calibration, load_calibration

MM = 1e-3
SEEN = Calibration("side", np.radians(-45.0), 0.0, 0.0, (14 * MM, 14 * MM, 4 * MM), 150 * MM, 16e3, 0.0, 640, 480)
PLACES = np.array([[14.0, 14.0, 0.0], [10.0, 18.0, 6.0], [18.0, 10.0, 3.0]]).T * MM
"""In the plane of the gel, across the line of sight."""


def run(*words: str) -> str:
    result = CliRunner().invoke(app, ["calibrate", *words])
    assert result.exit_code == 0, result.output
    return result.stdout


def pixels(point: np.ndarray) -> str:
    x, y = SEEN.project(point[:, None])[:, 0]
    return f"{x:.3f},{y:.3f}"


def alike(path: Path) -> None:
    found = load_calibration(path)
    np.testing.assert_allclose(found.project(PLACES), SEEN.project(PLACES), atol=0.7)


def test_two_clicks(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("picture.png", np.full((480, 640), 180, np.uint8))
    right = SEEN.axes[0]
    place = np.array(SEEN.place)
    ends = place - 7 * MM * right, place + 7 * MM * right
    clicks = [word for end in ends for word in ("--click", pixels(end))]
    known = ["--known", pixels(place), "--at", "14 mm, 14 mm, 4 mm"]
    said = run("picture.png", "--azimuth", "-45 deg", "--distance", "150 mm", *clicks, "--apart", "14 mm", *known)
    assert said.startswith("16 pixels per mm")
    alike(Path("camera.toml"))
    before = Path("camera.toml").read_bytes()
    again = ("calibrate", "picture.png", "--azimuth", "-45 deg", "--distance", "150 mm", *clicks, "--apart", "14 mm")
    assert "--out: got 'camera.toml'; allowed: a file that does not exist yet" in refused(*again, *known)
    assert Path("camera.toml").read_bytes() == before
    # What else is wrong is told first.
    assert "--apart: got nothing" in refused(*again[:-2])
    # Lines to look at are drawn where the tank is.
    drawn = cv2.imread("camera.png")
    assert drawn is not None
    foot = np.round(SEEN.project(np.array([[14.0], [14.0], [0.0]]) * MM)[:, 0]).astype(int)
    assert np.ptp(drawn[foot[1], foot[0]].astype(int)) > 50


def test_a_checkerboard(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # The board stands in the plane of the gel, its lower left inner corner at `first`.
    first = np.array(SEEN.place) - 8 * MM * SEEN.axes[0] - 3 * MM * SEEN.axes[1]
    picture = np.full((480, 640), 230, np.uint8)
    for column in range(-1, 9):
        for row in range(-1, 6):
            if (column + row) % 2 == 0:
                square = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
                corners = np.stack([first + 2 * MM * (c * SEEN.axes[0] + r * SEEN.axes[1]) for c, r in square]).T
                at = np.round(SEEN.project(corners).T * 16.0).astype(np.int32)
                cv2.fillPoly(picture, [at], 30, shift=4)
    cv2.imwrite("board.png", cv2.GaussianBlur(picture, (0, 0), 1.0))
    at = ", ".join(f"{value / MM:.6f} mm" for value in first)
    words = ("--azimuth", "-45 deg", "--distance", "150 mm", "--board", "9x6", "--square", "2 mm", "--at", at)
    found = json.loads(run("board.png", *words, "--json"))
    assert found["scale"] == pytest.approx(16e3, rel=2e-3)
    alike(Path("camera.toml"))


@pytest.mark.parametrize(("elevation", "roll"), [(0.0, -3.0), (8.0, 5.0)])
def test_the_lines_of_a_camera_that_leans_stand_in_the_tank(elevation, roll):
    seen = replace(SEEN, elevation=np.radians(elevation), roll=np.radians(roll))
    drawn = marked(np.full((480, 640), 180, np.uint8), seen, np.array(SEEN.place))
    # The floor line, across the line of sight, and the upright one.
    along = np.linspace(-12.0, 12.0, 25) * MM
    across = np.array([14 * MM, 14 * MM, 0.0])[:, None] + along * np.array([1.0, 1.0, 0.0])[:, None] / np.sqrt(2.0)
    upright = np.array([14 * MM, 14 * MM, 0.0])[:, None] + np.abs(along) * np.array([0.0, 0.0, 1.0])[:, None]
    for line in (across, upright):
        x, y = np.round(seen.project(line)).astype(int)
        there = (x >= 1) & (x < 639) & (y >= 1) & (y < 479)
        assert there.sum() > 10
        for column, row in zip(x[there], y[there], strict=True):
            near = drawn[row - 1 : row + 2, column - 1 : column + 2]
            assert np.ptp(near.astype(int), axis=2).max() > 50, (column, row)


def test_a_board_to_print(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "print it at 100 %" in run("board.svg", "--board", "7x5", "--square", "3 mm")
    assert Path("board.svg").read_text().count("<rect") >= 8 * 6 // 2
    assert "does not exist yet" in refused("calibrate", "board.svg")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "--click: got nothing"),
        (("--click", "1,2"), "two points a known distance apart"),
        (("--click", "1,2", "--click", "300,2"), "--apart: got nothing"),
        (("--click", "1,2", "--click", "3,2", "--apart", "3 mm"), "10 pixels or more apart"),
        (("--click", "1,2", "--click", "300,2", "--apart", "3"), "a length with its unit"),
        (("--board", "nine"), "such as 9x6"),
        (("--board", "9x6"), "no board of 9 x 6 inner corners"),
        (("--board", "9x6", "--square", "0 mm"), "--square: got '0 mm'"),
        (("--board", "9x6", "--click", "1,2", "--click", "300,2"), "a checkerboard or clicks, one of them"),
        (("--view", "below"), "side or above"),
        (("--azimuth", "45"), "an angle with its unit"),
        (("--at", "1 mm, 2 mm", "--board", "9x6"), "x, y and z with units"),
    ],
)
def test_wrong_options(tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("picture.png", np.full((480, 640), 180, np.uint8))
    assert says in refused("calibrate", "picture.png", *words)
