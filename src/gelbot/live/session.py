"""The session behind the page: one thread that turns the loop, and what a user can do to it.

Whatever happens in the loop, a driver's mistake, a lost device, a full disk, ends in the guard's stop: zero volts, one
message, a whole log.
"""

from __future__ import annotations

import gc
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from gelbot.bench import Tick, drive
from gelbot.clock import WallClock, be_in_time
from gelbot.errors import BadInput, BenchStopped, GelbotError
from gelbot.live import asked
from gelbot.live.drivers import ByHand, Programmed
from gelbot.live.keeping import Keeping
from gelbot.live.moment import Moment, Stage, Ticks
from gelbot.live.ready import HAND, RECORDED, SERVO, Ready, Source, make_ready, stage_of
from gelbot.live.setups import Setup
from gelbot.live.standing import Helm, Standing, seen_at
from gelbot.live.twin import Twin
from gelbot.scenario.load import names

Floats = NDArray[np.float64]
REMEMBERED = 600
"""Ticks whose times the page tells of: a minute of them."""
PATIENCE = 10.0
"""The thread must be over within this time [s] once it is told to."""
IDLE = 0.02
"""So long [s] the thread sleeps where there is nothing to do."""
SWITCH = 2e-4
"""A thread that computes gives way after so long [s]: a tick takes the interpreter some fifty times, and must not wait
Python's usual 5 ms each time while a recording or the page is written."""
READY, BUILDING, RUNNING, PAUSED, STOPPED = "ready", "building", "running", "paused", "stopped"


