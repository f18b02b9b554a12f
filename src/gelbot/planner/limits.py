"""What limits a motion: what can be said before any run, and what the best of many runs came up against."""

from __future__ import annotations

import numpy as np

from gelbot.motion.reach import worded
from gelbot.planner.search import Candidate, Search
from gelbot.scenario.load import Loaded
from gelbot.units import shown

AT_BOUND = 0.02
"""A choice this near to the end of its range would go beyond it."""


def impossible(loaded: Loaded) -> str:
    """Why no programme at all can meet the motion, in words; empty when nothing speaks against it.

    The centre of a body that stands on its tips is no higher than the longest way from it to its outline; a body that
    is carried beyond the electrodes is no longer in their field.
    """
    scenario = loaded.scenario
    assert scenario.motion is not None
    outline = scenario.body.outline()
    arm = outline.reach + scenario.body.thickness
    electrodes = scenario.electrodes.array.electrodes
    low, high = (
        reach([electrode.bounds[k] for electrode in electrodes], axis=0) for k, reach in ((0, np.min), (1, np.max))
    )
    for number, goal in enumerate(scenario.motion.goals):
        said = f"goal {number + 1} ({worded(goal)})"
        ceiling = float(low[2])
        least = -np.inf if goal.at_least is None else goal.at_least
        if goal.quantity == "height" and goal.point == 0 and least > min(arm, ceiling):
            if arm <= ceiling:
                return f"{said}: the body reaches {shown(arm, 'm')} from its centre, and no programme makes it longer"
            return f"{said}: the electrodes hang at {shown(ceiling, 'm')}"
        if goal.quantity == "normal" and (least > 1.0 or (goal.at_most is not None and goal.at_most < -1.0)):
            return f"{said}: a unit vector's z is between -1 and 1"
        if goal.quantity in ("along", "across"):
            way = scenario.motion.way(goal)
            most = -np.inf if goal.at_most is None else goal.at_most
            for distance in (least if np.isfinite(least) else 0.0, most if np.isfinite(most) and most < 0.0 else 0.0):
                place = np.array(scenario.body.pose.position) + distance * way
                if np.any(place < low[:2] - outline.reach) or np.any(place > high[:2] + outline.reach):
                    x, y = (shown(float(value), "m") for value in place)
                    return f"{said}: ({x}, {y}) is outside the array's reach: there is no field there"
    return ""


def limited_by(search: Search, best: Candidate) -> list[str]:
    """What the best candidate came up against, in words."""
    said, at = [], 0
    for one in search.choices:
        shares = best.shares[at : at + one.size]
        at += one.size
        beyond = (("low", shares < AT_BOUND), ("high", shares > 1.0 - AT_BOUND))
        ends = [word for word, found in beyond if found.any()]
        if ends and "|" not in one.text:
            said.append(f"{one.key} is at the {' and the '.join(ends)} end of its range {one.text}")
    limit = search.loaded.scenario.supply.limit
    if max(one.peak for one in best.scores) > 0.999 * limit:
        said.append(f"the voltage is at supply.limit = {shown(limit, 'V')}")
    reasons = sorted({one.reason for one in best.scores if not one.met})
    return said + reasons[:3]
