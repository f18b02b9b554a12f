"""How far a run came towards its motion's goals: when each was reached, or what was missing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.motion.wrap import wrapped
from gelbot.scenario.load import Loaded
from gelbot.scenario.motions import UNITS, Goal, Motion
from gelbot.scenario.schema import Scenario
from gelbot.units import shown

Floats = NDArray[np.float64]

SCALES = {"m": 1e-3, "rad": np.radians(30.0), "": 0.5}
"""Shortfalls of different units are added up: this much of each counts as one."""


def check_has_motion(loaded: Loaded, use: str = "") -> None:
    """Raise `BadInput` for a scenario that does not say what shall happen; `use` says what that is needed for."""
    if loaded.scenario.motion is None:
        allowed = f"a table [motion] that says what shall happen{use}"
        raise BadInput(f"{loaded.source}: motion", "nothing", allowed, "gelbot show turn-over")


class Reached(NamedTuple):
    """`times` [s] at which the goals were reached, as many as were; the whole motion is `met` when all are.

    `shortfall`: what is missing at best, in units of `SCALES`, 0 when met; `reason`: the first goal that was not
    reached, in words, empty when met; `best`: the nearest value that came to it, NaN when met.
    """

    met: bool
    times: tuple[float, ...]
    shortfall: float
    reason: str
    best: float


class Seen(NamedTuple):
    """What goals are judged by, at k frames: `centre` [m] (k, 3), `normal` (k, 3), `tips` [m] (k, 3, a) and
    `tip_angles` [rad] (k, a), as `points.Observation` has them; `wrap` [rad] (k,), where it was computed."""

    centre: Floats
    normal: Floats
    tips: Floats
    tip_angles: Floats
    wrap: Floats | None = None


def seen_in(run: xr.Dataset, scenario: Scenario) -> Seen:
    """The frames of a run's data set; positions of nodes are needed only where a goal is about wrap."""
    assert scenario.motion is not None
    wraps = any(goal.quantity == "wrap" for goal in scenario.motion.goals)
    names = ("centre", "normal", "tip_position", "tip_angle")
    centre, normal, tips, angles = (_values(run, name) for name in names)
    return Seen(centre, normal, tips, angles, wrapped(run, scenario) if wraps else None)


def quantity_of(goal: Goal, seen: Seen, scenario: Scenario, start: Floats) -> Floats:
    """The goal's quantity at all frames, shape (k,); `start` [m], (2, 1 + a), is where centre and tips began.

    Arrays of the engine give one of the engine, which can be differentiated.
    """
    if goal.quantity == "normal":
        return seen.normal[:, 2]
    if goal.quantity == "tip_angle":
        return seen.tip_angles.max(axis=1)
    if goal.quantity == "wrap":
        return np.full(len(seen.centre), np.nan) if seen.wrap is None else seen.wrap
    if goal.point > seen.tips.shape[2]:
        return np.full(len(seen.centre), np.nan)
    place = seen.centre if goal.point == 0 else seen.tips[:, :, goal.point - 1]
    if goal.quantity == "height":
        return place[:, 2]
    assert scenario.motion is not None
    return (place[:, :2] - start[:, goal.point]) @ scenario.motion.way(goal)


def misses(scenario: Scenario, seen: Seen, start: Floats) -> list[Floats]:
    """How far each goal is missed at all frames, shape (k,) each, in units of `SCALES`."""
    assert scenario.motion is not None
    return [_miss(goal, quantity_of(goal, seen, scenario, start)) for goal in scenario.motion.goals]


def _start(run: xr.Dataset) -> Floats:
    """Where centre and tips were at the start [m], (2, 1 + a): as the static part knows it, or the first frame."""
    if "start_point" in run:
        return run["start_point"].transpose("space", "point").values[:2]
    return np.concatenate([_values(run, "centre")[0, :2, None], _values(run, "tip_position")[0, :2]], axis=1)


def reach(run: xr.Dataset, scenario: Scenario) -> Reached:
    """How far `run` came. Needs the positions only for goals that are of the whole body (wrap).

    A goal is reached at the first time from which on its quantity keeps within its bounds for `lasting` [s]; it counts
    from when the goal before it has lasted. Of all such sequences the one with the least shortfall is taken, by
    dynamic programming over the frames, and of equals the earliest.
    """
    assert scenario.motion is not None
    if run.sizes.get("time", 0) == 0:
        return unreached("the run has no frames")
    goals, time = scenario.motion.goals, _values(run, "time")
    count = len(time)
    step = float(time[0]) if count == 1 else float(time[1] - time[0])
    seen, start = seen_in(run, scenario), _start(run)
    values = [quantity_of(goal, seen, scenario, start) for goal in goals]
    best, chosen, missed = _sequence(goals, values, step)
    return _told(goals, values, time, step, (best, chosen, missed))


def unreached(reason: str) -> Reached:
    """Of a run that tells nothing, for this `reason`."""
    return Reached(False, (), float("inf"), reason, float("nan"))


def _frames(goal: Goal, step: float) -> int:
    """For how many frames, `step` [s] apart, a goal has to hold."""
    return max(1, round((goal.lasting or 0.0) / step))


def windows(scenario: Scenario, values: list[Floats], step: float) -> list[slice]:
    """The frames, `step` [s] apart, in which each goal would best be reached, by the `values` of its quantity there."""
    assert scenario.motion is not None
    goals, count = scenario.motion.goals, len(values[0])
    _, chosen, _ = _sequence(goals, values, step)
    at, found = count, []
    for goal, began in zip(reversed(goals), reversed(chosen), strict=True):
        first = max(0, int(began[at]))
        last = count if goal.to_the_end else first + _frames(goal, step)
        found.append(slice(first, min(last, count)))
        at = first
    return found[::-1]