class Session:
    """A `setup` under a scenario; see `live.actions.Actions` for what a user can do.

    `real`: how the simulated gel differs from the scenario that its controllers know, key=value. `folder` takes logs
    and recordings, `elsewhere` is the folder for those of another scenario; `say` is told what is done while it is
    built. Made, it has built everything and waits at the beginning; `close` ends it. Raises `BadInput`.
    """

    def __init__(
        self,
        setup: Setup,
        source: Source,
        folder: Path,
        changes: Sequence[str] = (),
        real: Sequence[str] = (),
        say: Callable[[str], None] = lambda text: None,
        elsewhere: Callable[[str], Path] | None = None,
    ) -> None:
        self.setup, self.message, self._say = setup, "", say
        self._real, self._commands = tuple(real), SimpleQueue[Callable[[], None]]()
        self._state, self._number, self._time = READY, 0, 0.0
        self._took, self._late = deque[float](maxlen=REMEMBERED), 0
        self._last: Tick | None = None
        self._ticks: Iterator[Tick] | None = None
        self._turned = 0.0
        self._single = self._closing = self._is_changing = False
        # What was stopped stays stopped, whatever was asked for before and is done later: a start counts the stops.
        self._stops, self._stopped_by, self._has_ended = 0, "", False
        self._notes: list[str] = []
        # Whoever chooses another scenario in the browser keeps the bench's own limits.
        self._changes = tuple(changes)
        self._fixed = tuple(change for change in changes if change.startswith(("supply.", "camera.")))
        self._wall = WallClock()
        self._has_helm = False
        self.keeping = Keeping(folder, elsewhere)
        self._news = SimpleQueue[str]()
        try:
            self._begin(make_ready(source, changes, self._real), 0)
        except BaseException:
            setup.close()
            raise
        self._switched = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH)
        self._thread = Thread(target=self._run, name="control loop", daemon=True)
        self._thread.start()

    # -- what the page asks

    def stage(self) -> Stage:
        """What stands."""
        return self._standing.stage

    def scenarios(self) -> list[str]:
        """The names of the scenarios that can be chosen."""
        own = self._ready.source.name
        return names() if own in names() else [own, *names()]

    def moment(self) -> Moment:
        """The newest moment. The simulated gel is shown a period late, so that it moves smoothly between ticks."""
        standing, helm = self._standing, self._helm
        tick = self._last if self._state == RUNNING else None
        shape = standing.twin.shape_at(self.setup.clock.now() - standing.period)
        given = standing.given(tick)
        return Moment(
            number=self._number,
            state=STOPPED if standing.guard.reason is not None else RUNNING if self._is_changing else self._state,
            message=standing.twin.broken or self.message or standing.guard.reason or "",
            time=self._time,
            positions=shape.positions,
            adsorption=shape.adsorption,
            asked=given if self.setup.is_played else helm.asked(tick, standing.count),
            given=given,
            currents=standing.currents(given),
            observed=None if self._last is None else seen_at(self._last),
            reference=helm.reference(self._last),
            phase=standing.phase(helm, self._last),
            controller=RECORDED if self.setup.is_played else helm.name,
            recording=self.keeping.recording,
            arrows=standing.twin.arrows(),
            picture=self.setup.picture(),
            ticks=self._told(),
            pace=self.setup.pace,
        )

    def news(self) -> list[str]:
        """What was told of since this was asked last: stops, refusals, what a recording came to."""
        told = []
        with suppress(Empty):
            while True:
                told.append(self._news.get_nowait())
        return told

    # -- what a user does; each returns at once, but checks what it was given

    def choose(self, scenario: str) -> None:
        """Another of the `scenarios`."""
        if scenario not in self.scenarios():
            raise BadInput("scenario", scenario, "one of " + ", ".join(self.scenarios()))
        # What stands is chosen anew as it was begun with: that may be a recording's own.
        own = scenario == self._ready.source.name
        source, changes = (self._ready.source, self._changes) if own else (Source(scenario), self._fixed)
        source.load(changes)
        stops = self._stops
        self._do(lambda: self._rebuild(source, changes, stops))

    def change(self, changes: Mapping[str, str]) -> None:
        """Values of the scenario, by key."""
        kept, source, stops = asked.changed(self._ready, changes), self._ready.source, self._stops
        self._do(lambda: self._rebuild(source, kept, stops))

    def start(self) -> None:
        """Go, or go on."""
        self._check_free()
        stops = self._stops
        self._do(lambda: self._go(stops))

    def step(self) -> None:
        """One control period."""
        self._check_free()
        stops = self._stops
        self._do(lambda: self._go_once(stops))

    def pause(self) -> None:
        """Stand still with zero volts."""
        self._do(self._pause)

    def reset(self) -> None:
        """Back to the beginning."""
        stops = self._stops
        self._do(lambda: self._begin_again(stops))

    def emergency_stop(self, who: str) -> None:
        """Zero volts now."""
        self._stop(f"emergency stop: {who}")

    def halt(self, reason: str) -> None:
        """Zero volts now, and for good."""
        self._has_ended = True
        self._stop(reason)

    def _stop(self, why: str) -> None:
        # First counted, then done: a start that is on its way sees it, whichever guard it arms.
        self._stopped_by = why
        self._stops += 1
        self.setup.guard.stop(why)

    def drive_with(self, controller: str) -> None:
        """Who drives."""
        asked.check_free_to_drive(self.setup.is_played)
        self._ready.driver(controller)
        self._do(lambda: self._seat(controller))

    def set_voltage(self, electrode: int, volts: float) -> None:
        """By hand from now on: one electrode at `volts` [V]."""
        ready = self._ready
        asked.check_free_to_drive(self.setup.is_played)
        asked.check_electrode(ready, electrode, volts)
        self._do(lambda: self._by_hand(ready, lambda now: _with(now, electrode, volts)))

    def set_pattern(self, pattern: str, amplitude: float) -> None:
        """By hand from now on: a named pattern with this amplitude [V]."""
        ready = self._ready
        asked.check_free_to_drive(self.setup.is_played)
        shaped = asked.pattern(ready, pattern, amplitude)
        self._do(lambda: self._by_hand(ready, lambda now: shaped))

    def set_reference(self, height: float | None) -> None:
        """The servo follows this height [m]; None: its own reference again."""
        follows = isinstance(self._helm.driver, Programmed)
        asked.check_free_to_drive(self.setup.is_played)
        asked.check_reference(self._ready, height, follows)
        if height is not None and not follows:
            self._do(lambda: self._seat(SERVO))

        def put() -> None:
            if isinstance(self._helm.driver, Programmed):
                self._helm.driver.reference = height

        self._do(put)

    def set_pace(self, pace: float | None) -> None:
        """Simulated seconds to one of the wall clock; None: as fast as it goes."""
        asked.check_pace(pace)
        self.setup.set_pace(pace)

    def record(self, wanted: bool) -> None:
        """Keep, or no longer keep, the simulated gel's shape."""
        self._do(lambda: self.keeping.record(wanted, self._ready))

    def close(self) -> None:
        """Zero volts; the log is closed, and all threads are over."""
        self._closing = True
        self.halt("the program was ended")
        self._do(lambda: None)
        try:
            self._thread.join(PATIENCE)
        finally:
            try:
                self.setup.close()
            finally:
                self.keeping.close()
        # As it was before, for whoever goes on.
        sys.setswitchinterval(self._switched)
        gc.unfreeze()

    # -- the thread

    def _do(self, command: Callable[[], None]) -> None:
        self._commands.put(command)

    def _run(self) -> None:
        be_in_time()
        while not self._closing:
            self._obey()
            if self._state == RUNNING:
                self._turn()
        with suppress(Exception):
            self.setup.guard.rest()

    def _obey(self) -> None:
        """Do what was asked; wait a little for it where nothing else is to be done."""
        try:
            command = self._commands.get(block=self._state != RUNNING, timeout=IDLE)
            while True:
                self._try(command)
                command = self._commands.get_nowait()
        except Empty:
            pass

    def _try(self, command: Callable[[], None]) -> None:
        try:
            command()
        except (GelbotError, OSError) as error:
            self._tell(str(error))
        except Exception as error:
            self._failed(error)

    def _turn(self) -> None:
        """One turn of the loop."""
        try:
            if self._ticks is None:
                plant, clock, period = self.setup.plant, self.setup.waiting, self._standing.period
                self._ticks = drive(plant, self._helm, clock, period, busy=self._wall, begun=self._time)
            self._turned = self.setup.clock.now()
            self._after(next(self._ticks))
        except BenchStopped as stop:
            self._halt(STOPPED, stop.reason)
        except (GelbotError, OSError) as error:
            self.setup.guard.stop(_words(error))
            self._halt(STOPPED, _words(error))
        except Exception as error:  # whatever it is: zero volts first
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        reason = f"a mistake in the program: {error!r}"
        self.setup.guard.stop(reason)
        self.keeping.event(self._time, "".join(traceback.format_exception(error)))
        self._halt(STOPPED, reason)

    def _after(self, tick: Tick) -> None:
        """What belongs to a tick, and may wait until the electrodes have their voltages."""
        twin, period = self._twin, self._standing.period
        twin.advance(self.setup.clock.now())
        twin.voltages = tick.given
        self._took.append(tick.took)
        self._late += tick.missed
        self._last, self._number, self._time = tick, self._number + 1, tick.time + period
        self.keeping.tick(tick, self._standing.currents(tick.given), self.setup.guard.measured, twin)
        if self.keeping.failed:
            self._tell(self.keeping.failed)
            self.keeping.record(False, self._ready)
        self.setup.kept_up(tick.missed)
        if self.setup.guard.reason is not None:
            self._halt(STOPPED, self.setup.guard.reason)
        elif self.setup.is_over:
            self._halt(PAUSED, "the recording has ended")
        elif self._single:
            # To the end of the period: a step is what its voltages did.
            self.setup.clock.wait_until(self._turned + period)
            self.setup.plant.observe()
            twin.advance(self.setup.clock.now())
            self._halt(PAUSED, "")

    def _halt(self, state: str, message: str) -> None:
        """No more ticks; zero volts."""
        self._ticks, self._single = None, False
        self.setup.stand()
        self._twin.voltages = np.zeros_like(self._twin.voltages)
        self._state = state
        if message:
            self.message = message

    def _tell(self, text: str) -> None:
        """For the user and for the log. The guard calls it too, from its own thread."""
        self.message = text.removeprefix("stopped: ")
        self._news.put(text)
        self.keeping.event(self._time, text)

    def _told(self) -> Ticks:
        took = np.array(self._took) if self._took else np.zeros(1)
        return Ticks(self._number, self._late, *(float(q) for q in np.percentile(took, [50, 99, 100])))

    # -- commands, in the thread

    def _begin(self, ready: Ready, stops: int) -> None:
        """Everything at its beginning; what was stopped since it was asked for stays stopped."""
        if self._has_helm:
            self._halt(BUILDING, "")
        self._notes = []
        self.setup.begin(ready, self._note, self._progress)
        name = self._helm.name if self._has_helm else ready.controllers[1]
        name = name if name in ready.controllers else ready.controllers[1]
        ready.warm(name, self.setup.first_sight())
        twin = Twin(ready.nominal, self.setup.clock.now())
        twin.gel.compile()
        twin.arrows()
        drivers = (RECORDED,) if self.setup.is_played else ready.controllers
        stage = stage_of(ready, self.setup.words, self.setup.has_camera, self.setup.is_real, drivers)
        self._helm, self._has_helm = Helm(name, ready.driver(name)), True
        self._last, self._number, self._time, self._late = None, 0, 0.0, 0
        self._took.clear()
        self._standing = Standing(ready, twin, stage, self.setup.guard)
        self.keeping.begin(ready, self.setup.words)
        self._state, self.message = READY, self._notes[-1] if self._notes else ""
        if self._stops != stops:
            self.setup.guard.stop(self._stopped_by)

    def _begin_again(self, stops: int) -> None:
        try:
            self._begin(self._ready, stops)
        except Exception as error:
            self._halt(STOPPED, "")
            self.setup.guard.stop(_words(error))
            raise

    def _rebuild(self, source: Source, changes: tuple[str, ...], stops: int) -> None:
        self._halt(BUILDING, "building")
        try:
            self._begin(make_ready(source, changes, self._real, self._ready), stops)
        except (GelbotError, OSError) as error:
            # What stood before stands again.
            self._begin_again(stops)
            self._tell(_words(error))

    def _check_free(self) -> None:
        reason = self._stopped_by if self._has_ended else self.setup.guard.reason
        if reason is not None:
            raise GelbotError(f"it was stopped: {reason}. Press reset first")
        if self._state == BUILDING:
            raise GelbotError("it is still being built. Start when it stands")

    def _go(self, stops: int) -> None:
        if self._state == RUNNING:
            return
        if self._has_ended or self._stops != stops:
            raise BenchStopped(self._stopped_by)
        self.keeping.open()
        for note in self._notes:
            self.keeping.event(self._time, note)
        self._notes = []
        _settle_memory()
        self.setup.go()
        self.keeping.event(self._time, f"started, driven by: {self._helm.name}")
        self._state = RUNNING
        if self._stops != stops:  # it came while this was done
            self.setup.guard.stop(self._stopped_by)

    def _go_once(self, stops: int) -> None:
        if self._state != RUNNING:
            self._go(stops)
            self._single = True

    def _pause(self) -> None:
        if self._state == RUNNING:
            self._halt(PAUSED, "")
            self.keeping.event(self._time, "paused")

    def _seat(self, name: str) -> None:
        if name == self._helm.name:
            return
        running, stops = self._state == RUNNING, self._stops
        sight = self._last.seen.observation if self._last is not None else self.setup.first_sight()
        self._is_changing = running
        try:
            if running:
                # Compiling takes longer than the guard waits.
                self._halt(PAUSED, "")
            self._ready.warm(name, sight)
            self._helm = Helm(name, self._ready.driver(name))
            self.keeping.event(self._time, f"driven by: {name}")
            if running:
                self._go(stops)
        finally:
            self._is_changing = False

    def _by_hand(self, ready: Ready, changed: Callable[[Floats], Floats]) -> None:
        if ready is not self._ready:  # it was asked of electrodes that stand no longer
            return
        driver = self._helm.driver
        if not isinstance(driver, ByHand):
            driver = ByHand(self._standing.count)
            driver.voltages = self._standing.given(None)
            self._helm = Helm(HAND, driver)
            if self._state == RUNNING:
                self._ticks = None
            self.keeping.event(self._time, f"driven by: {HAND}")
        driver.voltages = changed(driver.voltages)

    def _note(self, text: str) -> None:
        """What setup and guard have to say: for the user, and for the log, once there is one."""
        if self._state in (READY, BUILDING):
            self._notes.append(text)
        self._tell(text)

    def _progress(self, text: str) -> None:
        """How far building has come."""
        self.message = text
        self._say(text)

    @property
    def _ready(self) -> Ready:
        return self._standing.ready

    @property
    def _twin(self) -> Twin:
        return self._standing.twin


def _settle_memory() -> None:
    """What stands now will stand: the collector, which holds up everything for a quarter of a second where it looks at
    all that a scenario is made of, need not look at it again."""
    gc.unfreeze()
    gc.collect()
    gc.freeze()


def _with(voltages: Floats, electrode: int, volts: float) -> Floats:
    voltages = voltages.copy()
    voltages[electrode] = volts
    return voltages


def _words(error: Exception) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or 'the log'} cannot be written: {error.strerror or error}"
    return str(error)
