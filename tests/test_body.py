"""Bodies: outlines, their symmetry, and the sheets made of them.

| identity | one road | the other |
|---|---|---|
| symmetry of the mesh | nodes, springs, faces, tetrahedra | their images under every operation of the group |
| up and down alike | springs of two layers | their mirror images in the middle plane |
| volume | outline's area times thickness | tetrahedra; shares of nodes; surface integral of r . n / 3 |
| surface closed | every edge of a face | the same edge of another face, run the other way |
| Euler characteristic | V - E + F of the surface | 2 |
| area | node shares of the surface | 2 area + perimeter times thickness |
| essential points | weights times nodes | the points of the outline |
| rigid motion | points seen after it | points seen before, moved |
| bending | tip angle of an arm laid on a circle | slope of the circle there |
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gelbot.body.lattice import TIP_PART, Body, build_body, tetrahedron_volumes
from gelbot.body.outline import Outline, outline_from_points, outline_from_svg, starfish, strip
from gelbot.body.symmetry import reflection, rotation, symmetry_group
from gelbot.errors import BadInput
from gelbot.points import EssentialPoints, body_frame, observe

MM = 1e-3


def l_outline() -> Outline:
    return outline_from_points(MM * np.array([[0, 0], [9, 0], [9, 4], [4, 4], [4, 7], [0, 7]]))


def pinwheel() -> Outline:
    """Four blades, each a quarter turn from the last, with no mirror."""
    blade = MM * np.array([[1.5, -1.5], [6.0, -1.0], [5.0, 2.0], [2.0, 1.0]])
    return outline_from_points(np.concatenate([blade @ rotation(k * np.pi / 2.0).T for k in range(4)]))


def parallelogram() -> Outline:
    return outline_from_points(MM * np.array([[0, 0], [8, 0], [11, 5], [3, 5]]))


OUTLINES = {
    "starfish": lambda: starfish(15 * MM, 5.45 * MM, 3.5 * MM, 0.8 * MM),
    "starfish with shoulders": lambda: starfish(15 * MM, 5 * MM, 2.4 * MM, 0.8 * MM),
    "pointed starfish": lambda: starfish(15 * MM, 5 * MM, None, 0.0),
    "six arms": lambda: starfish(16 * MM, 5.0 * MM, None, 1.0 * MM, arms=6),
    "strip": lambda: strip(12 * MM, 3 * MM),
    "L": l_outline,
    "pinwheel": pinwheel,
    "parallelogram": parallelogram,
}
GROUP = {  # rotations, mirrors
    "starfish": (5, 5),
    "starfish with shoulders": (5, 5),
    "pointed starfish": (5, 5),
    "six arms": (6, 6),
    "strip": (2, 2),
    "L": (1, 0),
    "pinwheel": (4, 0),
    "parallelogram": (2, 0),
}
THICKNESS = 0.8 * MM


@pytest.fixture(scope="module", params=[(name, layers) for name in OUTLINES for layers in (2, 3)], ids=str)
def case(request: pytest.FixtureRequest) -> tuple[str, Body]:
    name, layers = request.param
    return name, build_body(OUTLINES[name](), THICKNESS, 0.9 * MM, layers)


def image_of_nodes(body: Body, matrix: np.ndarray) -> np.ndarray:
    """Node numbers after the operation: node k goes to where node `image[k]` lies, to 1e-12 m."""
    moved = matrix @ body.nodes
    distance = np.linalg.norm(moved[:, :, None] - body.nodes[:, None, :], axis=0)
    image = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 1e-12
    assert len(np.unique(image)) == len(image)
    return image


def as_set(rows: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(sorted(c)) for c in rows.T.tolist()}


def directed(faces: np.ndarray) -> set[tuple[int, ...]]:
    """Faces with their sense: each row begins at its smallest node."""
    turned = [np.roll(c, -int(np.argmin(c))) for c in faces.T]
    return {tuple(c.tolist()) for c in turned}


def spring_table(springs: np.ndarray, values: np.ndarray) -> dict[tuple[int, int], float]:
    return {(min(i, j), max(i, j)): v for (i, j), v in zip(springs.T.tolist(), values, strict=True)}


class TestSymmetry:
    def test_group_of_the_outline(self, case):
        name, body = case
        assert (body.group.rotation_count, len(body.group.mirror_angles)) == GROUP[name]

    def test_mesh_is_carried_into_itself(self, case):
        _, body = case
        volumes = spring_table(body.springs, body.spring_volume)
        for planar in body.group.operations():
            matrix = np.eye(3)
            matrix[:2, :2] = planar
            image = image_of_nodes(body, matrix)
            assert as_set(image[body.tetrahedra]) == as_set(body.tetrahedra)
            faces = image[body.faces]
            assert directed(faces if np.linalg.det(planar) > 0 else faces[::-1]) == directed(body.faces)
            moved = spring_table(image[body.springs], body.spring_volume)
            assert moved.keys() == volumes.keys()
            assert [moved[s] for s in volumes] == pytest.approx(list(volumes.values()), rel=1e-9)
            assert body.node_volume[image] == pytest.approx(body.node_volume, rel=1e-9)

    def test_adjacent_faces_are_carried_along(self, case):
        _, body = case
        uniform = np.ones(body.faces.shape[1])
        on_spring = (uniform[body.spring_faces] * body.spring_face_weights).sum(axis=0)
        assert set(np.round(on_spring, 12)) <= {0.0, 1.0}
        # Adsorption that has the symmetry of the outline gives springs that have it.
        radial = np.linalg.norm(body.nodes[:2, body.faces].mean(axis=1), axis=0)
        table = spring_table(body.springs, (radial[body.spring_faces] * body.spring_face_weights).sum(axis=0))
        for planar in body.group.operations():
            matrix = np.eye(3)
            matrix[:2, :2] = planar
            image = image_of_nodes(body, matrix)
            values = spring_table(image[body.springs], np.array(list(table.values())))
            assert [values[s] for s in table] == pytest.approx(list(table.values()), rel=1e-9)

    def test_up_and_down_are_alike(self, case):
        _, body = case
        columns = body.nodes.shape[1] // body.layer_count
        layer, column = np.divmod(np.arange(body.nodes.shape[1]), columns)
        image = (body.layer_count - 1 - layer) * columns + column
        volumes = spring_table(body.springs, body.spring_volume)
        mirrored = spring_table(image[body.springs], body.spring_volume)
        assert mirrored.keys() == volumes.keys()
        assert [mirrored[s] for s in volumes] == pytest.approx(list(volumes.values()), rel=1e-9)
        assert body.node_volume[image] == pytest.approx(body.node_volume, rel=1e-9)

    @pytest.mark.parametrize(
        ("outline", "rotations", "mirrors"),
        [
            (strip(4 * MM, 4 * MM), 4, 4),
            (strip(4 * MM, 3 * MM), 2, 2),
            (outline_from_points(MM * np.array([[0, 0], [6, 0], [6, 2], [2, 2], [2, 6], [0, 6]])), 1, 1),
            (outline_from_points(MM * np.array([[0, 0], [4, 0], [2, 4 * np.sqrt(0.75)]])), 3, 3),
            (starfish(15 * MM, 5 * MM, None, 1 * MM, arms=7), 7, 7),
        ],
        ids=["square", "rectangle", "even L", "triangle", "seven arms"],
    )
    def test_known_groups(self, outline, rotations, mirrors):
        group = symmetry_group(outline)
        assert (group.rotation_count, len(group.mirror_angles)) == (rotations, mirrors)
        assert group.order == len(group.operations()) == max(rotations, rotations + mirrors)

    def test_operations_form_a_group(self):
        operations = symmetry_group(starfish(15 * MM, 5 * MM, None, 1 * MM)).operations()
        assert operations[0] == pytest.approx(np.eye(2))
        for a in operations:
            for b in operations:
                assert np.min(np.abs(operations - a @ b).max(axis=(1, 2))) < 1e-12

    def test_a_turned_outline_has_turned_mirrors(self):
        outline = starfish(15 * MM, 5 * MM, None, 1 * MM)
        turned = symmetry_group(Outline(outline.points @ rotation(0.3).T))
        for angle in turned.mirror_angles:
            back = np.min(np.abs((angle - 0.3 - symmetry_group(outline).mirror_angles + np.pi / 2) % np.pi - np.pi / 2))
            assert back < 1e-9

    def test_reflection_keeps_its_line(self):
        line = np.array([np.cos(0.7), np.sin(0.7)])
        across = np.array([-np.sin(0.7), np.cos(0.7)])
        assert reflection(0.7) @ line == pytest.approx(line)
        assert reflection(0.7) @ across == pytest.approx(-across)
        assert rotation(np.pi / 2) @ np.array([1.0, 0.0]) == pytest.approx([0.0, 1.0])


class TestMeasure:
    def test_volume_four_ways(self, case):
        name, body = case
        volume = OUTLINES[name]().area * THICKNESS
        a, b, c = (body.nodes[:, body.faces[k]] for k in range(3))
        by_surface = np.sum(a * np.cross(b, c, axis=0)) / 6.0  # divergence theorem; its sign says: normals point out
        assert tetrahedron_volumes(body.nodes, body.tetrahedra).sum() == pytest.approx(volume, rel=1e-9)
        assert body.node_volume.sum() == pytest.approx(volume, rel=1e-9)
        assert by_surface == pytest.approx(volume, rel=1e-9)
        assert body.volume == pytest.approx(volume, rel=1e-9)
        # Every tetrahedron has six edges.
        assert body.spring_volume.sum() == pytest.approx(6.0 * volume, rel=1e-9)

    def test_tetrahedra_are_positive(self, case):
        _, body = case
        a, b, c, d = (body.nodes[:, body.tetrahedra[k]] for k in range(4))
        signed = np.einsum("ij,ij->j", np.cross(b - a, c - a, axis=0), d - a) / 6.0
        assert signed.min() > 1e-4 * (0.9 * MM) ** 2 * THICKNESS

    def test_surface_is_closed_and_oriented(self, case):
        _, body = case
        i, j, k = body.faces
        edges = list(zip(np.concatenate([i, j, k]).tolist(), np.concatenate([j, k, i]).tolist(), strict=True))
        assert len(set(edges)) == len(edges)
        assert {(b, a) for a, b in edges} == set(edges)

    def test_euler_characteristic(self, case):
        _, body = case
        vertices = len(np.unique(body.faces))
        edges = len({tuple(sorted(e)) for f in body.faces.T.tolist() for e in pairwise([*f, f[0]])})
        assert vertices - edges + body.faces.shape[1] == 2

    def test_surface_area(self, case):
        name, body = case
        outline = OUTLINES[name]()
        area = 2.0 * outline.area + outline.polygon.length * THICKNESS
        assert body.node_area.sum() == pytest.approx(area, rel=1e-9)

    def test_normals_of_lower_and_upper_face(self, case):
        _, body = case
        a, b, c = (body.nodes[:, body.faces[k]] for k in range(3))
        normal = np.cross(b - a, c - a, axis=0)
        z = body.nodes[2, body.faces]
        assert np.all(normal[2, np.all(z == 0.0, axis=0)] < 0.0)
        assert np.all(normal[2, np.all(z == THICKNESS, axis=0)] > 0.0)

    def test_springs_lie_on_the_surface_or_inside(self, case):
        _, body = case
        ends = np.linalg.norm(body.nodes[:, body.springs[1]] - body.nodes[:, body.springs[0]], axis=0)
        assert body.spring_length == pytest.approx(ends, rel=1e-12)
        active = body.spring_face_weights.sum(axis=0) > 0.0
        for s in np.flatnonzero(active):
            corners = [set(body.faces[:, f].tolist()) for f in body.spring_faces[:, s]]
            assert set(body.springs[:, s].tolist()) <= corners[0] | corners[1]
        surface = {tuple(sorted(e)) for f in body.faces.T.tolist() for e in pairwise([*f, f[0]])}
        assert surface <= {tuple(sorted(s)) for s in body.springs[:, active].T.tolist()}

    @settings(max_examples=25)
    @given(
        st.integers(3, 12).flatmap(
            lambda n: st.tuples(
                st.lists(st.floats(2.0, 6.0), min_size=n, max_size=n), st.floats(0.0, 6.0), st.floats(0.7, 1.5)
            )
        )
    )
    def test_any_star_shaped_polygon_is_meshed_to_its_area(self, drawn):
        radii, turn, mesh_size = drawn
        angles = turn + 2.0 * np.pi * np.arange(len(radii)) / len(radii)
        outline = outline_from_points(MM * np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]))
        body = build_body(outline, THICKNESS, mesh_size * MM)
        assert body.volume == pytest.approx(outline.area * THICKNESS, rel=1e-9)

    def test_a_finer_mesh_has_shorter_springs(self):
        coarse, fine = (build_body(strip(12 * MM, 3 * MM), THICKNESS, m * MM) for m in (1.0, 0.5))
        ratio = np.median(coarse.spring_length) / np.median(fine.spring_length)
        assert fine.nodes.shape[1] > 3 * coarse.nodes.shape[1]
        assert ratio > 1.2


class TestStarfish:
    @pytest.mark.parametrize("arms", [3, 4, 5, 6, 7])
    def test_dimensions_of_the_figure(self, arms):
        width, arm, root, tip = 15 * MM, 4.5 * MM, 2.0 * MM, 0.8 * MM
        outline = starfish(width, arm, root, tip, arms)
        corners = outline.points
        radius = np.linalg.norm(corners, axis=1)
        ends = corners[radius > radius.max() * (1.0 - 1e-9)]
        assert len(ends) == 2 * arms
        # The two corners of a tip are `tip` apart; the tip is their middle.
        separations = np.linalg.norm(ends[:, None] - ends[None], axis=-1)
        partner = np.argsort(separations, axis=1)[:, 1]
        assert separations[np.arange(2 * arms), partner] == pytest.approx(np.full(2 * arms, tip))
        middles = (ends + ends[partner]) / 2.0
        assert np.linalg.norm(middles[:, None] - middles[None], axis=-1).max() == pytest.approx(width)
        # Arm 1 along +x: its end, and its root `arm` further in.
        x_tip = middles[:, 0].max()
        root_chord = shapely.LineString([(x_tip - arm + 1e-9, -1.0), (x_tip - arm + 1e-9, 1.0)])
        cut = outline.polygon.intersection(root_chord)
        pieces = [g for g in getattr(cut, "geoms", [cut]) if g.distance(shapely.Point(x_tip - arm, 0.0)) < 1e-6]
        assert pieces[0].length == pytest.approx(root, rel=1e-6)

    def test_roots_that_meet(self):
        outline = starfish(15 * MM, 5.45 * MM, None, 0.8 * MM)
        assert len(outline.points) == 15
        tip_axis = 15 * MM / (2.0 * np.cos(np.pi / 10.0))
        inner = np.linalg.norm(outline.points, axis=1).min()
        # The notch lies on the circle of radius (tip_axis - arm_length) / cos(36 deg).
        assert inner == pytest.approx((tip_axis - 5.45 * MM) / np.cos(np.pi / 5.0))

    def test_essential_points(self, star):
        assert star.nodes @ star.centre == pytest.approx([0.0, 0.0, star.thickness / 2.0], abs=1e-12)
        tip_axis = 15 * MM / (2.0 * np.cos(np.pi / 10.0))
        turn = 2.0 * np.pi * np.arange(5) / 5.0
        for part, weights in ((1.0, star.tips), (TIP_PART, star.tip_bases)):
            r, middle = part * tip_axis, np.full(5, star.thickness / 2.0)
            expected = np.stack([r * np.cos(turn), r * np.sin(turn), middle])
            assert star.nodes @ weights.T == pytest.approx(expected, abs=1e-9)
        for weights in (star.centre[None], star.tips, star.tip_bases):
            assert weights.sum(axis=1) == pytest.approx(np.ones(len(weights)))
            assert weights.min() >= 0.0

    def test_strip_has_two_tips_and_a_square_four(self, sheet):
        body = build_body(strip(12 * MM, 3 * MM), THICKNESS, 1 * MM)
        tips = body.nodes @ body.tips.T
        assert tips[0] == pytest.approx([6 * MM, -6 * MM], abs=1e-9)
        assert tips[1] == pytest.approx([0.0, 0.0], abs=1e-9)
        assert sheet.tips.shape[0] == 4

    def test_hub_triangles_surround_the_centre_counter_clockwise(self, star):
        corners = star.nodes[:2, : star.nodes.shape[1] // star.layer_count][:, star.hub]
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        doubled = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
        assert np.all(doubled > 0.0)
        assert corners.mean(axis=(1, 2)) == pytest.approx([0.0, 0.0], abs=1e-12)


def points_of(body: Body) -> EssentialPoints:
    """The readings of a body, all its columns of nodes as those of the hub."""
    columns = np.arange(body.nodes.shape[1]).reshape(body.layer_count, -1)
    return EssentialPoints(*map(jnp.asarray, (body.centre, body.tips, body.tip_bases, body.hub, columns)))


class TestPoints:
    def test_flat_body(self, star):
        seen = observe(points_of(star), jnp.asarray(star.nodes))
        assert np.asarray(seen.centre) == pytest.approx([0.0, 0.0, star.thickness / 2.0], abs=1e-12)
        assert np.asarray(seen.normal) == pytest.approx([0.0, 0.0, 1.0])
        assert np.asarray(seen.tip_angles) == pytest.approx(np.zeros(5), abs=1e-9)

    @settings(max_examples=15)
    @given(st.integers(0, 10_000))
    def test_moves_with_the_body(self, star, seed):
        rng = np.random.default_rng(seed)
        turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
        points = points_of(star)
        rest, seen = (observe(points, jnp.asarray(x)) for x in (star.nodes, turn @ star.nodes + shift[:, None]))
        assert np.asarray(seen.centre) == pytest.approx(turn @ np.asarray(rest.centre) + shift, abs=1e-12)
        assert np.asarray(seen.normal) == pytest.approx(turn @ np.asarray(rest.normal), abs=1e-9)
        assert np.asarray(seen.tips) == pytest.approx(turn @ np.asarray(rest.tips) + shift[:, None], abs=1e-12)
        frame = np.asarray(body_frame(points, jnp.asarray(turn @ star.nodes)))
        assert frame == pytest.approx(turn @ np.asarray(body_frame(points, jnp.asarray(star.nodes))), abs=1e-9)
        assert frame.T @ frame == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)

    @pytest.mark.parametrize("degrees", [-60.0, 0.0, 30.0, 90.0, 120.0])
    def test_tip_angle_of_a_sheet_laid_on_a_cone_or_a_circle(self, star, degrees):
        """Every radius bent to an arc that has turned by `degrees` at the tip; between base and tip it is a chord."""
        end = np.deg2rad(degrees)
        reach = 15 * MM / (2.0 * np.cos(np.pi / 10.0))
        r = np.linalg.norm(star.nodes[:2], axis=0)
        slope = end * r / reach
        curvature = end / reach
        out = np.where(end == 0.0, r, np.sin(slope) / (curvature or 1.0))
        drop = np.where(end == 0.0, 0.0, (1.0 - np.cos(slope)) / (curvature or 1.0))
        bent = star.nodes.copy()
        bent[:2] *= out / np.maximum(r, 1e-12)
        bent[2] -= drop
        seen = observe(points_of(star), jnp.asarray(bent))
        chord = end * (1.0 + TIP_PART) / 2.0
        assert np.asarray(seen.tip_angles) == pytest.approx(np.full(5, chord), abs=0.02)


class TestRefusals:
    def test_root_too_wide(self):
        with pytest.raises(BadInput, match="where neighbouring arms meet") as error:
            starfish(15 * MM, 6 * MM, 6 * MM, 1 * MM)
        assert error.value.where == "body.root_width"

    def test_arm_too_long(self):
        with pytest.raises(BadInput, match=r"body\.arm_length"):
            starfish(15 * MM, 9 * MM, None, 1 * MM)

    def test_tip_wider_than_root(self):
        with pytest.raises(BadInput, match="tip_width"):
            starfish(15 * MM, 5 * MM, 2 * MM, 3 * MM)

    @pytest.mark.parametrize(
        ("points", "reason"),
        [
            ([[0, 0], [1, 1], [1, 0], [0, 1]], "does not cross itself"),
            ([[0, 0], [1, 1]], "three"),
            ([[0, 0], [1, 1], [2, float("nan")]], "finite"),
            ([[0, 0], [1, 0], [2, 0]], "simple closed outline"),
            ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "three"),
        ],
        ids=["crossing", "two points", "not a number", "no area", "in space"],
    )
    def test_bad_polygons(self, points, reason):
        with pytest.raises(BadInput, match=reason):
            outline_from_points(points)

    def test_clockwise_and_closed_lists_are_the_same_outline(self):
        square = MM * np.array([[0, 0], [3, 0], [3, 3], [0, 3]])
        for points in (square, square[::-1], np.concatenate([square, square[:1]])):
            outline = outline_from_points(points)
            assert outline.polygon.exterior.is_ccw
            assert outline.area == pytest.approx(9e-6)
            assert outline.points.mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-12)


class TestSvg:
    def write(self, folder: Path, shapes: str) -> Path:
        path = folder / "body.svg"
        path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">{shapes}</svg>')
        return path

    def test_circle_area(self, tmp_path):
        outline = outline_from_svg(self.write(tmp_path, '<circle cx="40" cy="30" r="20"/>'), 10 * MM, 0.5 * MM)
        assert outline.area == pytest.approx(np.pi * (5 * MM) ** 2, rel=0.01)
        assert np.ptp(outline.points[:, 0]) == pytest.approx(10 * MM, rel=1e-3)

    def test_path_is_scaled_and_turned_upwards(self, tmp_path):
        # A triangle whose point looks up on the screen, where y counts down.
        outline = outline_from_svg(self.write(tmp_path, '<path d="M 10 60 L 30 60 L 20 20 Z"/>'), 10 * MM, 1 * MM)
        assert len(outline.points) == 3
        assert outline.points[np.argmax(outline.points[:, 1])][0] == pytest.approx(0.0, abs=1e-12)
        assert np.ptp(outline.points, axis=0) == pytest.approx([10 * MM, 20 * MM])
        assert (outline.points[:, 1] > 0.0).sum() == 1

    def test_a_turned_shape_is_turned(self, tmp_path):
        """A rectangle 10 x 4, turned by 30 deg, is 10 cos 30 + 4 sin 30 wide."""
        turned = '<rect x="5" y="8" width="10" height="4" transform="rotate(30 10 10)"/>'
        width = (10.0 * np.sqrt(3.0) / 2.0 + 4.0 / 2.0) * MM
        outline = outline_from_svg(self.write(tmp_path, turned), width, 1 * MM)
        assert outline.area == pytest.approx(40 * MM**2)

    def test_no_closed_path(self, tmp_path):
        with pytest.raises(BadInput, match="closed path"):
            outline_from_svg(self.write(tmp_path, '<path d="M 0 0 L 10 0 L 10 10"/>'), 10 * MM, 1 * MM)

    def test_not_an_svg(self, tmp_path):
        path = tmp_path / "body.svg"
        path.write_text("no xml here")
        with pytest.raises(BadInput, match="readable SVG"):
            outline_from_svg(path, 10 * MM, 1 * MM)
