"""Potential directions of locomotion: the group of a shape, tips, supports, and what body and electrodes share.

| identity | one road | the other |
|---|---|---|
| the paper, IV-C | a pentagram's directions | two for each of five axes, over tip 1 or over tips 2 and 3 |
| the group permutes the table | directions of a shape | their images under every operation of its group |
| a turned body has turned directions | directions of a turned outline | the outline's, turned |
| a shared operation is a symmetry of the field | current of exchanged voltages at an image | image of the current |
| an orbit is all of it | operations on one of its members | the other members, and no others |
| a group is one of permutations | electrodes exchanged by two operations in turn | by their product |
| the mesh follows its outline | nodes | their images |
| the robot elsewhere | current density on its nodes there | on its nodes here |
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import command_line
from gelbot.body.lattice import build_body
from gelbot.body.outline import Outline, outline_from_points, outline_from_svg, starfish, strip
from gelbot.body.symmetry import (
    SymmetryGroup,
    carried_into_itself,
    images,
    miss,
    reflection,
    rotation,
    symmetry_group,
    symmetry_within,
)
from gelbot.body.tips import tips_of
from gelbot.cli import app
from gelbot.directions_report.common import Common, common_to
from gelbot.directions_report.report import TOLERANCE
from gelbot.directions_report.subject import Subject, subject
from gelbot.errors import BadInput
from gelbot.field.array_symmetry import Setting, array_group, electrode_images
from gelbot.field.charge import FieldSolution, build_problem, solve
from gelbot.field.electrodes import (
    DOWN,
    Block,
    Disc,
    Electrode,
    ElectrodeArray,
    Rectangle,
    Rod,
    frame_of,
    hexagonal_array,
    square_array,
)
from gelbot.field.images import Tank
from gelbot.plan.directions import Direction, check_has_directions, directions, find_tips
from gelbot.plan.equivalence import carried, images_of_directions, kinds, operations_of, orbits, turned
from gelbot.scenario import load
from gelbot.scenario.build import electrode_array, field_tank

MM = 1e-3
runner = CliRunner()


def five() -> Outline:
    return starfish(15 * MM, 6 * MM, None, 0.7 * MM)


def pinwheel(blades: int = 4) -> Outline:
    """Pointed blades, all bent to the same side."""
    blade = MM * np.array([[1.0, -1.0], [6.0, 1.5], [2.0, 1.0]])
    turns = 2.0 * np.pi * np.arange(blades) / blades
    return outline_from_points(np.concatenate([blade @ rotation(turn).T for turn in turns]))


def odd_one() -> Outline:
    """Three arms without any symmetry."""
    return outline_from_points(MM * np.array([[9, 0], [1, 1.5], [-1, 4.5], [-1.5, 0.5], [-6.5, -2], [0.5, -2]]))


def long_arm(factor: float = 1.3) -> Outline:
    """The starfish with its first arm longer: one mirror line is left."""
    points = five().points.copy()
    points[[1, 2]] *= [factor, 1.0]
    return outline_from_points(points)


def rhombus() -> Outline:
    return outline_from_points(MM * np.array([[6, 0], [0, 3], [-6, 0], [0, -3]]))


def spindle() -> Outline:
    """Two pointed ends, and sides without a corner that reaches out."""
    x = np.linspace(-8.0, 8.0, 41)
    y = 2.0 * (1.0 - (x / 8.0) ** 2)
    return outline_from_points(MM * np.column_stack([[*x, *x[-2:0:-1]], [*-y, *y[-2:0:-1]]]))


SHAPES: dict[str, Callable[[], Outline]] = {
    "five arms": five,
    "three arms": lambda: starfish(15 * MM, 7 * MM, None, 0.7 * MM, 3),
    "cross": lambda: starfish(15 * MM, 5 * MM, None, 0.7 * MM, 4),
    "six arms": lambda: starfish(15 * MM, 5 * MM, None, 0.7 * MM, 6),
    "fourteen arms": lambda: starfish(20 * MM, 5 * MM, None, 0.3 * MM, 14),
    "strip": lambda: strip(20 * MM, 3 * MM),
    "rectangle": lambda: strip(10 * MM, 6 * MM),
    "square": lambda: strip(6 * MM, 6 * MM),
    "rhombus": rhombus,
    "spindle": spindle,
    "long arm": long_arm,
    "pinwheel": pinwheel,
    "three blades": lambda: pinwheel(3),
    "odd": odd_one,
}


def found(outline: Outline, tolerance: float = 1e-6) -> tuple[SymmetryGroup, list[Direction]]:
    group = symmetry_within(outline, tolerance)
    return group, directions(find_tips(outline, group), group)


def table(name: str) -> list[tuple[float, tuple[int, ...], tuple[int, ...]]]:
    """Angle [deg], tips moved over and supports, these from 1 as the paper has them."""
    return [
        (round(float(np.degrees(one.angle)), 6), tuple(k + 1 for k in one.over), tuple(k + 1 for k in one.supports))
        for one in found(SHAPES[name]())[1]
    ]


class TestRule:
    """Tips count from 1, counter-clockwise from +x."""

    def test_pentagram(self):
        group, ways = found(five())
        assert (group.order, group.rotation_count, len(group.mirror_angles)) == (10, 5, 5)
        assert np.degrees([one.angle for one in ways]) == pytest.approx(36.0 * np.arange(10))
        for one in ways:
            # Two on one side of the centre face one on the other: tip 1, and tips 2 and 3 of the paper.
            assert sorted(len(part) for part in (one.over, set(one.supports) - set(one.over))) == [1, 2]
            assert one.stable
        assert table("five arms")[:2] == [(0.0, (1,), (1, 3, 4)), (36.0, (1, 2), (1, 2, 4))]
        assert [len(one.over) for one in ways] == [1, 2] * 5

    def test_way_to_the_supports(self):
        """A flat pentagram's centre is its circumradius away from a tip, and cos 36 deg of it from two, if pointed."""
        _, ways = found(starfish(15 * MM, 5.5 * MM, None, 0.0))
        radius = 15 * MM / (2.0 * np.cos(np.pi / 10.0))
        assert [one.travel for one in ways] == pytest.approx([radius, radius * np.cos(np.pi / 5.0)] * 5, rel=1e-5)

    def test_three_arms(self):
        assert table("three arms") == [
            (0.0, (1,), (1, 2, 3)),
            (60.0, (1, 2), (1, 2, 3)),
            (120.0, (2,), (1, 2, 3)),
            (180.0, (2, 3), (1, 2, 3)),
            (240.0, (3,), (1, 2, 3)),
            (300.0, (1, 3), (1, 2, 3)),
        ]

    def test_cross(self):
        """Along an arm the two tips beside the centre face tip 1; between arms two tips face two."""
        assert table("cross") == [
            (0.0, (1,), (1, 2, 4)),
            (45.0, (1, 2), (1, 2, 3, 4)),
            (90.0, (2,), (1, 2, 3)),
            (135.0, (2, 3), (1, 2, 3, 4)),
            (180.0, (3,), (2, 3, 4)),
            (225.0, (3, 4), (1, 2, 3, 4)),
            (270.0, (4,), (1, 3, 4)),
            (315.0, (1, 4), (1, 2, 3, 4)),
        ]
        assert all(one.stable for one in found(SHAPES["cross"]())[1])

    def test_six_arms(self):
        assert table("six arms")[:2] == [(0.0, (1,), (1, 3, 5)), (30.0, (1, 2), (1, 2, 4, 5))]

    @pytest.mark.parametrize(("name", "arms"), [("five arms", 5), ("cross", 4), ("six arms", 6), ("fourteen arms", 14)])
    def test_a_star_has_two_for_each_arm(self, name: str, arms: int):
        group, ways = found(SHAPES[name]())
        assert group.order == len(ways) == 2 * arms
        assert sum(len(one.over) == 1 for one in ways) == arms
        assert len(kinds(group, ways)) == 2

    def test_strip_stands_on_its_ends(self):
        assert table("strip") == [
            (0.0, (1,), (1, 2)),
            (90.0, (1, 2), (1, 2)),
            (180.0, (2,), (1, 2)),
            (270.0, (1, 2), (1, 2)),
        ]
        _, ways = found(SHAPES["strip"]())
        assert all(one.stable for one in ways)
        assert [one.travel for one in ways] == pytest.approx([10 * MM, 1.5 * MM] * 2, rel=1e-4)

    def test_rectangle_stands_on_its_corners(self):
        assert table("rectangle") == [(angle, over, (1, 2, 3, 4)) for angle, over in
                                      [(0.0, (1, 4)), (90.0, (1, 2)), (180.0, (2, 3)), (270.0, (3, 4))]]  # fmt: skip

    def test_square_is_a_cross_turned_by_an_eighth(self):
        assert [(len(over), len(supports)) for _, over, supports in table("square")] == [(2, 4), (1, 3)] * 4

    def test_rhombus(self):
        assert [(over, supports) for _, over, supports in table("rhombus")] == [
            ((1,), (1, 2, 4)), ((2,), (1, 2, 3)), ((3,), (2, 3, 4)), ((4,), (1, 3, 4))]  # fmt: skip

    def test_two_points_carry_nothing(self):
        group = symmetry_within(spindle(), 1e-6)
        ways = directions(find_tips(spindle(), group, 0.01), group)
        assert group.order == 4
        assert [one.over for one in ways] == [(0,), (0, 1), (1,), (0, 1)]
        assert not any(one.stable for one in ways)

    def test_one_mirror_line(self):
        """With one arm longer, the directions are along it: over its tip, and over the two that face it."""
        assert table("long arm") == [(0.0, (1,), (1, 3, 4)), (180.0, (3, 4), (1, 3, 4))]

    def test_short_arms_carry_nothing(self):
        points = starfish(15 * MM, 5 * MM, None, 0.7 * MM, 6).points.copy()
        for k in (1, 3, 5):
            points[3 * k + 1 : 3 * k + 3] *= 0.45
        group, ways = found(outline_from_points(points))
        tips = find_tips(outline_from_points(points), group)
        assert (group.order, len(tips.points), len(ways)) == (6, 6, 6)
        short = set(np.flatnonzero(np.linalg.norm(tips.points, axis=1) < 5 * MM).tolist())
        assert len(short) == 3
        assert not any(short & set(one.supports) for one in ways)

    @pytest.mark.parametrize(("name", "blades"), [("pinwheel", 4), ("three blades", 3)])
    def test_rotations_only(self, name: str, blades: int):
        """No mirror keeps the centre on a line; there is a direction over each tip, and one solution serves all."""
        group, ways = found(SHAPES[name]())
        assert (group.order, group.mirror_angle) == (blades, None)
        assert [one.over for one in ways] == [(k,) for k in range(blades)]
        assert all(one.axis is None and one.stable and len(one.supports) == 3 for one in ways)
        assert kinds(group, ways) == [list(range(blades))]

    def test_no_symmetry(self):
        """Each tip's direction stands alone."""
        group, ways = found(odd_one())
        tips = find_tips(odd_one(), group)
        assert group.order == 1
        assert [one.over for one in ways] == [(0,), (1,), (2,)]
        assert [one.angle for one in ways] == pytest.approx(np.arctan2(*tips.points.T[::-1]) % (2.0 * np.pi))
        assert kinds(group, ways) == [[0], [1], [2]]

    def test_a_round_body_is_refused(self):
        angles = 2.0 * np.pi * np.arange(100) / 100
        disc = outline_from_points(MM * np.column_stack([np.cos(angles), np.sin(angles)]))
        with pytest.raises(BadInput, match="round"):
            check_has_directions(disc)

    def test_tips_are_those_of_the_body(self):
        for name in ("five arms", "cross", "strip", "square", "pinwheel", "odd", "fourteen arms"):
            outline = SHAPES[name]()
            body = build_body(outline, 1 * MM, 0.9 * MM)
            tips = find_tips(outline, symmetry_within(outline, TOLERANCE))
            seen = (body.nodes @ body.tips.T)[:2].T
            assert seen == pytest.approx(tips.points, abs=1e-9)


