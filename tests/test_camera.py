"""The camera: calibration, silhouettes, the sheet that is laid over them, and the tracker on rendered videos.

| identity | one road | the other |
|---|---|---|
| a calibration's pixels | there | and back; saved and read; from clicks, from a board, from known points |
| a sheet's slopes | by formula | by differences |
| a flat sheet | bent by nothing | the outline |
| examples of a run | the sheet's essential points | `gelbot.points.observe` of the nodes |
| an example's silhouette | its own | its mirror image's |
| a body that may be its mirror image | what was believed before | what is believed now; tips are not sure |
| a disc's edge | found | where it was drawn, to a tenth of a pixel |
| a rendered body | tracked | `gelbot.points.observe` of what was rendered |
| a hand, an empty tank, a wrong scale | the tracker | says that it is lost, and finds the body again |
| a video | played by a clock | its pictures at their times |

How far tracking is off is printed with `pytest -s`; benchmarks/camera.py measures how long a picture takes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import numpy as np
import pytest

from gelbot.body.outline import starfish
from gelbot.body.tips import tips_of
from gelbot.clock import HandClock
from gelbot.controllers.choice import with_controller
from gelbot.ensemble import experiment_of
from gelbot.errors import BadInput, CameraFailed
from gelbot.hardware import open_cv
from gelbot.hardware.belief import begun, doubt, kin_of, marks_of, thought
from gelbot.hardware.calibration import (
    Calibration,
    from_checkerboard,
    from_clicks,
    from_points,
    load_calibration,
    write_checkerboard,
)
from gelbot.hardware.camera import VideoCamera
from gelbot.hardware.fitting import draw
from gelbot.hardware.habits import (
    CELL,
    Habits,
    cells_of,
    differing,
    habits_of,
    mirrored,
    rotation_by,
    together,
    turn_between,
)
from gelbot.hardware.rendered import Light, render, write_video
from gelbot.hardware.segment import background_of, mean_picture, silhouette
from gelbot.hardware.tracking import Tracker, flat_pose
from gelbot.hardware.umbrella import Mesh, Umbrella, tip_angles, umbrella_of
from gelbot.points import observe
from gelbot.run import march
from gelbot.scenario import load
from gelbot.scenario.build import disturbed

MM = 1e-3
DEG = np.pi / 180.0
PLACE = (14 * MM, 14 * MM, 4 * MM)
"""What the cameras look at: between where the body starts and where it comes to lie."""
SIDE = Calibration("side", -45 * DEG, 0.0, 0.0, PLACE, 150 * MM, 16e3, 0.0, 640, 480)
ABOVE = Calibration("above", -45 * DEG, 90 * DEG, 0.0, (14 * MM, 14 * MM, 0.0), 150 * MM, 16e3, 0.0, 640, 480)
NOTHING = (np.zeros((3, 0)), np.zeros((3, 0), np.int64))
OUTLINE = starfish(15 * MM, 6 * MM, None, 0.7 * MM)
END = 24.0
"""Until when a turn-over is watched [s]: from then on nothing happens."""


class Run(NamedTuple):
    """A simulated run: `time` [s] (t,), `positions` [m] (t, 3, n), the `faces`, how to read the `points`, the `sheet`
    with the run's own mesh and the pose in which it began, and `habits` of the run on demand."""

    time: np.ndarray
    positions: np.ndarray
    faces: np.ndarray
    points: object
    sheet: Umbrella
    start: object

    def at(self, when: float):
        """Node positions at `when` [s], and what is to be seen there."""
        k = int(np.clip(np.searchsorted(self.time, when), 1, len(self.time) - 1))
        share = np.clip((when - self.time[k - 1]) / (self.time[k] - self.time[k - 1]), 0.0, 1.0)
        positions = (1.0 - share) * self.positions[k - 1] + share * self.positions[k]
        return positions, jax.tree.map(np.asarray, observe(self.points, positions))

    def habits(self, until: float = 28.0) -> Habits:
        moments = (self.time < until) & ((self.time > 10.0) | (np.arange(len(self.time)) % 3 == 0))
        return habits_of(self.sheet, self.positions[moments], self.start)


def simulated(name: str, *changes: str, **robot: object) -> Run:
    """The run of a scenario with its planned programme, where it has one, and with the `robot` as it is."""
    loaded = load(name, ["recording.chunk=1 s", *changes])
    if name == "turn-over":
        loaded = with_controller(loaded, "planned")
    experiment = experiment_of(loaded, {key.replace("__", "."): value for key, value in robot.items()})
    model = disturbed(experiment, experiment.model, experiment.state.positions)
    times = {"wall_s": 0.0, "compile_s": 0.0}
    chunks = list(march(experiment, model, experiment.state, PROGRAMS.setdefault(loaded.text, {}), times, at_once=True))
    pose, faces = experiment.scenario.body.pose, np.asarray(model.gel.faces)
    first = np.asarray(experiment.state.positions)
    lies = flat_pose(umbrella_of(OUTLINE.points.T, MM, tips_of(OUTLINE).points.T), tuple(pose.position), pose.heading)
    local = lies.rotation.T @ (first - np.array([*pose.position, 0.5 * MM])[:, None])
    mesh = Mesh(local[:2], np.where(local[2] > 0.0, 0.5, -0.5) * MM, faces)
    sheet = umbrella_of(OUTLINE.points.T, MM, tips_of(OUTLINE).points.T, mesh)
    return Run(
        np.concatenate([np.asarray(c.time) for c in chunks]),
        np.concatenate([np.asarray(c.positions) for c in chunks]),
        faces,
        model.points,
        sheet,
        flat_pose(sheet, tuple(pose.position), pose.heading),
    )


