"""A simulated gel as a camera would see it: for trying the whole bench without one."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.hardware.calibration import Calibration
from gelbot.hardware.camera import Picture
from gelbot.hardware.rendered import Light, render
from gelbot.hardware.segment import mean_picture
from gelbot.plants.simulated import SimulatedGel
from gelbot.scenario.build import Experiment

RATE = 30.0
"""Pictures a second."""
DISTANCE = 0.15
"""From the lens to the gel [m]."""
SIZE, SCALE = (640, 480), 16e3
"""Of the picture [px], and how many pixels show a metre of the gel."""
AHEAD, UP = 0.25, 4e-3
"""The middle of the picture lies this share of the body's reach ahead of it, to where it will topple, and so high
[m]."""
EMPTY = 4
"""Pictures of the empty tank whose mean is the background."""


def viewpoint(experiment: Experiment) -> Calibration:
    """The scenario's camera as a calibration: from the side it stands across the body's heading, if not told
    otherwise."""
    scenario = experiment.scenario
    camera, pose = scenario.camera, scenario.body.pose
    azimuth = pose.heading + np.pi / 2.0 if camera.azimuth is None else camera.azimuth
    towards = pose.heading + np.pi
    ahead = AHEAD * experiment.body.outline.reach * np.array([np.cos(towards), np.sin(towards)])
    x, y = np.array(pose.position) + ahead
    above = camera.view == "above"
    elevation, z = (np.pi / 2.0, 0.0) if above else (0.0, UP)
    return Calibration(camera.view, azimuth, elevation, 0.0, (x, y, z), DISTANCE, SCALE, 0.0, *SIZE)


class RenderedCamera:
    """Pictures of `gel` by the `clock`, each `delay` [s] old when it comes. `covered`: a hand is before the lens."""

    def __init__(
        self,
        gel: SimulatedGel,
        calibration: Calibration,
        clock: Clock,
        delay: float,
        light: Light | None = None,
        seed: int = 0,
    ) -> None:
        self.gel, self.covered = gel, False
        self._calibration, self._clock, self._delay = calibration, clock, delay
        self._light = Light() if light is None else light
        self._random = np.random.default_rng(seed)
        self._taken = -np.inf
        self._coming: deque[Picture] = deque()
        self._faces = np.asarray(gel.experiment.body.faces)

    def latest(self) -> Picture | None:
        """The newest picture that has arrived, once."""
        now = self._clock.now()
        if now - self._taken >= 1.0 / RATE - 1e-6:
            self._taken = now
            self.gel.advance(now)
            self._coming.append(Picture(self.gel.time, self._picture()))
        arrived = None
        while self._coming and self._coming[0].time <= now - self._delay + 1e-6:
            arrived = self._coming.popleft()
        return arrived

    def empty(self) -> NDArray[np.float32]:
        """The tank without gel: the mean of some pictures."""
        return mean_picture([self._drawn(np.zeros((3, 0)), np.zeros((3, 0), np.int64)) for _ in range(EMPTY)])

    def close(self) -> None:
        """Nothing to let go of."""

    def _picture(self) -> NDArray[np.uint8]:
        if self.covered:
            return np.full((self._calibration.height, self._calibration.width), 40, np.uint8)
        return self._drawn(np.asarray(self.gel.state.positions, np.float64), self._faces)

    def _drawn(self, positions: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.uint8]:
        return render(positions, faces, self._calibration, self._light, self._random)