class TestGroupAndTable:
    @pytest.mark.parametrize("name", SHAPES)
    def test_every_operation_permutes_the_table(self, name: str):
        outline = SHAPES[name]()
        group, ways = found(outline)
        points = find_tips(outline, group).points
        for matrix in group.operations():
            image = images_of_directions(ways, 0.0, matrix, 1e-6)
            tips = images(points.T, matrix, 1e-9)
            assert image is not None
            assert tips is not None
            for one, other in zip(ways, (ways[k] for k in image), strict=True):
                assert sorted(tips[list(one.over)]) == list(other.over)
                assert sorted(tips[list(one.supports)]) == list(other.supports)
                assert (one.travel, one.stable) == (pytest.approx(other.travel), other.stable)

    @pytest.mark.slow
    @settings(max_examples=20)
    @given(
        arms=st.integers(3, 12),
        arm=st.floats(0.2, 0.8),
        tip=st.floats(0.0, 0.6),
        turn=st.floats(0.0, 6.3),
        noise=st.integers(0, 1000),
    )
    def test_a_turned_and_a_drawn_star(self, arms: int, arm: float, tip: float, turn: float, noise: int):
        """Turning turns the directions; a shaking hand keeps their number, and the group still permutes them."""
        inner = 1.0 - arm
        widest = 2.0 * inner * np.tan(np.pi / arms)
        exact = starfish(2.0, arm, None, tip * widest, arms) if arms % 2 == 0 else starfish(
            2.0 * np.cos(np.pi / arms / 2.0), arm, None, tip * widest, arms)  # fmt: skip
        lying = Outline(exact.points @ rotation(turn).T)
        group, ways = found(lying)
        assert (group.order, len(ways)) == (2 * arms, 2 * arms)
        expected = np.sort(np.array([one.angle for one in found(exact)[1]]) + turn) % (2.0 * np.pi)
        angles = np.array([one.angle for one in ways])
        apart = np.abs(np.exp(1j * angles[:, None]) - np.exp(1j * expected[None])).min(axis=1)
        assert apart.max() < 1e-6
        shaken = lying.points + 0.004 * np.random.default_rng(noise).uniform(-1.0, 1.0, lying.points.shape)
        if tip > 0.2 and arm > 0.3 and arms < 9:
            drawn = outline_from_points(shaken)
            group, ways = found(drawn, 0.02)
            assert (group.order, len(ways)) == (2 * arms, 2 * arms)
            assert all(images_of_directions(ways, 0.0, matrix, 1e-6) is not None for matrix in group.operations())

    @pytest.mark.parametrize("name", SHAPES)
    def test_kinds_are_orbits_of_the_rotations(self, name: str):
        group, ways = found(SHAPES[name]())
        sizes = [len(members) for members in kinds(group, ways)]
        assert sum(sizes) == len(ways)
        assert all(group.rotation_count % size == 0 for size in sizes)


