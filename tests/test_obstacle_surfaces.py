"""Surfaces of obstacles: closed, outside out, on the obstacle, as large as geometry says."""

from __future__ import annotations

import numpy as np
import pytest

from gelbot.mechanics.obstacles import gaps
from gelbot.scenario.load import load
from gelbot.scenario.obstacle_surfaces import obstacle_triangles
from gelbot.scenario.surroundings import obstacles

SHAPES = {
    "sphere": ('shape="sphere", diameter="4 mm"', 4 / 3 * np.pi * 2.0**3),
    "cylinder": ('shape="cylinder", axis=[1, 2, 2], diameter="4 mm", length="7 mm"', np.pi * 2.0**2 * 7.0),
    "box": ('shape="box", axis=[1, 2, 2], size=["2 mm", "3 mm", "7 mm"]', 42.0),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_surface(shape: str) -> None:
    text, volume = SHAPES[shape]
    place = 'position=["0 mm", "30 mm", "20 mm"]'
    scenario = load("turn-over", [f"obstacles=[{{{text}, {place}}}]"]).scenario
    triangles = obstacle_triangles(scenario.obstacles) * 1e3
    a, b, c = (triangles[:, k] for k in range(3))
    middle = np.array([0.0, 30.0, 20.0])[:, None]
    # By the divergence theorem, on a surface whose triangles are all counter-clockwise from outside.
    enclosed = np.einsum("im,im->", a - middle, np.cross(b, c, axis=0) - np.cross(middle, c - b, axis=0)) / 6.0
    assert enclosed == pytest.approx(volume, rel=0.02)
    assert np.abs(np.cross(b - a, c - a, axis=0).sum(axis=1)).max() < 1e-9  # closed
    # Corners lie on the obstacle as the mechanics knows it.
    gap = gaps(obstacles(scenario), triangles.reshape(3, -1) * 1e-3)[0]
    assert np.abs(np.asarray(gap)[1]).max() < 1e-8


def test_a_thin_plate_has_no_more_triangles_than_a_picture_can_sort() -> None:
    plate = 'obstacles=[{shape="box", position=["0 mm", "0 mm", "9 mm"], size=["100 mm", "100 mm", "0.1 mm"]}]'
    rod = 'obstacles=[{shape="cylinder", position=["0 mm", "0 mm", "9 mm"], diameter="0.1 mm", length="99 mm"}]'
    for obstacle in (plate, rod):
        assert obstacle_triangles(load("turn-over", [obstacle]).scenario.obstacles).shape[2] < 4000


def test_planes_are_left_out() -> None:
    plane = 'obstacles=[{shape="plane", position=["0 mm", "60 mm", "0 mm"], normal=[0, -1, 0]}]'
    assert obstacle_triangles(load("turn-over", [plane]).scenario.obstacles).shape == (3, 3, 0)
    assert obstacle_triangles(()).shape == (3, 3, 0)