PROGRAMS: dict[str, dict] = {}
TURN_OVER = ("turn-over", "simulation.duration=30 s")


@pytest.fixture(scope="session")
def nominal() -> Run:
    return simulated(*TURN_OVER)


@pytest.fixture(scope="session")
def habits() -> Habits:
    """Examples of robots that scatter; none of them is among those that are watched."""
    robots = (
        {"material__p_ele": "0.0170 cm^2/mA"},
        {"material__p_ele": "0.0183 cm^2/mA", "material__p_l": 0.73, "body__pose__heading": "221 deg"},
        {"material__p_ele": "0.0195 cm^2/mA", "material__p_l": 0.80, "body__pose__position": ["12.0 mm", "12.8 mm"]},
        {"material__p_ele": "0.0205 cm^2/mA", "material__young_modulus": "54 kPa"},
        {"material__p_ele": "0.0219 cm^2/mA", "material__p_l": 0.75, "body__pose__heading": "230 deg"},
        {"material__p_ele": "0.0230 cm^2/mA", "body__pose__position": ["13.1 mm", "12.3 mm"]},
    )
    return together(*(simulated(*TURN_OVER, **robot).habits() for robot in robots))


class Errors(NamedTuple):
    """Of each picture, (k,) or (k, a): `centre` across the line of sight and `height`, `depth` of it along the line of
    sight, `tips` in space and `tips_seen` across the line of sight [mm]; `turn` of the normal and `angles` [deg];
    `sure`: the confidence of the tips; `lost`."""

    centre: np.ndarray
    height: np.ndarray
    depth: np.ndarray
    tips: np.ndarray
    tips_seen: np.ndarray
    turn: np.ndarray
    angles: np.ndarray
    sure: np.ndarray
    lost: np.ndarray

    def table(self) -> str:
        def line(name: str, values: np.ndarray) -> str:
            middle, most, all_ = np.quantile(np.abs(values), [0.5, 0.95, 1.0])
            return f"{name:10} median {middle:6.3f}   95 % {most:6.3f}   largest {all_:6.3f}"

        return "\n".join(line(name, getattr(self, name)) for name in self._fields[:-2])


def watched(
    run: Run, camera: Calibration, light: Light, rng, habits: Habits | None = None, end=END, empty=True
) -> Errors:
    """Watch a rendered video of `run` until `end` [s]: 10 pictures a second, 30 while the body falls."""
    background = [render(*NOTHING, camera, light, rng) for _ in range(4)] if empty else None
    background = mean_picture(background) if background else None
    tracker = Tracker(run.sheet, camera, run.start, background, habits)
    rows, when = [], 0.1
    while when < end:
        positions, truth = run.at(when)
        seen = tracker.look(render(positions, run.faces, camera, light, rng), when)
        off = camera.axes @ (seen.centre - truth.centre) / MM
        tips = camera.axes @ (seen.tips - truth.tips) / MM
        around = (seen.tip_angles - truth.tip_angles + np.pi) % (2.0 * np.pi) - np.pi
        turn = np.degrees(np.arccos(np.clip(seen.normal @ truth.normal, -1.0, 1.0)))
        rows.append((
            np.hypot(*off[:2]), (seen.centre - truth.centre)[2] / MM, off[2],
            np.linalg.norm(tips, axis=0), np.hypot(*tips[:2]), turn, np.degrees(around), seen.tip_confidence, seen.lost,
        ))  # fmt: skip
        when += 1.0 / (30.0 if 10.5 < when < 12.0 else 10.0)
    return Errors(*(np.array(values) for values in zip(*rows, strict=True)))


def must_show(found: Errors, camera: Calibration) -> None:
    """The figures that a loop needs, in 95 % of all pictures: the centre within 0.2 mm, tips of which the tracker is
    sure within 0.4 mm, both across the line of sight, the normal within 5 degrees. From above the height lies along the
    line of sight, and is not asked for. The largest errors stand in docs/camera.md."""
    print("\n" + found.table())
    assert not found.lost.any()
    assert np.quantile(found.centre, 0.95) < 0.2
    assert camera.view == "above" or np.quantile(np.abs(found.height), 0.95) < 0.2
    assert np.quantile(found.tips_seen[found.sure > 0.5], 0.95) < 0.4
    assert np.quantile(found.turn, 0.95) < 5.0