class TestTolerance:
    def test_the_exact_group_is_found_too(self):
        for shape in SHAPES.values():
            outline = shape()
            exact, near = symmetry_group(outline), symmetry_within(outline, 1e-6)
            assert (near.rotation_count, len(near.mirror_angles)) == (exact.rotation_count, len(exact.mirror_angles))
            assert max(miss(outline, matrix) for matrix in near.operations()) < 1e-6

    @pytest.mark.parametrize("seed", range(6))
    def test_a_hand_drawn_star_is_symmetric(self, seed: int):
        """Ten corners, each up to 3 % of the reach from its place both ways."""
        rng = np.random.default_rng(seed)
        angles, radii = 0.2 + np.pi / 5.0 * np.arange(10), np.tile([1.0, 0.42], 5)
        corners = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
        outline = outline_from_points(corners + rng.uniform(-0.03, 0.03, corners.shape))
        assert symmetry_group(outline).order == 1
        group, ways = found(outline, TOLERANCE)
        assert (group.order, len(ways)) == (10, 10)
        # The mirror lines are where they were meant to be, to a few degrees.
        apart = np.abs((group.mirror_angles[:, None] - 0.2 - np.pi / 5.0 * np.arange(10) + 0.3) % np.pi - 0.3)
        assert np.degrees(apart.min(axis=1).max()) < 3.0

    def test_one_arm_that_differs_is_noticed(self):
        assert symmetry_within(long_arm(1.12), TOLERANCE).order == 2
        assert symmetry_within(long_arm(1.04), TOLERANCE).order == 10
        assert symmetry_within(long_arm(1.04), 0.01).order == 2

    def test_a_pinwheel_is_not_mistaken_for_a_star(self):
        """Its blades are bent by less than a hand would shake; but as it was drawn exactly, the bend is meant."""
        mirrored = SymmetryGroup(4, float(np.arctan2(1.5, 6.0)))
        assert max(miss(pinwheel(), matrix) for matrix in mirrored.operations()) < TOLERANCE
        assert (symmetry_within(pinwheel(), TOLERANCE).order, symmetry_group(pinwheel()).order) == (4, 4)

    def test_a_polygon_of_many_corners_is_no_circle(self):
        for count in (6, 8, 12, 24):
            angles = 2.0 * np.pi * np.arange(count) / count
            polygon = outline_from_points(np.column_stack([np.cos(angles), np.sin(angles)]))
            assert symmetry_within(polygon, TOLERANCE).order == 2 * count

    def test_miss_of_a_mirrored_rectangle(self):
        """A quarter turn takes a corner (a, b) of a long rectangle to (-b, a): a - b beyond its long side."""
        a, b = 5 * MM, 1 * MM
        assert miss(strip(2 * a, 2 * b), rotation(np.pi / 2.0)) == pytest.approx((a - b) / np.hypot(a, b))
        assert miss(strip(2 * a, 2 * b), reflection(0.0)) < 1e-9

    def test_bumps_of_a_drawing_are_no_tips(self):
        angles = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
        radius = 1.0 + 0.5 * np.cos(5.0 * angles) + 0.01 * np.random.default_rng(3).normal(size=400)
        outline = outline_from_points(np.column_stack([radius * np.cos(angles), radius * np.sin(angles)]))
        group = symmetry_within(outline, TOLERANCE)
        assert group.order == 10
        assert len(find_tips(outline, group).points) == 5

    def test_fourteen_arms_have_fourteen_tips(self):
        assert len(tips_of(SHAPES["fourteen arms"]()).points) == 14


