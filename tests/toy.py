"""A session made of paper: a starfish that rises while there are volts, to try the page with and to measure it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.live.moment import Moment, Seen, Stage, Ticks

RINGS, SPOKES = 8, 20
"""Circles of nodes on each side of the starfish, and nodes on each: 322 with both middles."""
ROWS, PITCH, HALF, GAP = 4, 25e-3, 5e-3, 15e-3
"""Electrodes along a side, their distance, half their side and their height [m]."""
PLACE = np.array([12.5e-3, 12.5e-3])
RISE = 2e-3
"""How fast the middle rises at the limit of the supply [m/s]."""
HIGHEST, LIMIT, PERIOD = 6e-3, 10.0, 0.1
SCENARIOS = ("turn-over", "lift", "crawl")
PATTERNS = {"ridge": 3, "crossed-ridge": 5, "all": 1}


class Toy:
    """`Actions` without physics. `work` is done in each tick; `camera`: with a picture; `calls` keeps what was asked.

    Use it as a context: its thread ticks inside.
    """

    def __init__(self, work: Callable[[], None] | None = None, camera: bool = True, keep_running: bool = False) -> None:
        self.calls: deque[tuple[object, ...]] = deque(maxlen=1000)
        self.stopped_at = float("nan")
        """When the emergency stop came [s], by `time.perf_counter`."""
        self._work, self._camera = work, camera
        self._lock, self._done = threading.Lock(), threading.Event()
        self.spent: deque[float] = deque(maxlen=600)
        """What the last ticks took [s]."""
        self._count = self._late = self._steps = 0
        self._pace: float | None = 1.0
        self._wanted: float | None = None
        self._high = 0.0
        self._stage = _stage(SCENARIOS[0], {"body.width": "15 mm", "electrodes.gap": "15 mm"}, camera)
        self._moment = self._first()
        if keep_running:
            self.drive_with("servo")
            self.start()
        self._thread = threading.Thread(target=self._loop, name="toy session", daemon=True)

    def __enter__(self) -> Toy:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        self._thread.join()

    def stage(self) -> Stage:
        return self._stage

    def moment(self) -> Moment:
        return self._moment

    def scenarios(self) -> list[str]:
        return list(SCENARIOS)

    def choose(self, scenario: str) -> None:
        self.calls.append(("choose", scenario))
        if scenario not in SCENARIOS:
            raise BadInput("scenario", scenario, "one of " + ", ".join(SCENARIOS))
        with self._lock:
            self._stage = _stage(scenario, self._stage.settings, self._camera)
            self._moment = self._first()

    def change(self, changes: dict[str, str]) -> None:
        self.calls.append(("change", dict(changes)))
        for key, text in changes.items():
            if not text.endswith(" mm"):
                raise BadInput(key, text, "a length with its unit, such as 15 mm")
        with self._lock:
            self._stage = _stage(self._stage.name, {**self._stage.settings, **changes}, self._camera)
            self._moment = self._first()

    def start(self) -> None:
        self.calls.append(("start",))
        if self._moment.state == "stopped":
            raise BadInput("start", "stopped", "reset first, then start")
        self._now(state="running", message="")

    def pause(self) -> None:
        self.calls.append(("pause",))
        self._now(state="paused", given=np.zeros(ROWS**2))

    def step(self) -> None:
        self.calls.append(("step",))
        self._steps += 1

    def reset(self) -> None:
        self.calls.append(("reset",))
        with self._lock:
            self._moment = self._first()

    def emergency_stop(self, who: str) -> None:
        self._now(state="stopped", message=f"stopped by {who}", given=np.zeros(ROWS**2), asked=np.zeros(ROWS**2))
        self.stopped_at = time.perf_counter()
        self.calls.append(("emergency_stop", who))

    def drive_with(self, controller: str) -> None:
        self.calls.append(("drive_with", controller))
        self._now(controller=controller)

    def set_voltage(self, electrode: int, volts: float) -> None:
        self.calls.append(("set_voltage", electrode, volts))
        if abs(volts) > LIMIT:
            raise BadInput("voltage", volts, f"at most {LIMIT:g} V either way, the supply's limit")
        if not 0 <= electrode < ROWS**2:
            raise BadInput("electrode", electrode, f"a number from 0 to {ROWS**2 - 1}")
        asked = self._moment.asked.copy()
        asked[electrode] = volts
        self._now(controller="by hand", asked=asked)

    def set_pattern(self, pattern: str, amplitude: float) -> None:
        self.calls.append(("set_pattern", pattern, amplitude))
        asked = np.where(np.arange(ROWS**2) % PATTERNS[pattern] == 0, amplitude, -amplitude / 3.0)
        self._now(controller="by hand", asked=asked)

    def set_reference(self, height: float | None) -> None:
        self.calls.append(("set_reference", height))
        self._wanted = height

    def set_pace(self, pace: float | None) -> None:
        self.calls.append(("set_pace", pace))
        self._pace = pace
        self._now(pace=pace)

    def record(self, wanted: bool) -> None:
        self.calls.append(("record", wanted))
        self._now(recording=wanted)

    def _first(self) -> Moment:
        """The moment in which a scenario begins."""
        none, self._high = np.zeros(ROWS**2), 0.0
        return Moment(
            number=0, state="ready", message="", time=0.0, positions=self._stage.rest,
            adsorption=np.zeros(self._stage.faces.shape[1]), asked=none, given=none, currents=none, observed=None,
            reference=float("nan"), phase="preparation", controller="by hand", recording=False,
            arrows=np.zeros((0, 2, 3)), picture=None, ticks=Ticks(0, 0, 0.0, 0.0, 0.0),
        )  # fmt: skip

    def _now(self, **changes: object) -> None:
        with self._lock:
            self._moment = replace(self._moment, number=self._moment.number + 1, **changes)  # pyright: ignore

    def _loop(self) -> None:
        due = time.perf_counter()
        while not self._done.is_set():
            began = time.perf_counter()
            if self._moment.state == "running" or self._steps > 0:
                self._tick()
                self._steps = max(0, self._steps - 1)
            self.spent.append(time.perf_counter() - began)
            self._count += 1
            due += PERIOD / (self._pace or 10.0)
            left = due - time.perf_counter()
            if left < 0.0:
                self._late, due = self._late + 1, time.perf_counter()
            self._done.wait(max(0.0, left))

    def _tick(self) -> None:
        if self._work is not None:
            self._work()
        with self._lock:
            now, stage = self._moment, self._stage
            clock = now.time + PERIOD
            reference = self._wanted if self._wanted is not None else _programme(clock)
            asked = now.asked
            if now.controller != "by hand":
                pull = np.clip(2e3 * (reference - float(now.positions[2, 0])), -1.0, 1.0) * LIMIT
                asked = np.where(np.arange(ROWS**2) % 5 == 0, -pull / 3.0, pull)
            pull = np.sign(asked.sum()) * np.abs(asked).max() / LIMIT
            high = self._high = float(np.clip(self._high + RISE * pull * PERIOD, 0.0, HIGHEST))
            positions = _risen(stage.rest, high)
            spent = np.array(self.spent or [0.0])
            ticks = Ticks(self._count, self._late, *(float(v) for v in np.percentile(spent, (50, 99, 100))))
            self._moment = replace(
                now, number=now.number + 1, time=clock, positions=positions, asked=asked, given=asked,
                adsorption=_adsorbed(stage, high), currents=asked * 2e-4, observed=_seen(positions, clock),
                reference=reference if now.controller != "by hand" or self._wanted is not None else float("nan"),
                phase="preparation" if clock < 20.0 else "transition", arrows=_arrows(asked), ticks=ticks,
                picture=_picture(positions) if self._camera else None,
            )  # fmt: skip


def _programme(clock: float) -> float:
    """The height wanted [m]: up and down for ever."""
    return 2e-3 + 1.5e-3 * (1.0 - float(np.cos(2.0 * np.pi * clock / 20.0)))


def _stage(name: str, settings: dict[str, str], camera: bool) -> Stage:
    width, gap = (float(settings[key].split()[0]) * 1e-3 for key in ("body.width", "electrodes.gap"))
    rest, faces = _starfish(width / 2.0)
    square = HALF * np.array([[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]])
    along = PITCH * (np.arange(ROWS) - (ROWS - 1) / 2.0)
    outlines = tuple(
        np.vstack([square + np.array([[x], [y]]), np.full((1, 4), gap)]) for y in along[::-1] for x in along
    )
    return Stage(
        name=name, description="A starfish of gel under 4 x 4 plates.", faces=faces, rest=rest, outlines=outlines,
        electrode_names=tuple(str(k + 1) for k in range(ROWS**2)), limit=LIMIT, floor_depth=1e-3,
        obstacles=np.zeros((0, 3, 3)), patterns=tuple(PATTERNS),
        controllers=("by hand", "servo", "planned", "predictive"), plant="a second simulation, with noise",
        has_camera=camera, control_period=PERIOD, settings=dict(settings), water_height=30e-3,
    )  # fmt: skip


def _starfish(reach: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Nodes (3, n) and faces (3, f) of a starfish of five arms; node 0 is the middle of its upper side."""
    angle = 2.0 * np.pi * np.arange(SPOKES) / SPOKES
    rim = reach * np.array([1.0, 0.55, 0.3, 0.55])[np.arange(SPOKES) % 4]
    share = np.arange(1, RINGS + 1) / RINGS
    flat = np.stack([np.outer(share, rim * np.cos(angle)), np.outer(share, rim * np.sin(angle))]).reshape(2, -1)
    side = np.concatenate([np.zeros((2, 1)), flat], axis=1) + PLACE[:, None]
    per = side.shape[1]
    nodes = np.concatenate([np.vstack([side, np.full((1, per), z)]) for z in (1e-3, 0.0)], axis=1)
    around = np.arange(SPOKES)
    on = (around + 1) % SPOKES
    top = [np.stack([np.zeros_like(around), 1 + around, 1 + on])]
    for ring in range(RINGS - 1):
        a, b = 1 + ring * SPOKES, 1 + (ring + 1) * SPOKES
        top += [np.stack([a + around, b + around, b + on]), np.stack([a + around, b + on, a + on])]
    upper = np.concatenate(top, axis=1)
    lower = upper[::-1] + per
    rim_up, rim_down = 1 + (RINGS - 1) * SPOKES, per + 1 + (RINGS - 1) * SPOKES
    wall = np.concatenate(
        [
            np.stack([rim_up + around, rim_down + around, rim_down + on]),
            np.stack([rim_up + around, rim_down + on, rim_up + on]),
        ],
        axis=1,
    )
    return nodes, np.concatenate([upper, lower, wall], axis=1).astype(np.int64)