class TestCalibration:
    TILTED = Calibration("side", 0.7, 0.2, 0.05, (3 * MM, -2 * MM, 5 * MM), 120 * MM, 2e4, 0.02, 800, 600)

    @pytest.mark.parametrize("depth", [0.0, 4 * MM, -7 * MM])
    def test_there_and_back(self, rng, depth):
        pixels = rng.uniform([[0.0], [0.0]], [[800.0], [600.0]], (2, 50))
        points = self.TILTED.back(pixels, depth)
        np.testing.assert_allclose(self.TILTED.project(points), pixels, atol=1e-6)
        np.testing.assert_allclose(
            (points - np.array(self.TILTED.place)[:, None]).T @ self.TILTED.axes[2], depth, atol=1e-12
        )

    def test_on_the_floor(self, rng):
        points = self.TILTED.on_floor(self.TILTED.project(np.array([[1 * MM], [4 * MM], [0.0]])))
        np.testing.assert_allclose(points[:, 0], [1 * MM, 4 * MM, 0.0], atol=1e-9)
        assert not np.isfinite(SIDE.on_floor(np.array([[10.0], [SIDE.middle[1]]]))).all()

    def test_right_is_right_and_up_is_up(self):
        """From the side at azimuth 0 one sees +y to the right; from above, with that lower edge, too, and -x up."""
        side = Calibration("side", 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), np.inf, 1e4, 0.0, 101, 101)
        above = Calibration("above", 0.0, 90 * DEG, 0.0, (0.0, 0.0, 0.0), np.inf, 1e4, 0.0, 101, 101)
        points = np.array([[0.0, 0.0, -MM], [MM, 0.0, 0.0], [0.0, MM, 0.0]])
        np.testing.assert_allclose(side.project(points), [[60.0, 50.0, 50.0], [50.0, 40.0, 50.0]], atol=1e-9)
        np.testing.assert_allclose(above.project(points), [[60.0, 50.0, 50.0], [50.0, 50.0, 40.0]], atol=1e-9)

    @pytest.mark.parametrize("size", [2 * MM, 7 * MM])
    def test_error_of_a_telecentric_guess(self, size):
        """A point as near to the camera as it is off the axis, through a lens and through a telecentric one."""
        towards = SIDE.axes[2] * size + SIDE.axes[0] * size + np.array(SIDE.place)
        real, parallel = (c.project(towards[:, None]) for c in (SIDE, replace(SIDE, distance=np.inf)))
        off = np.linalg.norm(real - parallel) / SIDE.scale
        assert off == pytest.approx(SIDE.telecentric_error(size), rel=0.06)

    def test_saved_and_read(self, tmp_path: Path):
        for calibration in (self.TILTED, replace(SIDE, distance=np.inf)):
            calibration.save(tmp_path / "camera.toml")
            found = load_calibration(tmp_path / "camera.toml")
            np.testing.assert_allclose(found.project(np.eye(3) * MM), calibration.project(np.eye(3) * MM), atol=1e-5)

    @pytest.mark.parametrize(
        ("old", "new", "where"),
        [('px/mm"', '"', "scale"), ('"side"', '"left"', "view"), ("distortion", "distorsion", "distorsion"),
         ("mm\"\n", '"\n', "distance"), ("size = [800, 600]", "size = [800]", "size")],
    )  # fmt: skip
    def test_a_mistake_is_named(self, tmp_path: Path, old, new, where):
        path = tmp_path / "camera.toml"
        self.TILTED.save(path)
        path.write_text(path.read_text().replace(old, new, 1))
        with pytest.raises(BadInput, match=where):
            load_calibration(path)

    def test_two_clicks(self):
        """On the tips of a body of known width, and on the floor, which the camera sees tilted."""
        camera = replace(SIDE, roll=0.03)
        ends = np.array(PLACE)[:, None] + np.outer(camera.axes[0], [-7.5 * MM, 7.5 * MM])
        floor = np.array([*PLACE[:2], 0.0])[:, None] + np.outer([1.0, 1.0, 0.0], [-8 * MM, 8 * MM])
        known = np.array([*PLACE[:2], 0.0])
        found = from_clicks(
            "side", camera.azimuth, (640, 480), camera.project(ends), 15 * MM,
            camera.project(known[:, None])[:, 0], known, camera.project(floor), distance=150 * MM,
        )  # fmt: skip
        points = np.array([[16 * MM], [12 * MM], [5 * MM]])
        assert np.linalg.norm(found.project(points) - camera.project(points)) < 0.5

    def test_known_points(self, rng):
        points = np.array(self.TILTED.place)[:, None] + rng.uniform(-8 * MM, 8 * MM, (3, 40))
        guess = Calibration("side", 0.68, 0.22, 0.0, (2 * MM, -1 * MM, 5 * MM), 120 * MM, 1.9e4, 0.0, 800, 600)
        found = from_points(guess, points, self.TILTED.project(points))
        # What is not found, how far `place` lies along the line of sight, is a millimetre off.
        np.testing.assert_allclose(found.project(points), self.TILTED.project(points), atol=0.02)
        assert found.distortion == pytest.approx(0.02, abs=1e-3)
        with pytest.raises(BadInput, match="cannot tell"):
            from_points(guess, points[:, :1] + np.zeros((3, 9)), np.zeros((2, 9)))

    @pytest.mark.parametrize("camera", [SIDE, ABOVE], ids=["side", "above"])
    def test_checkerboard(self, camera, rng):
        """A board drawn as the camera sees it: turned by 1.5 degrees, a lens that distorts by 1 %, blur and noise."""
        camera = replace(camera, roll=0.026, distortion=0.01)
        flat = replace(camera, roll=0.0)
        first = np.array(camera.place) - flat.axes[0] * 8 * MM - flat.axes[1] * 5 * MM
        picture = _board(camera, flat, first, (9, 6), 2 * MM, rng)
        guess = replace(camera, roll=0.0, scale=1e4, place=(0.0, 0.0, 0.0), distortion=0.0)
        found = from_checkerboard(picture, (9, 6), 2 * MM, first, guess)
        points = first[:, None] + flat.axes[0][:, None] * 12 * MM + flat.axes[1][:, None] * np.array([0.0, 9 * MM])
        assert np.abs(found.project(points) - camera.project(points)).max() < 0.5
        assert found.scale == pytest.approx(camera.scale, rel=2e-3)
        with pytest.raises(BadInput, match="no board"):
            from_checkerboard(np.full((480, 640), 128, np.uint8), (9, 6), 2 * MM, first, guess)

    def test_printed_board(self, tmp_path: Path):
        write_checkerboard(tmp_path / "board.svg", (9, 6), 2 * MM)
        text = (tmp_path / "board.svg").read_text()
        assert 'width="24.0000mm"' in text
        assert text.count('width="2.0000"') == 35  # half of the 10 x 7 squares


