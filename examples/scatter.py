"""How sure is a motion when neither the robot's place nor its material is known exactly? Scatters a scenario's start.

    .venv/bin/python examples/scatter.py            # turn-over, 20 robots, up to 0.5 mm and 3 degrees
    .venv/bin/python examples/scatter.py --runs 100 --p-ele 0.15
    .venv/bin/python examples/scatter.py --runs 50 --set material.p_ele="0.017 cm^2/mA"

Each robot's outcome is a line; the last one counts who turned over, and who also stayed so for 10 s.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from gelbot.ensemble import Outcome, march_all, scattered
from gelbot.errors import GelbotError
from gelbot.scenario import load

STAYS = 10.0
"""It stays over when it does so for this long [s] at the end of the run."""


def line(one: Outcome) -> str:
    """What became of one robot, in words."""
    switch, height, transition = (
        np.nan if one.summary[key] is None else one.summary[key]
        for key in ("t_switch_s", "z_switch_mm", "t_transition_s")
    )
    return (
        f"{one.robot + 1:4d}   switch {switch:5.1f} s at {height:.2f} mm   transition {transition:5.1f} s   "
        f"stayed {one.summary['stayed_over_s']:5.1f} s" + ("" if one.converged else "   NOT CONVERGED")
    )


def study(
    scenario: str,
    changes: list[str],
    runs: int,
    shift_mm: float = 0.0,
    turn_deg: float = 0.0,
    p_ele: float = 0.0,
    seed: int = 1,
    processes: int | None = None,
) -> list[Outcome]:
    """The outcomes of `runs` robots, uniform within `shift_mm` in x and y, `turn_deg` and `p_ele`; prints each."""
    robots = scattered(runs, seed, shift_mm * 1e-3, np.radians(turn_deg), p_ele)
    found = []
    for one in march_all(load(scenario, changes), robots, processes):
        found.append(one)
        print(line(one), flush=True)
    return sorted(found)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="turn-over")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--shift", type=float, default=0.5, help="largest shift in x and in y [mm]")
    parser.add_argument("--turn", type=float, default=3.0, help="largest turn [deg]")
    parser.add_argument("--p-ele", type=float, default=0.0, help="largest relative change of p_ele")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, help="how many at once; as many as the machine has cores if left out")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    try:
        found = study(
            given.scenario, given.set, given.runs, given.shift, given.turn, given.p_ele, given.seed, given.processes
        )
    except GelbotError as error:
        sys.exit(f"scatter.py: {error}")
    over = sum(one.summary["t_transition_s"] is not None for one in found)
    stays = sum(one.summary["stayed_over_s"] >= STAYS for one in found)
    print(f"turned over: {over} of {len(found)}; turned over and stayed so for {STAYS:.0f} s: {stays} of {len(found)}")