def _sequence(goals: tuple[Goal, ...], values: list[Floats], step: float) -> tuple[Floats, list[Any], list[Floats]]:
    """By how much all goals are missed at best when the last one is over by a frame, (k + 1,); for each goal when it
    then began, (k + 1,), and how far it is missed from each frame on, (k,)."""
    count = len(values[0])
    # best[k]: least sum of the goals so far, the last of which has lasted by frame k; chosen: when it began.
    best, chosen, missed = np.zeros(count + 1), [], []
    for goal, value in zip(goals, values, strict=True):
        miss = _miss(goal, value)
        frames = _frames(goal, step)
        if goal.to_the_end:
            worst = np.maximum.accumulate(miss[::-1])[::-1]
            worst[max(0, count - frames + 1) :] = np.inf
            ends = np.full(count, count)
        else:
            worst = _worst_within(miss, frames)
            ends = np.minimum(np.arange(count) + frames, count)
        total = best[:count] + worst
        # The earliest of the best beginnings whose window ends by frame k.
        later, began = np.full(count + 1, np.inf), np.full(count + 1, -1)
        for k in range(count):
            if total[k] < later[ends[k]]:
                later[ends[k]], began[ends[k]] = total[k], k
        for k in range(1, count + 1):
            if later[k - 1] <= later[k]:
                later[k], began[k] = later[k - 1], began[k - 1]
        best = later
        chosen.append(began)
        missed.append(worst)
    return best, chosen, missed


def _told(
    goals: tuple[Goal, ...],
    values: list[Floats],
    time: Floats,
    step: float,
    found: tuple[Floats, list[Any], list[Floats]],
) -> Reached:
    """The sequence that was `found` (see `_sequence`), in words."""
    best, chosen, missed = found
    for number, (goal, value, began) in enumerate(zip(goals, values, chosen, strict=True), 1):
        if began[-1] < 0:
            broke_off = not np.isfinite(value[-1])
            reason = f"goal {number} ({worded(goal)}) " + ("not met: broke off" if broke_off else "needs a longer run")
            return unreached(reason)
    at, begins = len(time), []
    for began in reversed(chosen):
        begins.append(int(began[at]))
        at = begins[-1]
    begins.reverse()
    shortfall = float(best[-1])
    for index, (goal, begin, miss) in enumerate(zip(goals, begins, missed, strict=True)):
        if miss[begin] > 0.0:
            # A goal counts from when the one before it has lasted; of a run that ends with it, its last frame.
            over = begins[index - 1] + _frames(goals[index - 1], step) if index else 0
            since = values[index][min(over, len(time) - 1) :]
            short = _miss(goal, since)
            nearest = float(since[int(np.argmin(short))])
            unit = UNITS[goal.quantity]
            said = shown(nearest, unit) if unit else f"{nearest:.3g}"
            kept = " (reached, but not kept)" if short.min() <= 0.0 else ""
            reason = f"goal {index + 1} ({worded(goal)}) not met: nearest {said}{kept}"
            return Reached(False, tuple(float(time[b]) for b in begins[:index]), shortfall, reason, nearest)
    return Reached(True, tuple(float(time[b]) for b in begins), 0.0, "", float("nan"))


def told(found: Reached, motion: Motion) -> dict[str, Any]:
    """How far a run came, as plain values: `met`, the `goals` in words with when each was reached, and the `reason`."""
    times = [*found.times, *([None] * (len(motion.goals) - len(found.times)))]
    goals = [{"goal": worded(goal), "reached_s": time} for goal, time in zip(motion.goals, times, strict=True)]
    return {"met": found.met, "goals": goals, "reason": found.reason}


def worded(goal: Goal) -> str:
    """A goal in words: "height at least 3 mm for 20 s"."""
    unit = UNITS[goal.quantity]

    def value(bound: float) -> str:
        return shown(bound, unit) if unit else f"{bound:g}"

    name = goal.quantity if goal.point == 0 else f"{goal.quantity} of tip {goal.point}"
    low = "" if goal.at_least is None else f" at least {value(goal.at_least)}"
    high = "" if goal.at_most is None else f" at most {value(goal.at_most)}"
    lasting = "" if goal.lasting is None else f" for {goal.lasting:g} s"
    return f"{name}{low}{' and' if low and high else ''}{high}{lasting}{', to the end' if goal.to_the_end else ''}"


def outside(goal: Goal, values: Any) -> Any:
    """How far `values` are outside the goal's bounds, in units of `SCALES`; the engine's arrays give one of its own."""
    low = -np.inf if goal.at_least is None else goal.at_least
    high = np.inf if goal.at_most is None else goal.at_most
    return ((low - values).clip(0.0) + (values - high).clip(0.0)) / SCALES[UNITS[goal.quantity]]


def _miss(goal: Goal, values: Floats) -> Floats:
    """How far `values` are `outside`; infinite where they are not finite."""
    return np.where(np.isfinite(values), outside(goal, values), np.inf)


def _worst_within(miss: Floats, frames: int) -> Floats:
    """The largest of `miss` from each frame on, over so many `frames`; infinite where the run ends before."""
    if frames > len(miss):
        return np.full(len(miss), np.inf)
    windows = np.lib.stride_tricks.sliding_window_view(miss, frames).max(axis=1)
    return np.concatenate([windows, np.full(frames - 1, np.inf)])


def _values(run: xr.Dataset, name: str) -> NDArray[Any]:
    return run[name].transpose("time", ...).values