def _board(camera, flat, first, corners, square, rng):
    """A checkerboard of which `first` is the lower left inner corner, seen by `camera`."""
    rows, columns = np.mgrid[:480, :640]
    points = camera.back(np.stack([columns.ravel(), rows.ravel()]).astype(float)) - first[:, None]
    across, up = (np.floor(flat.axes[k] @ points / square).astype(int) for k in range(2))
    inside = (across >= -1) & (across < corners[0]) & (up >= -1) & (up < corners[1])
    grey = np.where(inside & ((across + up) % 2 == 0), 40.0, 200.0).reshape(480, 640)
    return np.clip(cv2.GaussianBlur(grey, (0, 0), 1.0) + rng.normal(0.0, 3.0, grey.shape), 0, 255).astype(np.uint8)


class TestSheet:
    SHEET = umbrella_of(OUTLINE.points.T, MM, tips_of(OUTLINE).points.T)

    def test_slopes(self, rng):
        numbers = rng.normal(0.0, 1.0, self.SHEET.number_count)
        numbers[-2:] *= 0.1
        at = np.arange(len(self.SHEET.side))
        rest, step = self.SHEET.no_rest, 1e-6
        differences = [
            (self.SHEET.surface(numbers + step * e, rest) - self.SHEET.surface(numbers - step * e, rest)) / (2 * step)
            for e in np.eye(len(numbers))
        ]
        np.testing.assert_allclose(self.SHEET.slopes(numbers, at), np.stack(differences, axis=-1), atol=1e-10)

    def test_flat_is_flat(self):
        pose = flat_pose(self.SHEET, (2 * MM, 3 * MM), 0.4)
        seen = self.SHEET.essential(pose)
        np.testing.assert_allclose(seen.centre, [2 * MM, 3 * MM, 0.5 * MM], atol=1e-12)
        np.testing.assert_allclose(seen.normal, [0.0, 0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(seen.tip_angles, 0.0, atol=1e-9)
        turned = rotation_by(np.array([0.0, 0.0, 0.4]))[:2, :2] @ tips_of(OUTLINE).points.T
        np.testing.assert_allclose(seen.tips[:2], turned + np.array([[2 * MM], [3 * MM]]), atol=1e-9)
        surface = self.SHEET.surface(pose.numbers, pose.rest)
        corners = np.linalg.norm(surface[:2, :, None] - OUTLINE.points.T[:, None, :], axis=0).min(axis=0)
        assert corners.max() < 1e-9

    def test_an_arc_keeps_its_length(self):
        """Bent by K_0 alone an arm is a circular arc, of the arm's length."""
        numbers = np.zeros(self.SHEET.number_count)
        numbers[:5] = np.pi / 2.0
        tips = self.SHEET.essential(flat_pose(self.SHEET, (0.0, 0.0), 0.0)._replace(numbers=numbers)).tips
        radius = self.SHEET.reach / (np.pi / 2.0)
        np.testing.assert_allclose(np.linalg.norm(tips[:2], axis=0), radius, rtol=1e-6)
        np.testing.assert_allclose(tips[2], 0.5 * MM - radius, rtol=1e-6)

    def test_angles(self):
        centre = np.zeros(3)
        bases = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        tips = bases + np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, -1.0, -1.0]])
        np.testing.assert_allclose(tip_angles(centre, tips, bases), [0.0, np.pi / 2, 0.75 * np.pi])

    def test_turns(self, rng):
        turn = rng.normal(0.0, 0.8, 3)
        np.testing.assert_allclose(turn_between(np.eye(3), rotation_by(turn)), turn, atol=1e-12)

    def test_what_it_cannot_be(self):
        u_shape = np.array([[-3, 3, 3, 1, 1, -1, -1, -3], [-3, -3, 3, 3, -2, -2, 3, 3]]) * MM
        with pytest.raises(BadInput, match="turns back"):
            umbrella_of(u_shape, MM, np.array([[3 * MM], [3 * MM]]))
        with pytest.raises(BadInput, match="tips"):
            umbrella_of(OUTLINE.points.T, MM, np.zeros((2, 0)))


