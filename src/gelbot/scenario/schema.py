"""What a scenario is: the tables of its file, each value in SI, every check on them.

Checks of one value stand at the value (`fields`), checks within a table in that table (`bodies`, `tables`,
`programmes`), checks among tables here (`placement`).
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from gelbot.scenario.bench import Camera, Supply
from gelbot.scenario.bodies import Body
from gelbot.scenario.electrodes import Electrodes
from gelbot.scenario.fields import Table, check_multiples, wrong
from gelbot.scenario.motions import Motion
from gelbot.scenario.obstacle_shapes import AnyObstacle, CylinderObstacle
from gelbot.scenario.placement import check_gel_is_clear, check_reach, check_tank, check_voltages
from gelbot.scenario.programmes import Programme
from gelbot.scenario.ranges import Scatter
from gelbot.scenario.tables import Material, Recording, Simulation, Solution, Tank


class Scenario(Table):
    """One experiment: what is moved, where, by what, and how it is computed and recorded."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$")]
    description: str
    body: Body
    material: Material
    solution: Solution
    electrodes: Electrodes
    tank: Tank
    obstacles: tuple[AnyObstacle, ...] = ()
    supply: Supply
    camera: Camera = Camera()
    programme: Programme
    motion: Motion | None = None
    scatter: Scatter = Field(default_factory=dict)
    search: Scatter = Field(default_factory=dict)
    simulation: Simulation
    recording: Recording

    @property
    def place(self) -> tuple[float, float]:
        """Where in x and y [m] the programme is meant to be done, and around which the field is tabulated."""
        return self.body.pose.position if self.programme.place is None else self.programme.place

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        self._check_times()
        self._check_wrap()
        self.supply.check_channels(self.electrodes.array.count)
        check_tank(self.electrodes, self.tank)
        check_gel_is_clear(self.body, self.electrodes)
        check_reach(self.body, self.electrodes, self.tank)
        check_voltages(self.programme, self.electrodes, self.supply)
        return self

    def _check_times(self) -> None:
        times = {
            "simulation.time_step": self.simulation.time_step,
            "programme.control_period": self.programme.control_period,
            "recording.interval": self.recording.interval,
            "recording.chunk": self.recording.chunk,
            "simulation.duration": self.simulation.duration,
        }
        multiples = {
            "programme.control_period": "simulation.time_step",
            "recording.interval": "programme.control_period",
            "recording.chunk": "recording.interval",
            "simulation.duration": "recording.interval",
        }
        check_multiples(times, multiples)

    def _check_wrap(self) -> None:
        has_rod = any(isinstance(obstacle, CylinderObstacle) for obstacle in self.obstacles)
        for index, goal in enumerate(() if self.motion is None else self.motion.goals):
            if goal.quantity == "wrap" and not has_rod:
                allowed = "a quantity of the body alone, or a cylinder among the obstacles, round which it may lie"
                raise wrong(f"motion.goals.{index}.quantity", "wrap", allowed)
