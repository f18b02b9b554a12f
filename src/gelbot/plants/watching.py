"""The gel through a camera: what the tracker must know of the body, and the eye that looks through it."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from gelbot.body.symmetry import rotation
from gelbot.body.tips import tips_of
from gelbot.clock import Clock
from gelbot.control.programme import Playing, begin, play
from gelbot.errors import CameraFailed
from gelbot.hardware.camera import Camera, Picture
from gelbot.hardware.habits import Habits, habits_of, together
from gelbot.hardware.open_cv import cv2_of
from gelbot.hardware.tracking import Tracked, Tracker, flat_pose
from gelbot.hardware.umbrella import Mesh, Pose, Umbrella, umbrella_of
from gelbot.plant import Sighting, as_seen
from gelbot.points import observe
from gelbot.scenario.build import Experiment
from gelbot.simulate import Model, State, rollout, start

Floats = NDArray[np.float64]
IDLE = 2e-3
"""An eye without a new picture waits so long [s]."""
FOUND, FITTED = (0, 160, 80), (40, 110, 230)
"""Colours (RGB) of the outline that was found and of the sheet that was laid over it."""
APART = 0.25e-3
"""Examples of one run are so far apart: some node has moved by this [m]."""


class Robot(NamedTuple):
    """An example: factors on p_ele and p_l, and how much further it is turned [rad] at the start."""

    p_ele: float
    p_l: float
    turned: float


ROBOTS = (
    Robot(0.85, 1.0, 0.0),
    Robot(0.92, 0.95, -0.07),
    Robot(0.98, 1.04, 0.04),
    Robot(1.03, 1.0, -0.03),
    Robot(1.09, 0.97, 0.08),
    Robot(1.15, 1.0, 0.0),
)
"""What the examples scatter about the scenario: the paper's range of p_ele, and what else is never known exactly."""


def sheet_of(experiment: Experiment) -> tuple[Umbrella, Pose]:
    """The scenario's body as the tracker has it, and how it lies at the start."""
    body, pose = experiment.body, experiment.scenario.body.pose
    corners = int(body.faces.max()) + 1
    half = body.thickness / 2.0
    side = np.where(body.nodes[2, :corners] > half, half, -half)
    mesh = Mesh(np.asarray(body.nodes[:2, :corners], float), side, np.asarray(body.faces))
    sheet = umbrella_of(body.outline.points.T, body.thickness, tips_of(body.outline).points.T, mesh)
    return sheet, flat_pose(sheet, (pose.position[0], pose.position[1]), pose.heading)


def examples_of(experiment: Experiment, duration: float, told: Callable[[int, int], None] | None = None) -> Habits:
    """How the body looks under the experiment's programme for `duration` [s]: from simulated robots that scatter.

    `told` is called with how many of how many are done.
    """
    sheet, lies = sheet_of(experiment)
    habits = []
    for k, robot in enumerate(ROBOTS):
        positions, turned = _moved(experiment, robot, duration)
        habits.append(habits_of(sheet, positions, lies._replace(rotation=_about_z(turned) @ lies.rotation)))
        if told is not None:
            told(k + 1, len(ROBOTS))
    return together(*habits)


def _moved(experiment: Experiment, robot: Robot, duration: float) -> tuple[Floats, float]:
    """Node positions (t, 3, n) of a robot's run where it has moved, and how far it was turned at its start."""
    model, simulation = experiment.model, experiment.scenario.simulation
    period, dtype = experiment.scenario.programme.control_period, experiment.state.positions.dtype
    gel = model.gel._replace(p_ele=model.gel.p_ele * robot.p_ele, p_l=jnp.clip(model.gel.p_l * robot.p_l, 0.0, 0.99))
    model = model._replace(gel=gel)
    middle = np.array([*experiment.scenario.body.pose.position, 0.0])[:, None]
    first = np.asarray(experiment.state.positions, float)
    first = jnp.asarray(_about_z(robot.turned) @ (first - middle) + middle, dtype)
    count, steps = round(duration / period), round(period / simulation.time_step)
    moved = np.asarray(
        _run(model, start(model, first), _began(experiment, model, first), simulation.time_step, count, steps)
    )
    moved = moved[np.isfinite(moved).all(axis=(1, 2))].astype(float)
    corners = int(experiment.body.faces.max()) + 1
    kept = [0]
    for k in range(1, len(moved)):
        if np.linalg.norm(moved[k] - moved[kept[-1]], axis=0).max() > APART:
            kept.append(k)
    return moved[kept][:, :, :corners], robot.turned


