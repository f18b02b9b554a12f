"""The loop: see, decide, apply, at equal times; on any plant, with any driver, by any clock.

for tick in drive(plant, driver, clock, period=0.1, duration=60.0):
    log.append(tick)
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import Clock
from gelbot.plant import Plant, Sighting
from gelbot.points import Observation

Floats = NDArray[np.float64]
EARLY = 1e-6
"""Times that are added up are off by less than this [s]."""


class Decision(NamedTuple):
    """What a driver wants: `voltages` [V] (e,); and what it says of itself: the number of its `phase`, its `amplitude`
    [V], the `reference` [m] that it follows, NaN where it has none."""

    voltages: Floats
    phase: int
    amplitude: float
    reference: float


class Driver(Protocol):
    """Whoever decides: a person, a programme, a predictive controller."""

    def decide(self, time: float, seen: Observation) -> Decision:
        """The voltages to hold for the next period, `time` [s] after the loop began."""
        ...


class Tick(NamedTuple):
    """One turn of the loop: `number` since it began, `time` [s] since then at which it should have begun.

    `seen`, what was `decided`, what the electrodes were `given` [V] (e,). `jitter`: how much later than it should it
    began, `took`: how long it was busy [s]. `missed`: ticks before this one that were left out, for one before them was
    not over: meanwhile the last voltages were held.
    """

    number: int
    time: float
    seen: Sighting
    decided: Decision
    given: Floats
    jitter: float
    took: float
    missed: int


def drive(
    plant: Plant,
    driver: Driver,
    clock: Clock,
    period: float,
    duration: float = np.inf,
    busy: Clock | None = None,
    begun: float = 0.0,
) -> Iterator[Tick]:
    """Ticks each `period` [s] for `duration` [s]; what comes between two ticks is the caller's.

    A tick that should have begun more than a period ago is left out. `busy`: the clock by which `took` is measured,
    where the loop's own stands still meanwhile. `begun` [s]: how long the driver has driven before. What plant and
    driver raise is not caught: whoever calls this holds the guard.
    """
    busy = clock if busy is None else busy
    start, number, turn = clock.now(), 0, 0
    while turn * period < duration - EARLY:
        due = start + turn * period
        clock.wait_until(due)
        now, began = clock.now(), busy.now()
        missed = max(0, int((now - due + EARLY) / period))
        turn += missed
        time, late = begun + turn * period, max(0.0, now - start - turn * period)
        seen = plant.observe()
        decided = driver.decide(time, seen.observation)
        given = plant.apply(decided.voltages)
        yield Tick(number, time, seen, decided, given, late, busy.now() - began, missed)
        number, turn = number + 1, turn + 1
