"""Electrodes as a scenario names them: each layout and shape, tables and drawings, and each kind of mistake explained.

| identity | one road | the other |
|---|---|---|
| electrodes of a file | read from it | written out as a list |
| a field with floating electrodes | asked for | of the voltages that all take |
| plates in a wall | as the scenario has them | as the field sees them, without a back |
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

from gelbot.body.lattice import build_body
from gelbot.control.programme import Command
from gelbot.errors import BadInput
from gelbot.field.electrodes import (
    DOWN,
    Block,
    Disc,
    ElectrodeArray,
    Rectangle,
    Ring,
    Rod,
    Shape,
    frame_of,
    hexagonal_array,
    rectangular_array,
)
from gelbot.field.lead_field import potential_coefficients
from gelbot.points import observe
from gelbot.run import frames_part, static_part
from gelbot.scenario import built_in_text, load
from gelbot.scenario.build import Experiment, build, electrode_array, working_box
from gelbot.scenario.load import Loaded
from gelbot.scenario.overrides import with_overrides
from gelbot.scenario.placement import mounted
from gelbot.simulate import Frame, StepReport

MM = 1e-3
DISC = Disc(10 * MM)
GRID = 'rows=2, columns=3, gap="15 mm"'
DRAWING = """<svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="80mm" viewBox="0 0 100 80">
<g transform="translate(10 10)"><circle id="north" cx="0" cy="0" r="5"/></g>
<ellipse cx="50" cy="10" rx="4" ry="4" transform="rotate(30 50 10)"/>
<rect id="east" x="70" y="35" width="20" height="10" transform="rotate(30 80 40)"/>
<path id="south" d="M10 60 h10 v10 h-10 z"/>
<path id="round" d="M 60,65 a 5,5 0 1 1 -10,0 5,5 0 1 1 10,0 z"/>
<text x="1" y="1">array 3</text>
</svg>"""


def scenario(folder: Path, electrodes: str, *changes: str, files: dict[str, str] | None = None) -> Loaded:
    """The scenario turn-over with these electrodes, in a folder with `files`."""
    for name, text in (files or {}).items():
        (folder / name).write_text(text, encoding="utf-8")
    file = folder / "mine.toml"
    text = with_overrides(built_in_text("dome"), [f"electrodes={{{electrodes}}}", *changes])
    file.write_text(text, encoding="utf-8")
    return load(str(file))


def array_of(folder: Path, electrodes: str, *changes: str, files: dict[str, str] | None = None) -> ElectrodeArray:
    return scenario(folder, electrodes, *changes, files=files).scenario.electrodes.array


class TestLayouts:
    @pytest.mark.parametrize(
        ("keys", "shape"),
        [
            ('side="10 mm"', Rectangle((10 * MM, 10 * MM))),
            ('shape="square", side="10 mm"', Rectangle((10 * MM, 10 * MM))),
            ('shape="rectangle", size=["12 mm", "5 mm"]', Rectangle((12 * MM, 5 * MM))),
            ('shape="disc", diameter="10 mm"', DISC),
            ('shape="ring", diameter="12 mm", inner_diameter="8 mm"', Ring(12 * MM, 8 * MM)),
            ('shape="rod", diameter="3 mm", length="15 mm"', Rod(3 * MM, 15 * MM)),
            ('shape="block", size=["4 mm", "6 mm", "8 mm"]', Block((4 * MM, 6 * MM, 8 * MM))),
        ],
    )
    def test_arrays_of_each_shape(self, tmp_path: Path, keys: str, shape: Shape):
        for layout, make in (("rectangular", rectangular_array), ("hexagonal", hexagonal_array)):
            found = array_of(tmp_path, f'layout="{layout}", {GRID}, pitch="25 mm", {keys}')
            pitch = (25 * MM, 25 * MM) if layout == "rectangular" else 25 * MM
            expected = make(shape, 2, 3, pitch, 15 * MM)
            assert {electrode.shape for electrode in found.electrodes} == {shape}
            assert found.centres == pytest.approx(expected.centres)
            assert all(np.array_equal(e.frame, DOWN) for e in found.electrodes)

    def test_space_is_measured_from_edge_to_edge(self, tmp_path: Path):
        plates = array_of(tmp_path, f'{GRID}, space="5 mm", shape="rectangle", size=["12 mm", "6 mm"]')
        assert np.diff(plates.centres[0, :3]) == pytest.approx(17 * MM)
        assert np.diff(plates.centres[1, ::3]) == pytest.approx(11 * MM)

    def test_a_single_electrode_needs_no_space(self, tmp_path: Path):
        keys = 'rows=1, columns=1, gap="15 mm", shape="disc", diameter="40 mm"'
        assert array_of(tmp_path, keys).centres[:, 0] == pytest.approx([0, 0, 15 * MM])

    def test_an_insulated_back(self, tmp_path: Path):
        keys = f'{GRID}, space="5 mm", side="10 mm", conducts="front"'
        assert {e.backing for e in array_of(tmp_path, keys).electrodes} == {1 * MM}
        assert {e.backing for e in array_of(tmp_path, f'{keys}, backing="3 mm"').electrodes} == {3 * MM}

    def test_a_list(self, tmp_path: Path):
        places = """[
            {position=["0 mm", "0 mm", "10 mm"]},
            {position=["30 mm", "0 mm", "10 mm"], name="wall", axis=[-2, 0, 0], turn="90 deg"},
            {position=["0 mm", "30 mm", "15 mm"], shape="rod", length="20 mm", diameter="3 mm"},
            {position=["0 mm", "-30 mm", "10 mm"], diameter="8 mm"},
        ]"""
        array = array_of(tmp_path, f'layout="list", shape="disc", diameter="10 mm", places={places}'.replace("\n", ""))
        assert [e.shape for e in array.electrodes] == [DISC, DISC, Rod(3 * MM, 20 * MM), Disc(8 * MM)]
        assert [e.name for e in array.electrodes] == ["electrode 0", "wall", "electrode 2", "electrode 3"]
        assert array.centres[:, 1] == pytest.approx([30 * MM, 0, 10 * MM])
        assert array.electrodes[1].frame == pytest.approx(frame_of((-1, 0, 0), np.pi / 2))

    def test_a_table(self, tmp_path: Path):
        text = (
            "x [mm],y_mm,z [cm],name,shape,diameter [mm],size_x [mm],size_y [mm],axis_x,axis_y,axis_z,turn [deg]\n"
            "0,0,,,,,,,,,,\n"
            "# the walls\n"
            "30,0,1,wall,rectangle,,8,6,-1,0,0,\n"
            "-30,0,1,,rod,2,,,,,,\n"
            "0,30,,,square,,,,0,0,1,30\n"
        )
        keys = 'layout="file", file="plan.csv", gap="12 mm", shape="disc", diameter="10 mm", side="5 mm", length="9 mm"'
        array = array_of(tmp_path, keys, files={"plan.csv": text})
        side = 5 * MM
        assert [e.shape for e in array.electrodes] == [
            DISC, Rectangle((8 * MM, 6 * MM)), Rod(2 * MM, 9 * MM), Rectangle((side, side)),
        ]  # fmt: skip
        assert array.centres[2] == pytest.approx(np.array([12, 10, 10, 12]) * MM)
        assert array.electrodes[1].name == "wall"
        assert array.electrodes[3].frame == pytest.approx(frame_of((0, 0, 1), np.radians(30)))

    def test_without_heights_the_lowest_points_are_at_the_gap(self, tmp_path: Path):
        text = "x [mm],y [mm],axis_x,axis_y,axis_z\n0,0,0,0,1\n0,20,1,0,1\n"
        keys = 'layout="file", file="rods.csv", gap="8 mm", shape="rod", diameter="3 mm", length="10 mm"'
        array = array_of(tmp_path, keys, files={"rods.csv": text})
        assert [e.bounds[0][2] for e in array.electrodes] == pytest.approx([8 * MM, 8 * MM])

    def test_a_drawing(self, tmp_path: Path):
        array = array_of(tmp_path, 'layout="file", file="plan.svg", gap="12 mm"', files={"plan.svg": DRAWING})
        assert [e.name for e in array.electrodes] == ["north", "electrode 1", "east", "south", "round"]
        shapes = [e.shape for e in array.electrodes]
        assert [type(s) for s in shapes] == [Disc, Disc, Rectangle, Rectangle, Disc]
        diameters = [s.diameter for s in shapes if isinstance(s, Disc)]
        assert diameters == pytest.approx([10 * MM, 8 * MM, 10 * MM])
        sizes = [s.size for s in shapes if isinstance(s, Rectangle)]
        assert sizes == [pytest.approx((20 * MM, 10 * MM)), pytest.approx((10 * MM, 10 * MM))]
        # The turned rectangle, half 20 x 10 mm, reaches furthest to the right.
        right = 80 + 10 * np.cos(np.pi / 6) + 5 * np.sin(np.pi / 6)
        x, y = (5 + right) / 2, (5 + 70) / 2
        drawn = np.array([[10, 10], [50, 10], [80, 40], [15, 65], [55, 65]])
        assert array.centres[0] == pytest.approx((drawn[:, 0] - x) * MM, abs=1e-8)
        assert array.centres[1] == pytest.approx((y - drawn[:, 1]) * MM, abs=1e-8)
        assert array.centres[2] == pytest.approx(12 * MM)
        low, high = (np.array([e.bounds[k] for e in array.electrodes]) for k in (0, 1))
        assert (low.min(axis=0) + high.max(axis=0))[:2] == pytest.approx([0, 0], abs=1e-8)

    def test_a_drawing_is_mirrored_with_its_angles(self, tmp_path: Path):
        """A rectangle turned clockwise on the screen, y down, is turned clockwise on the array, y up."""
        array = array_of(tmp_path, 'layout="file", file="plan.svg", gap="12 mm"', files={"plan.svg": DRAWING})
        long_side = array.electrodes[2].frame[:, 0]
        assert abs(long_side @ [np.cos(np.pi / 6), -np.sin(np.pi / 6), 0.0]) == pytest.approx(1.0)

    def test_a_drawing_with_an_origin_of_its_own(self, tmp_path: Path):
        keys = 'layout="file", file="plan.svg", gap="12 mm", origin=["50 mm", "40 mm"]'
        array = array_of(tmp_path, keys, files={"plan.svg": DRAWING})
        assert array.centres[:2, 0] == pytest.approx([-40 * MM, 30 * MM])

    @pytest.mark.parametrize("name", ["plan.svg", "plan.csv"])
    def test_a_file_is_written_out_as_a_list(self, tmp_path: Path, name: str):
        table = "x [mm],y [mm],axis_x,axis_y,axis_z,turn [deg],name\n1,2,1,2,3,40,a\n30,0,,,,,\n"
        shape = ', shape="rectangle", size=["9 mm", "5 mm"]' if name == "plan.csv" else ""
        keys = f'layout="file", file="{name}", gap="12 mm", conducts="front", backing="2 mm"{shape}, floating=[1]'
        loaded = scenario(tmp_path, keys, files={"plan.csv": table, "plan.svg": DRAWING})
        (tmp_path / name).rename(tmp_path / "away")
        (tmp_path / "copy.toml").write_text(loaded.text)
        again = load(str(tmp_path / "copy.toml")).scenario
        assert again == loaded.scenario
        assert "file" not in tomllib.loads(loaded.text)["electrodes"]
        assert again.electrodes.states[1] == "floating"
        (tmp_path / "away").rename(tmp_path / name)
        read = array_of(tmp_path, keys)
        for one, other in zip(read.electrodes, again.electrodes.array.electrodes, strict=True):
            assert (one.shape, one.name, one.backing) == (other.shape, other.name, other.backing)
            assert one.centre == pytest.approx(other.centre, abs=1e-15)
            assert one.frame == pytest.approx(other.frame, abs=1e-12)


AT = 'position=["0 mm", "0 mm", "10 mm"]'
BESIDE = 'position=["20 mm", "0 mm", "10 mm"]'
DISCS = 'layout="list", shape="disc", diameter="10 mm"'
RODS, RINGS = 'shape="rod", diameter="2 mm", length="5 mm"', 'shape="ring", diameter="5 mm"'
IN_GEL = 'position=["13 mm", "13 mm", "0.5 mm"]'
FILE = 'layout="file", gap="12 mm", shape="disc", diameter="5 mm"'
SQUARES = f'{GRID}, space="15 mm", side="10 mm"'


def svg(content: str, size: str = 'width="90mm" height="90mm" viewBox="0 0 90 90"') -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{content}</svg>'


# The electrodes, the key, a part of what is given, a part of what is allowed or advised.
MISTAKES = [
    # Keys that are missing.
    ('columns=3, gap="15 mm", space="5 mm", side="9 mm"', "rows", "nothing", 'the layout "rectangular" needs it'),
    ('rows=2, columns=3, pitch="5 mm", side="9 mm"', "gap", "nothing", 'the layout "rectangular" needs it'),
    (f'{GRID}, side="9 mm"', "space", "nothing", "or pitch, from middle to middle"),
    (f'{GRID}, space="5 mm"', "side", "nothing", 'the shape "square" needs it'),
    (f'{GRID}, space="5 mm", shape="rod", diameter="2 mm"', "length", "nothing", 'the shape "rod" needs it'),
    (f'{GRID}, space="5 mm", shape="ring", diameter="9 mm"', "inner_diameter", "nothing", 'the shape "ring" needs it'),
    (f'{GRID}, space="5 mm", shape="block"', "size", "nothing", "3 lengths"),
    ('layout="list", side="5 mm"', "places", "nothing", "[[electrodes.places]]"),
    ('layout="list", places=[]', "places", "nothing", "one for each electrode"),
    (f'{DISCS}, places=[{{name="a"}}]', "places.0.position", "nothing", "a list of three values"),
    (f'layout="list", shape="rod", length="9 mm", places=[{{{AT}}}]', "places.0.diameter", "nothing", "needs it"),
    ('layout="file", gap="12 mm"', "file", "nothing", ".csv or .svg"),
    ('layout="file", file="ok.csv", shape="disc", diameter="5 mm"', "gap", "nothing", "gives electrode 0 no z"),
    # Keys that are not used.
    (f'{SQUARES}, diameter="5 mm"', "diameter", "5 mm", 'the shape "square" has no diameter, but side'),
    (f'{GRID}, space="5 mm", shape="disc", diameter="9 mm", side="9 mm"', "side", "9 mm", "but diameter"),
    (f'{SQUARES}, pitch="25 mm"', "pitch", "25 mm", "one of space and pitch"),
    (f'{SQUARES}, file="a.csv"', "file", "a.csv", 'the layout "rectangular" has no file'),
    (f'{DISCS}, rows=2, places=[{{{AT}}}]', "rows", "2", 'the layout "list" has no rows, but places'),
    (f'{DISCS}, gap="9 mm", places=[{{{AT}}}]', "gap", "9 mm", 'the layout "list" has no gap'),
    (f'{SQUARES}, places=[{{{AT}}}]', "places", "1 tables", "has no places"),
    (f'{DISCS}, length="9 mm", places=[{{{AT}}}]', "length", "9 mm", "no electrode of this layout uses it"),
    (f'{DISCS}, places=[{{{AT}, length="9 mm"}}]', "places.0.length", "9 mm", 'the shape "disc" has no length'),
    (f'{DISCS}, places=[{{{AT}, gap="9 mm"}}]', "places.0.gap", "9 mm", "the keys shape, side"),
    ('layout="file", file="z.csv", gap="9 mm", shape="disc", diameter="5 mm"', "gap", "9 mm", "no electrode"),
    (f'{FILE}, file="ok.csv", origin=["0 mm", "0 mm"]', "origin", "0 mm, 0 mm", "only a drawing"),
    ('layout="file", gap="12 mm", file="plan.svg", shape="disc"', "shape", "disc", "no electrode"),
    (f'{SQUARES}, backing="1 mm"', "backing", "1 mm", 'conducts = "front"'),
    (f'{GRID}, pitch="9 mm", {RODS}, conducts="front"', "conducts", "front", "all over"),
    # Values.
    (f'{SQUARES}, layout="round"', "layout", "round", "'rectangular', 'hexagonal', 'list' or 'file'"),
    (f'{SQUARES}, shape="oval"', "shape", "oval", "'disc'"),
    (f'{GRID}, space="5 mm", shape="rectangle", size=["5 mm"]', "size", "5 mm", "a list of two or three values"),
    (f'{GRID}, space="5 mm", shape="block", size=["5 mm", "4 mm"]', "size", "5 mm, 4 mm", "3 lengths"),
    (f'{GRID}, pitch="9 mm", {RINGS}, inner_diameter="5 mm"', "inner_diameter", "5 mm", "less than"),
    (f'{DISCS}, places=[{{{AT}, axis=[0, 0, 0]}}]', "places.0.axis", "[0.0, 0.0, 0.0]", "not all zero"),
    (f'{DISCS}, places=[{{{AT}, turn="3 mm"}}]', "places.0.turn", "3 mm", "an angle"),
    (f'{SQUARES}, bubbling="3 mA"', "bubbling", "3 mA", "greater than 0"),
    (f'{SQUARES}, panels=64', "panels", "64, that is 24576 panels in all", "at most 20000"),
    # Places.
    (f'{GRID}, pitch="10 mm", side="10 mm"', "pitch", "electrode 0 and electrode 1, which overlap", "apart"),
    (f'{DISCS}, places=[{{{AT}}}, {{{AT}, name="b"}}]', "places.1", 'electrode 0 and electrode 1 "b"', "apart"),
    (f'{FILE}, file="twice.csv"', "file", "electrode 0 and electrode 1", "apart"),
    (f'{DISCS}, places=[{{{IN_GEL}}}]', "places.0", "electrode 0, which reaches into the gel", "or above z = 1 mm"),
    (f'{DISCS}, places=[{{{AT}, name="a"}}, {{{BESIDE}, name="a"}}]', "places.1", '"a" for electrode 0 and', "differ"),
    # States.
    (f"{SQUARES}, grounded=[6]", "grounded", "6", "numbers from 0 to 5"),
    (f"{SQUARES}, off=[-1]", "off", "-1", "numbers from 0 to 5"),
    (f'{SQUARES}, off=["electrode 9"]', "off", "electrode 9", "names of electrodes"),
    (f"{SQUARES}, floating=[true]", "floating", "[True]", "a list of numbers and names"),
    (f'{DISCS}, places=[{{{AT}, name="north"}}, {{{BESIDE}}}], grounded=["nord"]', "grounded", "nord", "Try: north"),
    (f"{SQUARES}, grounded=[1], off=[1]", "off", "electrode 1", "already in grounded"),
    (f"{SQUARES}, grounded=[1, 1]", "grounded", "electrode 1", "already in grounded"),
    (f"{SQUARES}, grounded=[0, 1, 2], off=[3, 4, 5]", "off", "all electrodes that were left", "stays driven"),
    # Files.
    (f'{FILE}, file="none.csv"', "file: none.csv", "no file", "No such file"),
    (f'{FILE}, file="plan.txt"', "file", "plan.txt", ".csv or .svg"),
    (f'{FILE}, file="word.csv"', "file: word.csv, line 3", "two", "a finite number"),
    (f'{FILE}, file="oval.csv"', "file: oval.csv, line 2: shape", "oval", "'disc'"),
    (f'{FILE}, file="small.csv"', "file: small.csv, line 3: diameter", "-0.002 m", "greater than 0"),
    (f'{FILE}, file="long.csv"', "file: long.csv, line 2.length", "2 mm", 'the shape "disc" has no length'),
    (f'{FILE}, file="axis.csv"', "file: axis.csv, line 2", "axis_x and axis_z alone", "axis_x, axis_y, axis_z"),
    ('layout="file", gap="9 mm", file="line.svg"', 'file: line.svg, element "l"', "another shape", "circles"),
    ('layout="file", gap="9 mm", file="oval.svg"', 'file: oval.svg, element "o"', "another shape", "circles"),
    ('layout="file", gap="9 mm", file="skew.svg"', "file: skew.svg, element 1 (rect)", "another shape", "circles"),
    ('layout="file", gap="9 mm", file="arc.svg"', 'file: arc.svg, element "a"', "another shape", "circles"),
    ('layout="file", gap="9 mm", file="empty.svg"', "file: empty.svg", "no circle", "at least one"),
    ('layout="file", gap="9 mm", file="pixels.svg"', "file: pixels.svg, <svg>", "width='90'", "mm, cm or in"),
    ('layout="file", gap="9 mm", file="torn.svg"', "file: torn.svg", "no drawing", "an SVG file"),
]  # fmt: skip
FILES = {
    "ok.csv": "x [mm],y [mm]\n0,0\n",
    "z.csv": "x [mm],y [mm],z [mm]\n0,0,9\n",
    "twice.csv": "x [mm],y [mm]\n0,0\n0.1,0\n",
    "word.csv": "x [mm],y [mm]\n0,0\n1,two\n",
    "oval.csv": "x [mm],y [mm],shape\n0,0,oval\n",
    "small.csv": "x [mm],y [mm],diameter [mm]\n0,0,1\n9,0,-2\n",
    "long.csv": "x [mm],y [mm],length [mm]\n0,0,2\n",
    "axis.csv": "x [mm],y [mm],axis_x,axis_z\n0,0,1,1\n",
    "plan.svg": DRAWING,
    "line.svg": svg('<circle r="3"/><line id="l" x2="9" y2="9"/>'),
    "oval.svg": svg('<circle id="o" r="3" transform="scale(1 2)"/>'),
    "skew.svg": svg('<rect width="9" height="9" transform="skewX(20)"/>'),
    "arc.svg": svg('<path id="a" d="M 0 0 A 5 5 0 0 1 10 0 z"/>'),
    "empty.svg": svg("<text>nothing</text>"),
    "pixels.svg": svg('<circle r="3"/>', 'width="90" height="90"'),
    "torn.svg": "<svg><circle",
}


@pytest.mark.parametrize(("electrodes", "key", "given", "allowed"), MISTAKES)
def test_a_mistake_is_explained(tmp_path, monkeypatch, electrodes: str, key: str, given: str, allowed: str):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text, encoding="utf-8")
    Path("mine.toml").write_text(
        with_overrides(built_in_text("dome"), [f"electrodes={{{electrodes}}}"]), encoding="utf-8"
    )
    with pytest.raises(BadInput) as refused:
        load("mine.toml")
    assert refused.value.where == f"mine.toml: electrodes.{key}"
    assert given in str(refused.value.given)
    assert allowed in str(refused.value)


TANK = 'tank={floor_depth="1 mm", depth="30 mm", size=["80 mm", "60 mm"], friction=0.1}'
OUTSIDE = [
    ("through the surface", '"0 mm", "0 mm", "25 mm"', "", "tank.depth", "at least 35 mm: electrode 0"),
    ("through the floor", '"30 mm", "0 mm", "5 mm"', "", "tank.floor_depth", "at least 5 mm: electrode 0"),
    ("through a wall in x", '"-39 mm", "0 mm", "15 mm"', "", "tank.size", "at least 82 mm in x: electrode 0"),
    ("through a wall in y", '"0 mm", "25 mm", "15 mm"', "axis=[0, 1, 0]", "tank.size", "at least 70 mm in y"),
]  # fmt: skip


class TestTank:
    @pytest.mark.parametrize(("place", "more", "key", "allowed"), [o[1:] for o in OUTSIDE], ids=[o[0] for o in OUTSIDE])
    def test_an_electrode_outside(self, tmp_path: Path, place: str, more: str, key: str, allowed: str):
        keys = f'layout="list", shape="rod", diameter="4 mm", length="20 mm", places=[{{position=[{place}], {more}}}]'
        with pytest.raises(BadInput) as refused:
            scenario(tmp_path, keys.replace(", }", "}"), TANK)
        assert refused.value.where.endswith(f": {key}")
        assert allowed in refused.value.allowed

    def test_rods_may_begin_at_the_surface_and_plates_lie_in_the_walls(self, tmp_path: Path):
        places = """[
            {position=["0 mm", "0 mm", "25 mm"], shape="rod", diameter="4 mm", length="10 mm"},
            {position=["20 mm", "0 mm", "30 mm"]},
            {position=["-20 mm", "0 mm", "-1 mm"], axis=[0, 0, 1]},
            {position=["40 mm", "0 mm", "15 mm"], axis=[-1, 0, 0]},
            {position=["0 mm", "-30 mm", "15 mm"], axis=[0, 1, 0]},
            {position=["0 mm", "20 mm", "29 mm"]},
        ]""".replace("\n", "")
        keys = f'layout="list", shape="disc", diameter="10 mm", conducts="front", places={places}'
        made = scenario(tmp_path, keys, TANK).scenario
        # What lies in a wall needs no back of its own.
        assert [e.backing for e in made.electrodes.array.electrodes] == [0.0, *[1 * MM] * 5]
        assert [e.backing for e in mounted(made.electrodes.array, made.tank).electrodes] == [0.0] * 5 + [1 * MM]

    def test_a_front_against_a_wall(self, tmp_path: Path):
        place = 'position=["40 mm", "0 mm", "15 mm"], axis=[1, 0, 0]'
        keys = f'layout="list", shape="disc", diameter="10 mm", conducts="front", places=[{{{place}}}]'
        with pytest.raises(BadInput, match=r"places.0: .*electrode 0, whose front lies against a boundary"):
            scenario(tmp_path, keys, TANK)

    def test_a_back_through_the_surface(self, tmp_path: Path):
        keys = 'rows=2, columns=3, gap="29.5 mm", space="5 mm", side="10 mm", conducts="front"'
        with pytest.raises(BadInput, match=r"tank.depth: .*at least 30.5 mm: electrode 0"):
            scenario(tmp_path, keys)
        scenario(tmp_path, keys.replace("29.5", "30"))
        scenario(tmp_path, keys + ', backing="0.5 mm"')


class TestStates:
    def test_numbers_and_names(self, tmp_path: Path):
        places = ", ".join(
            f'{{position=["{20 * n} mm", "0 mm", "10 mm"], name="{name}"}}' for n, name in enumerate("abcd")
        )
        keys = f'{DISCS}, places=[{places}], grounded=["b"], floating=[2], off=["d"]'
        states = scenario(tmp_path, keys).scenario.electrodes.states
        assert states == ("driven", "grounded", "floating", "off")

    def test_all_are_driven_if_nothing_is_said(self):
        assert set(load("dome").scenario.electrodes.states) == {"driven"}


@pytest.mark.parametrize(
    ("pattern", "given", "allowed"),
    [
        ([1] * 5, "5 voltages", "6 voltages, one for each of the 2 x 3 electrodes"),
        ([[1] * 2] * 3, "3 rows", "2 rows of 3"),
    ],
)
def test_voltages_for_the_electrodes_of_an_array(tmp_path: Path, pattern: list, given: str, allowed: str):
    for layout in ("rectangular", "hexagonal"):
        with pytest.raises(BadInput) as refused:
            scenario(tmp_path, f'layout="{layout}", {SQUARES}', f"programme.phases.0.pattern={pattern}")
        assert given in str(refused.value.given)
        assert allowed in refused.value.allowed


def test_voltages_for_the_electrodes_of_a_list(tmp_path: Path):
    keys = f"{DISCS}, places=[{{{AT}}}, {{{BESIDE}}}]"
    with pytest.raises(BadInput, match="2 voltages, one for each of the 2 electrodes; there are more"):
        scenario(tmp_path, keys, "programme.phases.0.pattern=[1, 1, 1]")
    assert scenario(tmp_path, keys, "programme.phases.0.pattern=[1, -1]").scenario.programme.phases[0].shares == (1, -1)


def test_new_keys_have_their_defaults():
    made = load("dome").scenario
    assert made.electrodes.bubbling == pytest.approx(100.0)
    assert made.electrodes.panels == 12
    assert made.supply.current_limit is None
    assert made.material.conductivity is None
    made = load("dome", ["supply.current_limit=100 mA", "material.conductivity=2 mS/cm"]).scenario
    assert made.supply.current_limit == pytest.approx(0.1)
    assert made.material.conductivity == pytest.approx(0.2)


HEXAGON = 'layout="hexagonal", rows=2, columns=2, gap="15 mm", pitch="25 mm", shape="disc", diameter="10 mm", panels=6'
COARSE = ("body.mesh_size=2 mm", 'body.pose.position=["0 mm", "0 mm"]')


@pytest.fixture(scope="module")
def experiments(tmp_path_factory: pytest.TempPathFactory) -> tuple[Experiment, Experiment]:
    """All driven; one grounded and one floating."""
    folder, changes = tmp_path_factory.mktemp("scenarios"), (*COARSE, "programme.phases.0.pattern=[1, -1, 0.5, 1]")
    states = "", ', grounded=[3], floating=["electrode 1"]'
    driven, some = (build(scenario(folder, HEXAGON + more, *changes).scenario) for more in states)
    return driven, some


class TestBuild:
    """Electrodes that are not driven: the field of a run is that of the voltages that all electrodes take."""

    def test_the_lead_field_is_that_of_the_voltages_taken(self, experiments):
        driven, some = experiments
        asked = np.array([7.0, -3.0, 2.0, 5.0])
        taken = some.connection @ asked
        assert taken[[0, 2, 3]] == pytest.approx([7.0, 2.0, 0.0])
        assert 0.0 < taken[1] < 7.0
        found = np.asarray(potential_coefficients(some.model.lead, asked))
        assert found == pytest.approx(np.asarray(potential_coefficients(driven.model.lead, taken)), abs=1e-9)
        assert np.array_equal(driven.connection, np.eye(4))

    def test_what_is_not_connected_gets_no_voltage_of_the_supply(self, experiments):
        driven, some = experiments
        assert driven.programme.phases.patterns[0] == pytest.approx(np.array([1, -1, 0.5, 1]))
        assert some.programme.phases.patterns[0] == pytest.approx(np.array([1, 0, 0.5, 0]))

    def test_voltages_and_currents_are_recorded(self, experiments):
        _, some = experiments
        voltages = np.array([[7.0, 0.0, 2.0, 0.0]])
        seen = jax.tree.map(lambda a: a[None], observe(some.model.points, some.state.positions))
        command = Command(*[np.zeros(1)] * len(Command._fields))
        state, report = some.state, StepReport(np.ones(1), np.zeros(1), np.zeros(1, int))
        frames = Frame(
            np.ones(1), state.positions[None], state.ads[None], voltages, seen, command, report, np.ones(1, int)
        )
        part = frames_part(some, frames)
        assert part["voltage"].values == pytest.approx(voltages)
        assert part["electrode_potential"].values == pytest.approx(voltages @ some.connection.T)
        current = part["electrode_current"].values[0]
        assert current[1] == pytest.approx(0.0, abs=1e-15)
        assert current.sum() == pytest.approx(0.0, abs=1e-15)
        assert current[0] > 0.0 > current[3]

    def test_the_outlines_and_states_are_recorded(self, experiments):
        _, some = experiments
        part = static_part(some, Loaded(some.scenario, "", "mine.toml"))
        outline = part["electrode_outline"].transpose("electrode", "space", "outline_corner").values
        assert np.ptp(outline, axis=2) == pytest.approx(np.tile([10 * MM, 10 * MM, 0.0], (4, 1)))
        assert part.attrs["electrode_states"] == ["driven", "floating", "driven", "grounded"]

    def test_the_working_box_ends_below_what_hangs_above_the_body(self, tmp_path: Path):
        places = """[
            {position=["0 mm", "0 mm", "12 mm"]},
            {position=["30 mm", "0 mm", "5 mm"], shape="rod", diameter="2 mm", length="12 mm"},
            {position=["0 mm", "0 mm", "-1 mm"], axis=[0, 0, 1]},
        ]""".replace("\n", "")
        keys = f'layout="list", shape="disc", diameter="10 mm", places={places}'
        made = scenario(tmp_path, keys, *COARSE, "programme.phases.0.pattern=cathode").scenario
        body = build_body(made.body.outline(), made.body.thickness, made.body.mesh_size, made.body.layers)
        low, high = working_box(made, body, electrode_array(made))
        assert (low[2], high[2]) == pytest.approx((0.0, 9.25 * MM))  # a quarter of the room above the body is left
        without = ElectrodeArray(electrode_array(made).electrodes[1:])
        assert working_box(made, body, without)[1][2] > 15 * MM
