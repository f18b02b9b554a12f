"""The field of a scenario in numbers, files and pictures.

| identity | where |
|---|---|
| currents sum to zero, I = C V, power = V . I | test_numbers_agree_with_each_other |
| mean density = current / conducting area, both sides of a plate | test_conducting_area |
| a floating electrode carries no current, a grounded one has 0 V | test_states |
| field.nc, points.csv = lead potential, lead current density times voltages | test_the_data_set_holds..., test_points |
| a gel that conducts as the solution changes nothing | test_a_gel_like_the_solution_changes_nothing |
| inside a gel of conductivity s the current density is -s grad phi | test_current_density_inside_the_gel |
| a closed surface is seen under 4 pi from inside, 0 from outside | test_inside |
| the plane's cut of a disc is its chord, of a ring two of them, of a block a rectangle | test_cuts |
"""

import json
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from typer.testing import CliRunner

import command_line
from gelbot.body.lattice import Body
from gelbot.cli import app
from gelbot.errors import BadInput
from gelbot.field.charge import build_problem, solve
from gelbot.field.electrodes import (
    DOWN,
    Block,
    Disc,
    Electrode,
    ElectrodeArray,
    Rectangle,
    Ring,
    Rod,
    frame_of,
    square_array,
)
from gelbot.field.gel import gel_panels
from gelbot.field.gel_effect import gel_effect
from gelbot.field.images import Tank
from gelbot.field.operating_point import Excess, Limits, conducting_area, excesses, operating_point
from gelbot.field.outlines import outlines
from gelbot.field.panels import panels_of
from gelbot.field.winding import inside
from gelbot.field_report.asked import Plane, Request, drive, planes
from gelbot.field_report.moment import at_start
from gelbot.field_report.report import checked, report_field
from gelbot.field_report.sampling import grid, on_electrode, view
from gelbot.field_report.words import NAMED, message
from gelbot.record.json_text import as_text
from gelbot.record.run_store import RunStore
from gelbot.record.whole_file import write_through
from gelbot.scenario import load
from gelbot.scenario.build import electrode_array
from gelbot.scenario.load import Loaded
from gelbot.show.cuts import across, chained, cut, silhouette, surface_cut
from gelbot.show.field_map import Section
from gelbot.show.field_table import ALL_UP_TO, LARGEST, electrode_table, print_field
from gelbot.show.outlines import Outline

runner = CliRunner()
SMALL = ["electrodes.rows=2", "electrodes.columns=2", "electrodes.panels=4", "body.mesh_size='1.5 mm'"]
"""Four plates, at the corners of a square of 25 mm; the body under the last of them."""
SETS = [word for change in SMALL for word in ("--set", change)]
POINTS = "x [mm],y [mm],z [mm]\n0,0,1\n12.5,12.5,0.5\n-20, 3.25, 29\n"


