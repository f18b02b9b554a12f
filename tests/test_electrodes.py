"""Electrodes: where they stand, how far they reach, which overlap.

| identity | one road | the other |
|---|---|---|
| bounds | closed form | corners of the outline |
| a triangular grid | `hexagonal_array` | six neighbours at one distance |
| overlap | in the plane, where axes are parallel | as convex bodies, after a small tilt |
| overlap | two electrodes | the same two, moved and turned together |
| a gel in the way | cut at its heights | a prism among the electrodes |
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gelbot.field.electrodes import (
    DOWN,
    Block,
    Disc,
    Electrode,
    ElectrodeArray,
    Rectangle,
    Ring,
    Rod,
    Shape,
    frame_of,
    hexagonal_array,
    rectangular_array,
    square_array,
)
from gelbot.field.outlines import outlines
from gelbot.field.overlap import overlaps, reaches_into

MM = 1e-3
SHAPES = {
    "square": Rectangle((10 * MM, 10 * MM)),
    "rectangle": Rectangle((12 * MM, 5 * MM)),
    "disc": Disc(10 * MM),
    "ring": Ring(12 * MM, 8 * MM),
    "rod": Rod(3 * MM, 20 * MM),
    "block": Block((4 * MM, 6 * MM, 8 * MM)),
}
shapes = st.sampled_from(list(SHAPES.values()))
axes = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1)
angles = st.floats(-np.pi, np.pi)


def one(
    shape: Shape, place: tuple[float, ...] = (0, 0, 0), axis: tuple[float, ...] = (0, 0, -1), turn=0.0, backing=0.0
) -> Electrode:
    """An electrode with its middle at `place` [mm]; `turn` [deg], `backing` [mm]."""
    return Electrode(shape, np.array(place) * MM, frame_of(axis, np.radians(turn)), backing * MM)


def overlapping(*electrodes: Electrode) -> bool:
    return list(overlaps(ElectrodeArray(electrodes))) != []


class TestPlaces:
    @given(axes, angles)
    def test_a_frame_is_a_rotation_with_z_along_the_axis(self, axis, turn):
        frame = frame_of(axis, turn)
        assert frame.T @ frame == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert frame[:, 2] == pytest.approx(np.array(axis) / np.linalg.norm(axis))
        turned = Rotation.from_rotvec(turn * frame[:, 2]).as_matrix() @ frame_of(axis)
        assert frame == pytest.approx(turned, abs=1e-12)

    def test_a_plate_faces_down_unless_told_otherwise(self):
        assert np.array_equal(frame_of((0, 0, -1)), DOWN)
        assert np.array_equal(frame_of((0, 0, 1)), np.eye(3))

    @given(angles)
    def test_the_first_size_of_an_upright_plate_is_horizontal(self, direction):
        frame = frame_of((np.cos(direction), np.sin(direction), 0.0))
        assert frame[2, 0] == pytest.approx(0.0, abs=1e-12)
        assert abs(frame[2, 1]) == pytest.approx(1.0)

    def test_the_matrix_of_figure_3(self):
        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        assert array.count == 16
        assert array.pitch == pytest.approx(25 * MM)
        assert array.centres[:, 0] == pytest.approx([-37.5 * MM, -37.5 * MM, 15 * MM])
        assert array.centres[:, 1] == pytest.approx([-12.5 * MM, -37.5 * MM, 15 * MM])
        assert array.centres[:, 10] == pytest.approx([12.5 * MM, 12.5 * MM, 15 * MM])
        assert [e.name for e in array.electrodes[:2]] == ["electrode 0", "electrode 1"]

    @pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
    @pytest.mark.parametrize("backing", [0.0, 1 * MM])
    def test_the_lowest_points_of_an_array_are_at_its_height(self, shape, backing):
        backing = backing if isinstance(shape, Rectangle | Disc | Ring) else 0.0
        for array in (
            rectangular_array(shape, 2, 3, (20 * MM, 30 * MM), 15 * MM, backing),
            hexagonal_array(shape, 3, 2, 20 * MM, 15 * MM, backing),
        ):
            low, high = (np.array([e.bounds[k] for e in array.electrodes]) for k in (0, 1))
            assert low[:, 2] == pytest.approx(15 * MM)
            assert (low.min(axis=0) + high.max(axis=0))[:2] == pytest.approx([0, 0], abs=1e-12)

    def test_a_hexagonal_array_has_six_neighbours(self):
        array = hexagonal_array(Disc(4 * MM), 5, 6, 10 * MM, 15 * MM)
        distance = np.linalg.norm(array.centres[:, :, None] - array.centres[:, None], axis=0)
        neighbours = np.sum(np.abs(distance - 10 * MM) < 1e-9, axis=0)
        assert np.max(neighbours) == 6
        assert np.sum(neighbours == 6) == 3 * 4
        assert array.pitch == pytest.approx(10 * MM)
        # A row after the other, each along x; the first one lies further to the left.
        x, y = array.centres[:2].reshape(2, 5, 6)
        assert np.diff(x, axis=1) == pytest.approx(10 * MM)
        assert np.ptp(y, axis=1) == pytest.approx(0.0)
        assert np.diff(y[:, 0]) == pytest.approx(10 * MM * np.sqrt(0.75))
        assert np.diff(x[:, 0]) == pytest.approx(np.array([5, -5, 5, -5]) * MM)


class TestExtent:
    @given(shapes, axes, angles)
    def test_bounds_are_those_of_the_corners(self, shape, axis, turn):
        electrode = Electrode(shape, np.array([1.0, 2.0, 3.0]) * MM, frame_of(axis, turn))
        corners = outlines(ElectrodeArray((electrode,)), 720)[:, :, 0]
        low, high = electrode.bounds
        assert low == pytest.approx(np.nanmin(corners, axis=1), abs=1e-6)
        assert high == pytest.approx(np.nanmax(corners, axis=1), abs=1e-6)

    @given(axes, angles)
    def test_a_backing_lies_behind(self, axis, turn):
        front = Electrode(Disc(10 * MM), np.zeros(3), frame_of(axis, turn))
        backed = Electrode(Disc(10 * MM), np.zeros(3), frame_of(axis, turn), 2 * MM)
        behind = -2 * MM * front.frame[:, 2]
        assert backed.bounds[0] == pytest.approx(front.bounds[0] + np.minimum(behind, 0.0))
        assert backed.bounds[1] == pytest.approx(front.bounds[1] + np.maximum(behind, 0.0))

    def test_outlines_of_different_electrodes_are_padded(self):
        found = outlines(ElectrodeArray((one(Rectangle((2 * MM, 4 * MM)), (1, 2, 3)), one(Ring(4 * MM, 2 * MM)))), 12)
        assert found.shape == (3, 25, 2)
        assert found[:, :4, 0].min(axis=1) == pytest.approx([0, 0, 3 * MM], abs=1e-12)
        assert found[:, :4, 0].max(axis=1) == pytest.approx([2 * MM, 4 * MM, 3 * MM])
        assert np.isnan(found[:, 4:, 0]).all()
        assert np.isnan(found[:, 12, 1]).all()
        rim, hole = found[:2, :12, 1], found[:2, 13:, 1]
        assert np.linalg.norm(rim, axis=0) == pytest.approx(2 * MM)
        assert np.linalg.norm(hole, axis=0) == pytest.approx(1 * MM)

        def area(loop: np.ndarray) -> float:
            x, y = loop
            return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2.0)

        assert area(rim) * area(hole) < 0.0

    def test_a_rod_has_both_ends(self):
        corners = outlines(ElectrodeArray((one(Rod(2 * MM, 10 * MM), axis=(1, 0, 0)),)), 16)[:, :, 0]
        assert corners.shape == (3, 32)
        assert sorted(set(np.round(corners[0] / MM, 9))) == [-5.0, 5.0]
        assert np.linalg.norm(corners[1:], axis=0) == pytest.approx(1 * MM)


SQUARE, DISC, RING, ROD, BLOCK = (SHAPES[name] for name in ("square", "disc", "ring", "rod", "block"))
PAIRS = [
    ("side by side", one(SQUARE), one(SQUARE, (10.01, 0, 0)), False),
    ("edge to edge", one(SQUARE), one(SQUARE, (10, 0, 0)), True),
    ("corner to corner", one(SQUARE), one(SQUARE, (10, 10, 0)), True),
    ("in one place", one(DISC), one(DISC), True),
    ("one under the other", one(SQUARE), one(SQUARE, (0, 0, 0.1)), False),
    ("back to back", one(SQUARE), one(SQUARE, (0, 0, 1), backing=1), False),
    ("front in a backing", one(SQUARE), one(SQUARE, (0, 0, -0.5), backing=1), True),
    ("a turned square's corner", one(SQUARE), one(SQUARE, (12.05, 0, 0), turn=45), True),
    ("beside a turned square", one(SQUARE), one(SQUARE, (12.1, 0, 0), turn=45), False),
    ("discs that touch", one(DISC), one(DISC, (6, 8, 0)), True),
    ("discs side by side", one(DISC), one(DISC, (6.01, 8, 0)), False),
    ("a disc in a ring", one(RING), one(Disc(7.9 * MM)), False),
    ("a disc that fills a ring", one(RING), one(Disc(8 * MM)), True),
    ("a rod through a ring", one(RING), one(ROD), False),
    ("a tilted rod through a ring", one(RING), one(ROD, axis=(0.3, 0, 1)), False),
    ("a rod leaning on a ring", one(RING), one(ROD, (2.6, 0, 0), axis=(0.1, 0, 1)), True),
    ("a rod above a plate", one(SQUARE), one(ROD, (0, 0, 10.1)), False),
    ("a rod on a plate", one(SQUARE), one(ROD, (0, 0, 10)), True),
    ("an upright plate over another", one(SQUARE), one(SQUARE, (0, 0, 5.01), (0, 1, 0)), False),
    ("an upright plate on another", one(SQUARE), one(SQUARE, (0, 0, 5), (0, 1, 0)), True),
    ("crossing plates", one(SQUARE), one(SQUARE, axis=(1, 1, 1)), True),
    ("a rod in a block", one(BLOCK), one(Rod(1 * MM, 2 * MM), axis=(1, 2, 3)), True),
    ("crossed rods", one(ROD, axis=(1, 0, 0)), one(ROD, (0, 0, 2.99), axis=(0, 1, 0)), True),
    ("rods that cross apart", one(ROD, axis=(1, 0, 0)), one(ROD, (0, 0, 3.01), axis=(0, 1, 0)), False),
]


class TestOverlap:
    @pytest.mark.parametrize(("a", "b", "expected"), [p[1:] for p in PAIRS], ids=[p[0] for p in PAIRS])
    def test_two_electrodes(self, a, b, expected):
        assert overlapping(a, b) == expected
        assert overlapping(b, a) == expected

    @pytest.mark.parametrize(("a", "b", "expected"), [p[1:] for p in PAIRS[:9]], ids=[p[0] for p in PAIRS[:9]])
    def test_moved_and_turned_together(self, a, b, expected, rng):
        rotation, shift = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1.0, 1.0, 3)
        moved = [Electrode(e.shape, rotation @ e.centre + shift, rotation @ e.frame, e.backing) for e in (a, b)]
        assert overlapping(*moved) == expected

    @given(shapes, shapes, st.tuples(*[st.floats(-12, 12)] * 3), angles)
    def test_the_plane_and_space_agree(self, one_shape, other_shape, place, turn):
        """A pair with parallel axes, and with one of them tilted by a hair: the same unless they just touch."""
        a, b = one(one_shape, backing=0), one(other_shape, place, turn=float(np.degrees(turn)))
        tilted = Electrode(b.shape, b.centre, Rotation.from_rotvec([3e-7, 2e-7, 0.0]).as_matrix() @ b.frame)
        inner, outer = scaled(b, 0.99), scaled(b, 1.01)
        higher, lower = (replace(b, centre=b.centre + np.array([0.0, 0.0, d])) for d in (1e-7, -1e-7))
        if len({overlapping(a, near) for near in (inner, outer, higher, lower)}) == 1:
            assert overlapping(a, tilted) == overlapping(a, b)

    def test_all_pairs_are_found(self):
        array = rectangular_array(DISC, 2, 2, (10 * MM, 30 * MM), 15 * MM)
        assert list(overlaps(array)) == [(0, 1), (2, 3)]
        assert list(overlaps(hexagonal_array(DISC, 6, 6, 10.1 * MM, 15 * MM))) == []

    @pytest.mark.parametrize(
        ("electrode", "expected"),
        [
            (one(ROD, (8, 0, 0)), False),
            (one(ROD, (6.4, 0, 0)), True),
            (one(ROD, (0, 0, 11.1)), False),
            (one(ROD, (0, 0, 11)), True),
            (one(ROD, (15, 0, 8), (1, 0, 1)), False),
            (one(ROD, (9, 0, 8), (1, 0, 1)), True),
            (one(Ring(20 * MM, 16 * MM), (0, 0, 0.5)), False),
            (one(Ring(20 * MM, 12 * MM), (0, 0, 0.5)), True),
            (one(SQUARE, (0, 0, -1), (0, 0, 1)), False),
        ],
    )
    def test_a_gel_in_the_way(self, electrode, expected):
        """A gel of 10 mm x 10 mm x 1 mm on the floor: the cut at its heights against a block in its place."""
        half = 5 * MM
        outline = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
        assert reaches_into(electrode, outline, 0.0, 1 * MM) == expected
        assert overlapping(electrode, one(Block((10 * MM, 10 * MM, 1 * MM)), (0, 0, 0.5))) == expected


def scaled(electrode: Electrode, factor: float) -> Electrode:
    """The electrode with all its sizes multiplied."""
    shape = electrode.shape
    sizes = {k: tuple(factor * x for x in v) if isinstance(v, tuple) else factor * v for k, v in vars(shape).items()}
    return Electrode(type(shape)(**sizes), electrode.centre, electrode.frame, electrode.backing)