class TestSilhouette:
    @pytest.mark.parametrize("gel", [90.0, 250.0], ids=["darker", "lighter"])
    def test_a_disc(self, gel, rng):
        """Its edge, drawn 8 times finer, is found to a tenth of a pixel before light that halves from left to right."""
        fine = np.full((8 * 240, 8 * 320), 170.0, np.float32)
        cv2.circle(fine, (8 * 150 + 4, 8 * 110 + 4), 8 * 40, gel, -1)
        picture = cv2.GaussianBlur(cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA), (0, 0), 1.0)
        light = np.linspace(0.5, 1.0, 320)[None, :]
        noisy = np.clip(picture * light + rng.normal(0.0, 2.0, picture.shape), 0, 255).astype(np.uint8)
        empty = np.broadcast_to((170.0 * light).astype(np.float32), (240, 320)).copy()
        seen = silhouette(noisy, empty)
        assert seen is not None
        away = np.linalg.norm(seen.edge - np.array([[150.0], [110.0]]), axis=0)
        assert abs(away.mean() - 40.0) < 0.1
        assert away.std() < 0.25
        assert seen.area == pytest.approx(np.pi * 40.0**2, rel=0.03)
        assert not seen.is_cut

    def test_nothing(self, rng):
        empty = [render(*NOTHING, SIDE, Light(), rng) for _ in range(5)]
        assert silhouette(empty[0], mean_picture(empty[1:])) is None

    def test_guessed_background(self, nominal, rng):
        """Without a picture of the empty tank the background is guessed from rows and columns: within a few percent."""
        picture = render(nominal.at(8.0)[0], nominal.faces, SIDE, Light(), rng)
        empty = mean_picture([render(*NOTHING, SIDE, Light(), rng) for _ in range(8)])
        share = background_of(picture) / empty
        assert np.quantile(np.abs(share - 1.0), 0.99) < 0.08


class TestHabits:
    def test_examples_are_what_was_simulated(self, nominal):
        found = nominal.habits()
        moments = (nominal.time < 28.0) & ((nominal.time > 10.0) | (np.arange(len(nominal.time)) % 3 == 0))
        for k, when in list(enumerate(nominal.time[moments]))[::20]:
            truth = nominal.at(when)[1]
            seen = nominal.sheet.essential(found.pose(k))
            np.testing.assert_allclose(seen.centre, truth.centre, atol=1e-6)
            np.testing.assert_allclose(seen.tips, truth.tips, atol=2e-6)
            assert seen.normal @ truth.normal > np.cos(2.0 * DEG)

    def test_mirror_images(self, nominal):
        """An image has the silhouette of its example, through a telecentric lens, and is an image of its image."""
        camera = replace(SIDE, distance=np.inf)
        found = nominal.habits(16.0)
        images = mirrored(nominal.sheet, found, camera.axes[2])
        again = mirrored(nominal.sheet, images, camera.axes[2])
        assert images.numbers.shape == found.numbers.shape
        np.testing.assert_allclose(again.rotation, found.rotation, atol=1e-9)
        np.testing.assert_allclose(again.numbers, found.numbers, atol=1e-9)
        for k in range(0, found.numbers.shape[1], 20):
            drawn = [draw(nominal.sheet, camera, h.pose(k)) for h in (found, images)]
            one, other = (cells_of(d.mask, camera.scale) for d in drawn if d is not None)
            assert differing(one[None], other)[0] < 0.01 * one.sum() * CELL**2

    def test_an_outline_without_mirror_image_has_none(self):
        saw = np.array([[2, 6, 2, 0, -2, -2, -2, 0], [0, 4, 2, 6, 2, 0, -2, -2]]) * MM
        sheet = umbrella_of(saw, MM, saw[:, [1, 3]])
        pose = flat_pose(sheet, (0.0, 0.0), 0.0)
        one = Habits(pose.numbers[:, None], pose.rotation[:, :, None], pose.centre[:, None], pose.rest[:, :, None])
        assert mirrored(sheet, one, SIDE.axes[2]).numbers.shape[1] == 0


LEANS = 0.25


@pytest.fixture(scope="module")
def leaning():
    """Upright, then leaning more and more either way: nine examples, and their `Kin`."""
    sheet = TestSheet.SHEET
    flat = flat_pose(sheet, (0.0, 0.0), 0.0)
    angles = LEANS * np.linspace(-1.0, 1.0, 9)
    habits = Habits(
        np.stack([flat.numbers] * 9, axis=-1),
        np.stack([rotation_by(np.array([a, 0.0, 0.0])) for a in angles], axis=-1),
        np.stack([flat.centre] * 9, axis=-1),
        np.stack([flat.rest] * 9, axis=-1),
    )
    return sheet, habits, kin_of(sheet, habits)