def small(*changes: str) -> Loaded:
    return load("turn-over", [*SMALL, *changes])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A field with everything in it; its floating electrode makes the states matter."""
    base = tmp_path_factory.mktemp("field")
    (base / "at.csv").write_text(POINTS)
    request = Request(amplitude="4 V", points=base / "at.csv", gel_conductivity="0.6 S/m")
    report_field(small("electrodes.floating=[1]"), request, base / "out", progress=False)
    return base / "out"


@pytest.fixture(scope="module")
def report(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "field.json").read_text())


@pytest.fixture
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


refused = partial(command_line.refused, "field")


# What field.json says


def test_numbers_agree_with_each_other(report: dict[str, Any]):
    current, voltage = np.array(report["currents_A"]), np.array(report["electrode_voltages_V"])
    assert report["net_current_A"] == pytest.approx(0.0, abs=1e-12)
    assert current.sum() == pytest.approx(0.0, abs=1e-12)
    assert report["total_current_A"] == pytest.approx(current[current > 0].sum())
    np.testing.assert_allclose(np.array(report["conductance_S"]) @ voltage, current, atol=1e-14)
    assert report["power_W"] == pytest.approx(voltage @ current)
    np.testing.assert_allclose(report["mean_current_density_A_m2"], current / 2e-4, rtol=1e-9, atol=1e-9)
    assert report["name"] == "turn-over"
    assert report["drive"] == 'phase "preparation", ridge at 4 V'
    assert (report["panels_per_side"], report["panels"] > 4 * 16) == (4, True)
    assert set(report["gel"]) >= {"relative_change_rms", "relative_change_max", "conductance_change"}
    assert [entry["plane"] for entry in report["planes"]] == ["y = 12.5 mm", "z = 0.5 mm"]


def test_states(report: dict[str, Any]):
    # The ridge through the robot's electrode, 3, is 0 and 3; of the other two one floats.
    assert report["states"] == ["driven", "floating", "driven", "driven"]
    assert report["voltages_V"] == [-4.0, 0.0, 4.0, -4.0]
    assert report["currents_A"][1] == pytest.approx(0.0, abs=1e-14)
    assert -4.0 < report["electrode_voltages_V"][1] < 4.0


def test_lists_stand_on_one_line(folder: Path, report: dict[str, Any]):
    text = (folder / "field.json").read_text()
    assert '"states": ["driven", "floating", "driven", "driven"]' in text
    assert json.loads(as_text(report)) == report
    odd = {"names": ['a], [b\n"', "{c}"], "empty": [], "rows": [[1, 2], [3, 4]]}
    assert json.loads(as_text(odd)) == odd


def test_default_is_the_first_phase_at_the_limit_of_the_supply():
    loaded = small()
    array, moment = electrode_array(loaded.scenario), at_start(loaded.scenario)
    asked = drive(Request(), loaded.scenario, array, moment)
    np.testing.assert_array_equal(asked.voltages, [-10.0, 10.0, 10.0, -10.0])
    fixed = small("programme.phases.0.drive='3 V'").scenario
    np.testing.assert_array_equal(drive(Request(), fixed, array, moment).voltages, [-3.0, 3.0, 3.0, -3.0])
    named = drive(Request(template="cathode", amplitude="-2"), loaded.scenario, array, moment)
    np.testing.assert_array_equal(named.voltages, [-2.0, -2.0, -2.0, 2.0])


@pytest.mark.parametrize("text", ["-1, 2, 0.5, 300 mV", "-1 2 0.5 300mV", "-1 V 2 V, .5 0.3", "-1V,2V,+.5V,3e-1"])
def test_voltages_are_read(text: str):
    loaded = small()
    asked = drive(Request(voltages=text), loaded.scenario, electrode_array(loaded.scenario), at_start(loaded.scenario))
    np.testing.assert_allclose(asked.voltages, [-1.0, 2.0, 0.5, 0.3])


# Warnings


def test_excesses_have_their_numbers():
    array = square_array(1, 2, 10e-3, 15e-3, 15e-3)
    field = solve(build_problem(array, Tank(-1e-3), 0.2, 4))
    point = operating_point(field, np.array([12.0, -3.0]), ["driven", "driven"])
    body = np.zeros((3, 1))
    total, density = point.total_current, np.abs(point.mean_density).max()

    assert excesses(point, Limits(12.0, total, density), body, 0.01) == []
    found = excesses(point, Limits(2.0, total / 2.0, density / 4.0), body, 0.02)
    assert found == [
        Excess("voltage", 12.0, 2.0, (0, 1)),
        Excess("current", total, total / 2.0),
        Excess("bubbling", pytest.approx(density), density / 4.0, (0, 1)),
        Excess("error", 0.02, 0.01),
    ]
    # A node 1 mm below the first plate sees its panels, the widest of which are some 4 mm wide.
    (coarse,) = excesses(point, Limits(12.0, None, density), array.centres[:, :1] - [[0.0], [0.0], [1e-3]], None)
    assert (coarse.kind, coarse.electrodes) == ("panels", (0,))
    assert coarse.value > 1.0


def test_an_electrode_that_is_not_driven_asks_nothing_of_the_supply():
    field = solve(build_problem(square_array(1, 2, 10e-3, 15e-3, 15e-3), Tank(-1e-3), 0.2, 4))
    point = operating_point(field, np.array([1.0, 50.0]), ["driven", "grounded"])
    assert point.voltages.tolist() == [1.0, 0.0]
    assert excesses(point, Limits(2.0, None, 1e9), np.zeros((3, 1)), None) == []


def test_messages_name_the_worst_and_count_the_rest():
    names = [f"electrode {n}" for n in range(12)]
    excess = Excess("bubbling", 250.0, 100.0, (7, 3, 1, 0, 2, 4))
    text = message(excess, names)
    assert text.startswith("electrode 7, electrode 3, electrode 1, electrode 0 and 2 more: ")
    assert "25 mA/cm^2" in text
    assert "10 mA/cm^2" in text
    assert len(excess.electrodes) == NAMED + 2
    for kind, parts in {
        "voltage": ("12 V", "10 V", "supply.limit"),
        "current": ("12 A", "10 A", "supply.current_limit"),
        "panels": ("12", "10", "electrodes.panels"),
        "error": ("1.2e+03 %", "1e+03 %", "electrodes.panels"),
        "idle": ("12 V", "no current flows"),
    }.items():
        assert all(part in message(Excess(kind, 12.0, 10.0, (0, 1)), names) for part in parts), kind
    assert "1.04 %, more than 1 %" in message(Excess("error", 0.0104, 0.01), names)
    assert "electrode 3 alone" in message(Excess("idle", 12.0, 0.0, (3,)), names)


def test_warnings_of_a_report(folder: Path, report: dict[str, Any]):
    bubbling, error = report["warnings"]
    assert (bubbling["kind"], error["kind"]) == ("bubbling", "error")
    # 4 panels a side cannot be halved.
    assert report["error_estimate_with"] == "twice"
    assert error["message"].startswith("with twice as many panels along a side")
    assert bubbling["threshold"] == 100.0
    assert bubbling["value"] == pytest.approx(np.abs(report["mean_current_density_A_m2"]).max())
    assert 1 not in bubbling["electrodes"]


def test_conducting_area():
    area = np.pi * 36e-6
    places = {
        2.0 * 40e-6: Electrode(Rectangle((10e-3, 4e-3)), np.array([0.0, 0.0, 9e-3]), np.eye(3)),
        1.0 * area: Electrode(Disc(12e-3), np.array([30e-3, 0.0, 9e-3]), DOWN, backing=1e-3),
        0.75 * area: Electrode(Ring(12e-3, 6e-3), np.array([60e-3, 0.0, 20e-3]), DOWN),  # lies in the surface
        np.pi * 40e-6 + 2.0 * np.pi * 4e-6: Electrode(Rod(4e-3, 10e-3), np.array([90e-3, 0.0, 9e-3]), np.eye(3)),
        52e-6: Electrode(Block((2e-3, 3e-3, 4e-3)), np.array([120e-3, 0.0, 9e-3]), np.eye(3)),
    }
    array = ElectrodeArray(tuple(places.values()))
    np.testing.assert_allclose(conducting_area(array, Tank(-1e-3, 20e-3)), list(places))


# Files


def test_data_set(folder: Path, report: dict[str, Any]):
    with xr.open_dataset(folder / "field.nc") as opened:
        data = opened.load()
    np.testing.assert_allclose(data["electrode_current"], report["currents_A"])
    np.testing.assert_allclose(data["electrode_potential"], report["electrode_voltages_V"])
    np.testing.assert_allclose(data["conductance"], report["conductance_S"])
    assert data["electrode_name"].values.tolist() == report["names"]
    assert data["electrode_state"].values.tolist() == report["states"]
    assert data["potential_0"].dims == ("z_0", "x_0")
    assert float(data["y_0"]) == pytest.approx(12.5e-3)
    assert data["current_density_1"].dims == ("space", "y_1", "x_1")
    assert data["space"].values.tolist() == ["x", "y", "z"]
    assert data.attrs["planes"] == "y = 12.5 mm; z = 0.5 mm"
    assert (data["potential_0"].attrs["units"], data["current_density_0"].attrs["units"]) == ("V", "A/m^2")
    assert all("units" in data[name].attrs and "long_name" in data[name].attrs for name in data.data_vars)
    # From floor to surface, and beyond the plates on both sides.
    assert data["z_0"].values[[0, -1]] == pytest.approx([-1e-3, 30e-3])
    assert data["x_0"].values[0] < -17.5e-3
    assert not [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_the_data_set_holds_the_field_of_the_solution(tmp_path: Path):
    loaded = small("electrodes.floating=[1]")
    report = report_field(loaded, Request(planes=("x=-3mm",)), tmp_path / "out", progress=False)
    assert [entry["plane"] for entry in report["planes"]] == ["x = -3 mm"]
    assert report["gel"] is None
    scenario = loaded.scenario
    problem = build_problem(electrode_array(scenario), Tank(-1e-3, 30e-3), scenario.solution.conductivity, 4)
    voltages = np.array(report["electrode_voltages_V"])
    with xr.open_dataset(tmp_path / "out" / "field.nc") as data:
        k, m = 5, 20
        place = np.array([[-3e-3], [float(data["y_0"][m])], [float(data["z_0"][k])]])
        potential, density = float(data["potential_0"][k, m]), data["current_density_0"].values[:, k, m]
    field = solve(problem)
    assert potential == pytest.approx(float(voltages @ field.lead_potential(place)[:, 0]), rel=1e-5)
    np.testing.assert_allclose(density, voltages @ field.lead_current_density(place)[:, :, 0], rtol=1e-3, atol=1e-3)


def test_points(tmp_path: Path):
    (tmp_path / "at.csv").write_text(POINTS)
    loaded = small()
    request = Request(points=tmp_path / "at.csv", planes=("z=20mm",))
    report_field(loaded, request, tmp_path / "out", progress=False)
    lines = (tmp_path / "out" / "points.csv").read_text().splitlines()
    assert lines[0] == "x [m],y [m],z [m],potential [V],ix [A/m^2],iy [A/m^2],iz [A/m^2]"
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    np.testing.assert_allclose(table[:, :3], [[0, 0, 1e-3], [12.5e-3, 12.5e-3, 0.5e-3], [-20e-3, 3.25e-3, 29e-3]])
    scenario = loaded.scenario
    field = solve(build_problem(electrode_array(scenario), Tank(-1e-3, 30e-3), scenario.solution.conductivity, 4))
    voltages = np.array([-10.0, 10.0, 10.0, -10.0])
    np.testing.assert_allclose(table[:, 3], voltages @ field.lead_potential(table[:, :3].T), rtol=1e-8, atol=1e-8)
    density = np.tensordot(voltages, field.lead_current_density(table[:, :3].T), 1)
    np.testing.assert_allclose(table[:, 4:], density.T, rtol=1e-8, atol=1e-8)


def test_pictures(folder: Path, report: dict[str, Any]):
    names = [name for entry in report["planes"] for name in entry["pictures"]]
    assert names == ["plane-y12.5mm.png", "plane-y12.5mm.pdf", "plane-z0.5mm.png", "plane-z0.5mm.pdf"]
    for name in names[::2]:
        picture = matplotlib.image.imread(folder / name)[:, :, :3]
        assert picture.shape[1] == round(7.16 * 200)
        # Colours everywhere, and white paper round them.
        middle = picture[picture.shape[0] // 4 : picture.shape[0] // 2]
        assert (middle.std(axis=2) > 0.05).mean() > 0.4
        assert np.all(picture[:3] == 1.0)
        assert np.all(picture[:, -3:] == 1.0)
    assert all((folder / name).read_bytes().startswith(b"%PDF") for name in names[1::2])


def test_without_current_there_is_a_picture_too(tmp_path: Path):
    report = report_field(small(), Request(template="off", planes=("z=1mm",)), tmp_path / "out", progress=False)
    assert report["total_current_A"] == 0.0
    assert [warning["kind"] for warning in report["warnings"]] == ["error", "idle"]
    picture = matplotlib.image.imread(tmp_path / "out" / "plane-z1mm.png")[:, :, :3]
    height, width = picture.shape[:2]
    assert np.median(picture[height // 4 : height // 2, width // 6 : width // 3], axis=(0, 1)).min() > 0.95


def test_one_voltage_on_all_electrodes_drives_nothing(tmp_path: Path):
    (tmp_path / "at.csv").write_text(POINTS)
    request = Request(voltages="5 5 5 5", points=tmp_path / "at.csv", planes=("z=1mm",))
    report = report_field(small(), request, tmp_path / "out", progress=False)
    assert report["currents_A"] == [0.0] * 4
    assert report["power_W"] == 0.0
    assert report["warnings"][-1]["kind"] == "idle"
    assert "one voltage, 5 V" in report["warnings"][-1]["message"]
    lines = (tmp_path / "out" / "points.csv").read_text().splitlines()[1:]
    assert all(line.endswith(",5.0,0.0,0.0,0.0") for line in lines)


def test_one_electrode_alone(tmp_path: Path):
    loaded = small("electrodes.rows=1", "electrodes.columns=1", "body.pose.position=['0 mm', '0 mm']")
    report_field(loaded, Request(planes=("z=1mm",)), tmp_path / "out", progress=False)
    report = json.loads((tmp_path / "out" / "field.json").read_text(), parse_constant=pytest.fail)
    assert report["warnings"][-1]["kind"] == "idle"
    assert report["currents_A"] == [0.0]
    print_field(report, Console(quiet=True))


def test_what_was_asked_is_kept(report: dict[str, Any], folder: Path):
    assert report["asked"] == {
        "voltages": None,
        "template": None,
        "amplitude": "4 V",
        "planes": [],
        "points": str(folder.parent / "at.csv"),
        "gel_conductivity": "0.6 S/m",
        "run": None,
        "time": None,
    }


def test_a_plane_of_antisymmetry_has_no_field_in_it(tmp_path: Path):
    request = Request(voltages="-5 -5 5 5", planes=("y=0 mm", "x=0mm"))
    report_field(small(), request, tmp_path / "out", progress=False)
    with xr.open_dataset(tmp_path / "out" / "field.nc") as data:
        across_it, along = Section.of(data, 0), Section.of(data, 1)
    assert np.all(across_it.potential == 0.0)
    assert (across_it.flows, across_it.has_lines) == (True, False)
    assert (along.flows, along.has_lines) == (True, True)


def test_places_on_electrodes():
    disc, block = Disc(10e-3), Block((2e-3, 4e-3, 6e-3))
    upright = Electrode(disc, np.array([0.0, 0.0, 9e-3]), frame_of([1.0, 0.0, 0.0]))
    array = ElectrodeArray((upright, Electrode(block, np.array([20e-3, 0.0, 9e-3]), np.eye(3))))
    places = np.array(
        [[0, 1, 11], [0, 0, 9], [0, 4, 11], [0, 0, 15], [1e-5, 0, 9], [21, 1, 10], [20, 0, 9], [20, 0, 12]]
    )
    expected = [True, True, True, False, False, True, False, True]
    np.testing.assert_array_equal(on_electrode(places.T * 1e-3, panels_of(array, 6)), expected)


def test_points_on_a_plate_have_no_current_density(tmp_path: Path):
    (tmp_path / "at.csv").write_text("sample,x [mm],y [mm],z [mm],x_error [mm]\na,12.5,12.5,15,0\nb,12.5,12.5,14,?\n")
    request = Request(points=tmp_path / "at.csv", planes=("z=20mm",))
    report_field(small(), request, tmp_path / "out", progress=False)
    lines = (tmp_path / "out" / "points.csv").read_text().splitlines()
    on, below = ([float(cell) for cell in line.split(",")] for line in lines[1:])
    assert on[3] == pytest.approx(-10.0, rel=0.1)
    assert np.all(np.isnan(on[4:]))
    assert np.all(np.isfinite(below))


def test_who_stops_the_drawing_keeps_the_numbers(in_empty_folder: Path, monkeypatch: pytest.MonkeyPatch):
    def stop(*_: object):
        raise KeyboardInterrupt

    monkeypatch.setattr("gelbot.show.field_map.draw_plane", stop)
    with pytest.raises(KeyboardInterrupt):
        report_field(small(), Request(), Path("out"), progress=False)
    assert sorted(path.name for path in Path("out").iterdir()) == ["field.json", "field.nc", "scenario.toml"]
    assert json.loads(Path("out/field.json").read_text())["planes"] == []


def test_a_file_is_whole_or_not_there(tmp_path: Path):
    (tmp_path / "a").write_text("old")

    def fail(draft: Path):
        draft.write_text("half")
        raise OSError("full")

    with pytest.raises(OSError, match="full"):
        write_through(tmp_path / "a", fail)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_text() == "old"


# Planes and grids


def test_planes_are_read():
    moment = at_start(small().scenario)
    assert planes(Request(), Tank(-1e-3), moment) == [Plane(1, 12.5e-3), Plane(2, 0.5e-3)]
    asked = ("z=1mm", "x = -12.5 mm", "y=0 m", "z=0.1 cm")
    found = planes(Request(planes=asked), Tank(-1e-3), moment)
    assert [(axis, pytest.approx(value)) for axis, value in found] == [(2, 1e-3), (0, -12.5e-3), (1, 0.0)]
    assert [str(plane) for plane in found] == ["z = 1 mm", "x = -12.5 mm", "y = 0 mm"]


def test_grids_stay_inside_the_tank():
    array, body = square_array(2, 2, 10e-3, 15e-3, 15e-3), np.zeros((3, 1))
    low, high = view(array, body, Tank(-1e-3, 16e-3, (38e-3, 100e-3)))
    np.testing.assert_allclose(low, [-19e-3, -21.7e-3, -1e-3], atol=1e-12)
    np.testing.assert_allclose(high, [19e-3, 21.7e-3, 16e-3], atol=1e-12)
    for axis in range(3):
        u, v, points = grid(Plane(axis, 2e-3), low, high)
        right, up = across(axis)
        assert points.shape == (3, len(u) * len(v))
        assert points.shape[1] <= 15_000
        np.testing.assert_allclose(points[[right, up], 1], [u[1], v[0]])
        assert np.all(points[axis] == 2e-3)
        assert (u[0], u[-1], v[0], v[-1]) == (low[right], high[right], low[up], high[up])


# The gel


def test_a_gel_like_the_solution_changes_nothing(sheet: Body):
    array, tank = square_array(1, 2, 10e-3, 15e-3, 15e-3), Tank(-1e-3)
    placed = sheet.nodes + np.array([[12.5e-3], [0.0], [0.1e-3]])
    voltages, states = np.array([5.0, -5.0]), ["driven", "driven"]
    before = operating_point(solve(build_problem(array, tank, 0.2, 4)), voltages, states)

    def effect(conductivity: float):
        gel = gel_panels(placed, sheet.faces, conductivity, 0.2)
        return gel_effect(operating_point(solve(build_problem(array, tank, 0.2, 4, gel)), voltages, states), before)

    same = effect(0.2)
    assert same.rms_change == pytest.approx(0.0, abs=1e-12)
    assert same.conductance_change == pytest.approx(0.0, abs=1e-12)
    # Below the cathode the current enters the gel from below, and leaves it above.
    a, b, c = (placed[:, corner] for corner in sheet.faces)
    up = np.cross(b - a, c - a, axis=0)[2]
    assert same.without[up < -1e-8].mean() > 1.0
    assert same.without[up > 1e-8].mean() < -1.0
    better = effect(1.0)
    assert better.area @ better.inflow == pytest.approx(0.0, abs=1e-2 * better.area @ np.abs(better.inflow))
    assert 0.1 < better.rms_change < 2.0
    assert better.largest_change > better.rms_change
    assert np.abs(better.inflow).mean() > np.abs(better.without).mean() > np.abs(effect(0.01).inflow).mean()


def test_current_density_inside_the_gel(sheet: Body):
    array, tank = square_array(1, 2, 10e-3, 15e-3, 15e-3), Tank(-1e-3)
    placed = sheet.nodes + np.array([[12.5e-3], [0.0], [0.1e-3]])
    field = solve(build_problem(array, tank, 0.2, 4, gel_panels(placed, sheet.faces, 0.8, 0.2)))
    point = operating_point(field, np.array([5.0, -5.0]), ["driven", "driven"])
    middle, h = placed.mean(axis=1, keepdims=True), 1e-5
    above, steps = middle + np.array([[0.0], [0.0], [3e-3]]), h * np.eye(3)[:, :, None]
    for place, sigma in ((middle, 0.8), (above, 0.2)):
        slope = [(point.potential(place + step) - point.potential(place - step))[0] for step in steps]
        np.testing.assert_allclose(point.current_density(place)[:, 0], -sigma * np.array(slope) / (2 * h), rtol=2e-3)


def test_inside(sheet: Body, rng: np.random.Generator):
    points = rng.uniform([[-3e-3], [-3e-3], [-1e-3]], [[3e-3], [3e-3], [2e-3]], (3, 500))
    expected = np.all(np.abs(points - [[0.0], [0.0], [0.5e-3]]) < [[2e-3], [2e-3], [0.5e-3]], axis=0)
    np.testing.assert_array_equal(inside(points, sheet.nodes[:, sheet.faces]), expected)


def test_the_body_and_voltages_of_a_run(tmp_path: Path):
    loaded = small()
    array, start = electrode_array(loaded.scenario), at_start(loaded.scenario)
    store = RunStore.create(
        tmp_path / "run.zarr",
        xr.Dataset(
            {
                "faces": (("corner", "face"), start.faces),
                "electrode_centre": (("space", "electrode"), array.centres),
                "electrode_outline": (("space", "outline_corner", "electrode"), outlines(array)),
            }
        ),
    )
    lift = np.array([[0.0], [0.0], [1.0]])
    lifts, volts = np.array([1e-3, 2e-3, 4e-3]), np.array([[1.0, -1, 2, -2], [3.0, -3, 4, -4], [5.0, -5, 6, -6]])
    store.append(
        xr.Dataset(
            {
                "position": (("time", "space", "node"), start.positions + lift * lifts[:, None, None]),
                "centre": (("time", "space"), start.centre + lift[:, 0] * lifts[:, None]),
                "voltage": (("time", "electrode"), volts),
            },
            coords={"time": [1.0, 2.0, 3.0]},
        )
    )
    store.finish("finished")
    question = checked(loaded, Request(run=tmp_path, time="2.2 s"))
    np.testing.assert_allclose(question.drive.voltages, volts[1])
    assert question.planes == [Plane(1, pytest.approx(12.5e-3)), Plane(2, pytest.approx(2.5e-3))]
    np.testing.assert_allclose(question.moment.positions[2], start.positions[2] + 2e-3)
    assert checked(loaded, Request(run=tmp_path)).moment.centre[2] == pytest.approx(4.5e-3)
    floating = checked(small("electrodes.floating=[1]"), Request(run=tmp_path)).drive
    np.testing.assert_allclose(floating.voltages, [5.0, 0.0, 6.0, -6.0])
    named = checked(loaded, Request(run=tmp_path, time="3", template="anode")).drive
    np.testing.assert_allclose(named.voltages, [-10.0, -10.0, -10.0, 10.0])
    for request, part in (
        (Request(run=tmp_path, amplitude="2 V"), "--template"),
        (Request(run=tmp_path, time="4 s"), "0 s to 3 s"),
        (Request(run=tmp_path / "none"), "run folder"),
        (Request(time="1 s"), "--run"),
    ):
        with pytest.raises(BadInput, match=part):
            checked(loaded, request)
    with pytest.raises(BadInput, match="the electrodes of this scenario"):
        checked(small("electrodes.space='16 mm'"), Request(run=tmp_path))
    with pytest.raises(BadInput, match="the electrodes of this scenario"):
        checked(small("electrodes.side='9 mm'", "electrodes.space='16 mm'"), Request(run=tmp_path))


# Cuts


def test_cuts():
    places = (
        Electrode(Disc(10e-3), np.array([0.0, 0.0, 5e-3]), DOWN),
        Electrode(Ring(10e-3, 6e-3), np.array([20e-3, 0.0, 5e-3]), DOWN),
        Electrode(Block((2e-3, 4e-3, 6e-3)), np.array([40e-3, 0.0, 5e-3]), np.eye(3)),
    )
    found = outlines(ElectrodeArray(places), corners=96)
    parts = [found[:, np.isfinite(found[0, :, n]), n] for n in range(3)]
    disc, block = (Outline(part, np.zeros((3, 0))) for part in (parts[0], parts[2]))
    ring = Outline(parts[1][:, :96], parts[1][:, 96:])
    chord = 2.0 * np.sqrt(25.0 - 9.0) * 1e-3
    assert cut(disc, 1, 3e-3).length == pytest.approx(chord, rel=1e-3)
    assert cut(disc, 1, 6e-3).is_empty
    assert cut(disc, 2, 5e-3).area == pytest.approx(np.pi * 25e-6, rel=2e-3)
    assert cut(ring, 1, 0.0).length == pytest.approx(4e-3, rel=1e-3)
    assert len(cut(ring, 1, 0.0).geoms) == 2  # pyright: ignore[reportAttributeAccessIssue]
    assert cut(ring, 2, 5e-3).area == pytest.approx(np.pi * 16e-6, rel=2e-3)
    assert cut(block, 1, 1e-3).area == pytest.approx(12e-6)
    assert cut(block, 2, 7.9e-3).area == pytest.approx(8e-6)


def test_cut_and_silhouette_of_the_gel(sheet: Body):
    section = surface_cut(sheet.nodes, sheet.faces, 1, 0.3e-3)
    assert np.linalg.norm(section[:, 1] - section[:, 0], axis=1).sum() == pytest.approx(2 * (4e-3 + 1e-3))
    assert section.reshape(-1, 2).max(axis=0) == pytest.approx([2e-3, 1e-3])
    assert surface_cut(sheet.nodes, sheet.faces, 1, 3e-3).shape == (0, 2, 2)
    rim = silhouette(sheet.nodes, sheet.faces, 2)
    assert np.linalg.norm(rim[:, 1] - rim[:, 0], axis=1).sum() == pytest.approx(16e-3)
    (line,) = chained(rim)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(16e-3)


# The command


def test_field_command(in_empty_folder: Path):
    result = runner.invoke(app, ["field", "turn-over", *SETS, "--plane", "z=1mm"])
    assert result.exit_code == 0, result.output
    assert "the supply gives" in result.stdout
    assert "warning: electrode" in result.stdout
    assert result.stdout.endswith("results in fields/turn-over\n")
    assert sorted(path.name for path in Path("fields/turn-over").iterdir()) == [
        "field.json",
        "field.nc",
        "plane-z1mm.pdf",
        "plane-z1mm.png",
        "scenario.toml",
    ]
    assert "this folder holds a field already" in refused("turn-over", "--out", "fields/turn-over")
    result = runner.invoke(app, ["field", "turn-over", *SETS, "--plane", "z=1mm", "--json"])
    assert result.stderr == ""
    assert result.stdout == Path("fields/turn-over-2/field.json").read_text()
    again = runner.invoke(app, ["run", "turn-over", "--out", "fields/turn-over"])
    assert again.exit_code == 2


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--voltages", "1,2,3"], ["'3 voltages'", "4 voltages, one for each electrode"]),
        (["--voltages", "1"], ["'1 voltage'"]),
        (["--voltages", ""], ["--voltages: got ''", "commas"]),
        (["--voltages", "1;2;3"], ["got '1;2;3'", "commas"]),
        (["--voltages", "abc"], ["got 'abc'", "commas"]),
        (["--voltages", "1,2,,3"], ["--voltages, electrode 2", "got ''"]),
        (["--voltages", "1,2,x,3"], ["--voltages, electrode 2", "'x'", "or a number in V"]),
        (["--voltages", "1,2,nan,3"], ["--voltages, electrode 2", "got 'nan'", "finite"]),
        (["--voltages", "1,2,3 mm,3"], ["--voltages, electrode 2", "a voltage with its unit"]),
        (["--voltages", "1 2 3 4", "--template", "ridge"], ["--template", "nothing beside --voltages"]),
        (["--voltages", "1 2 3 4", "--amplitude", "1 V"], ["--amplitude"]),
        (["--voltages", "1 2 3 4", "--set", "electrodes.floating=[1]"], ["electrode 1", "not driven"]),
        (["--template", "rigde"], ["--template", "'rigde'", "crossed-ridge", "Try: ridge"]),
        (["--template", "ridge", "--amplitude", "1 m"], ["--amplitude"]),
        (["--plane", "1mm"], ["--plane", "x, y or z"]),
        (["--plane", "w=1mm"], ["--plane", "'w=1mm'"]),
        (["--plane", "z=1"], ["--plane z", "a length with its unit"]),
        (["--plane", "z=31mm"], ["inside the tank", "at least -1 mm and at most 30 mm"]),
        (["--plane", "z=-2mm"], ["inside the tank"]),
        (["--plane", "x=-30mm", "--set", "tank.size=['50 mm','60 mm']"], ["x at least -25 mm and at most 25 mm"]),
        (["--gel-conductivity", "0.4"], ["--gel-conductivity", "S/m"]),
        (["--gel-conductivity", "-1 S/m"], ["not negative"]),
        (["--points", "none.csv"], ["none.csv"]),
        (["--out", "/proc/x"], ["--out", "a folder that can be written"]),
        (["--run", "none"], ["run folder"]),
        (["--time", "1 s"], ["--time", "--run"]),
        (["--set", "electrodes.panels=0"], ["electrodes.panels"]),
    ],
)
def test_bad_input_is_one_message(in_empty_folder: Path, words: list[str], parts: list[str]):
    text = refused("turn-over", *SETS, *words)
    assert all(part in text for part in parts), text


def test_points_outside_the_tank_are_named_by_their_line(in_empty_folder: Path):
    Path("at.csv").write_text("# measured\nx [mm],y [mm],z [mm]\n0,0,1\n\n0,0,31\n")
    text = refused("turn-over", *SETS, "--points", "at.csv")
    assert "at.csv, line 5: got 'z = 31 mm'" in text
    assert "at most 30 mm" in text
    Path("at.csv").write_text("x,y,z\n1,2,3\n")
    assert "at.csv, header" in refused("turn-over", *SETS, "--points", "at.csv")


def test_of_many_electrodes_the_largest_currents_are_shown():
    count = ALL_UP_TO + 5
    currents = [(-1) ** n * n * 1e-3 for n in range(count)]
    table = electrode_table(
        {
            "name": "many [of them]",
            "drive": "ridge",
            "names": [f"electrode {n}" for n in range(count)],
            "states": ["driven"] * count,
            "electrode_voltages_V": [1.0] * count,
            "currents_A": currents,
            "mean_current_density_A_m2": [1.0] * count,
        }
    )
    assert table.row_count == LARGEST
    assert str(next(table.columns[0].cells)) == str(count - 1)
