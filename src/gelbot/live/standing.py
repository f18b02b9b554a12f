"""What stands on the bench and who drives it, and how that looks from the page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelbot.bench import Decision, Driver, Tick
from gelbot.hardware.guard import Guard
from gelbot.live.drivers import ByHand, Programmed
from gelbot.live.moment import Seen, Stage
from gelbot.live.ready import Ready
from gelbot.live.twin import Twin
from gelbot.points import Observation

Floats = NDArray[np.float64]


class Helm:
    """Where a driver sits: it may change while the loop turns, and each counts the time from where it sat down."""

    def __init__(self, name: str, driver: Driver) -> None:
        self.name, self.driver = name, driver
        self._since: float | None = None

    def decide(self, time: float, seen: Observation) -> Decision:
        """What the driver that sits here wants."""
        if self._since is None:
            self._since = time
        return self.driver.decide(time - self._since, seen)

    def reference(self, tick: Tick | None) -> float:
        """The height [m] that the driver follows, NaN where there is none: what was set by hand, else that of
        `tick`."""
        by_hand = self.driver.reference if isinstance(self.driver, Programmed) else None
        if by_hand is not None:
            return by_hand
        return np.nan if tick is None else tick.decided.reference

    def asked(self, tick: Tick | None, count: int) -> Floats:
        """The voltages [V] (e,) that the driver wants; by hand they are known before a `tick` has carried them out."""
        if isinstance(self.driver, ByHand):
            return self.driver.voltages
        return np.zeros(count) if tick is None else tick.decided.voltages


@dataclass(frozen=True)
class Standing:
    """What stands: a scenario, the simulator beside it, what the page shows of both, and the guard over it."""

    ready: Ready
    twin: Twin
    stage: Stage
    guard: Guard

    @property
    def count(self) -> int:
        """How many electrodes there are."""
        return self.ready.nominal.array.count

    @property
    def period(self) -> float:
        """The control period [s]."""
        return self.ready.nominal.scenario.programme.control_period

    def given(self, tick: Tick | None) -> Floats:
        """The voltages [V] (e,) on the electrodes: of a recording, over which no guard stands, those of `tick`."""
        given = self.guard.given
        if len(given) == self.count:
            return given
        return tick.given if tick is not None and len(tick.given) == self.count else np.zeros(self.count)

    def currents(self, given: Floats) -> Floats:
        """The currents [A] (e,) from the electrodes into the tank, as the conductances give them."""
        return self.ready.nominal.field.conductance @ (self.ready.nominal.connection @ given)

    def phase(self, helm: Helm, tick: Tick | None) -> str:
        """The name of the phase in which the driver was at `tick`."""
        if tick is None or helm.name not in self.ready.controllers:
            return ""
        phases = self.ready.phases(helm.name)
        return phases[min(tick.decided.phase, len(phases) - 1)]


def seen_at(tick: Tick) -> Seen:
    """What was seen of the plant, for the page."""
    seen = tick.seen.observation
    centre, tips, normal = (np.asarray(part, np.float64) for part in (seen.centre, seen.tips, seen.normal))
    return Seen(centre, tips, normal, tick.seen.confidence)
