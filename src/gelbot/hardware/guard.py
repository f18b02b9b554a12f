"""The lowest layer of safety: the only one that holds a supply, below every controller; nothing above can switch it
off.

It limits what is asked for, and puts all electrodes at zero volts when one of those that it watches falls silent, when
the supply fails or measures what it should not, when it is told to stop, and when the program ends. What kills the
program kills the guard too: then the device's own watchdog does the same.

    guard = Guard(supply, wiring, limits, clock, {"the control loop": Watch(0.2)})
    guard.watch()                   # a thread that looks every 20 ms; or call guard.check() yourself
    guard.arm()
    given = guard.apply(voltages)
    guard.stop("the user pressed the emergency stop")
    guard.close()
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from threading import Event, Lock, RLock, Thread
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock, be_in_time
from gelbot.errors import BenchStopped, GelbotError
from gelbot.hardware.limits import Limits, Wiring
from gelbot.hardware.supply import Supply

LOOK = 0.02
"""The guard's thread looks this often [s]."""
HEARTBEAT = 0.08
"""A device that has heard nothing for this long [s] is told its voltages again, for its own watchdog's sake."""
READ_EVERY = 0.1
"""The supply is asked what it measures this often [s]."""
STANDSTILL = 1.0
"""Where the guard itself has not looked for so long [s], the machine has slept or its clock has jumped."""
EXCESS = 1.1
"""A measured current may be so many times the limit: the amplifier's own errors."""
ASTRAY, ASTRAY_SHARE = 0.2, 0.05
"""A measured voltage may be off by this [V] plus this share of it."""
EARLY = 1e-6
"""Times that are added up are off by less than this [s]."""
LOOP = "the control loop"
CAMERA = "the camera"

Floats = NDArray[np.float64]


class Watch(NamedTuple):
    """Who is silent for `limit` [s] puts the electrodes at zero volts, and for `patience` [s] ends the run: until then
    it may come back, and the run goes on."""

    limit: float
    patience: float = 0.0