class TestMesh:
    @pytest.mark.parametrize("name", ["five arms", "strip", "pinwheel", "odd"])
    def test_nodes_are_carried_into_themselves(self, name: str):
        outline = SHAPES[name]()
        body = build_body(outline, 1 * MM, 0.9 * MM)
        assert carried_into_itself(body.nodes, body.group, 1e-12).all()

    def test_a_mesh_does_not_follow_more_than_its_own_group(self):
        body = build_body(long_arm(1.04), 1 * MM, 0.9 * MM)
        near = symmetry_within(body.outline, TOLERANCE)
        followed = carried_into_itself(body.nodes, near, 1e-9)
        assert (near.order, followed.sum()) == (10, 2)

    def test_where_nodes_go(self, rng: np.random.Generator):
        points = rng.normal(size=(3, 7))
        both = np.concatenate([points, np.diag([1.0, -1.0, 1.0]) @ points], axis=1)
        assert images(both, reflection(0.0), 1e-12) == pytest.approx([*range(7, 14), *range(7)])
        assert images(both, reflection(0.1), 1e-3) is None


def setting(array: ElectrodeArray, place: tuple[float, float] = (0.0, 0.0), **more: Any) -> Setting:
    states = more.get("states", ["driven"] * array.count)
    return Setting(array, states, more.get("tank", Tank(-1 * MM)), np.array(place))


def order(what: Setting) -> int:
    group = array_group(what)
    assert group is not None
    return group.order


