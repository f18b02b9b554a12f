"""Electrodes in pictures: any shape from any side, and square plates as they always were.

| identity | one road | the other |
|---|---|---|
| an outline from a direction | corners on the hull | convex hull of the projection, by shapely |
| a plate in a window | cut edge by edge | intersection, by shapely |
| square plates | their outlines | their side, as early runs have it |
"""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
import shapely
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg

from gelbot.field.electrodes import (
    Block,
    Disc,
    Electrode,
    ElectrodeArray,
    Rectangle,
    Ring,
    Rod,
    frame_of,
    hexagonal_array,
    square_array,
)
from gelbot.field.outlines import outlines
from gelbot.show.gel_view import GelView, Scene
from gelbot.show.outlines import Outline, clipped, electrode_outlines, is_flat, joined, seen_from
from gelbot.show.plan_view import PlanView
from gelbot.show.style import new_figure

MM = 1e-3
STAR = np.array([[0.0, 5.0, -5.0], [6.0, -4.0, -4.0], [0.2, 0.2, 0.2]]) * MM
"""A body of one triangle."""
shapes = st.sampled_from([Rectangle((9 * MM, 4 * MM)), Disc(8 * MM), Rod(3 * MM, 9 * MM), Block((2 * MM,) * 3)])
axes = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1)


def run_of(array: ElectrodeArray, voltage: np.ndarray | None = None, lean: float = 0.0) -> xr.Dataset:
    """A run of two moments above which `array` hangs; its body leans over along y."""
    position = np.stack([STAR, STAR])
    normal = np.tile([0.0, np.sin(lean), np.cos(lean)], (2, 1))
    voltage = np.linspace(-10.0, 10.0, array.count) if voltage is None else voltage
    return xr.Dataset(
        {
            "position": (("time", "space", "node"), position),
            "adsorption": (("time", "face"), np.zeros((2, 1))),
            "voltage": (("time", "electrode"), np.tile(voltage, (2, 1))),
            "centre": (("time", "space"), position.mean(axis=2)),
            "normal": (("time", "space"), normal),
            "phase": (("time",), np.zeros(2, int)),
            "rest_position": (("space", "node"), STAR),
            "faces": (("corner", "face"), np.array([[0], [1], [2]])),
            "electrode_centre": (("space", "electrode"), array.centres),
            "electrode_outline": (("space", "outline_corner", "electrode"), outlines(array)),
        },
        coords={"time": [0.0, 1.0]},
        attrs={"limit": 10.0},
    )