def _began(experiment: Experiment, model: Model, first: Array) -> Playing:
    return Playing(experiment.programme, begin(experiment.programme, observe(model.points, first)))


def _run(model: Model, state: State, memory: Any, dt: float, count: int, steps: int) -> Array:
    return rollout(model, state, play, memory, jnp.asarray(dt, state.positions.dtype), count, steps)[2].positions


def _about_z(angle: float) -> Floats:
    turn = np.eye(3)
    turn[:2, :2] = rotation(angle)
    return turn


class CameraEye:
    """The gel as `tracker` finds it in the pictures of `camera`, in a thread of its own; without one, when it is
    looked.

    Until the first picture it sees what was there `at_first`, with confidence 0.
    """

    def __init__(self, camera: Camera, tracker: Tracker, clock: Clock, threaded: bool = True) -> None:
        self._camera, self._tracker, self._clock = camera, tracker, clock
        self.on_seen: Callable[[], None] = lambda: None
        self._newest: tuple[Picture, Tracked] | None = None
        self._drawn: tuple[Tracked, NDArray[np.uint8]] | None = None
        self._failure: Exception | None = None
        self._lock, self._off = Lock(), Event()
        sheet, lies = tracker.scene.sheet, tracker.state
        self._at_first = sheet.essential(flat_pose(sheet, (0.0, 0.0), 0.0) if lies is None else lies.pose)
        self._thread = Thread(target=self._watch, name="camera eye", daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    def look(self, now: float) -> Sighting:
        """The newest that was found. Raises `CameraFailed` when the camera has stopped for good."""
        if self._thread is None:
            self._once()
        if self._failure is not None:
            raise self._failure
        newest = self._newest
        if newest is None:
            return Sighting(now, as_seen(*self._at_first), 0.0)
        found = newest[1]
        return Sighting(found.time, as_seen(found.centre, found.normal, found.tips, found.tip_angles), found.confidence)

    @property
    def tracked(self) -> Tracked | None:
        """All that is known of the newest picture."""
        return None if self._newest is None else self._newest[1]

    def picture(self) -> NDArray[np.uint8] | None:
        """The newest picture (h, w, 3), RGB, with the outline that was found and the sheet laid over it."""
        newest = self._newest
        if newest is None:
            return None
        with self._lock:
            if self._drawn is None or self._drawn[0] is not newest[1]:
                self._drawn = newest[1], overlaid(*newest)
            return self._drawn[1]

    def close(self) -> None:
        """Look no more."""
        self._off.set()
        if self._thread is not None:
            self._thread.join()
        self._camera.close()

    def _watch(self) -> None:
        while not self._off.is_set():
            try:
                seen = self._once()
            except Exception as error:  # told to whoever looks next, and they stop
                self._failure = error
                return
            if not seen:
                self._off.wait(IDLE)

    def _once(self) -> bool:
        """Take in a new picture, if there is one."""
        picture = self._camera.latest()
        if picture is None:
            return False
        found = self._tracker.look(picture.pixels, picture.time)
        self._newest = picture, found
        if found.confidence > 0.0:
            self.on_seen()
        return True


def overlaid(picture: Picture, found: Tracked) -> NDArray[np.uint8]:
    """The picture in colour (h, w, 3), RGB, with what was found in it."""
    cv2 = cv2_of("a picture with its outline")
    pixels = picture.pixels
    colour = cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB if pixels.ndim == 2 else cv2.COLOR_BGR2RGB)
    for line, tint in ((found.outline_pixels, FOUND), (found.fit_pixels, FITTED)):
        if line.size and not (found.lost and tint == FITTED):
            cv2.polylines(colour, [np.round(line.T).astype(np.int32)], True, tint, 1, cv2.LINE_AA)
    if found.lost:
        cv2.putText(
            colour, f"lost: {found.why}", (12, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (200, 30, 30), 1, cv2.LINE_AA
        )
    return colour


def read_background(path: str) -> NDArray[np.float32]:
    """The picture of the empty tank in the file `path`, grey (h, w). Raises `CameraFailed`."""
    cv2 = cv2_of("camera.background")
    pixels = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise CameraFailed(
            f"camera.background = {path}", "it is no picture that can be read", "a PNG of the empty tank"
        )
    return pixels.astype(np.float32)