class TestArray:
    @pytest.mark.parametrize(
        ("place", "expected"),
        [((0, 0), 8), ((12.5, 12.5), 2), ((12.5, 0), 2), ((3.0, 0), 2), ((12.5, 12.0), 1), ((37.5, -37.5), 2)],
    )
    def test_square_array(self, place: tuple[float, float], expected: int):
        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        assert order(setting(array, (place[0] * MM, place[1] * MM))) == expected

    def test_diagonal_through_an_inner_electrode(self):
        array = square_array(4, 4, 10 * MM, 15 * MM, 15 * MM)
        about = setting(array, (12.5 * MM, 12.5 * MM))
        group = array_group(about)
        assert group is not None
        assert np.degrees(group.mirror_angles) == pytest.approx([45.0])
        image = electrode_images(about, reflection(np.pi / 4.0))
        assert image is not None
        # Row and column are exchanged.
        assert image.tolist() == np.arange(16).reshape(4, 4).T.ravel().tolist()
        assert electrode_images(about, rotation(np.pi)) is None

    def test_other_arrays(self):
        seven = hexagonal_array(Disc(4 * MM), 3, 3, 10 * MM, 15 * MM)
        assert order(setting(square_array(3, 5, 4 * MM, 6 * MM, 15 * MM))) == 4
        assert order(setting(seven)) == 2
        ring = [Electrode(Disc(3 * MM), 9 * MM * np.array([np.cos(a), np.sin(a), 1.0]), DOWN, 0.0, f"{a:.2f}")
                for a in 2.0 * np.pi * np.arange(6) / 6]  # fmt: skip
        assert order(setting(ElectrodeArray(tuple(ring)))) == 12
        assert order(setting(ElectrodeArray(tuple(ring[:2])))) == 2
        assert array_group(setting(ElectrodeArray((Electrode(Disc(3 * MM), np.array([0, 0, 9 * MM]), DOWN),)))) is None

    @pytest.mark.parametrize(
        ("shape", "frame", "backing", "expected"),
        [
            (Rectangle((4 * MM, 4 * MM)), DOWN, 0.0, 8),
            (Rectangle((4 * MM, 2 * MM)), DOWN, 0.0, 4),
            (Rectangle((4 * MM, 4 * MM)), frame_of((1, 0, 0)), 0.0, 4),
            (Rectangle((4 * MM, 4 * MM)), frame_of((1, 0, 0)), 1 * MM, 2),
            (Rod(1 * MM, 5 * MM), frame_of((1, 1, 0)), 0.0, 4),
            (Rod(1 * MM, 5 * MM), frame_of((1, 0, 1)), 0.0, 2),
            (Block((2 * MM, 2 * MM, 3 * MM)), DOWN, 0.0, 8),
            (Block((2 * MM, 2 * MM, 3 * MM)), frame_of((1, 0, 0)), 0.0, 4),
        ],
    )
    def test_one_electrode(self, shape: Any, frame: Any, backing: float, expected: int):
        one = ElectrodeArray((Electrode(shape, np.array([0.0, 0.0, 9 * MM]), frame, backing),))
        assert order(setting(one)) == expected

    def test_states_and_walls_count(self):
        array = square_array(2, 2, 10 * MM, 15 * MM, 15 * MM)
        assert order(setting(array)) == 8
        assert order(setting(array, states=["driven", "driven", "driven", "off"])) == 2
        assert order(setting(array, states=["driven", "off", "off", "driven"])) == 4
        assert order(setting(array, tank=Tank(-1 * MM, None, (90 * MM, 90 * MM)))) == 8
        assert order(setting(array, tank=Tank(-1 * MM, None, (90 * MM, 120 * MM)))) == 4
        open_wall = Tank(-1 * MM, None, (90 * MM, 90 * MM), (True, False, True, True))
        assert order(setting(array, tank=open_wall)) == 2

    def test_permutations_form_a_group(self):
        about = setting(square_array(4, 4, 10 * MM, 15 * MM, 15 * MM))
        group = array_group(about)
        assert group is not None
        known = {}
        for matrix in group.operations():
            image = electrode_images(about, matrix)
            assert image is not None
            known[tuple(np.round(matrix, 6).ravel() + 0.0)] = image
        assert len({tuple(image) for image in known.values()}) == 8
        for a in group.operations():
            for b in group.operations():
                together = known[tuple(np.round(a @ b, 6).ravel() + 0.0)]
                after = known[tuple(np.round(a, 6).ravel() + 0.0)][known[tuple(np.round(b, 6).ravel() + 0.0)]]
                assert together.tolist() == after.tolist()


@pytest.fixture(scope="module")
def coarse_field() -> FieldSolution:
    """The field of turn-over's electrodes with few panels."""
    scenario = load("turn-over").scenario
    return solve(build_problem(electrode_array(scenario), field_tank(scenario), 0.19, 4))


def common_in(*changes: str) -> tuple[Subject, SymmetryGroup, list[Direction], Common]:
    chosen = subject("turn-over", None, changes)
    assert chosen.loaded is not None
    group, ways = found(chosen.outline, TOLERANCE)
    return chosen, group, ways, common_to(chosen, chosen.loaded.scenario, group, ways, TOLERANCE, None)