def pictures(run: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """The views in space and from above."""
    figures = new_figure(4, 3, 100), new_figure(4, 4, 100)
    scene = Scene.of(run)
    GelView(figures[0], (0.0, 0.0, 1.0, 1.0), scene).show(0)
    PlanView(figures[1].add_axes((0.0, 0.0, 1.0, 1.0)), scene, labels=False).show(0)
    canvases = [cast(FigureCanvasAgg, figure.canvas) for figure in figures]
    for canvas in canvases:
        canvas.draw()
    space, plan = (np.array(canvas.buffer_rgba())[..., :3].astype(int) for canvas in canvases)
    return space, plan


def one(shape, place=(0.0, 0.0, 0.0), axis=(0.0, 0.0, -1.0)) -> ElectrodeArray:
    return ElectrodeArray((Electrode(shape, np.array(place) * MM, frame_of(axis)),))


def across(towards: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (3, p) on the screen of who looks from `towards`, anticlockwise there as here, (p, 2)."""
    frame = frame_of(towards.tolist())
    return (frame[:, :2].T @ points).T


@given(shapes, axes, axes)
def test_the_outline_from_any_side_is_the_hull_of_the_corners(shape, axis, side):
    towards = np.array(side) / np.linalg.norm(side)
    outline = Outline(outlines(one(shape, axis=axis))[:, :, 0], np.zeros((3, 0)))
    seen = across(towards, seen_from(outline, towards).corners)
    hull = shapely.MultiPoint(across(towards, outline.corners)).convex_hull
    ring = shapely.LinearRing(seen) if len(seen) > 2 else None
    assert (0.0 if ring is None else shapely.Polygon(ring).area) == pytest.approx(hull.area, rel=1e-3, abs=1e-11)
    assert ring is None or hull.area < 1e-9 or ring.is_ccw


def test_a_hole_runs_the_other_way_round_from_both_sides():
    (outline,) = electrode_outlines(run_of(one(Ring(12 * MM, 6 * MM))))
    assert outline.corners.shape == outline.hole.shape == (3, 48)
    for towards in (np.array([0.0, 0.0, 1.0]), np.array([0.3, 0.5, -0.8])):
        seen = seen_from(outline, towards / np.linalg.norm(towards))
        outer, hole = (shapely.LinearRing(across(towards, loop)) for loop in seen)
        assert outer.is_ccw
        assert not hole.is_ccw
        assert joined(seen).shape == (3, 98)


@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(1, 8))
def test_what_lies_in_the_window_is_what_shapely_cuts_out(x, y, half):
    (outline,) = electrode_outlines(run_of(one(Disc(10 * MM), (x, y, 5.0))))
    low, high = np.array([-half, -half]) * MM, np.array([half, half]) * MM
    part = clipped(outline, low, high).corners
    expected = shapely.Polygon(outline.corners[:2].T).intersection(shapely.box(*low, *high)).area
    area = shapely.Polygon(part[:2].T).area if part.shape[1] > 2 else 0.0
    assert area == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_plates_are_flat_and_rods_are_not():
    kinds = Disc(MM), Ring(2 * MM, MM), Rod(MM, 5 * MM), Block((MM,) * 3)
    array = ElectrodeArray(tuple(one(shape, axis=(1, 2, 3)).electrodes[0] for shape in kinds))
    assert [is_flat(outline) for outline in electrode_outlines(run_of(array))] == [True, True, False, False]


def test_square_plates_look_as_they_did_in_early_runs():
    run = run_of(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM))
    early = run.drop_vars("electrode_outline").assign_attrs(electrode_side=10 * MM)
    for picture, before in zip(pictures(run), pictures(early), strict=True):
        assert np.abs(picture - before).max() <= 3


def test_one_sees_through_the_hole_of_a_ring():
    plan = pictures(run_of(one(Ring(40 * MM, 26 * MM), (0.0, 0.0, 15.0)), np.array([10.0])))[1]
    colourful = np.ptp(plan, axis=2) > 60
    # On a line just below the body: rim, hole, rim.
    crossings = np.flatnonzero(np.diff(colourful[260].astype(int)) != 0)
    assert len(crossings) == 4
    assert (plan[200, 290] > 250).all()


def test_an_electrode_has_the_colour_of_the_voltage_that_it_takes():
    array = square_array(1, 2, 10 * MM, 15 * MM, 15 * MM)
    run = run_of(array, np.array([-10.0, 0.0]))
    taken = run.assign(electrode_potential=(("time", "electrode"), np.tile([-10.0, 10.0], (2, 1))))
    assert not np.any(red(pictures(run)[1]))
    assert np.any(red(pictures(taken)[1]))


def red(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] > picture[..., 1] + 60) & (picture[..., 0] > picture[..., 2] + 60)


@pytest.mark.parametrize(
    ("place", "axis", "is_behind"),
    [((0, 0, 15), (0, 0, -1), False), ((0, 0, -1), (0, 0, 1), True), ((0, 0, 0), (0, 0, 1), True)],
)
def test_electrodes_in_the_floor_are_drawn_below_the_body(place, axis, is_behind):
    view = GelView(new_figure(4, 3, 100), (0.0, 0.0, 1.0, 1.0), Scene.of(run_of(one(Disc(20 * MM), place, axis))))
    assert (list(view._behind), list(view._before)) == (([0], []) if is_behind else ([], [0]))


def test_upright_electrodes_beside_the_body_stand_before_it_or_behind_it():
    scene = Scene.of(run_of(hexagonal_array(Rod(2 * MM, 20 * MM), 1, 2, 20 * MM, 0.1 * MM)))
    view = GelView(new_figure(4, 3, 100), (0.0, 0.0, 1.0, 1.0), scene)
    camera = np.radians(scene.azimuth)
    (behind,), (before,) = view._behind, view._before
    x = [np.mean(scene.electrodes[n].corners[0]) * np.cos(camera) for n in (behind, before)]
    assert x[0] < 0.0 < x[1]


def test_a_rod_at_the_edge_is_drawn_whole():
    rod = one(Rod(4 * MM, 20 * MM), (0.0, 0.0, 25.0))
    scene = Scene.of(run_of(rod))
    (x, y), half = scene.window
    for shift, drawn in ((0.0, [0]), (1.5 * half, [0]), (3.0 * half, [])):
        place = (x + shift, y, 25.0)
        near = Scene.of(run_of(one(Rod(4 * MM, 20 * MM), place)))
        view = GelView(new_figure(4, 3, 100), (0.0, 0.0, 1.0, 1.0), near)
        assert list(view._before) == drawn
        if drawn:
            assert np.ptp(view._before[0].corners[2]) == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize(("hole", "drawn"), [(30.0, [0]), (90.0, [])])
def test_a_ring_round_the_picture_is_not_in_it(hole, drawn):
    scene = Scene.of(run_of(one(Ring(100 * MM, hole * MM), (0.0, 0.0, 15.0))))
    assert list(GelView(new_figure(4, 3, 100), (0.0, 0.0, 1.0, 1.0), scene)._before) == drawn


@pytest.mark.parametrize("shape", [Disc(9 * MM), Ring(9 * MM, 5 * MM), Rod(3 * MM, 12 * MM), Block((4 * MM,) * 3)])
def test_hexagonal_arrays_of_any_shape_are_drawn(shape):
    space, plan = pictures(run_of(hexagonal_array(shape, 4, 4, 12 * MM, 15 * MM)))
    for picture in (space, plan):
        assert red(picture).sum() > 300
        assert (picture[..., 2] > picture[..., 0] + 60).sum() > 300
