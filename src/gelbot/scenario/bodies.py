"""The [body] table of a scenario: its shapes and where it lies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, ValidationInfo, field_validator, model_validator

from gelbot.body.outline import Outline, outline_from_points, outline_from_svg, starfish, strip
from gelbot.errors import BadInput
from gelbot.scenario.fields import Angle, Count, Height, Length, Point, Table, passed_on, wrong
from gelbot.units import shown

NODES_MOST = 10_000
"""A body of more nodes than this would not be solved in reasonable memory."""


class Pose(Table):
    """Where the body lies: `position` [m] of its centroid and `heading` [rad] of its outline's +x in the array's frame;
    `lift` [m] of the lower face above z = 0."""

    position: Point
    heading: Angle
    lift: Height


class Sheet(Table):
    """What all bodies have: `thickness` [m], `mesh_size` [m], number of node `layers`, and their `pose`."""

    thickness: Length
    mesh_size: Length
    layers: Annotated[int, Count(ge=2, le=20)]
    pose: Pose

    def outline(self) -> Outline:
        """The outline of the body, centred on its centroid."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _has_an_outline(self) -> Sheet:
        try:
            outline = self.outline()
        except BadInput as error:
            raise passed_on(error, "body") from error
        # Equilateral triangles have one node for each sqrt(3)/2 of the squared edge length.
        nodes = self.layers * outline.area / (0.866 * self.mesh_size**2)
        if nodes > NODES_MOST:
            coarsest = self.mesh_size * (nodes / NODES_MOST) ** 0.5
            allowed = f"at least {shown(coarsest, 'm')}: a finer mesh has more than {NODES_MOST} nodes"
            raise wrong("mesh_size", shown(self.mesh_size, "m"), allowed)
        return self


class StarfishBody(Sheet):
    """The star of Fig. 3; lengths in m; see `gelbot.body.outline.starfish`."""

    shape: Literal["starfish"]
    width: Length
    arms: Annotated[int, Count(ge=3, le=24)]
    arm_length: Length
    root_width: Length | None = None
    tip_width: Height

    def outline(self) -> Outline:
        return starfish(self.width, self.arm_length, self.root_width, self.tip_width, self.arms)


class StripBody(Sheet):
    """A rectangle, `length` [m] along its x and `width` [m] along its y."""

    shape: Literal["strip"]
    length: Length
    width: Length

    def outline(self) -> Outline:
        return strip(self.length, self.width)


class OutlineBody(Sheet):
    """Any simple closed outline: `points` [m], or the file `svg` scaled to `width` [m] in x."""

    shape: Literal["outline"]
    points: tuple[Point, ...] | None = None
    svg: str | None = None
    width: Length | None = None

    @field_validator("svg")
    @classmethod
    def _beside_the_scenario(cls, svg: str, info: ValidationInfo) -> str:
        return str(Path((info.context or {}).get("folder", "")) / svg)

    def outline(self) -> Outline:
        if (self.points is None) == (self.svg is None):
            raise BadInput("body.points", "neither" if self.svg is None else "both", "one of points and svg")
        if (self.width is None) != (self.svg is None):
            given = "no width" if self.width is None else "a width beside points"
            raise BadInput("body.width", given, "with svg the width to which it is scaled, with points none")
        if self.svg is not None and self.width is not None:
            return outline_from_svg(Path(self.svg), self.width, self.mesh_size)
        return outline_from_points(self.points or (), "body.points")


Body = Annotated[StarfishBody | StripBody | OutlineBody, Discriminator("shape")]