def _risen(rest: NDArray[np.float64], high: float) -> NDArray[np.float64]:
    """The starfish as a dome whose middle has come up to `high` [m]: the arms bend down, and come in."""
    out = rest[:2] - PLACE[:, None]
    far = np.linalg.norm(out, axis=0) / 7.5e-3
    bend = 2.2 * high / HIGHEST
    inward = np.where(far > 0, np.sin(bend * far) / np.maximum(bend * far, 1e-9), 1.0) if bend > 1e-6 else 1.0
    drop = 7.5e-3 * (1.0 - np.cos(bend * far)) / max(bend, 1e-9)
    lift = float(drop.max())
    return np.vstack([PLACE[:, None] + out * inward, rest[2] + lift - drop])


def _adsorbed(stage: Stage, high: float) -> NDArray[np.float64]:
    """Most where the arms end below."""
    middle = stage.rest[:, stage.faces].mean(axis=1)
    far = np.linalg.norm(middle[:2] - PLACE[:, None], axis=0) / 7.5e-3
    below = middle[2] < 0.5e-3
    return np.clip(high / HIGHEST * np.where(below, 0.3 + 0.7 * far, 0.15 * far), 0.0, 1.0)


def _seen(positions: NDArray[np.float64], clock: float) -> Seen:
    wobble = 2e-4 * np.array([np.sin(3.0 * clock), np.cos(2.3 * clock), 0.5 * np.sin(1.7 * clock)])
    ends = 1 + (RINGS - 1) * SPOKES + np.arange(0, SPOKES, 4)
    centre = positions[:, 0] + wobble
    tips = positions[:, ends] + wobble[:, None]
    normal = np.array([0.05 * np.sin(clock), 0.03, 1.0])
    return Seen(centre, tips, normal / np.linalg.norm(normal), 0.7 + 0.3 * float(np.sin(0.5 * clock)))


