"""Who drives a robot: the same scenario under different controllers, to be compared on the same robots.

template     open loop: the voltages and switch times that the scenario's own programme had on its nominal robot
servo        the scenario's own programme: Section IV-E, the servo with its events
planned      a programme that was planned for the scenario (`gelbot plan`), from a file or as it comes with gelbot
predictive   the planned programme, whose phases begin when a twin of the robot says that they should
"""

from __future__ import annotations

import time as clock
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gelbot.body.symmetry import symmetry_group
from gelbot.controllers.predictive import march_predictive
from gelbot.ensemble import Changes, Outcome, judged, nominal_experiment, numbered_experiment, outcome, programs_of
from gelbot.errors import BadInput
from gelbot.plan.directions import directions, find_tips
from gelbot.scenario.load import Loaded, checked
from gelbot.scenario.overrides import with_changes
from gelbot.units import quantity

CONTROLLERS = ("template", "servo", "planned", "predictive")
SAMPLES = 0.5
"""Voltages of a nominal run are kept this often [s], straight lines between."""


def with_controller(
    loaded: Loaded, controller: str, programme: Path | None = None, direction: str | None = None
) -> Loaded:
    """`loaded` with the programme of `controller`; `programme` is the file of a planned one.

    A planned one goes in the `direction` of the body that is nearest to this angle, such as "90 deg"; None: as it was
    planned. Raises `BadInput` for a controller that does not exist, and for a scenario for which nothing was planned.
    """
    if controller not in CONTROLLERS:
        raise BadInput("--controller", controller, "one of " + ", ".join(CONTROLLERS))
    if controller == "template":
        return with_programme(loaded, _open_loop(loaded))
    if controller not in ("planned", "predictive"):
        return loaded
    if direction is None:
        return with_programme(loaded, planned(loaded, programme)["programme"])
    return _directed(loaded, programme, direction)


def with_programme(loaded: Loaded, programme: dict[str, Any], motion: dict[str, Any] | None = None) -> Loaded:
    """`loaded` with another [programme], given as parsed TOML, and another [motion] where there is one."""
    changes = [(["programme"], programme), *([] if motion is None else [(["motion"], motion)])]
    text = with_changes(loaded.text, changes)
    return Loaded(checked(tomllib.loads(text), loaded.source), text, loaded.source)


def _directed(loaded: Loaded, programme: Path | None, direction: str) -> Loaded:
    """A planned programme in the direction of the body that is nearest to `direction`.

    Over one tip and over two are different motions, and have programmes of their own. The programme tells by its
    [motion] which way it goes; it is turned from there, see `plan.carry`.
    """
    body = loaded.scenario.body
    outline, asked = body.outline(), quantity(direction, "rad", "--direction")
    group = symmetry_group(outline)
    ways = directions(find_tips(outline, group), group)
    nearest = min(ways, key=lambda way: abs(_between(way.angle + body.pose.heading, asked)))
    angle = nearest.angle + body.pose.heading
    file = planned(loaded, programme, KINDS[len(nearest.over)])
    motion = file.get("motion")
    if not isinstance(motion, dict) or "direction" not in motion:
        raise BadInput("--direction", direction, "only with a programme whose file has a [motion] with its direction")
    own = quantity(motion["direction"], "rad", "motion.direction")
    turn = _between(angle, own)
    turned = {**file["programme"], "turn": f"{np.degrees(turn):.9g} deg"} if abs(turn) > 1e-6 else file["programme"]
    return with_programme(loaded, turned, {**motion, "direction": f"{np.degrees(angle) % 360.0:.9g} deg"})


KINDS = {1: "over-one", 2: "over-two"}
"""What the file of a programme is called by the number of tips over which the body turns."""


def _between(angle: float, other: float) -> float:
    """angle - other [rad], in [-pi, pi)."""
    return float((angle - other + np.pi) % (2.0 * np.pi) - np.pi)


def planned(loaded: Loaded, programme: Path | None, kind: str | None = None) -> dict[str, Any]:
    """What stands in the programme file, or in the one of this `kind` that comes with gelbot for the scenario: a table
    [programme], and the [motion] for which it was planned."""
    if programme is None:
        name = loaded.scenario.name if kind is None else f"{loaded.scenario.name}.{kind}"
        found = files("gelbot.scenario") / "library" / "programmes" / f"{name}.toml"
        if not found.is_file():
            allowed = f"a scenario with a planned programme, or the file of one; there is none for {name}"
            raise BadInput("--controller", "planned", allowed, f"gelbot plan {loaded.source}, then --programme FILE")
        text, place = found.read_text(encoding="utf-8"), found.name
    else:
        text, place = _text_of(programme), str(programme)
    try:
        file = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(place, str(error), "TOML with a table [programme]") from error
    if not isinstance(file.get("programme"), dict):
        raise BadInput(place, "no table [programme]", "a programme file of gelbot plan, or a scenario")
    return file


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise BadInput("--programme", str(path), f"a programme file that can be read ({reason})") from error


def _open_loop(loaded: Loaded) -> dict[str, Any]:
    """What the scenario's programme does to its nominal robot, without looking at it: "desired trajectory and nominal
    input electric fields were generated simultaneously" (Section IV-D)."""
    nominal = outcome(loaded, 0, {})
    time, phase = nominal.frames["time"].values, nominal.frames["phase"].values
    amplitude = nominal.frames["amplitude"].values
    data = tomllib.loads(loaded.text)["programme"]
    period = loaded.scenario.programme.control_period
    phases = []
    # Frames are at the ends of control periods.
    starts = [0, *(np.flatnonzero(np.diff(phase)) + 1)]
    for number, start in enumerate(starts):
        end = starts[number + 1] if number + 1 < len(starts) else len(time)
        own = data["phases"][int(phase[start])]
        places = np.unique([*range(start, end, max(1, round(SAMPLES / period))), end - 1])
        ages = (places - start) * period
        volts = amplitude[places]
        replayed = {
            "name": f"{own['name']}" if number == int(phase[start]) else f"{own['name']} {number + 1}",
            "pattern": own["pattern"],
            "drive": [[f"{age:.6g} s", f"{float(volt)!r} V"] for age, volt in zip(ages, volts, strict=True)],
        }
        if len(places) == 1:
            replayed["drive"] = f"{float(volts[0])!r} V"
        if number + 1 < len(starts):
            replayed["until"] = {"after": f"{(end - start) * period:.6g} s"}
        phases.append(replayed)
    kept = {key: data[key] for key in ("control_period", "place") if key in data}
    return {**kept, "phases": phases}


def outcome_with(controller: str, loaded: Loaded, index: int, robot: Changes) -> Outcome:
    """The run of one robot under `controller`, for which `loaded` has been prepared by `with_controller`."""
    if controller == "predictive":
        return _predicted(loaded, index, robot)
    return outcome(loaded, index, robot)


def _predicted(loaded: Loaded, index: int, robot: Changes) -> Outcome:
    experiment, frames = numbered_experiment(loaded, index, robot), []
    began, late = clock.perf_counter(), 0
    for frame, controller in march_predictive(experiment, nominal_experiment(loaded), programs_of(loaded)):
        frames.append(jax.tree.map(np.asarray, frame))
        late = controller.late
        if not np.isfinite(frames[-1].positions).all():
            break
    stacked = jax.tree.map(lambda *parts: np.stack(parts), *frames)
    times = {"wall_s": clock.perf_counter() - began, "compile_s": 0.0}
    one = judged(experiment, index, stacked, times)
    return one._replace(summary={**one.summary, "late_ticks": late})
