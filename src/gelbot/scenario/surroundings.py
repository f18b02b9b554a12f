"""From a scenario's tank and obstacles to what the body can touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.mechanics.obstacles import Boxes, Cylinders, Obstacles, Planes, Spheres, gaps
from gelbot.scenario.obstacle_shapes import BoxObstacle, CylinderObstacle, PlaneObstacle, SphereObstacle
from gelbot.scenario.placement import boundaries
from gelbot.scenario.schema import Scenario
from gelbot.units import shown

Kind = TypeVar("Kind")
Vector = Sequence[float] | NDArray[np.float64]


def obstacles(scenario: Scenario) -> Obstacles:
    """The plane z = 0 on which the gel lies, the tank's walls, and the obstacles, in this order of kinds."""
    tank, given = scenario.tank, scenario.obstacles
    planes: list[tuple[Vector, Vector, float]] = [((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), tank.friction)]
    walls = [boundary for boundary in boundaries(tank) if boundary.key == "tank.size"]
    for _, axis, sign, limit in walls:
        planes.append((limit * np.eye(3)[axis], -sign * np.eye(3)[axis], tank.friction))

    def of(kind: type[Kind]) -> list[Kind]:
        return [obstacle for obstacle in given if isinstance(obstacle, kind)]

    def friction(among: Sequence[SphereObstacle | CylinderObstacle | BoxObstacle | PlaneObstacle]) -> list[float]:
        return [tank.friction if obstacle.friction is None else obstacle.friction for obstacle in among]

    flats = of(PlaneObstacle)
    planes += [(p.position, p.direction, mu) for p, mu in zip(flats, friction(flats), strict=True)]
    balls, rods, boxes = of(SphereObstacle), of(CylinderObstacle), of(BoxObstacle)
    return Obstacles(
        Planes(_vectors([p[0] for p in planes]), _vectors([p[1] for p in planes]), jnp.array([p[2] for p in planes])),
        Spheres(
            _vectors([ball.position for ball in balls]),
            jnp.array([ball.diameter / 2.0 for ball in balls]),
            jnp.array(friction(balls)),
        ),
        Cylinders(
            _vectors([rod.position for rod in rods]),
            _vectors([rod.direction for rod in rods]),
            jnp.array([rod.diameter / 2.0 for rod in rods]),
            jnp.array([rod.length for rod in rods]),
            jnp.array(friction(rods)),
        ),
        Boxes(
            _vectors([box.position for box in boxes]),
            _vectors([box.size for box in boxes]),
            jnp.moveaxis(jnp.array([box.turn for box in boxes]).reshape(-1, 3, 3), 0, -1),
            jnp.array(friction(boxes)),
        ),
    )


def check_free(around: Obstacles, positions: NDArray[np.float64]) -> None:
    """The body at `positions` [m], (3, n), overlaps no wall and no obstacle."""
    depth = -np.asarray(gaps(around, jnp.asarray(positions))[0]).min(axis=1)
    worst = int(np.argmax(depth))
    if depth[worst] > 1e-9:
        names = [f"{kind} {k}" for kind, part in zip(("plane", "sphere", "cylinder", "box"), around, strict=True)
                 for k in range(part.friction.shape[0])]  # fmt: skip
        given = f"a body that reaches {shown(float(depth[worst]), 'm')} into {names[worst]} (counted from 0)"
        raise BadInput("body.pose", given, "a place where it overlaps neither walls nor obstacles at the start")


def _vectors(rows: Sequence[Vector]) -> jnp.ndarray:
    return jnp.array([list(row) for row in rows], float).reshape(-1, 3).T
