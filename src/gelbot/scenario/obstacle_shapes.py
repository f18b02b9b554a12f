"""The [[obstacles]] of a scenario: spheres, cylinders, boxes and planes that stand in the tank and do not move."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, model_validator

from gelbot.field.electrodes import frame_of
from gelbot.scenario.fields import Dimension, Direction, Length, Number, Position, Several, Table, wrong

Sizes3 = Annotated[tuple[float, float, float], Several(Dimension("m", gt=0), (3,))]
UP = (0.0, 0.0, 1.0)


class Obstacle(Table):
    """What all obstacles have: a `position` [m] and Coulomb `friction`, None: as the floor's."""

    position: Position
    friction: Annotated[float, Number(ge=0)] | None = None


def _unit(direction: tuple[float, float, float], key: str) -> NDArray[np.float64]:
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise wrong(key, list(direction), "a direction: three numbers that are not all zero")
    return np.array(direction) / length


class SphereObstacle(Obstacle):
    """A ball of `diameter` [m] about `position`."""

    shape: Literal["sphere"]
    diameter: Length


class DirectedObstacle(Obstacle):
    """One that stands along an `axis`, which need not have length one."""

    axis: Direction = UP

    @model_validator(mode="after")
    def _has_an_axis(self) -> DirectedObstacle:
        _unit(self.axis, "axis")
        return self

    @property
    def direction(self) -> NDArray[np.float64]:
        """The unit vector of the axis, shape (3,)."""
        return _unit(self.axis, "axis")


class CylinderObstacle(DirectedObstacle):
    """A rod with flat ends about `position`, its middle: `diameter`, `length` [m], along `axis`."""

    shape: Literal["cylinder"]
    diameter: Length
    length: Length


class BoxObstacle(DirectedObstacle):
    """A cuboid about `position`: its three `size` [m] along its own axes; its own z along `axis`, its own x as
    nearly as it can along the tank's x.
    """

    shape: Literal["box"]
    size: Sizes3

    @property
    def turn(self) -> NDArray[np.float64]:
        """Columns are the box's own axes, shape (3, 3), turned as an electrode's."""
        return frame_of(self.axis)


class PlaneObstacle(Obstacle):
    """A plane through `position`; the free side is where `normal` points."""

    shape: Literal["plane"]
    normal: Direction

    @model_validator(mode="after")
    def _has_a_normal(self) -> PlaneObstacle:
        _unit(self.normal, "normal")
        return self

    @property
    def direction(self) -> NDArray[np.float64]:
        """The unit normal, shape (3,)."""
        return _unit(self.normal, "normal")


AnyObstacle = Annotated[SphereObstacle | CylinderObstacle | BoxObstacle | PlaneObstacle, Discriminator("shape")]