def thought_over(pictures, leaning, last, differs):
    """What is thought after so many pictures that differ by `differs` from the examples, all alike."""
    sheet, _, kin = leaning
    thinks = thought(kin, begun(kin, sheet, last), differs, marks_of(sheet, last), 1.0 / 30.0)
    for _ in range(pictures - 1):
        thinks = thought(kin, thinks.belief, differs, marks_of(sheet, last), 1.0 / 30.0)
    return thinks


class TestBelief:
    """A body that leans towards the camera, one of the examples, and its mirror image that leans away."""

    def test_what_was_seen_before_tells(self, leaning):
        """A picture that both would give leaves belief where it was, and says that the tips may be elsewhere."""
        sheet, habits, kin = leaning
        last = habits.pose(8)
        differs = np.full(9, 5e-6, np.float32)
        differs[[0, 8]] = 0.0
        thinks = thought_over(30, leaning, last, differs)
        assert np.argmax(thinks.weight) == 8
        assert thinks.weight[8] > 0.9 * thinks.weight.sum()
        tips, normal = doubt(kin, thinks, sheet.tip_count)
        assert tips.max() > 0.3 * MM
        assert normal == pytest.approx(2.0 * LEANS * np.sqrt(0.05), rel=0.2)

    def test_a_picture_that_contradicts_is_believed(self, leaning):
        last = leaning[1].pose(8)
        differs = np.full(9, 5e-6, np.float32)
        differs[0] = 0.0
        assert np.argmax(thought_over(60, leaning, last, differs).weight) == 0

    def test_without_pictures_it_is_forgotten(self, leaning):
        sheet, habits, kin = leaning
        last, differs = habits.pose(8), np.zeros(9, np.float32)
        thinks = thought(kin, begun(kin, sheet, last), differs, marks_of(sheet, last), 5.0)
        np.testing.assert_allclose(thinks.belief, 1.0 / 9.0, rtol=0.01)


class TestTracking:
    def test_turn_over_from_the_side(self, nominal, habits, rng):
        must_show(watched(nominal, SIDE, Light(), rng, habits), SIDE)

    @pytest.mark.slow
    def test_turn_over_from_above(self, nominal, habits, rng):
        must_show(watched(nominal, ABOVE, Light(), rng, habits), ABOVE)

    @pytest.mark.slow
    @pytest.mark.parametrize("p_ele", ["0.0173 cm^2/mA", "0.0227 cm^2/mA"])
    def test_other_robots(self, habits, rng, p_ele):
        robot = simulated(*TURN_OVER, material__p_ele=p_ele, material__p_l=0.78)
        must_show(watched(robot, SIDE, Light(), rng, habits), SIDE)

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "light",
        [Light(noise=10.0), Light(blur=2.5), Light(gradient=0.9, vignette=0.6), Light(gel=150.0), Light(jpeg=60),
         Light(smear=6.0)],
        ids=["noise", "blur", "uneven", "pale", "jpeg", "smeared"],
    )  # fmt: skip
    def test_other_pictures(self, nominal, habits, rng, light):
        must_show(watched(nominal, SIDE, light, rng, habits), SIDE)

    @pytest.mark.slow
    def test_without_a_picture_of_the_empty_tank(self, nominal, habits, rng):
        must_show(watched(nominal, SIDE, Light(), rng, habits, empty=False), SIDE)

    @pytest.mark.slow
    def test_a_robot_that_is_not_like_the_examples(self, habits, rng):
        """It shrinks, bends and slides otherwise than all of them: centre and height are still seen; orientation and
        tips are not, once it has toppled, and the tracker is less sure of tips where it is wrong."""
        robot = simulated(
            *TURN_OVER, "tank.friction=0.15", material__p_ele="0.0188 cm^2/mA", material__p_l=0.70,
            material__young_modulus="42 kPa", body__pose__position=["12.0 mm", "13.0 mm"],
            body__pose__heading="234 deg",
        )  # fmt: skip
        found = watched(robot, SIDE, Light(), rng, habits)
        print("\n" + found.table())
        assert np.quantile(found.centre, 0.95) < 0.3
        assert np.quantile(np.abs(found.height), 0.95) < 0.2
        sure = found.sure > 0.5
        print(f"sure of {sure.mean():.0%}", np.quantile(found.tips_seen[sure], [0.5, 0.95, 1.0]))
        assert np.median(found.tips_seen[~sure]) > 2.0 * np.median(found.tips_seen[sure])

    @pytest.mark.slow
    @pytest.mark.parametrize(
        "robot",
        [{"p_ele": "0.0191 cm^2/mA", "p_l": 0.75, "heading": "223 deg"},
         {"p_ele": "0.0224 cm^2/mA", "p_l": 0.77, "heading": "222 deg"}],
        ids=["223", "222"],
    )  # fmt: skip
    def test_a_robot_that_leans(self, habits, rng, robot):
        """It starts a little askew, and leans towards the camera or away from it once it has toppled, which a level
        camera cannot tell apart: the centre is seen, and where the tracker is sure of tips they are where it says."""
        found = watched(
            simulated(*TURN_OVER, material__p_ele=robot["p_ele"], material__p_l=robot["p_l"],
                      body__pose__heading=robot["heading"]),
            SIDE, Light(), rng, habits,
        )  # fmt: skip
        print("\n" + found.table())
        assert not found.lost.any()
        assert found.centre.max() < 0.3
        assert np.quantile(found.centre, 0.95) < 0.2
        assert np.quantile(np.abs(found.height), 0.95) < 0.2
        sure = found.sure > 0.5
        print(f"sure of {sure.mean():.0%}", np.quantile(found.tips_seen[sure], [0.5, 0.95, 1.0]))
        assert np.quantile(found.tips_seen[sure], 0.95) < 0.4

    def test_dome_without_examples(self, rng):
        """Without any knowledge of how such a body moves, centre and orientation are seen; tips are not sure then."""
        found = watched(simulated("dome"), SIDE, Light(), rng, end=10.0)
        print("\n" + found.table())
        assert not found.lost.any()
        assert np.quantile(found.centre, 0.95) < 0.2
        assert np.quantile(np.abs(found.height), 0.95) < 0.2
        assert np.quantile(found.turn, 0.95) < 5.0
        assert np.median(found.tips_seen) < 0.4
        assert found.sure.max() < 0.5

    @pytest.mark.slow
    @pytest.mark.parametrize("camera", [SIDE, ABOVE], ids=["side", "above"])
    def test_dome_with_examples(self, rng, camera):
        others = [simulated("dome", material__p_ele=p) for p in ("0.017 cm^2/mA", "0.0215 cm^2/mA", "0.023 cm^2/mA")]
        known = together(*(other.habits(20.0) for other in others))
        must_show(watched(simulated("dome"), camera, Light(), rng, known, end=15.0), camera)

    def test_phases_are_left_when_they_are_over(self, nominal, habits, rng):
        """The planned programme's conditions through the camera: within 0.3 s of the truth, and in their order."""
        conditions = {
            "switch": lambda seen: np.degrees(np.max(seen.tip_angles)) >= 76.034 and seen.centre[2] >= 5.3692 * MM,
            "over": lambda seen: seen.normal[2] <= -0.8,
            "on its back": lambda seen: seen.normal[2] <= -0.85,
        }
        tracker = Tracker(nominal.sheet, SIDE, nominal.start, _empty(SIDE, rng), habits)
        switched, when = {}, 0.1
        while when < 21.0:
            positions, truth = nominal.at(when)
            seen = tracker.look(render(positions, nominal.faces, SIDE, Light(), rng), when)
            for name, holds in conditions.items():
                for who, what in (("seen", seen), ("true", truth)):
                    if holds(what):
                        switched.setdefault((name, who), when)
            when += 1.0 / (30.0 if 10.5 < when < 12.0 else 10.0)
        print(switched)
        for name in conditions:
            assert switched[name, "seen"] == pytest.approx(switched[name, "true"], abs=0.31)


