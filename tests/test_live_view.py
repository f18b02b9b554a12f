"""Where things are on the page's screen: views that hold everything, frames of plates, plates under the pointer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from viser import transforms

from gelbot.live.gaze import ASPECTS
from gelbot.live.moment import Stage
from gelbot.live.plates import inset
from gelbot.live.stroke import Strokes, under
from gelbot.live.view import ABOVE, ALL, FIELD_OF_VIEW, VIEWS, View, fitted, on_screen, view
from toy import Toy

SQUARE = np.array([[-5.0, 5.0, 5.0, -5.0], [-5.0, -5.0, 5.0, 5.0], [15.0] * 4])


def camera(seen: View, aspect: float) -> Any:
    """The camera of a browser that looks from there."""
    forward = (seen.target - seen.position) / np.linalg.norm(seen.target - seen.position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    turned = np.stack([right, np.cross(forward, right), forward], axis=1)
    wxyz = transforms.SO3.from_matrix(turned).wxyz
    return SimpleNamespace(wxyz=wxyz, position=seen.position, fov=FIELD_OF_VIEW, aspect=aspect)


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Toy(camera=False).stage()


@pytest.mark.parametrize("aspect", [0.4, 0.95, 1.23, 3.0])
@pytest.mark.parametrize(("azimuth", "elevation"), [(-72.0, 42.0), (-90.0, 89.0), (30.0, 5.0), (0.0, -40.0)])
def test_all_points_are_in_the_picture_and_fill_it(rng, aspect, azimuth, elevation):
    points = rng.normal(size=(3, 50)) * np.array([[40.0], [20.0], [8.0]]) + np.array([[100.0], [-30.0], [7.0]])
    places = on_screen(camera(fitted(points, azimuth, elevation, aspect), aspect), points)
    assert places.min() > 0.0
    assert places.max() < 1.0
    sides = np.stack([places.min(axis=1), 1.0 - places.max(axis=1)])
    # It touches two sides that lie opposite, equally.
    np.testing.assert_allclose(*sides[:, np.argmin(sides[0])], rtol=1e-6)
    assert sides.min() == pytest.approx(0.06)


@pytest.mark.parametrize("name", [ALL, ABOVE])
@pytest.mark.parametrize("aspect", [0.5, 0.947, 1.224, *ASPECTS])
def test_plates_and_gel_are_in_the_picture(stage, name, aspect):
    for shown in (stage, Stage(**{**vars(stage), "outlines": (), "electrode_names": ()})):
        points = np.concatenate([shown.rest, *shown.outlines], axis=1) * 1e3
        places = on_screen(camera(view(shown, name, aspect), aspect), points)
        assert places.min() > 0.05
        assert places.max() < 0.95


def test_the_first_view_is_that_of_all():
    assert VIEWS[0] == ALL


def test_a_frame_is_as_broad_everywhere():
    long = SQUARE * np.array([[1.0], [4.0], [1.0]])
    np.testing.assert_allclose(inset(long, 0.2), long - np.array([[-1.0, 1, 1, -1], [-1, -1, 1, 1], [0] * 4]))
    # Whichever way round, wherever it stands, and where a corner is given twice.
    np.testing.assert_allclose(inset(long[:, ::-1], 0.2), inset(long, 0.2)[:, ::-1])
    np.testing.assert_allclose(inset(long[[2, 0, 1]] + 7.0, 0.2), inset(long, 0.2)[[2, 0, 1]] + 7.0)
    assert np.isfinite(inset(np.repeat(long, 2, axis=1), 0.2)).all()
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    disc = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    np.testing.assert_allclose(inset(disc, 0.2), 0.8 * disc, atol=1e-12)


def test_of_several_plates_the_nearest_is_under_the_pointer():
    above = camera(View(np.array([0.0, -1.0, 300.0]), np.zeros(3)), 1.0)
    rims = [SQUARE - np.array([[0.0], [0.0], [14.0]]), SQUARE, SQUARE + np.array([[25.0], [0.0], [0.0]])]
    middles = [tuple(on_screen(above, rim.mean(axis=1, keepdims=True))[:, 0]) for rim in rims]
    assert under(above, rims, np.array([middles[1]])) == [1]
    assert under(above, rims, np.array([[0.05, 0.05]])) == []
    strokes = Strokes()
    assert strokes.go_on(0, above, rims, middles[2]) == []
    strokes.begin(0, middles[1])
    assert strokes.go_on(0, above, rims, middles[2]) == [1, 2]
    assert strokes.go_on(0, above, rims, middles[1]) == []
    strokes.end(0)
    assert strokes.go_on(0, above, rims, middles[1]) == []
