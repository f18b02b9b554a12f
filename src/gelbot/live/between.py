"""Pictures between two moments: a loop that ticks ten times a second is shown in motion thirty times a second."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelbot.live.moment import Moment

LONGEST = 0.25
"""Moments that lie further apart [s of the wall clock] are shown as they come: nothing moved between them."""
LAG = 1.2
"""How much longer they are on their way than the last moment took to come: one that comes a little late finds them
still moving, not standing."""
SHORTEST = 0.05
"""Moments that come faster [s] are pictures themselves: a session that moves its gel between ticks makes them."""
FAR = 0.5
"""A jump of the gel's time [s] that is no motion but another beginning."""


class Between:
    """Nodes on their way from the last moment to the newest one, which they reach when the next may be expected."""

    def __init__(self) -> None:
        self._last: NDArray[np.float64] | None = None
        self._newest: Moment | None = None
        self._came = self._takes = 0.0

    def positions(self, moment: Moment, now: float) -> NDArray[np.float64]:
        """The nodes (3, n) [m] to show at `now` [s of the wall clock], when `moment` is the newest."""
        before = self._newest
        if before is not moment:
            self._last = None
            if before is not None and before.positions.shape == moment.positions.shape:
                lasted, passed = now - self._came, moment.time - before.time
                if SHORTEST <= lasted <= LONGEST and 0.0 < passed < FAR:
                    self._last, self._takes = self._shown(before, now), lasted
            self._newest, self._came = moment, now
        return self._shown(moment, now)

    def _shown(self, moment: Moment, now: float) -> NDArray[np.float64]:
        if self._last is None:
            return moment.positions
        share = (now - self._came) / (LAG * max(self._takes, 1e-3))
        return moment.positions if share >= 1.0 else self._last + share * (moment.positions - self._last)