def _empty(camera: Calibration, rng) -> np.ndarray:
    return mean_picture([render(*NOTHING, camera, Light(), rng) for _ in range(4)])


class TestLost:
    def test_a_hand(self, nominal, habits, rng):
        """A hand covers the gel from 6 to 8 s: it is lost while the hand is there, and found again within a second."""
        tracker = Tracker(nominal.sheet, SIDE, nominal.start, _empty(SIDE, rng), habits)
        lost = {}
        for when in np.arange(0.1, 10.0, 0.1):
            positions, truth = nominal.at(when)
            picture = render(positions, nominal.faces, SIDE, Light(), rng)
            if 6.0 <= when < 8.0:
                cv2.rectangle(picture, (250, 0), (480, 420), 60, -1)
            seen = tracker.look(picture, when)
            lost[round(float(when), 1)] = seen.lost
            if when < 5.95 or when > 9.0:
                assert np.linalg.norm((SIDE.axes @ (seen.centre - truth.centre))[:2]) < 0.2 * MM
        assert all(lost[round(t, 1)] for t in np.arange(6.0, 7.95, 0.1))
        assert not any(lost[round(t, 1)] for t in np.arange(0.1, 5.95, 0.1))
        assert not any(lost[round(t, 1)] for t in np.arange(9.0, 9.95, 0.1))

    def test_it_topples_behind_a_hand(self, nominal, habits, rng):
        """From 10.4 to 12.4 s, while it falls on its side: the examples say how it lies when the hand is gone."""
        tracker = Tracker(nominal.sheet, SIDE, nominal.start, _empty(SIDE, rng), habits)
        for when in np.arange(0.1, 14.0, 0.1):
            positions, truth = nominal.at(when)
            picture = render(positions, nominal.faces, SIDE, Light(), rng)
            if 10.4 < when < 12.4:
                cv2.rectangle(picture, (200, 0), (520, 420), 60, -1)
            seen = tracker.look(picture, when)
            assert seen.lost == (10.4 < when < 12.4) or 12.4 < when < 13.0
            if when > 13.0:
                assert seen.normal @ truth.normal > np.cos(5.0 * DEG)

    def test_an_empty_tank(self, nominal, rng):
        tracker = Tracker(nominal.sheet, SIDE, nominal.start, _empty(SIDE, rng))
        seen = tracker.look(render(*NOTHING, SIDE, Light(), rng), 0.0)
        assert seen.lost
        assert seen.confidence == 0.0
        assert not seen.tip_confidence.any()
        assert "nothing" in seen.why
        np.testing.assert_allclose(seen.centre, nominal.start.centre)

    @pytest.mark.parametrize("factor", [0.6, 1.6])
    def test_a_wrong_scale(self, nominal, rng, factor):
        wrong = replace(SIDE, scale=SIDE.scale * factor)
        tracker = Tracker(nominal.sheet, wrong, nominal.start, _empty(SIDE, rng))
        assert tracker.look(render(nominal.at(0.1)[0], nominal.faces, SIDE, Light(), rng), 0.1).lost

    def test_another_size(self, nominal):
        tracker = Tracker(nominal.sheet, SIDE, nominal.start)
        with pytest.raises(BadInput, match="640 x 480"):
            tracker.look(np.zeros((100, 100), np.uint8), 0.0)

    def test_the_first_pose_is_found(self, nominal, rng):
        """From above, a flat body lies where it lies, whatever its heading; which arm is which nobody can tell, nor, to
        some tenths of a millimetre, how high it is: there is a dome with the same silhouette."""
        tracker = Tracker(nominal.sheet, ABOVE, None, _empty(ABOVE, rng))
        positions, truth = nominal.at(0.1)
        seen = tracker.look(render(positions, nominal.faces, ABOVE, Light(), rng), 0.1)
        assert np.linalg.norm((seen.centre - truth.centre)[:2]) < 0.2 * MM
        assert abs(seen.centre - truth.centre)[2] < 0.5 * MM
        apart = np.linalg.norm(seen.tips[:2, :, None] - truth.tips[:2, None, :], axis=0).min(axis=0)
        assert apart.max() < 0.4 * MM


