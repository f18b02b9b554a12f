"""The three plants as the session handles them: each with its guard and its clock, at its beginning, going,
standing."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock, PacedClock, WallClock
from gelbot.errors import BadInput
from gelbot.hardware.guard import Guard
from gelbot.hardware.limits import Limits, straight
from gelbot.hardware.soft_supply import SoftSupply
from gelbot.hardware.supply import Supply
from gelbot.live.eyes import RENDERED, rendered_eye
from gelbot.live.ready import Ready
from gelbot.plant import Plant, Sighting
from gelbot.plants.build import Simulated, guard_of, simulated
from gelbot.plants.guarded import Eye, GuardedPlant
from gelbot.plants.played import PlayedPlant, recording
from gelbot.plants.simulated import Meanwhile, SimulatedGel
from gelbot.plants.watching import CameraEye
from gelbot.points import Observation
from gelbot.units import shown

Tell = Callable[[str], None]


SLACK = 3.0
"""The loop of a simulated gel may be held up for so long [s]: nothing is at stake, and the machine may be busy."""
LONGEST_PERIOD = 0.15
"""A control period that leaves time to see that the loop has stalled [s]."""


class Setup(Protocol):
    """A plant with what belongs to it. `words`: what it is, for the page. `is_played`: its voltages were recorded, and
    nobody can give it others. `is_real`: its gel is no simulation, and goes at the pace of the world."""

    words: str

    @property
    def is_played(self) -> bool:
        """See there."""
        ...

    @property
    def is_real(self) -> bool:
        """See there."""
        ...

    @property
    def has_camera(self) -> bool:
        """Whether there are pictures."""
        ...

    @property
    def pace(self) -> float | None:
        """See `set_pace`."""
        ...

    @property
    def clock(self) -> Clock:
        """The loop's."""
        ...

    @property
    def waiting(self) -> Clock:
        """The same clock for whoever waits by it."""
        ...

    @property
    def guard(self) -> Guard:
        """What stops it."""
        ...

    @property
    def plant(self) -> Plant:
        """What is seen and given voltages."""
        ...

    def begin(self, ready: Ready, tell: Tell, progress: Tell) -> None:
        """Put a scenario under it, at its beginning, all electrodes at zero volts.

        What lasts is told to `tell`, how far it has come to `progress`. Raises `GelbotError`.
        """
        ...

    def go(self) -> None:
        """Let its time go on, and arm its guard. Raises `BenchStopped`."""
        ...

    def stand(self) -> None:
        """Zero volts; what is simulated stands still."""
        ...

    def kept_up(self, missed: int) -> None:
        """Told after each tick how many before it were `missed`."""
        ...

    def set_pace(self, pace: float | None) -> None:
        """Seconds of a simulated gel to one of the wall clock; None: as fast as it goes."""
        ...

    @property
    def is_over(self) -> bool:
        """Whether nothing more will come of it."""
        ...

    def first_sight(self) -> Observation:
        """What is seen at the beginning."""
        ...

    def picture(self) -> NDArray[np.uint8] | None:
        """The newest picture of the camera, None without one."""
        ...

    def close(self) -> None:
        """Zero volts, and let go of everything."""
        ...


class OpenEye(Eye, Protocol):
    """An eye that has a picture to show, and something to close."""

    def picture(self) -> NDArray[np.uint8] | None:
        """The newest picture (h, w, 3), RGB, with what was found in it."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


class _Paced:
    """What setups have in common whose gel is not real: their time may stand still, and go faster than the wall's."""

    is_over = is_played = is_real = False

    guard: Guard
    plant: Plant

    def __init__(self, pace: float | None) -> None:
        self._wall = WallClock()
        self.clock = PacedClock(self._wall, pace, running=False)
        self.waiting: Clock = self.clock
        self.guard = _nobody(self._wall)

    @property
    def pace(self) -> float | None:
        """How fast it goes."""
        return self.clock.pace

    def set_pace(self, pace: float | None) -> None:
        """How fast it goes."""
        self.clock.set_pace(pace)

    def go(self) -> None:
        """Let it go on."""
        self.guard.arm()
        self.clock.go()

    def stand(self) -> None:
        """Zero volts; it stands still."""
        self.guard.rest()
        self.clock.stop()

    def first_sight(self) -> Observation:
        """What is seen of it now."""
        return self.plant.observe().observation


class SimulatedSetup(_Paced):
    """A simulated gel, which may differ from what its controllers know; seen with noise, or in rendered pictures."""

    def __init__(self, pace: float | None = 1.0, seed: int = 0) -> None:
        super().__init__(pace)
        self.words, self._seed, self.plant = "simulated gel", seed, _Nothing()
        self.inside: Simulated | None = None
        self._camera: CameraEye | None = None

    @property
    def has_camera(self) -> bool:
        """Whether there are pictures."""
        return self._camera is not None

    def begin(self, ready: Ready, tell: Tell, progress: Tell) -> None:
        """A new gel at its beginning."""
        self.close()
        self._camera = None
        rendered = ready.nominal.scenario.camera.source == RENDERED
        eye_of = partial(self._rendered, ready, progress) if rendered else None
        self.inside = simulated(ready.nominal, ready.real, self.clock, self._wall, self._seed, tell, eye_of, SLACK)
        self.inside.gel.compile()
        # Before a camera it moves on in the camera's thread.
        self.waiting = self.clock if rendered else Meanwhile(self.clock, self.inside.gel)
        self.plant, self.guard = self.inside.plant, self.inside.plant.guard
        self.guard.watch()
        self.words = "simulated gel" if ready.real is ready.nominal else "simulated gel, not as the model"

    def _rendered(self, ready: Ready, progress: Tell, gel: SimulatedGel) -> CameraEye:
        self._camera = rendered_eye(ready, gel, self.clock, progress, self._seed)
        return self._camera

    def kept_up(self, missed: int) -> None:
        """A simulation that cannot keep up takes its time."""
        if missed and self.inside is not None:
            self.clock.set_back(self.inside.gel.time)

    def picture(self) -> NDArray[np.uint8] | None:
        """The newest rendered one, if they are."""
        return None if self._camera is None else self._camera.picture()

    def close(self) -> None:
        """Zero volts, for good."""
        self.guard.close()
        if self._camera is not None:
            self._camera.close()


