"""What the page shows: plain arrays, in SI. The session makes them, the page draws them and knows nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Stage:
    """What does not change while a scenario stands: lengths in m.

    `faces` (3, f) of the gel's surface, `rest` (3, n) where its nodes lie at the start; `outlines`: of each electrode
    its corners (3, k), the plate's rim in order; `electrode_names`; `limit` [V] of the supply; `floor_depth`;
    `obstacles` (m, 3, 3) triangles (triangle, corner, space); `patterns`: names of voltage patterns that can be asked
    for; `controllers`: who can drive; `plant`: words for where the observed gel comes from; `has_camera`;
    `is_real`: the gel goes at the pace of the world. `settings`: keys of the scenario that the page offers to change,
    with their present text ("body.width": "15 mm"); `water_height`: of the free surface above z = 0, NaN where there
    is none.
    """

    name: str
    description: str
    faces: NDArray[np.int64]
    rest: NDArray[np.float64]
    outlines: tuple[NDArray[np.float64], ...]
    electrode_names: tuple[str, ...]
    limit: float
    floor_depth: float
    obstacles: NDArray[np.float64]
    patterns: tuple[str, ...]
    controllers: tuple[str, ...]
    plant: str
    has_camera: bool
    control_period: float
    settings: dict[str, str]
    water_height: float = math.nan
    is_real: bool = False

    def is_like(self, other: Stage) -> bool:
        """Whether the other one looks the same: after a reset the same things stand anew."""
        return all(_is_equal(getattr(self, part.name), getattr(other, part.name)) for part in fields(self))


def _is_equal(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return len(one) == len(other) and all(_is_equal(a, b) for a, b in zip(one, other, strict=True))
    is_number = isinstance(one, np.ndarray | float)
    return np.array_equal(one, other, equal_nan=True) if is_number else bool(one == other)


class Seen(NamedTuple):
    """What was seen of the gel: `centre` (3,), `tips` (3, a) [m], `normal` (3,), `confidence` 0 .. 1."""

    centre: NDArray[np.float64]
    tips: NDArray[np.float64]
    normal: NDArray[np.float64]
    confidence: float


@dataclass(frozen=True)
class Ticks:
    """How the loop keeps its time: ticks so far, those that were `late`, and of the last minute's ticks the time [s]
    that they took: median, 99 %, longest."""

    count: int
    late: int
    median: float
    p99: float
    longest: float


@dataclass(frozen=True)
class Moment:
    """What the page shows of one moment; `number` grows with every tick.

    `state`: "ready", "running", "paused" or "stopped"; `message`: one line for the user, empty when there is nothing to
    say. `time` [s] of the gel. The simulated gel: `positions` (3, n) [m], `adsorption` (f,). `asked` and `given` [V]
    (e,), `currents` [A] (e,). `observed`: what was seen of the plant, None before anything was. `reference` [m], NaN
    without one; `phase`: of the programme. `arrows` (m, 2, 3): current density on a plane, from foot to head [m],
    scaled to be seen. `picture` (h, w, 3) uint8 RGB from the camera, the tracked outline drawn in, None without a
    camera. `pace`: simulated seconds to one of the wall clock, None: as fast as it goes.
    """

    number: int
    state: str
    message: str
    time: float
    positions: NDArray[np.float64]
    adsorption: NDArray[np.float64]
    asked: NDArray[np.float64]
    given: NDArray[np.float64]
    currents: NDArray[np.float64]
    observed: Seen | None
    reference: float
    phase: str
    controller: str
    recording: bool
    arrows: NDArray[np.float64]
    picture: NDArray[np.uint8] | None
    ticks: Ticks
    pace: float | None = 1.0