class Guard:
    """Holds the `supply`; see the module. Every method may be called from any thread.

    Silence is measured by `clock`; slew and charge by the `gel_clock`, which may go faster where the gel is simulated.
    What happens is told to `on_event`, in words.

    `armed`: the electrodes may have voltages. `reason`: why they may not have them any more, None as long as they may.
    """

    def __init__(
        self,
        supply: Supply,
        wiring: Wiring,
        limits: Limits,
        clock: Clock,
        watches: Mapping[str, Watch],
        on_event: Callable[[str], None] = lambda text: None,
        gel_clock: Clock | None = None,
    ) -> None:
        self.wiring, self.limits = wiring, limits
        self.reason: str | None = None
        self.armed = False
        self.waiting_for: str | None = None
        self.checks, self.longest_gap = 0, 0.0
        self.measured: Floats | None = None
        self.charge = 0.0
        self._supply, self._clock, self._watches, self._tell_of = supply, clock, dict(watches), on_event
        self._gel_clock = clock if gel_clock is None else gel_clock
        self._lock, self._telling = RLock(), Lock()
        self._fed = dict.fromkeys(self._watches, clock.now())
        self._given = np.zeros(len(wiring.channel))
        self._checked = self._written = self._read = clock.now()
        self._applied = self._counted = self._gel_clock.now()
        self._off = Event()
        self._thread: Thread | None = None
        self._strays, self._expired = 0, 0
        # Whether the device has said that it is at zero; until then it is told so again and again.
        self._is_zero, self._is_closed = False, False

    @property
    def given(self) -> Floats:
        """The voltages [V], (e,), that the electrodes were last told to have."""
        return self._given.copy()

    # -- what those above may do

    def arm(self) -> None:
        """Let the electrodes have voltages; all that is watched counts from now.

        Raises `BenchStopped` after a stop, and when the device does not say that it is at zero.
        """
        with self._lock:
            if self._is_closed:
                raise BenchStopped("the supply was closed")
            if self.reason is not None:
                raise BenchStopped(self.reason)
            self._zero()
            if not self._is_zero:
                self.stop("the supply does not say that it is at zero volts")
                raise BenchStopped(self.reason or "")
            self._expired = self._supply.expired_count
            now = self._clock.now()
            self._fed = dict.fromkeys(self._watches, now)
            self._checked = now
            self._applied = self._counted = self._gel_clock.now()
            self.waiting_for, self.armed = None, True

    def rest(self) -> None:
        """Zero volts, until armed again."""
        with self._lock:
            self.armed, self.waiting_for = False, None
            self._zero()

    def reset(self) -> None:
        """After a stop: what stopped it has been seen to. The electrodes stay at zero volts until armed."""
        with self._lock:
            self.rest()
            self.reason, self.charge, self._strays = None, 0.0, 0

    def feed(self, name: str) -> None:
        """A sign of life of one that is watched."""
        # Without the lock: whoever gives it must not wait for a device.
        self._fed[name] = self._clock.now()

    def apply(self, voltages: Floats) -> Floats:
        """Put the electrodes at `voltages` [V], (e,), as far as the limits allow; returns what they got.

        Zeros as long as one that is watched is silent, and while not armed. Raises `BenchStopped` after a stop, and
        when this stops it: a voltage that is no number, a supply that fails, a charge that is used up.
        """
        asked = np.asarray(voltages, float)
        if asked.shape != self._given.shape or not np.isfinite(asked).all():
            self.stop(f"the controller asked for {_odd(asked, self._given.shape)}")
        self.check()
        with self._lock:
            if self.reason is not None:
                raise BenchStopped(self.reason)
            if LOOP in self._fed:
                self._fed[LOOP] = self._clock.now()
            now = self._gel_clock.now()
            elapsed, self._applied = min(max(now - self._applied, 0.0), STANDSTILL), now
            if not self.armed or self.waiting_for is not None:
                return np.zeros_like(self._given)
            self._tell(self.limits.allowed(asked, self._given, elapsed))
            if self.reason is not None:
                raise BenchStopped(self.reason)
            return self._given.copy()

    def stop(self, reason: str) -> None:
        """Zero volts at once, until `reset`. The first reason counts."""
        with self._telling:
            first, self.reason = self.reason is None, self.reason or reason
        # Set before the lock is asked for: a thread that waits for a device will not write another voltage after it.
        with self._lock:
            self.armed, self.waiting_for = False, None
            self._zero()
            self.reason = self.reason or reason  # a reset may have come between
        if first:
            self._say(f"stopped: {reason}")

    def close(self) -> None:
        """Zero volts, and let go of the supply."""
        self._off.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            if not self._is_closed:
                self.rest()
                self._is_closed = True
                self._supply.close()

    # -- what it does by itself

    def watch(self) -> None:
        """Look every `LOOK` seconds of real time, in a thread of its own, until closed."""
        self._off.clear()
        self._thread = Thread(target=self._look, name="guard", daemon=True)
        self._thread.start()

    def _look(self) -> None:
        be_in_time()
        while not self._off.wait(LOOK):
            try:
                self.check()
            except Exception as error:  # a guard does not fall asleep over a mistake of its own
                with suppress(Exception):
                    self.stop(f"the guard failed: {error!r}")

    def check(self) -> None:
        """Look once at everything that is watched."""
        with self._lock:
            now = self._clock.now()
            gap, self._checked = now - self._checked, now
            self.checks += 1
            if not self.armed:
                if not self._is_zero and now - self._written > HEARTBEAT:
                    self._zero(is_told=True)
                return
            self.longest_gap = max(self.longest_gap, gap)
            if gap < 0.0:
                self.stop(f"the clock went back by {-gap:.3g} s")
            elif gap > STANDSTILL:
                self.stop(f"the program or its clock stood still for {gap:.3g} s")
            if self.reason is None:
                self._watch(now)
            if self.armed:
                self._count()
                self._keep_alive(now)

    def _watch(self, now: float) -> None:
        silent = {name: now - fed for name, fed in self._fed.items() if now - fed > self._watches[name].limit + EARLY}
        for name, silence in silent.items():
            if silence > self._watches[name].patience:
                self.stop(f"{name} has been silent for {silence:.2g} s")
                return
        waiting = next(iter(silent), None)
        if waiting != self.waiting_for:
            self.waiting_for = waiting
            if waiting is not None:
                self._zero()
                self._say(f"zero volts: waiting for {waiting}")
            else:
                self._say("all is seen again: going on")

    def _count(self) -> None:
        """Add up the charge, and stop when it is used up."""
        self._count_last()
        if self.charge > self.limits.charge:
            self.stop(f"the charge is used up: {self.charge:.3g} C of {self.limits.charge:.3g} C")

    def _keep_alive(self, now: float) -> None:
        if now - self._written > HEARTBEAT:
            self._tell(self._given)
        if self.reason is None and now - self._read >= READ_EVERY:
            self._read = now
            self._compare()

    def _compare(self) -> None:
        """Look whether the supply gives what it was told, and no more current than it may."""
        try:
            reading = self._supply.read()
        except Exception as error:
            self.stop(_words(error))
            return
        if not all(part is None or np.isfinite(part).all() for part in reading):
            self.stop("the supply measures what is no number")
            return
        if self._supply.expired_count > self._expired:
            # It was at zero, and would have gone back to its voltages in one step.
            self.stop("the device's own watchdog had expired: the program stood still")
            return
        self.measured = reading.amperes
        if reading.amperes is not None:
            total = float(np.maximum(reading.amperes, 0.0).sum())
            if total > EXCESS * self.limits.current:
                self.stop(f"the supply measures {total:.3g} A in all; the limit is {self.limits.current:.3g} A")
        if reading.volts is not None and self.reason is None:
            told = self.wiring.to_channels(self._given)
            off = np.abs(reading.volts - told)
            stray = off > ASTRAY + ASTRAY_SHARE * np.abs(told)
            # Once may be a reading between two voltages.
            self._strays = self._strays + 1 if stray.any() else 0
            if self._strays > 1:
                k = int(np.argmax(off))
                self.stop(f"channel {k} has {reading.volts[k]:.3g} V where it was told {told[k]:.3g} V")

    # -- the device

    def _tell(self, voltages: Floats) -> None:
        """Write `voltages` [V], (e,); a supply that fails stops everything. Called with the lock held."""
        self._count()
        if self.reason is not None:
            return
        try:
            self._supply.write(self.wiring.to_channels(voltages))
        except Exception as error:
            self.stop(_words(error))
            return
        self._given, self._written = voltages, self._clock.now()
        self._is_zero = False
        if self._supply.expired_count > self._expired:
            self.stop("the device's own watchdog had expired: the program stood still")
        elif self.reason is not None:  # stopped while the device was written to
            self._zero()

    def _zero(self, is_told: bool = False) -> None:
        """All electrodes at zero volts, or as near to it as the supply can. A device that does not say that it did is
        told again at each look; `is_told`: so is the user."""
        if self._is_closed:
            return
        self._count_last()
        self._given, self._is_zero = np.zeros_like(self._given), False
        volts = self.wiring.to_channels(self._given)
        try:
            self._supply.write(np.clip(volts, self._supply.lowest, self._supply.highest))
            self._is_zero = True
        except Exception as error:
            if not is_told:
                self._say(f"zero volts were not acknowledged, and are asked for again: {_words(error)}")
        self._written = self._clock.now()

    def _count_last(self) -> None:
        """What flowed until now counts, whatever it comes to."""
        now = self._gel_clock.now()
        self.charge += self.limits.total_current(self._given) * max(now - self._counted, 0.0)
        self._counted = now

    def _say(self, text: str) -> None:
        """Tell what happened. Whoever is told may fail; the guard does not."""
        with suppress(Exception):
            self._tell_of(text)


def _words(error: Exception) -> str:
    return str(error) if isinstance(error, GelbotError) else f"the supply failed: {error!r}"


def _odd(asked: Floats, shape: tuple[int, ...]) -> str:
    if asked.shape != shape:
        return f"{asked.size} voltages for {shape[0]} electrodes"
    k = int(np.argmin(np.isfinite(asked)))
    return f"{asked[k]} V on electrode {k}"
