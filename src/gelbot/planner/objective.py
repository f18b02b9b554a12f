"""What a candidate programme is worth: what its motion costs, over robots that scatter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gelbot.ensemble import Changes, outcome
from gelbot.errors import BadInput
from gelbot.scenario.load import Loaded
from gelbot.scenario.motions import Motion

MISS = 1000.0
"""What a motion that is not met costs, and as much again for each unit of its shortfall: more than any that is met."""


class Score(NamedTuple):
    """What became of one robot under one candidate: its `cost`, whether the motion was `met`, `time` [s] of the motion,
    `peak` voltage [V], `charge` [C], and what was missing: `shortfall`, `best` value, `reason`."""

    cost: float
    met: bool
    time: float | None
    peak: float
    charge: float
    shortfall: float
    best: float
    reason: str


def score(loaded: Loaded, candidate: Changes, index: int, robot: Changes) -> Score:
    """One run. A candidate that the scenario does not allow is worth nothing, for the reason that it gives."""
    assert loaded.scenario.motion is not None
    try:
        one = outcome(loaded, index, {**candidate, **robot})
    except BadInput as error:
        return Score(10.0 * MISS, False, None, 0.0, 0.0, np.inf, np.nan, str(error))
    assert one.reached is not None
    met = one.reached.met and one.converged
    peak, charge = float(one.summary["peak_voltage_V"]), float(one.summary["charge_C"])
    time = one.reached.times[-1] if met else None
    # A shortfall without bounds, of a run that broke off, counts as a large one.
    shortfall = 0.0 if met else float(min(one.reached.shortfall, 9.0))
    cost = cost_of(loaded.scenario.motion, float(one.summary["simulated_s"]) if time is None else time, charge, peak)
    if not met:
        cost += MISS * (1.0 + shortfall)
    reason = "" if met else one.reached.reason if one.converged else "a step did not converge"
    return Score(cost, met, time, peak, charge, shortfall, one.reached.best, reason)


def cost_of(motion: Motion, time: float, charge: float, peak: float) -> float:
    """The motion's own costs: its weights times `time` [s], `charge` [C] and `peak` [V]."""
    weights = motion.costs
    return weights.time * time + weights.charge * charge + weights.peak_voltage * peak


def total(scores: Sequence[Score]) -> float:
    """What a candidate is worth over its robots: their mean cost, of which those that fail make the most."""
    return float(np.mean([one.cost for one in scores]))


def plain(scores: Sequence[Score]) -> list[list[Any]]:
    """Scores as JSON."""
    return [[None if isinstance(v, float) and not np.isfinite(v) else v for v in one] for one in scores]


def from_plain(rows: list[list[Any]]) -> list[Score]:
    """Scores out of JSON."""
    missing: dict[str, Any] = dict(zip(Score._fields, (0.0, False, None, 0.0, 0.0, np.inf, np.nan, ""), strict=True))
    named: list[dict[str, Any]] = [dict(zip(Score._fields, row, strict=True)) for row in rows]
    return [Score(**{key: missing[key] if value is None else value for key, value in row.items()}) for row in named]