class BenchSetup:
    """A real supply and a real eye, at the pace of the world: `open_supply` and `open_eye` make them for a scenario,
    each time it begins."""

    pace, is_over, is_played, is_real = 1.0, False, False, True

    def __init__(
        self,
        open_supply: Callable[[Ready, Clock], Supply],
        open_eye: Callable[[Ready, Clock, Tell], OpenEye],
        words: str = "bench",
    ) -> None:
        self.words, self.has_camera = words, True
        self._open_supply, self._open_eye = open_supply, open_eye
        self.clock = self.waiting = WallClock()
        self.guard, self.plant = _nobody(self.clock), _Nothing()
        self._eye: OpenEye | None = None

    def begin(self, ready: Ready, tell: Tell, progress: Tell) -> None:
        """Open what is there anew. Raises `SupplyFailed`, `CameraFailed` and `BadInput`."""
        self.close()
        period = ready.nominal.scenario.programme.control_period
        if period > LONGEST_PERIOD:
            allowed = f"at most {shown(LONGEST_PERIOD, 's')} on the bench: a loop that is silent for longer is stopped"
            raise BadInput("programme.control_period", shown(period, "s"), allowed)
        supply = self._open_supply(ready, self.clock)
        try:
            self.guard = guard_of(ready.nominal, supply, self.clock, tell)
        except Exception:
            supply.close()
            raise
        try:
            self._eye = self._open_eye(ready, self.clock, progress)
        except Exception:
            self.guard.close()  # and with it the supply
            raise
        self.plant = GuardedPlant(self.guard, self._eye, self.clock)
        self.guard.watch()
        if supply.watchdog is None:
            tell(f"{supply.name} has no watchdog: where this program is killed, it keeps its voltages")

    def go(self) -> None:
        """Let the electrodes have voltages."""
        self.guard.arm()

    def stand(self) -> None:
        """Zero volts."""
        self.guard.rest()

    def kept_up(self, missed: int) -> None:
        """It does not wait for anybody."""

    def set_pace(self, pace: float | None) -> None:
        """Raises `BadInput`: a real gel takes its time."""
        if pace != 1.0:
            raise BadInput("pace", "as fast as it goes" if pace is None else pace, "1: a real gel takes its time")

    def first_sight(self) -> Observation:
        """What is seen now."""
        return self.plant.observe().observation

    def picture(self) -> NDArray[np.uint8] | None:
        """What the camera sees, with what was found in it."""
        return None if self._eye is None else self._eye.picture()

    def close(self) -> None:
        """Zero volts, and let go of supply and camera."""
        self.guard.close()
        if self._eye is not None:
            self._eye.close()
            self._eye = None


class PlayedSetup(_Paced):
    """A recorded run or log. Voltages do nothing; its guard has nothing to guard, but stops it like any other."""

    has_camera, is_played = False, True

    def __init__(self, path: Path, pace: float | None = 1.0) -> None:
        super().__init__(pace)
        self._recording, file = recording(path)
        self.words = f"recording {file}"
        self.plant = self._played = PlayedPlant(self._recording, self.clock)
        self.scenario_text = str(self._recording.attrs.get("scenario", ""))

    def begin(self, ready: Ready, tell: Tell, progress: Tell) -> None:
        """Back to its beginning. Raises `BadInput` for a scenario with other electrodes."""
        recorded, there = self._recording.sizes["electrode"], ready.nominal.array.count
        if recorded != there:
            raise BadInput("--plant", f"a recording with {recorded} electrodes", f"{there}, as the scenario has")
        self.guard.close()
        self.guard = _nobody(self._wall, tell)
        self.guard.watch()
        self.plant = self._played = PlayedPlant(self._recording, self.clock)

    def kept_up(self, missed: int) -> None:
        """It always does."""

    @property
    def is_over(self) -> bool:
        """Whether all of it was played."""
        return self._played.over

    def picture(self) -> NDArray[np.uint8] | None:
        """It kept none."""
        return None

    def close(self) -> None:
        """Let go."""
        self.guard.close()


class _Nothing:
    """The plant before there is one."""

    def observe(self) -> Sighting:
        raise RuntimeError("no scenario yet")

    def apply(self, voltages: NDArray[np.float64]) -> NDArray[np.float64]:
        raise RuntimeError("no scenario yet")


def _nobody(clock: Clock, tell: Tell = lambda text: None) -> Guard:
    """A guard over a supply that feeds nothing."""
    return Guard(SoftSupply(1, clock=clock), straight(1), Limits(0.0), clock, {}, tell)
