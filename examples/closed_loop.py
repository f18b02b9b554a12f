"""The turn-over in closed loop: gels that are not as their controllers believe, seen late and through noise.

    .venv/bin/python examples/closed_loop.py                            # 20 gels each: four minutes on two cores
    .venv/bin/python examples/closed_loop.py --controllers planned -n 100

Every second gel adsorbs 15 % less than the scenario says, the others 15 % more. The camera is the scenario's: pictures
are 100 ms old, points are off by 0.1 mm, angles by 2 degrees (standard deviations). All voltages pass the guard, as on
the bench.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track

from gelbot.bench import drive
from gelbot.clock import HandClock
from gelbot.engine import keep_compiled, prepare_engine
from gelbot.live.drivers import Predicting
from gelbot.live.ready import PREDICTIVE, Ready, Source, make_ready
from gelbot.plants.build import simulated
from gelbot.scenario.build import Experiment, build
from gelbot.scenario.load import load

OFF = 0.15
OVER, STAYS = -0.8, 5.0
"""On its back: the normal's z is below the first, and stays there for the last so many seconds."""
DURATIONS = {"planned": 30.0, "predictive": 35.0, "programme": 60.0}


class Ended(NamedTuple):
    """How a run ended: `over` since when [s], None where it did not stay; the `charge` [C] that it took."""

    over: float | None
    charge: float


def run(ready: Ready, gel: Experiment, controller: str, seed: int) -> Ended:
    """One gel in closed loop."""
    clock = HandClock()
    bench = simulated(ready.experiment(controller), gel, clock, seed=seed)
    # Without a clock, so that it repeats whatever else the machine does.
    driver = Predicting(ready.experiment(controller), False) if controller == PREDICTIVE else ready.driver(controller)
    bench.plant.guard.arm()
    since, last = None, 0.0
    for tick in drive(bench.plant, driver, clock, tick_period(ready), DURATIONS[controller]):
        last = tick.time
        over = float(bench.gel.seen.normal[2]) < OVER
        since = (tick.time if since is None else since) if over else None
    charge = bench.plant.guard.charge
    bench.plant.guard.close()
    return Ended(since if since is not None and last - since >= STAYS else None, charge)


def tick_period(ready: Ready) -> float:
    """The control period [s]."""
    return ready.nominal.scenario.programme.control_period


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=20, help="gels with each controller (default: 20)")
    parser.add_argument("--controllers", nargs="+", choices=list(DURATIONS), default=list(DURATIONS))
    asked = parser.parse_args()
    prepare_engine()
    keep_compiled()
    ready = make_ready(Source("turn-over"), (), ())
    gels = [
        build(load("turn-over", [f"material.p_ele={0.02 * (1.0 + sign * OFF)!r} cm^2/mA"]).scenario, ready.nominal)
        for sign in (-1.0, 1.0)
    ]
    print("| controller | over, and stays | since, median (range) | charge, median |\n|---|---|---|---|")
    for controller in asked.controllers:
        ended = [
            run(ready, gels[k % 2], controller, k)
            for k in track(range(asked.n), controller, transient=True, console=Console(stderr=True))
        ]
        since = np.array([one.over for one in ended if one.over is not None])
        spread = f"{np.median(since):.1f} s ({since.min():.1f} - {since.max():.1f})" if since.size else "-"
        charge = np.median([one.charge for one in ended])
        print(f"| {controller} | {since.size} of {asked.n} | {spread} | {charge:.1f} C |", flush=True)


if __name__ == "__main__":
    main()
