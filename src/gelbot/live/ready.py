"""What a scenario is made ready into before anything moves: experiments, who can drive, what the page shows of it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.bench import Driver
from gelbot.controllers.choice import planned, with_controller
from gelbot.errors import BadInput
from gelbot.field.electrodes import THIN, Electrode
from gelbot.field.outlines import outlines
from gelbot.hardware.habits import Habits
from gelbot.live.drivers import ByHand, Predicting, Programmed, lifting
from gelbot.live.moment import Stage
from gelbot.plan.templates import TEMPLATES
from gelbot.points import Observation
from gelbot.scenario.build import Experiment, build
from gelbot.scenario.load import Loaded, checked, load
from gelbot.scenario.obstacle_surfaces import obstacle_triangles
from gelbot.scenario.overrides import override_keys, with_overrides

DRIVERS = HAND, PROGRAMME, SERVO, PLANNED, PREDICTIVE = "by hand", "programme", "servo", "planned", "predictive"
"""Who can drive. The servo lifts the gel with the first phase's pattern, to a height that can be dragged."""
RECORDED = "recording"
"""Who drives where a recording is played."""
OFFERED = ("body", "electrodes", "material", "solution")
"""The tables of a scenario whose single values the page offers to change."""
WARMING = 3
"""Ticks of a driver that compile all that it needs."""


class Source(NamedTuple):
    """Where a scenario comes from: the `name` of a built-in one or a file; or its own `text`, and the name is whose."""

    name: str
    text: str | None = None

    def load(self, changes: Sequence[str]) -> Loaded:
        """The scenario with `changes` (key=value). Raises `BadInput`."""
        if self.text is None:
            return load(self.name, changes)
        text = with_overrides(self.text, changes)
        return Loaded(checked(tomllib.loads(text), self.name, overridden=override_keys(changes)), text, self.name)


@dataclass
class Ready:
    """A scenario made ready: `nominal` is what the controllers know, `real` the simulated gel, which may differ.

    `changes`: what was changed of the scenario since it was chosen. `habits`: how the body usually looks, for a camera,
    None before they are needed.
    """

    source: Source
    changes: tuple[str, ...]
    loaded: Loaded
    nominal: Experiment
    real: Experiment
    controllers: tuple[str, ...]
    programmes: dict[str, Experiment] = field(default_factory=dict)
    habits: Habits | None = None

    def driver(self, name: str) -> Driver:
        """A driver at its beginning. Raises `BadInput` for one that this scenario does not have."""
        if name == HAND:
            return ByHand(self.nominal.array.count)
        if name not in self.controllers:
            raise BadInput("controller", name, "one of " + ", ".join(self.controllers))
        if name == SERVO:
            return Programmed(lifting(self.nominal.programme))
        experiment = self.experiment(name)
        return Predicting(experiment) if name == PREDICTIVE else Programmed(experiment.programme)

    def experiment(self, name: str) -> Experiment:
        """The experiment with the programme of the driver `name`."""
        if name in (HAND, PROGRAMME, SERVO):
            return self.nominal
        if PLANNED not in self.programmes:
            self.programmes[PLANNED] = build(with_controller(self.loaded, "planned").scenario, self.nominal)
        return self.programmes[PLANNED]

    def phases(self, name: str) -> list[str]:
        """The names of the driver's phases."""
        if name == HAND:
            return [""]
        phases = [phase.name for phase in self.experiment(name).scenario.programme.phases]
        return phases[:1] if name == SERVO else phases

    def warm(self, name: str, seen: Observation) -> None:
        """Compile all that a driver needs: its first tick must take no longer than any other."""
        driver, period = self.driver(name), self.nominal.scenario.programme.control_period
        for k in range(WARMING):
            driver.decide(k * period, seen)


def make_ready(source: Source, changes: Sequence[str], real: Sequence[str], base: Ready | None = None) -> Ready:
    """The scenario `source` with its `changes` (key=value), and the real gel that differs from it by `real`.

    What it has in common with `base` is taken from there. Raises `BadInput`.
    """
    loaded = source.load(changes)
    others = source.load([*changes, *real]) if real else loaded
    try:
        nominal = build(loaded.scenario, None if base is None else base.nominal)
        gel = build(others.scenario, nominal) if real else nominal
    except BadInput as error:
        raise error.inside(loaded.source) from error
    controllers = [HAND, PROGRAMME]
    if loaded.scenario.programme.servo is not None:
        controllers.append(SERVO)
    if _was_planned(loaded):
        controllers += [PLANNED] if loaded.scenario.motion is None else [PLANNED, PREDICTIVE]
    return Ready(source, tuple(changes), loaded, nominal, gel, tuple(controllers))


def _was_planned(loaded: Loaded) -> bool:
    try:
        planned(loaded, None)
    except BadInput:
        return False
    return True


def stage_of(ready: Ready, plant: str, has_camera: bool, is_real: bool, drivers: tuple[str, ...]) -> Stage:
    """What the page shows of it, and of its `plant`; `drivers` may be chosen."""
    experiment = ready.nominal
    scenario = experiment.scenario
    corners = outlines(experiment.array)
    return Stage(
        name=scenario.name,
        description=" ".join(scenario.description.split()),
        faces=np.asarray(experiment.body.faces),
        rest=np.asarray(experiment.state.positions, np.float64),
        outlines=tuple(_rim(e, corners[:, :, k]) for k, e in enumerate(experiment.array.electrodes)),
        electrode_names=tuple(electrode.name for electrode in experiment.array.electrodes),
        limit=scenario.supply.limit,
        floor_depth=scenario.tank.floor_depth,
        obstacles=np.asarray(obstacle_triangles(scenario.obstacles)).transpose(2, 1, 0),
        patterns=tuple(name for name in TEMPLATES if name != "off"),
        controllers=drivers,
        plant=plant,
        has_camera=has_camera,
        control_period=scenario.programme.control_period,
        settings=settings_of(ready.loaded.text),
        water_height=np.nan if scenario.tank.depth is None else scenario.tank.depth,
        is_real=is_real,
    )


def _rim(electrode: Electrode, corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """The corners (3, k) of an electrode's rim, without a hole; of a rod or a block those of its lower end."""
    corners = corners[:, : np.argmax(~np.isfinite(corners[0])) or None]
    return corners if isinstance(electrode.shape, THIN) else corners[:, : corners.shape[1] // 2]


def settings_of(text: str) -> dict[str, str]:
    """The single values of a scenario's tables that the page offers to change, by key, as the file writes them."""
    data, found = tomllib.loads(text), {}
    for table in OFFERED:
        found.update(_values(table, data[table]))
    return found


def _values(key: str, value: Any) -> dict[str, str]:
    if isinstance(value, Mapping):
        return {k: v for name, part in value.items() for k, v in _values(f"{key}.{name}", part).items()}
    if isinstance(value, bool):
        return {key: str(value).lower()}
    if isinstance(value, str | int | float):
        return {key: str(value)}
    if isinstance(value, list) and len(value) <= 3 and all(isinstance(part, str) for part in value):
        return {key: "[" + ", ".join(f'"{part}"' for part in value) + "]"}
    return {}