class TestTogether:
    def test_turn_over_shares_the_diagonal(self):
        _, group, ways, common = common_in()
        assert [(one.operation.is_reflection, round(np.degrees(one.operation.angle), 6)) for one in common.shared] == [
            (False, 0.0), (True, 45.0)]  # fmt: skip
        assert common.orbits == [[0], [1, 9], [2, 8], [3, 7], [4, 6], [5]]
        assert common.solved == 0
        assert common.mesh == group.order == len(ways) == 10

    @pytest.mark.parametrize(
        ("changes", "shared", "count"),
        [
            # A star in the middle of the array: the mirror lines on which an arm lies are the array's too.
            (["body.pose.position=['0 mm', '0 mm']"], 2, 6),
            (["body.pose.position=['0 mm', '0 mm']", "body.arms=4", "body.arm_length='4 mm'"], 8, 2),
            (["body.arms=4", "body.arm_length='4 mm'"], 2, 5),
            (["body.pose.position=['0 mm', '0 mm']", "body.arms=4", "body.arm_length='4 mm'",
              "body.pose.heading='20 deg'"], 4, 4 // 2),
            (["body.pose.position=['12.5 mm', '11 mm']"], 1, 10),
            (["body.pose.heading='200 deg'"], 1, 10),
            (["electrodes.off=[5]"], 2, 6),
            (["electrodes.off=[1]"], 1, 10),
            (["tank.size=['120 mm', '120 mm']"], 2, 6),
            (["tank.size=['120 mm', '140 mm']"], 1, 10),
        ],
    )  # fmt: skip
    def test_what_is_shared(self, changes: list[str], shared: int, count: int):
        _, _, ways, common = common_in(*changes)
        assert (len(common.shared), len(common.orbits)) == (shared, count)
        assert sorted(k for members in common.orbits for k in members) == list(range(len(ways)))

    def test_obstacles_count(self):
        text = load("turn-over").text
        for y, shared in (("0 mm", 2), ("9 mm", 1)):
            table_text = f'\n[[obstacles]]\nshape = "sphere"\nposition = ["0 mm", "{y}", "5 mm"]\ndiameter = "4 mm"\n'
            Path("mine.toml").write_text(text + table_text, encoding="utf-8")
            chosen = subject("mine.toml")
            assert chosen.loaded is not None
            group, ways = found(chosen.outline)
            common = common_to(chosen, chosen.loaded.scenario, group, ways, TOLERANCE, None)
            assert len(common.shared) == shared

    @pytest.mark.parametrize("place", [(12.5, 12.5), (0.0, 0.0)])
    def test_exchanged_voltages_give_the_image_of_the_field(
        self, coarse_field: FieldSolution, rng: np.random.Generator, place: tuple[float, float]
    ):
        """i(V', g x) = g i(V, x) for every shared operation g, about the robot's place."""
        position = f"body.pose.position=['{place[0]} mm', '{place[1]} mm']"
        _, _, _, common = common_in(position, "body.arms=4", "body.arm_length='4 mm'")
        assert len(common.shared) == (2 if place[0] else 8)
        voltages = rng.uniform(-10.0, 10.0, 16)
        about = MM * np.array([*place, 0.0])[:, None]
        points = rng.uniform(-8 * MM, 8 * MM, (3, 20)) * [[1.0], [1.0], [0.5]] + about + [[0.0], [0.0], [5 * MM]]
        density = coarse_field.current_density(points, voltages[:, None])[0]
        for one in common.shared:
            turn = np.eye(3)
            turn[:2, :2] = one.operation.matrix
            exchanged = carried(voltages, one.electrodes)
            there = coarse_field.current_density(turn @ (points - about) + about, exchanged[:, None])[0]
            assert there == pytest.approx(turn @ density, abs=1e-9 * np.abs(density).max())

    def test_other_permutations_do_not(self, coarse_field: FieldSolution, rng: np.random.Generator):
        voltages, points = rng.uniform(-10.0, 10.0, 16), rng.uniform(0.0, 9 * MM, (3, 20))
        swapped = coarse_field.current_density(points, carried(voltages, np.roll(np.arange(16), 1))[:, None])[0]
        density = coarse_field.current_density(points, voltages[:, None])[0]
        assert np.abs(np.sort(swapped.ravel()) - np.sort(density.ravel())).max() > 0.01 * np.abs(density).max()

    def test_the_robot_elsewhere_sees_the_same_current(self, coarse_field: FieldSolution, rng: np.random.Generator):
        """Laid where the array's symmetry carries it, its surface gets the same inflow, node by node or mirrored."""
        chosen, group, ways, common = common_in()
        body = build_body(chosen.outline, 1 * MM, 1.5 * MM)
        voltages = rng.uniform(-10.0, 10.0, 16)

        def inflow(place: Any, heading: float, volts: Any) -> Any:
            flat = rotation(heading) @ body.nodes[:2] + np.array(place)[:, None]
            return coarse_field.current_density(np.vstack([flat, body.nodes[2] + 1 * MM]), volts[:, None])[0][2]

        here = inflow(chosen.place, chosen.heading, voltages)
        assert len(common.elsewhere) == 4
        for one in common.elsewhere:
            there = inflow(one.place, one.heading, carried(voltages, one.electrodes))
            mirror = images(body.nodes, reflection(ways[common.solved].axis or 0.0), 1e-9)
            assert mirror is not None
            expected = here[mirror] if one.operation.is_reflection else here
            assert there == pytest.approx(expected, abs=1e-9 * np.abs(here).max())
            moved = (one.angle - one.heading - ways[common.solved].angle + 1.0) % (2.0 * np.pi) - 1.0
            assert moved == pytest.approx(0.0, abs=1e-9)
        assert group.order == 10

    def test_patterns_of_many_times_are_carried_at_once(self, rng: np.random.Generator):
        patterns, exchange = rng.normal(size=(16, 5)), rng.permutation(16)
        together = carried(patterns, exchange)
        assert together[exchange].tolist() == patterns.tolist()
        assert carried(patterns[:, 2], exchange).tolist() == together[:, 2].tolist()

    @pytest.mark.slow
    def test_a_turned_body_is_the_same_experiment(self):
        """With the heading that is named for it, each direction of the solved kind lies along the solved one."""
        report = reported("turn-over")
        solved = report["directions"][report["solved"] - 1]
        for way in report["directions"]:
            if way["carries_over"]["how"] != "heading":
                continue
            again = reported("turn-over", "--set", f"body.pose.heading={way['carries_over']['heading']} deg")
            other = again["directions"][way["number"] - 1]
            assert (other["angle"], other["over"]) == (pytest.approx(solved["angle"]), way["over"])
            assert sorted(again["reflections"]) == pytest.approx(sorted(report["reflections"]), abs=1e-5)

    def test_orbits(self):
        assert orbits([], 3) == [[0], [1], [2]]
        assert orbits([np.array([1, 2, 0, 3])], 4) == [[0, 1, 2], [3]]
        assert orbits([np.array([1, 0, 2, 3]), np.array([0, 2, 1, 3])], 4) == [[0, 1, 2], [3]]

    def test_operations_of_a_turned_body(self):
        group = SymmetryGroup(4, 0.3)
        lying = turned(group, 0.5)
        for one in operations_of(lying):
            undone = rotation(-0.5) @ one.matrix @ rotation(0.5)
            assert np.abs(group.operations() - undone).max(axis=(1, 2)).min() < 1e-12
        assert len(operations_of(lying)) == 8


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def reported(*arguments: str) -> dict[str, Any]:
    """What `gelbot directions --json` prints; it prints nothing else."""
    result = runner.invoke(app, ["directions", *arguments, "--json"])
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    return json.loads(result.stdout)


refused = partial(command_line.refused, "directions")


def draw(corners: Any, name: str = "star.svg", head: str = 'viewBox="0 0 100 100"') -> str:
    points = " ".join(f"{x:.3f},{y:.3f}" for x, y in np.asarray(corners))
    Path(name).write_text(f'<svg xmlns="http://www.w3.org/2000/svg" {head}><polygon points="{points}"/></svg>')
    return name


def hand_drawn() -> Any:
    angles = -np.pi / 2.0 + np.pi / 5.0 * np.arange(10)
    radii = np.tile([45.0, 18.0], 5) + np.array([1, 0, -1, 1, 0.5, -0.5, 1, 0, -1, 0.5])
    return 50.0 + np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])