class TestVideo:
    def test_a_file_by_a_clock(self, tmp_path: Path):
        """Pictures that grow brighter by 10 each: which one comes says what time it is."""
        path = tmp_path / "video.avi"
        write_video(path, [np.full((48, 64), 10 * k, np.uint8) for k in range(12)], 10.0)
        clock = HandClock()
        camera = VideoCamera(path, clock)
        try:
            for k in range(1, 11):
                clock.wait_until(0.1 * k + 0.01)
                picture = _soon(camera, 0.1 * k - 0.05)
                assert picture.time == pytest.approx(0.1 * k, abs=1e-6)
                assert picture.pixels.mean() == pytest.approx(10.0 * k, abs=3.0)
            assert camera.frames_per_second == pytest.approx(10.0, rel=1e-3)
        finally:
            camera.close()

    def test_the_end(self, tmp_path: Path):
        path = tmp_path / "video.avi"
        write_video(path, [np.zeros((48, 64), np.uint8)] * 3, 10.0)
        camera = VideoCamera(path, HandClock(10.0), rate=1000.0)
        camera.clock.move(1.0)  # type: ignore[attr-defined]
        _until(lambda: camera.ended)
        camera.latest()
        assert camera.latest() is None
        camera.close()

    @pytest.mark.parametrize("source", [Path("nowhere.avi"), "nowhere.avi"])
    def test_nothing_to_open(self, source, capfd):
        with pytest.raises(CameraFailed, match=r"nowhere\.avi: .*\. Try: "):
            VideoCamera(source, HandClock())

    def test_a_camera_that_stops(self, monkeypatch):
        """Its pictures come until its cable is pulled; then `latest` says so, after it was opened again in vain."""

        class Device:
            left = 5

            def isOpened(self):  # noqa: N802
                return True

            def read(self):
                Device.left -= 1
                return (Device.left >= 0), np.full((48, 64, 3), 7, np.uint8)

            def set(self, *_):
                return True

            def release(self):
                pass

        monkeypatch.setattr(cv2, "VideoCapture", lambda _: Device())
        monkeypatch.setattr("gelbot.hardware.camera.NO_PICTURE", 0.05)
        monkeypatch.setattr("gelbot.hardware.camera.PAUSE", 0.01)
        camera = VideoCamera(0, HandClock(3.0), delay=0.02)
        picture = _soon(camera, -1.0)
        assert picture.time == pytest.approx(2.98)
        with pytest.raises(CameraFailed, match="no pictures any more"):
            _until(lambda: camera.latest() is not None and False)
        camera.close()

    def test_no_opencv(self, monkeypatch):
        def missing():
            raise ImportError

        monkeypatch.setattr(open_cv, "_loaded", missing)
        with pytest.raises(CameraFailed, match=r"gelbot\[hardware\]"):
            VideoCamera(0, HandClock())

    def test_no_pictures(self, tmp_path: Path):
        with pytest.raises(BadInput, match="no pictures"):
            write_video(tmp_path / "video.avi", [], 10.0)


def _until(done, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.002)


def _soon(camera: VideoCamera, after: float):
    """The newest picture, once there is one that was taken `after` [s]."""
    found = []
    _until(lambda: (p := camera.latest()) is not None and p.time > after and not found.append(p))
    return found[0]
