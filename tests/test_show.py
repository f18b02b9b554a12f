"""Pictures of a made-up turn-over on the real mesh: they come out whole, show the right moments, and clean up."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from rich.console import Console

from gelbot.body.lattice import build_body
from gelbot.body.outline import starfish
from gelbot.scenario import load
from gelbot.scenario.obstacle_surfaces import obstacle_triangles
from gelbot.show import movie
from gelbot.show.gel_view import ELEVATION, GelView, Scene
from gelbot.show.movie import film_frames, make_movie
from gelbot.show.plan_view import PlanView
from gelbot.show.progress import RunProgress
from gelbot.show.snapshots import COUNT, draw_snapshots, moments
from gelbot.show.style import is_rhythm, new_figure, phase_name, stretches
from gelbot.show.table import print_summary
from gelbot.show.trajectory import draw_trajectory

SWITCH, OVER, END = 20.0, 24.0, 30.0


def made_run(interval: float = 0.25, axis_angle: float = -np.pi / 4) -> xr.Dataset:
    """A starfish that turns stiffly about a horizontal axis between `SWITCH` and `OVER` seconds."""
    body = build_body(starfish(15e-3, 5.449e-3, None, 0.8e-3), 0.8e-3, 1.2e-3)
    time = np.arange(0.0, END + 1e-9, interval)
    turn = np.pi * np.clip((time - SWITCH) / (OVER - SWITCH), 0.0, 1.0)
    axis = np.array([np.cos(axis_angle), np.sin(axis_angle), 0.0])
    cross = np.cross(np.eye(3), axis).T
    matrices = np.eye(3) + np.sin(turn)[:, None, None] * cross + (1 - np.cos(turn))[:, None, None] * cross @ cross
    position = matrices @ body.nodes
    position[:, 2] -= position[:, 2].min(axis=1, keepdims=True)
    position[:, :2] += 12.5e-3
    xy = (np.arange(4) - 1.5) * 25e-3
    x, y = (g.ravel() for g in np.meshgrid(xy, xy))
    phase = (time >= SWITCH).astype(int)
    pattern = np.where(np.arange(16) == 10, -1.0, 1.0)
    count, faces = len(time), body.faces.shape[1]
    variables = {
        "position": (("time", "space", "node"), position),
        "adsorption": (("time", "face"), np.tile(np.linspace(0, 1, count)[:, None], (1, faces))),
        "voltage": (("time", "electrode"), np.tile(8.0 * pattern, (count, 1))),
        "centre": (("time", "space"), position @ body.centre),
        "normal": (("time", "space"), matrices[:, :, 2]),
        "tip_angle": (("time", "tip"), np.tile(np.linspace(0, 1.6, count)[:, None], (1, 5))),
        "reference": (("time",), 0.4e-3 + 5e-3 * np.clip(time / SWITCH, 0, 1)),
        "amplitude": (("time",), np.full(count, 8.0)),
        "phase": (("time",), phase),
        "rest_position": (("space", "node"), body.nodes),
        "faces": (("corner", "face"), body.faces),
        "electrode_centre": (("space", "electrode"), np.stack([x, y, np.full(16, 15e-3)])),
    }
    attrs = {"phase_names": ["preparation", "transition"], "electrode_side": 10e-3, "limit": 10.0}
    return xr.Dataset(variables, coords={"time": time, "space": ["x", "y", "z"]}, attrs=attrs)


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    return made_run()


def ink(picture: np.ndarray) -> float:
    """The share of a picture that is not white."""
    return float((picture[..., :3].min(axis=-1) < 0.98).mean())


@pytest.mark.parametrize("draw", [draw_trajectory, draw_snapshots])
def test_figures_come_out(run: xr.Dataset, tmp_path: Path, draw) -> None:
    for data in (run, run.isel(time=slice(0, 1)), run.isel(time=slice(0, 5))):
        path = draw(data, tmp_path / "figure.png")
        assert 0.02 < ink(imread(path)) < 0.9
        assert [p.name for p in tmp_path.iterdir()] == ["figure.png"]
    with pytest.raises(ValueError, match="without frames"):
        draw(run.isel(time=slice(0, 0)), tmp_path / "figure.png")


def test_frames_that_are_not_finite_are_left_out(run: xr.Dataset, tmp_path: Path) -> None:
    broken = run.copy(deep=True)
    broken["centre"][-3:] = np.nan
    broken["position"][-3:] = np.nan
    draw_trajectory(broken, tmp_path / "t.png")
    draw_snapshots(broken, tmp_path / "s.png")
    make_movie(broken.isel(time=slice(-12, None)), tmp_path / "m.mp4")


def test_the_moments_show_the_switch_and_the_turning(run: xr.Dataset) -> None:
    chosen = moments(run)
    time, tilt = run["time"].values[chosen], np.degrees(np.arccos(run["normal"].values[chosen, 2]))
    assert len(chosen) == COUNT
    assert np.all(np.diff(chosen) > 0)
    assert time[0] == 0.0
    assert time[3] == SWITCH
    assert time[-1] == END
    # A picture of every part of the turning, to within the frames' distance.
    np.testing.assert_allclose(tilt[4:7], [0.35 * 180, 0.65 * 180, 180], atol=12.0)


@pytest.mark.parametrize("phases", [np.zeros(121), np.ones(121), np.arange(121) >= 119])
def test_there_are_always_enough_moments(run: xr.Dataset, phases) -> None:
    still = run.assign(phase=(("time",), phases.astype(int)))
    assert len(moments(still)) == COUNT
    assert len(set(moments(still))) == COUNT


def test_a_rhythm_of_phases_is_shown_as_one(run: xr.Dataset, tmp_path: Path) -> None:
    """Four phases that come again and again, then a rest: names without their numbers, moments until the rest."""
    count = run.sizes["time"]
    phase = np.where(np.arange(count) < 90, np.arange(count) % 4, 4)
    walk = run.assign(phase=(("time",), phase))
    walk.attrs |= {
        "phase_names": ["step 1", "step 2", "step 3", "step 4", "rest"],
        "reference_axis": [1.0, 0.0, 0.0],
        "reference_point": 0,
    }
    assert is_rhythm(walk)
    assert stretches(walk) == [(0, 90, "step"), (90, count - 1, "rest")]
    assert moments(walk)[-2:].tolist() == [90, count - 1]
    assert len(moments(walk)) == COUNT
    for draw in (draw_trajectory, draw_snapshots):
        assert 0.02 < ink(imread(draw(walk, tmp_path / "figure.png"))) < 0.9
    few = run.assign(phase=(("time",), (np.arange(count) >= 60).astype(int)))
    assert not is_rhythm(few)
    assert [name for *_, name in stretches(few)] == ["preparation", "transition"]


def test_obstacles_are_drawn(run: xr.Dataset, tmp_path: Path) -> None:
    box = 'obstacles=[{shape="box", position=["12 mm", "12 mm", "3 mm"], size=["6 mm", "6 mm", "6 mm"]}]'
    surface = obstacle_triangles(load("turn-over", [box]).scenario.obstacles)
    with_box = run.assign(obstacle_surface=(("space", "corner", "obstacle_face"), surface))
    plain, boxed = (imread(draw_snapshots(data, tmp_path / "s.png")) for data in (run, with_box))
    assert (np.abs(plain - boxed).max(axis=-1) > 0.05).mean() > 0.003


def test_the_film_runs_at_its_speed() -> None:
    time = 0.1 * np.arange(751, dtype=np.float64)
    frames = film_frames(time, frames_per_second=10.0, speed=4.0)
    np.testing.assert_allclose(np.diff(time[frames])[:-1], 0.4)
    assert frames[0] == 0
    assert frames[-1] == 750
    assert len(frames) == pytest.approx(75.0 / 4.0 * 10.0, abs=2)
    # Faster than it was recorded: pictures repeat rather than go missing.
    assert len(film_frames(time[:11], frames_per_second=30.0, speed=1.0)) == 31


def test_the_movie_is_one_that_players_open(run: xr.Dataset, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    path = make_movie(run, tmp_path / "turn.mp4", 10.0, 4.0, on_picture=lambda done, of: seen.append((done, of)))
    assert [p.name for p in tmp_path.iterdir()] == ["turn.mp4"]
    # Not imageio-ffmpeg's own reader: it forks in a way of which JAX warns.
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(command, capture_output=True, check=True)
    meta = next(line for line in decoded.stderr.decode().splitlines() if "Video:" in line)
    assert all(word in meta for word in ("h264", "yuv420p", "960x540", "10 fps"))
    pictures = np.frombuffer(decoded.stdout, np.uint8).reshape(-1, 540, 960, 3).astype(int)
    assert len(pictures) == len(film_frames(run["time"].values, 10.0, 4.0))
    assert seen[-1] == (len(pictures), len(pictures))
    for picture in (pictures[0], pictures[-1]):
        red, green, blue = np.moveaxis(picture[:400], -1, 0)
        assert ((red > green + 60) & (red > blue + 60)).sum() > 2000, "plates with a positive voltage"
        assert ((blue > red + 40) & (blue > green + 20)).sum() > 1000, "plates with a negative voltage"
        assert ((green > blue + 30) & (green >= red - 40)).sum() > 1000, "the gel"
    assert np.abs(pictures[0] - pictures[-1]).max() > 100


def test_a_movie_that_fails_leaves_nothing(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(done: int, of: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_movie(run, tmp_path / "turn.mp4", on_picture=stop)
    monkeypatch.setattr(movie, "ENCODER", ["-no-such-option"])
    with pytest.raises(OSError, match="no-such-option"):
        make_movie(run, tmp_path / "turn.mp4")
    assert list(tmp_path.iterdir()) == []


def test_only_the_side_of_the_gel_that_faces_the_camera_is_drawn(run: xr.Dataset) -> None:
    view = GelView(new_figure(4, 3, 100), (0.0, 0.0, 1.0, 1.0), Scene.of(run))
    for k in (0, -1):
        view.show(k)
        drawn = len(view._gel._faces)  # pyright: ignore
        assert 0.4 < drawn / run.sizes["face"] < 0.75


@pytest.mark.parametrize("axis_angle", [-np.pi / 4, 0.3, 2.0])
def test_the_camera_sees_the_turning_from_the_side(axis_angle: float) -> None:
    scene = Scene.of(made_run(1.0, axis_angle))
    camera = np.radians(scene.azimuth)
    assert abs(np.cos(camera - axis_angle)) > 0.9
    assert 5.0 < ELEVATION < 30.0


def test_the_plan_shows_voltages_and_the_body_in_its_place(run: xr.Dataset) -> None:
    plan = PlanView(new_figure(3, 3, 100).add_axes((0.1, 0.1, 0.8, 0.8)), Scene.of(run))
    plan.show(0)
    colours = plan.plates.to_rgba(np.array([-8.0, 8.0]))
    assert colours[0, 2] > colours[0, 0]
    assert colours[1, 0] > colours[1, 2]
    outline = np.concatenate([p.vertices for p in plan.moving[-1].get_paths()])
    assert np.all(outline[:, 0] > 12.5 - 9)
    assert np.all(outline[:, 0] < 12.5 + 9)


def test_pictures_need_no_simulator() -> None:
    code = "import sys, json, gelbot.show.movie, gelbot.show.snapshots, gelbot.record.run_store, gelbot.show.table"
    code += "; print(json.dumps([m for m in ('jax', 'gelbot.simulate', 'matplotlib.pyplot') if m in sys.modules]))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert json.loads(out) == []


def test_progress_is_one_line_per_phase_off_a_terminal() -> None:
    console = Console(file=io.StringIO(), force_terminal=False, width=100)
    with RunProgress(30.0, console) as progress:
        for t in range(31):
            progress.update(float(t), "preparation" if t < 20 else "transition", 0.4 + 0.1 * t)
    lines = console.file.getvalue().splitlines()  # pyright: ignore
    assert [re.sub(r"\s+", " ", line).strip() for line in lines] == [
        "0.0 s preparation height 0.40 mm",
        "20.0 s transition height 2.40 mm",
    ]


def test_progress_of_a_rhythm_is_one_line() -> None:
    console = Console(file=io.StringIO(), force_terminal=False, width=100)
    with RunProgress(30.0, console) as progress:
        for t in range(31):
            progress.update(float(t), f"step {t % 4 + 1}" if t < 20 else "rest", 0.4)
    assert [line.split()[2] for line in console.file.getvalue().splitlines()] == ["step", "rest"]  # pyright: ignore


def test_progress_on_a_terminal_shows_time_phase_height_and_speed() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    with RunProgress(30.0, console) as progress:
        progress.update(0.0, "preparation", 0.4)
        progress.update(30.0, "transition", 5.25)
    text = console.file.getvalue()  # pyright: ignore
    assert all(word in text for word in ("30.0 of 30.0 s", "transition", "5.25 mm", "real time"))


def test_the_table_sets_the_paper_beside_the_run() -> None:
    summary = {
        "scenario": "turn-over",
        "status": "finished",
        "turned_over": True,
        "t_switch_s": 39.8,
        "z_switch_mm": 5.43,
        "tip_angle_at_switch_deg": 88.0,
        "t_transition_s": 7.4,
        "stayed_over_s": 21.0,
        "simulated_s": 70.0,
        "wall_s": 2.8,
        "compile_s": 4.2,
        "peak_voltage_V": 10.0,
        "peak_current_A": 0.01,
        "charge_C": 1.2,
    }
    console = Console(file=io.StringIO(), width=100)
    print_summary(summary, console)
    text = console.file.getvalue()  # pyright: ignore
    for word in ("40 s", "39.8 s", "6.5 mm", "5.43 mm", "88 deg", "7.4 s", "5 of 5", "yes, 21.0 s", "25x real time"):
        assert word in text
    empty = Console(file=io.StringIO(), width=100)
    print_summary({"turned_over": False, "t_switch_s": None}, empty)
    assert "no" in empty.file.getvalue()  # pyright: ignore


def test_the_table_tells_how_far_the_motion_came() -> None:
    goals = [{"goal": "along at least 10 mm", "reached_s": 73.3}, {"goal": "along at most 0.5 mm", "reached_s": None}]
    motion = {"met": False, "goals": goals, "reason": "goal 2 (along at most 0.5 mm) not met: nearest 2 mm"}
    console = Console(file=io.StringIO(), width=100)
    print_summary({"turned_over": False, "t_switch_s": 0.4, "motion": motion}, console)
    text = console.file.getvalue()  # pyright: ignore
    for word in ("along at least 10 mm", "73.3 s", "the motion is not met: goal 2 (along at most 0.5 mm)"):
        assert word in text
    assert "5 of 5" not in text  # the paper's robot turned over, and did not crawl


def test_phases_without_a_name_are_numbered(run: xr.Dataset) -> None:
    assert [phase_name(run, p) for p in range(3)] == ["preparation", "transition", "phase 3"]
