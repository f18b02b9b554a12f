"""The tables of a scenario that hold single values, in SI, with the checks on each and within one table."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import model_validator

from gelbot.scenario.fields import Count, Density, Dimension, Height, Length, Number, Size, Table, Time, wrong


class Material(Table):
    """The gel: `young_modulus` [Pa], `density` [kg/m^3], and the constants of Eqs. (2), (3) and (6).

    `model`: the paper's spring "lattice", or a "solid" of finite elements with its `poisson_ratio`. `p_ele` [m^2/A] and
    `p_ads` per `adsorption_step` [s]. `conductivity` [S/m]; None: it does not disturb the field. `self_contact`:
    whether the body is kept from passing through itself; `self_friction`: gel on gel, None: as the tank's.
    """

    model: Literal["lattice", "solid"] = "lattice"
    poisson_ratio: Annotated[float, Number(ge=0, le=0.48)] = 0.3
    self_contact: bool = False
    self_friction: Annotated[float, Number(ge=0)] | None = None
    young_modulus: Annotated[float, Dimension("Pa", gt=0)]
    density: Density
    p_ele: Annotated[float, Dimension("m^2/A", ge=0)]
    adsorption_step: Time
    p_ads: Annotated[float, Number(gt=0, le=1)]
    p_l: Annotated[float, Number(ge=0, lt=1)]
    conductivity: Annotated[float, Dimension("S/m", gt=0)] | None = None


class Solution(Table):
    """The surfactant solution: `conductivity` [S/m], `density` [kg/m^3], `drag` [1/s] of the body per its mass."""

    conductivity: Annotated[float, Dimension("S/m", gt=0)]
    density: Density
    drag: Annotated[float, Dimension("1/s", ge=0)]


class Tank(Table):
    """The tank: lengths in m; `depth` None is deep, `size` None is wide; Coulomb `friction` of the floor.

    Its boundaries insulate, but for those in `open`, beyond which the solution goes on.
    """

    floor_depth: Height
    depth: Length | None = None
    size: Size | None = None
    open: tuple[Literal["floor", "surface", "-x", "+x", "-y", "+y"], ...] = ()
    friction: Annotated[float, Number(ge=0)]

    @model_validator(mode="after")
    def _has_what_is_open(self) -> Tank:
        for side in self.open:
            missing = "size" if side[0] in "+-" and self.size is None else "depth" if side == "surface" else None
            if missing and getattr(self, missing) is None:
                raise wrong("open", side, f"a boundary that the tank has: without {missing} it has none there")
        return self


class Simulation(Table):
    """How it is computed: `duration` and `time_step` [s]; residual `tolerance` of the implicit step.

    `step_error` [m]: where given, the time step adapts, so that no node is farther off in a step than that.
    `field_spacing` [m]: cells of the table from which the body reads the field.
    """

    duration: Time
    time_step: Time
    tolerance: Annotated[float, Number(gt=0, lt=1)]
    max_iterations: Annotated[int, Count(ge=1)]
    precision: Literal["float64", "float32"]
    step_error: Annotated[float, Dimension("m", ge=1e-9, le=1e-2)] | None = None
    field_spacing: Annotated[float, Dimension("m", ge=1e-4, le=5e-3)] = 1e-3


class Recording(Table):
    """What is kept: a frame every `interval` [s], written every `chunk` [s]; the movie runs `speed` times as fast."""

    interval: Time
    chunk: Time
    frames_per_second: Annotated[int, Count(ge=1, le=120)]
    speed: Annotated[float, Number(gt=0)]