class TestCommand:
    def test_json_of_a_scenario(self):
        report = reported("turn-over")
        assert (report["order"], report["rotations"], report["reflections"]) == (10, 5, [9.0, 45.0, 81.0, 117.0, 153.0])
        assert [tip["number"] for tip in report["tips"]] == [1, 2, 3, 4, 5]
        first = np.array([report["tips"][0]["x_mm"], report["tips"][0]["y_mm"]]) - 12.5
        assert np.degrees(np.arctan2(*first[::-1])) % 360.0 == pytest.approx(225.0)
        assert [(way["angle"], way["mode"], way["supports"]) for way in report["directions"]][:2] == [
            (225.0, "over-one-tip", [1, 3, 4]), (261.0, "over-two-tips", [1, 2, 4])]  # fmt: skip
        how = [way["carries_over"]["how"] for way in report["directions"]]
        assert how == ["solved", *["no", "heading"] * 4, "no"]
        assert report["mesh_order"] == report["exact_order"] == 10
        assert json.loads(Path("directions/turn-over/directions.json").read_text()) == report
        assert load("directions/turn-over/scenario.toml").scenario == load("turn-over").scenario
        for name in ("directions.png", "directions.pdf"):
            assert (Path("directions/turn-over") / name).stat().st_size > 10_000
        reported("turn-over")
        assert Path("directions/turn-over-2/directions.json").exists()

    def test_solved_names_another_direction(self):
        report = reported("turn-over", "--solved", "81")
        assert report["solved"] == 7
        # Its mirror image in the diagonal needs the electrodes of rows and columns exchanged, and nothing else.
        exchanged = report["directions"][4]["carries_over"]
        assert (exchanged["how"], exchanged["by"], exchanged["miss"]) == ("operation", "reflection at 45 deg", 0.0)
        assert exchanged["electrodes"] == np.arange(16).reshape(4, 4).T.ravel().tolist()
        assert "9, 45, 81" in refused("turn-over", "--solved", "60 deg")

    def test_the_solved_direction_moves_the_solution(self):
        report = reported("strip")
        assert [way["carries_over"]["how"] for way in report["directions"]] == ["solved", "no", "operation", "no"]

    def test_table(self):
        result = runner.invoke(app, ["directions", "turn-over", "--out", "there"], env={"COLUMNS": "160"})
        assert result.exit_code == 0, result.output
        for part in (
            "over-one-tip",
            "1, 3, 4",
            "turn the field",
            "heading 153 deg",
            "reflection at 45 deg",
            "order 10",
        ):
            assert part in result.stdout
        assert "results in there" in result.stdout

    def test_hand_drawn_star(self):
        report = reported(draw(hand_drawn()))
        assert (report["order"], report["rotations"], len(report["directions"])) == (10, 5, 10)
        assert report["exact_order"] == 1
        assert 0.0 < report["miss"] <= TOLERANCE
        assert report["array"] is report["orbits"] is report["mesh_order"] is None
        assert all(way["carries_over"] is None for way in report["directions"])
        # One unit of the drawing is a millimetre, y points up.
        assert max(tip["radius_mm"] for tip in report["tips"]) == pytest.approx(45.0, abs=1.5)
        assert any(tip["y_mm"] == pytest.approx(45.0, abs=1.5) for tip in report["tips"])
        assert Path("directions/star/directions.png").exists()
        assert reported("star.svg", "--tolerance", "0.001")["order"] == 1

    def test_a_pen_that_writes_down_every_step(self):
        corners = hand_drawn()
        share = np.linspace(0.0, 1.0, 300, endpoint=False)[:, None]
        ends = zip(corners, np.roll(corners, -1, axis=0), strict=True)
        name = draw(np.concatenate([a + share * (b - a) + 0.2 * np.sin(np.pi * share) * np.cos(20.0 * share)
                                    for a, b in ends]), "pen.svg")  # fmt: skip
        assert len(outline_from_svg(Path(name), None, None).points) > 2000
        assert len(subject(name).outline.points) < 300
        assert (reported(name)["order"], len(reported(name)["tips"])) == (10, 5)

    def test_width_of_a_drawing(self):
        name = draw(hand_drawn())
        extent = np.ptp(outline_from_svg(Path(name), 15 * MM, None).points[:, 0])
        assert extent == pytest.approx(15 * MM)
        small, own = reported(name, "--width", "15 mm"), reported(name)
        assert small["tips"][0]["radius_mm"] / own["tips"][0]["radius_mm"] == pytest.approx(
            15.0 / np.ptp(hand_drawn()[:, 0]), rel=1e-3
        )
        twice = draw(hand_drawn(), "twice.svg", 'width="200mm" height="200mm" viewBox="0 0 100 100"')
        assert reported(twice)["tips"][0]["radius_mm"] == pytest.approx(2.0 * own["tips"][0]["radius_mm"], rel=1e-4)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", SHAPES)
    def test_every_shape_is_drawn(self, name: str):
        outline = SHAPES[name]()
        report = reported(draw(np.array([50.0, 50.0]) + outline.points * [1e3, -1e3]))
        assert report["order"] == symmetry_group(outline).order
        assert len(report["directions"]) == len(found(outline)[1])

    @pytest.mark.parametrize(
        ("content", "part"),
        [
            ("no xml here", "readable SVG"),
            ('<svg xmlns="http://www.w3.org/2000/svg"/>', "closed path"),
            ('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 L 9 0 L 9 9"/></svg>', "closed path"),
            ('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 L 0 9 Z"/></svg>', "has a width"),
            ('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 L 9 0 Z"/></svg>', "three"),
            ('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 L 9 9 L 9 0 L 0 9 Z"/></svg>', "cross itself"),
            ('<svg xmlns="http://www.w3.org/2000/svg"><circle cx="9" cy="9" r="5"/></svg>', "round"),
        ],
    )
    def test_drawings_without_a_body_are_refused(self, content: str, part: str):
        Path("mine.svg").write_text(content)
        assert part in refused("mine.svg")

    def test_other_bad_input(self):
        assert "there is no such file" in refused("nowhere.svg")
        assert "there is no such file" in refused("nowhere.toml")
        assert "Try: turn-over" in refused("turnover")
        Path("folder.svg").mkdir()
        assert "this is a folder" in refused("folder.svg")
        Path("other.json").write_text('{"a": 1}')
        refused("other.json")
        Path("list.json").write_text("[1, 2]")
        refused("list.json")
        assert "--tolerance: got 0.5" in refused("turn-over", "--tolerance", "0.5")
        assert "--tolerance" in refused("turn-over", "--tolerance", "nan")
        assert "--width" in refused("turn-over", "--width", "15 mm")
        name = draw(hand_drawn())
        assert "--width" in refused(name, "--width", "-1 mm")
        assert "--width" in refused(name, "--width", "15")
        assert "--set" in refused(name, "--set", "body.arms=7")
        assert "--solved" in refused(name, "--solved", "3")
        assert "--solved" in refused("turn-over", "--solved", "far")
        assert "--solved" in refused("turn-over", "--solved", "nan")
        Path("held").mkdir()
        Path("held/directions.json").write_text("{}")
        assert "holds directions already" in refused("turn-over", "--out", "held")
