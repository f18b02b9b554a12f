"""From a scenario to the eye that looks through a camera, real or rendered."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.errors import NOTHING, BadInput
from gelbot.hardware.calibration import Calibration, load_calibration
from gelbot.hardware.camera import VideoCamera
from gelbot.hardware.tracking import Tracker
from gelbot.live.ready import PLANNED, Ready
from gelbot.plants.rendered import RenderedCamera, viewpoint
from gelbot.plants.simulated import SimulatedGel
from gelbot.plants.watching import CameraEye, examples_of, read_background, sheet_of
from gelbot.scenario.bench import Camera

RENDERED = "rendered"
"""The source of a camera that is none: pictures of a simulated gel."""
LONGEST = 60.0
"""Examples are simulated for so long [s], at most."""

Tell = Callable[[str], None]


def rendered_eye(
    ready: Ready, gel: SimulatedGel, clock: Clock, tell: Tell, seed: int = 0, threaded: bool = True
) -> CameraEye:
    """An eye that sees `gel` in rendered pictures. Raises `CameraFailed` where there is no OpenCV."""
    calibration = viewpoint(ready.nominal)
    camera = RenderedCamera(gel, calibration, clock, ready.nominal.scenario.camera.delay, seed=seed)
    return CameraEye(camera, _tracker(ready, calibration, camera.empty(), tell), clock, threaded)


def check_camera(camera: Camera) -> None:
    """A real camera, and how it sees the tank, or a `BadInput`."""
    if camera.source is None or camera.source == RENDERED:
        given = NOTHING if camera.source is None else camera.source
        allowed = "the number of a USB camera, a file, or the address of a stream: a real gel is seen by a real camera"
        raise BadInput("camera.source", given, allowed, "--set camera.source=0, or --plant simulated without a camera")
    if camera.calibration is None:
        allowed = "a file that says how the camera sees the tank"
        raise BadInput("camera.calibration", NOTHING, allowed, "gelbot calibrate makes one, see docs/camera.md")


def camera_eye(ready: Ready, clock: Clock, tell: Tell) -> CameraEye:
    """An eye that looks through the scenario's camera. Raises `BadInput`, `CameraFailed`."""
    camera = ready.nominal.scenario.camera
    check_camera(camera)
    assert camera.source is not None
    assert camera.calibration is not None
    calibration = load_calibration(Path(camera.calibration))
    background = None if camera.background is None else read_background(camera.background)
    tracker = _tracker(ready, calibration, background, tell)
    source = VideoCamera(camera.source, clock, camera.delay, size=(calibration.width, calibration.height))
    return CameraEye(source, tracker, clock)


def _tracker(ready: Ready, calibration: Calibration, background: NDArray[np.float32] | None, tell: Tell) -> Tracker:
    """What finds the body, with examples of how it moves: made once for a scenario."""
    if ready.habits is None:
        experiment = ready.experiment(PLANNED) if PLANNED in ready.controllers else ready.nominal
        duration = min(experiment.scenario.simulation.duration, LONGEST)
        ready.habits = examples_of(experiment, duration, lambda k, n: tell(f"examples for the camera: {k} of {n}"))
    sheet, lies = sheet_of(ready.nominal)
    tracker = Tracker(sheet, calibration, lies, background, ready.habits)
    tracker.scene.prepare()
    return tracker