def _arrows(volts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Arrows on a grid half way up, towards the floor below electrodes that drive."""
    along = PLACE[0] + 5e-3 * np.arange(-3, 4)
    foot = np.stack([*np.meshgrid(along, along), np.full((7, 7), 9e-3)]).reshape(3, -1).T
    if not np.any(volts):
        return np.zeros((0, 2, 3))
    way = np.array([0.0, 0.0, -1.0]) * np.mean(np.abs(volts)) / LIMIT * 4e-3
    return np.stack([foot, foot + way], axis=1)


def _picture(positions: NDArray[np.float64]) -> NDArray[np.uint8]:
    """240 x 320 pixels from above, 0.1 mm each, the outline drawn in."""
    picture = np.full((240, 320, 3), 226, dtype=np.uint8)
    ring = positions[:2, 1 : 1 + RINGS * SPOKES]
    x, y = np.round((ring - PLACE[:, None]) * 1e4 + [[160.0], [120.0]]).astype(int)
    for shift in range(-4, 5):
        for up in range(-4, 5):
            picture[y + up, x + shift] = (170, 182, 120)
    rim = slice((RINGS - 1) * SPOKES, RINGS * SPOKES)
    for start, end in zip(np.stack([x[rim], y[rim]]).T, np.roll(np.stack([x[rim], y[rim]]).T, -1, axis=0), strict=True):
        line = np.round(np.linspace(start, end, 60)).astype(int)
        picture[line[:, 1], line[:, 0]] = picture[line[:, 1] + 1, line[:, 0]] = (213, 94, 0)
    return picture
