"""The [motion] table of a scenario: what shall happen, as goals on essential points, and what it may cost."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gelbot.errors import NOTHING, BadInput
from gelbot.scenario.fields import Angle, Number, Table, Time, wrong
from gelbot.scenario.programmes import Point
from gelbot.units import allowed_quantity, quantity

Quantity = Literal["height", "along", "across", "normal", "tip_angle", "wrap"]
UNITS: dict[str, str] = {"height": "m", "along": "m", "across": "m", "normal": "", "tip_angle": "rad", "wrap": "rad"}
"""The SI unit of each quantity; a plain number where there is none."""


class Goal(Table):
    """One thing to be reached: `quantity` of a `point` is `at_least` and `at_most` so much, for `lasting` [s] or more.

    height      of the point above the floor [m]
    along       how far the point has moved from its start in the motion's `direction` [m]; across: to the left of it
    normal      z of the unit normal of the body's upper side: 1 upright, -1 on its back
    tip_angle   steepest of the tips' angles below their outward direction [rad]
    wrap        angle about the first cylinder over which the body lies against it [rad]

    `to_the_end`: it must also stay so until the run is over.
    """

    quantity: Quantity
    point: Point = 0
    at_least: float | None = None
    at_most: float | None = None
    lasting: Time | None = None
    to_the_end: bool = False

    @model_validator(mode="before")
    @classmethod
    def _with_units(cls, given: Any) -> Any:
        """Bounds have the unit of their quantity."""
        if not isinstance(given, dict) or given.get("quantity") not in get_args(Quantity):
            return given  # what is wrong with it is said by the fields
        unit = UNITS[given["quantity"]]
        return given | {key: _bound(given[key], unit, key) for key in ("at_least", "at_most") if key in given}

    @model_validator(mode="after")
    def _bounds(self) -> Goal:
        if self.at_least is None and self.at_most is None:
            raise wrong("at_least", NOTHING, "at least one of at_least and at_most")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise wrong("at_most", self.at_most, f"no less than at_least = {self.at_least:g} (SI units)")
        if self.point and self.quantity in ("normal", "tip_angle", "wrap"):
            raise wrong("point", f"tip {self.point}", f"no point: {self.quantity} is of the whole body")
        return self


def _bound(given: object, unit: str, key: str) -> float:
    if not unit:
        if isinstance(given, bool) or not isinstance(given, int | float) or not Number().hold(given):
            raise wrong(key, given, Number().allowed)
        return float(given)
    try:
        return quantity(given, unit, "")
    except BadInput as error:
        raise wrong(key, given, allowed_quantity(unit), error.advice) from error


class Costs(Table):
    """What a motion costs: `time` [per s] until its last goal is reached, `charge` [per C], `peak_voltage` [per V]."""

    time: Annotated[float, Number(ge=0)] = 1.0
    charge: Annotated[float, Number(ge=0)] = 0.0
    peak_voltage: Annotated[float, Number(ge=0)] = 0.0


class Motion(Table):
    """What shall happen: `goals`, reached one after the other; `direction` [rad] from x for along and across."""

    direction: Angle | None = None
    goals: Annotated[tuple[Goal, ...], Field(min_length=1)]
    costs: Costs = Costs()

    def way(self, goal: Goal) -> NDArray[np.float64]:
        """The unit vector (2,) in the plane along which a `goal` along or across counts."""
        assert self.direction is not None  # checked by `_has_a_direction`
        angle = self.direction + (np.pi / 2.0 if goal.quantity == "across" else 0.0)
        return np.array([np.cos(angle), np.sin(angle)])

    @model_validator(mode="after")
    def _has_a_direction(self) -> Motion:
        for index, goal in enumerate(self.goals):
            if goal.quantity in ("along", "across") and self.direction is None:
                raise wrong("direction", NOTHING, f"an angle: goals.{index} is {goal.quantity} it", '"45 deg"')
            if goal.to_the_end and index < len(self.goals) - 1:
                raise wrong(f"goals.{index}.to_the_end", True, "only for the last goal")
        return self


def check_tips(motion: Motion | None, tips: int) -> None:
    """The goals of `motion` are about points that a body of so many `tips` has. Raises `BadInput`."""
    for index, goal in enumerate(() if motion is None else motion.goals):
        if goal.point > tips or (goal.quantity == "tip_angle" and not tips):
            given = f"tip {goal.point}" if goal.point else goal.quantity
            allowed = f"one of the body's {tips} tips" if tips else "the centre: the body has no tips"
            raise BadInput(f"motion.goals.{index}.{'point' if goal.point else 'quantity'}", given, allowed)
