"""The whole chain, from a scenario to its motion and to the folder of a run, held against laws and the paper.

| what | compared with |
|---|---|
| current enters from below, under a cathode | the body domes; with all signs turned it makes a cup |
| start and pattern mirrored in the array's diagonal | the motion mirrored |
| uniform vertical current on a starfish of five arms | a motion with the whole symmetry of the starfish, D5 |
| uniform bending of a strip | an arc of a circle in the vertical plane of its axis |
| electrode currents | sum to zero at any moment |
| time step halved, single precision | the same motion |
| kill -9, no convergence, overflow, a mesh too coarse | what was computed is kept; one message |
| turn-over, early-switch | the paper's Section V |
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time as clock
from pathlib import Path
from typing import Any, NamedTuple

import imageio_ffmpeg
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from numpy.typing import NDArray
from typer.testing import CliRunner

from gelbot.body.symmetry import reflection
from gelbot.cli import app
from gelbot.control.programme import play
from gelbot.field.lead_field import LeadField
from gelbot.record.run_store import open_run
from gelbot.record.summary import summarise
from gelbot.run import frames_part, run_scenario
from gelbot.scenario import built_in_text, load
from gelbot.scenario.build import Experiment, begun, build
from gelbot.simulate import Frame, apply, face_geometry, rollout, surface_inflow

MM = 1e-3
COARSE = ("body.mesh_size=1.5 mm",)
SHORT = (*COARSE, "simulation.duration=2 s")
ONE_LENGTH = (*COARSE, "simulation.duration=4 s")
"""One length of motion for the tests that compare motions: one compilation."""
TIGHT = "simulation.tolerance=1e-6"

UNITS = {
    "position": (("time", "space", "node"), "m"),
    "adsorption": (("time", "face"), "1"),
    "voltage": (("time", "electrode"), "V"),
    "electrode_current": (("time", "electrode"), "A"),
    "centre": (("time", "space"), "m"),
    "normal": (("time", "space"), "1"),
    "tip_position": (("time", "space", "tip"), "m"),
    "tip_angle": (("time", "tip"), "rad"),
    "reference": (("time",), "m"),
    "amplitude": (("time",), "V"),
    "phase": (("time",), "1"),
    "iterations": (("time",), "1"),
    "residual": (("time",), "1"),
    "rest_position": (("space", "node"), "m"),
    "electrode_centre": (("space", "electrode"), "m"),
    "electrode_outline": (("space", "outline_corner", "electrode"), "m"),
    "electrode_potential": (("time", "electrode"), "V"),
}
SUMMARY_KEYS = {
    "turned_over",
    "t_switch_s",
    "z_switch_mm",
    "tip_angle_at_switch_deg",
    "t_transition_s",
    "stayed_over_s",
    "simulated_s",
    "wall_s",
    "compile_s",
}

runner = CliRunner()


class Motion(NamedTuple):
    """A simulated scenario without a folder."""

    experiment: Experiment
    frames: Frame

    @property
    def height(self) -> NDArray[np.float64]:
        return np.asarray(self.frames.observation.centre)[:, 2]

    @property
    def summary(self) -> dict[str, Any]:
        return summarise(frames_part(self.experiment, self.frames), None, None)


def moved(name: str, *changes: str) -> Motion:
    """The scenario `name` with `changes`, simulated."""
    experiment = build(load(name, changes).scenario)
    memory = begun(experiment, experiment.state)
    return Motion(experiment, simulated(experiment, play, memory))


def simulated(experiment: Experiment, controller: Any, memory: Any) -> Frame:
    scenario, state = experiment.scenario, experiment.state
    period, step = scenario.programme.control_period, scenario.simulation.time_step
    periods, steps = round(scenario.simulation.duration / period), round(period / step)
    dt = jnp.asarray(step, state.positions.dtype)
    return jax.block_until_ready(rollout(experiment.model, state, controller, memory, dt, periods, steps))[2]


class Run(NamedTuple):
    """A run's folder, its data set and its summary."""

    folder: Path
    data: xr.Dataset
    summary: dict[str, Any]


@pytest.fixture(scope="module")
def dome(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A short run of `dome`, with everything that a run writes."""
    folder = tmp_path_factory.mktemp("runs") / "dome"
    summary = run_scenario(load("dome", [*SHORT, "recording.chunk=500 ms"]), folder, progress=False)
    return Run(folder, open_run(folder / "run.zarr"), summary)


class TestFolder:
    def test_holds_all_files(self, dome: Run):
        files = {"run.zarr", "summary.json", "scenario.toml", "trajectory.png", "snapshots.png", "dome.mp4"}
        assert {path.name for path in dome.folder.iterdir()} == files

    def test_data_set_is_as_described(self, dome: Run):
        for name, (dims, units) in UNITS.items():
            variable = dome.data[name]
            assert variable.dims == dims, name
            assert variable.attrs["units"] == units, name
            assert variable.attrs["long_name"], name
            if variable.dtype.kind == "f" and name != "reference":
                assert np.isfinite(variable.values).all(), name
        assert dome.data["faces"].dims == ("corner", "face")
        assert list(dome.data["space"].values) == ["x", "y", "z"]
        assert dome.data.sizes["electrode"] == 16
        assert dome.data.sizes["tip"] == 5
        assert dome.data["position"].dtype == np.float64
        assert dome.data.attrs["status"] == "finished"
        assert dome.data.attrs["precision"] == "float64"
        assert dome.data.attrs["phase_names"] == ["dome"]
        assert dome.data["electrode_outline"].dims == ("space", "outline_corner", "electrode")
        assert np.ptp(dome.data["electrode_outline"].values[:2], axis=1) == pytest.approx(10 * MM)
        assert set(dome.data.attrs["electrode_states"]) == {"driven"}
        assert dome.data.attrs["limit"] == 10.0

    def test_a_frame_each_interval(self, dome: Run):
        assert dome.data["time"].values == pytest.approx(0.1 * np.arange(1, 21))
        assert dome.data["time"].attrs["units"] == "s"

    def test_plain_xarray_opens_it(self, dome: Run):
        with xr.open_zarr(dome.folder / "run.zarr") as plain:
            assert plain.sizes == dome.data.sizes

    def test_scenario_repeats_the_run(self, dome: Run):
        copied = load(str(dome.folder / "scenario.toml"))
        assert copied.scenario == load("dome", [*SHORT, "recording.chunk=500 ms"]).scenario
        assert dome.data.attrs["scenario"] == copied.text

    def test_summary_is_written_as_returned(self, dome: Run):
        written = json.loads((dome.folder / "summary.json").read_text())
        assert written == dome.summary
        assert set(written) >= SUMMARY_KEYS
        assert written["turned_over"] is False
        assert written["t_switch_s"] is None
        assert written["simulated_s"] == pytest.approx(2.0)
        assert written["wall_s"] > 0.0
        assert written["compile_s"] > 0.0

    def test_pictures_and_movie_are_whole(self, dome: Run):
        for name in ("trajectory.png", "snapshots.png"):
            picture = imread(dome.folder / name)
            assert min(picture.shape[:2]) > 500
            assert picture[..., :3].std() > 0.02
        # 2 s at four times the speed and 10 pictures a second: every 0.4 s from the first frame, and the last one.
        assert imageio_ffmpeg.count_frames_and_secs(str(dome.folder / "dome.mp4"))[0] == 6

    def test_currents_sum_to_zero(self, dome: Run):
        current = dome.data["electrode_current"].values
        assert np.abs(current).max() > 1e-3
        assert np.abs(current.sum(axis=1)).max() < 1e-9 * np.abs(current).max()

    def test_power_is_positive(self, dome: Run):
        assert ((dome.data["voltage"] * dome.data["electrode_current"]).sum("electrode") > 0.0).all()

    def test_voltages_are_pattern_times_amplitude(self, dome: Run):
        ridge = np.where(np.eye(4).ravel() > 0, -1.0, 1.0)
        voltage, amplitude = dome.data["voltage"].values, dome.data["amplitude"].values
        assert voltage == pytest.approx(amplitude[:, None] * ridge)
        assert amplitude == pytest.approx(2.5)


@pytest.mark.slow
def test_the_servo_never_passes_the_limit():
    motion = moved("turn-over", *ONE_LENGTH, "supply.limit=0.7 V", "programme.phases.1.drive=0.5 V")
    amplitude = np.asarray(motion.frames.command.amplitude)
    assert np.abs(np.asarray(motion.frames.voltages)).max() <= 0.7
    assert amplitude.max() == pytest.approx(0.7)  # the servo asks for more


class TestSigns:
    DRIVE = 8.0

    @pytest.fixture(scope="class")
    @classmethod
    def convex(cls) -> Motion:
        return moved("dome", *ONE_LENGTH, f"programme.phases.0.drive={cls.DRIVE} V")

    @pytest.fixture(scope="class")
    @classmethod
    def concave(cls) -> Motion:
        return moved("dome", *ONE_LENGTH, f"programme.phases.0.drive={-cls.DRIVE} V")

    def test_current_enters_from_below_under_a_cathode(self, convex: Motion):
        experiment, model = convex.experiment, convex.experiment.model
        place = experiment.scenario.body.pose.position
        above = np.argmin(np.linalg.norm(experiment.array.centres[:2].T - place, axis=1))
        assert np.asarray(convex.frames.voltages)[0, above] == -self.DRIVE
        inflow = np.asarray(surface_inflow(model, experiment.state.positions, apply(model, convex.frames.voltages[0])))
        _, normals = face_geometry(experiment.state.positions, model.gel.faces)
        assert (inflow[np.asarray(normals)[2] < -0.9] > 0.0).all()
        assert (inflow[np.asarray(normals)[2] > 0.9] < 0.0).all()

    def test_dome_stands_on_its_tips(self, convex: Motion):
        seen, thickness = convex.frames.observation, convex.experiment.body.thickness
        assert convex.height[-1] > 2.0 * convex.height[0]
        assert np.all(np.diff(convex.height[5:]) > 0.0)
        # A tip's middle can lie no higher than half its thickness when its lower edge is on the floor.
        assert np.asarray(seen.tips)[-1, 2].max() < 0.5 * thickness
        assert np.asarray(seen.tip_angles)[-1].min() > 0.1

    def test_cup_stands_on_its_middle(self, concave: Motion):
        seen = concave.frames.observation
        assert concave.height.max() < 0.55 * MM
        assert np.asarray(seen.tips)[-1, 2].min() > 2.0 * concave.height[-1]
        assert np.asarray(seen.tip_angles)[-1].max() < -0.1

    def test_the_upper_side_adsorbs_in_a_cup(self, convex: Motion, concave: Motion):
        """What one field lays on the lower side the reverse field lays on the upper one, until the shapes differ."""
        _, normals = face_geometry(convex.experiment.state.positions, convex.experiment.model.gel.faces)
        up = np.asarray(normals)[2] > 0.9
        down = np.asarray(normals)[2] < -0.9
        lower, upper = (np.asarray(m.frames.ads)[0] for m in (convex, concave))
        assert lower[down].min() > 0.0
        assert np.all(lower[up] == 0.0)
        assert upper[up].min() > 0.0
        assert np.all(upper[down] == 0.0)


def test_mirrored_start_and_pattern_give_mirrored_motion(rng: np.random.Generator):
    """Mirror in the array's diagonal x = y: the place, the heading and the pattern; then the motion is mirrored."""
    x, y, heading = 13.1, 11.8, 231.0
    pattern = np.round(rng.uniform(-1.0, 1.0, (4, 4)), 3)
    common = (*ONE_LENGTH, TIGHT, "programme.phases.0.drive=10 V")

    def motion(x: float, y: float, heading: float, pattern: NDArray[np.float64]) -> Frame:
        place = f'body.pose.position=["{x} mm", "{y} mm"]'
        turned = (place, f"body.pose.heading={heading} deg", f"programme.phases.0.pattern={pattern.tolist()}")
        return moved("dome", *common, *turned).frames

    one, other = motion(x, y, heading, pattern), motion(y, x, 90.0 - heading, pattern.T)
    swapped = [1, 0, 2]
    arms = [0, 4, 3, 2, 1]  # counted the other way round
    start = np.array([x, y, 0.5]) * MM
    travel = np.abs(np.asarray(one.observation.tips)[-1] - np.asarray(one.observation.tips)[0]).max()
    assert travel > 0.1 * MM
    assert np.asarray(one.observation.centre)[0] == pytest.approx(start, abs=0.02 * MM)
    for a, b in (
        (one.observation.centre, np.asarray(other.observation.centre)[:, swapped]),
        (one.observation.tips, np.asarray(other.observation.tips)[:, swapped][:, :, arms]),
    ):
        assert np.abs(np.asarray(a) - b).max() < 1e-3 * travel
    assert np.asarray(one.observation.normal) == pytest.approx(
        np.asarray(other.observation.normal)[:, swapped], abs=1e-4
    )


def uniform_vertical(lead: LeadField) -> LeadField:
    """A field with one electrode: at 1 V a current density of `conductivity` [A/m^2] rises everywhere.

    The B-spline coefficients of a linear function are its values, one grid point further out on either side.
    """
    shape = lead.coefficients.shape[1:]
    z = float(lead.origin[2]) + float(lead.spacing[2]) * (np.arange(shape[2]) - 1)
    return lead._replace(coefficients=jnp.asarray(np.broadcast_to(-z, shape)[None]))


def steady(memory: Any, time: Any, observation: Any) -> tuple[Any, Any, Any]:
    """A controller that gives the voltages in its memory."""
    return memory, memory, time


def test_a_symmetric_field_moves_a_starfish_symmetrically():
    place = ('body.pose.position=["0 mm", "0 mm"]', "body.pose.heading=0 deg")
    experiment = build(load("dome", [*ONE_LENGTH, TIGHT, *place]).scenario)
    model = experiment.model._replace(lead=uniform_vertical(experiment.model.lead))
    still = np.asarray(experiment.state.positions)
    lower = np.asarray(surface_inflow(model, experiment.state.positions, apply(model, jnp.array([1.0]))))
    assert lower.max() == pytest.approx(experiment.scenario.solution.conductivity)

    # 2 mA/cm^2 for 4 s with p_ele = 0.02 cm^2/mA per second: adsorption 0.16 on the lower side.
    experiment = Experiment(**{**vars(experiment), "model": model})
    frames = simulated(experiment, steady, jnp.array([20.0 / experiment.scenario.solution.conductivity]))
    assert np.asarray(frames.ads)[-1].max() == pytest.approx(0.16, rel=0.01)
    tips, centre = np.asarray(frames.observation.tips)[-1], np.asarray(frames.observation.centre)[-1]
    rise = centre[2] - still[2].mean()
    assert rise > 0.5 * MM

    small = 1e-4 * rise
    assert np.hypot(*centre[:2]) < small
    assert np.ptp(tips[2]) < small
    assert np.ptp(np.hypot(*tips[:2])) < small
    x, group = np.asarray(frames.positions)[-1], experiment.body.group
    assert group.order == 10
    for operation in group.operations():
        carried = np.vstack([operation @ still[:2], still[2]])
        distance = np.linalg.norm(carried[:, :, None] - still[:, None], axis=0)
        to = distance.argmin(axis=1)
        assert sorted(to) == list(range(still.shape[1]))
        assert np.abs(np.vstack([operation @ x[:2], x[2]]) - x[:, to]).max() < small
    assert reflection(0.0) == pytest.approx(np.diag([1.0, -1.0]))


@pytest.mark.slow
def test_a_strip_bends_into_an_arc():
    motion = moved("strip")
    rest, x = np.asarray(motion.experiment.state.positions), np.asarray(motion.frames.positions)[-1]
    along = np.round(rest[1], 6)
    stations = np.unique(along)
    middle = np.array([x[:, along == s].mean(axis=1) for s in stations])
    # The ends: there the moment falls to zero within about a thickness, and the current comes in from the side too.
    inner = middle[np.abs(stations) < 0.5 * 20 * MM - 1.5 * MM]
    assert len(inner) > 8

    y, z = inner[:, 1], inner[:, 2]
    system = np.column_stack([2.0 * y, 2.0 * z, np.ones_like(y)])
    b, c, d = np.linalg.lstsq(system, y**2 + z**2, rcond=None)[0]
    radius = np.sqrt(d + b**2 + c**2)
    sagitta = np.ptp(z)
    assert sagitta > 0.5 * MM
    assert np.abs(np.hypot(y - b, z - c) - radius).max() < 0.02 * sagitta
    assert c < z.min()  # convex
    assert abs(b) < 1e-3 * 20 * MM
    assert np.abs(middle[:, 0]).max() < 0.01 * sagitta


@pytest.mark.slow
def test_single_precision_moves_alike():
    double, single = (moved("dome", *ONE_LENGTH, f"simulation.precision={p}") for p in ("float64", "float32"))
    assert frames_part(single.experiment, single.frames)["position"].dtype == np.float32
    assert frames_part(single.experiment, single.frames)["adsorption"].dtype == np.float32
    assert np.asarray(single.frames.report.residual).max() <= single.experiment.scenario.simulation.tolerance
    assert single.height - single.height[0] == pytest.approx(double.height - double.height[0], abs=0.002 * MM)
    # Rounding costs hardly an iteration.
    iterations = [float(np.asarray(m.frames.report.iterations).mean()) for m in (double, single)]
    assert iterations[1] < 1.2 * iterations[0]


@pytest.mark.slow
def test_a_gel_that_conducts_worse_rises_slower(tmp_path: Path, dome: Run):
    """A gel like the solution moves as one whose conductivity is not given; a bad conductor gets less current."""
    low = float(dome.data["centre"].values[0, 2])
    rises = []
    for name, conductivity in (("same", "0.19 S/m"), ("worse", "0.06 S/m")):
        change = f"material.conductivity={conductivity}"
        run_scenario(load("dome", [*SHORT, change]), tmp_path / name, movie=False, progress=False)
        rises.append(float(open_run(tmp_path / name / "run.zarr")["centre"].values[-1, 2]) - low)
    plain = float(dome.data["centre"].values[-1, 2]) - low
    assert rises[0] == pytest.approx(plain, rel=0.02)  # the steps are solved to 3 %
    assert 0.3 * plain < rises[1] < 0.9 * plain


class TestFailures:
    def test_a_mesh_too_coarse_writes_nothing(self, tmp_path: Path):
        """It shows only while the body is being built, after the scenario has been checked."""
        spiky = [(0, 0), (10, 0), (10, 0.1), (1, 0.2), (1, 3), (0, 3)]
        points = ", ".join(f'["{x} mm", "{y} mm"]' for x, y in spiky)
        before, rest = built_in_text("dome").split("[body]")
        rest = rest[rest.index("thickness") :].replace('mesh_size = "0.9 mm"', 'mesh_size = "5 mm"')
        (tmp_path / "mine.toml").write_text(f'{before}[body]\nshape = "outline"\npoints = [{points}]\n{rest}')
        command = [sys.executable, "-m", "gelbot", "run", "mine.toml", "--out", "out"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stdout == ""
        assert done.stderr.startswith("gelbot: mine.toml: body.mesh_size: got '5 mm'; allowed: ")
        assert done.stderr.count("\n") == 1
        assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]

    @pytest.mark.slow
    def test_what_was_computed_before_a_failure_is_kept(self, tmp_path: Path):
        # Enough to rise, too few to topple.
        changes = (*COARSE, "simulation.max_iterations=60")
        words = [word for change in changes for word in ("--set", change)]
        result = runner.invoke(app, ["run", "turn-over", "--out", str(tmp_path / "out"), "--no-movie", *words])
        assert result.exit_code == 1
        message = result.stderr
        assert "did not converge at t = " in message
        assert "residual" in message
        assert "tolerance 0.03" in message
        assert "Try: " in message
        assert "Traceback" not in message
        assert f"what was computed is kept in {tmp_path / 'out'}" in message

        run = open_run(tmp_path / "out" / "run.zarr")
        assert run.attrs["status"].startswith("failed: the simulation did not converge")
        assert run.sizes["time"] > 100
        assert np.isfinite(run["position"].values).all()
        assert float(run["residual"].max()) <= 0.03
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        assert summary["simulated_s"] == pytest.approx(float(run["time"][-1]))
        assert summary["status"] == run.attrs["status"]
        assert (tmp_path / "out" / "trajectory.png").is_file()

    @pytest.mark.slow
    def test_overflow_is_a_message(self, tmp_path: Path):
        # Stiffnesses that single precision cannot hold.
        goal = 'motion={goals=[{quantity="height", at_least="1 mm"}]}'
        changes = [*SHORT, "simulation.precision=float32", "material.young_modulus=1e40 GPa", goal]
        words = [word for change in changes for word in ("--set", change)]
        result = runner.invoke(app, ["run", "dome", "--out", str(tmp_path / "out"), "--no-movie", *words])
        assert result.exit_code == 1
        assert "became non-finite at t = 0.1" in result.stderr
        assert "Try: " in result.stderr
        run = open_run(tmp_path / "out" / "run.zarr")
        assert run.attrs["status"].startswith("failed: the simulation became non-finite")
        summary = json.loads((tmp_path / "out" / "summary.json").read_text())
        assert summary["simulated_s"] == 0.0
        assert summary["motion"]["reason"] == "the run was not finished"

    @pytest.mark.slow
    def test_a_killed_run_opens_up_to_its_last_chunk(self, tmp_path: Path):
        changes = [*COARSE, "simulation.duration=1 h", "recording.chunk=200 ms"]
        words = [word for change in changes for word in ("--set", change)]
        command = [sys.executable, "-m", "gelbot", "run", "turn-over", "--no-movie", "--out", "out", *words]
        store = tmp_path / "out" / "run.zarr"
        with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            try:
                until = clock.monotonic() + 300.0
                while not (store / "zarr.json").is_file() or open_run(store).sizes.get("time", 0) < 20:
                    assert process.poll() is None, "the run ended by itself"
                    assert clock.monotonic() < until, "the run wrote nothing"
                    clock.sleep(0.05)
            finally:
                os.kill(process.pid, signal.SIGKILL)
        for run in (open_run(store), xr.open_zarr(store)):
            count = run.sizes["time"]
            assert count >= 20
            assert count % 2 == 0
            assert run.attrs["status"] == "running"
            assert run["time"].values == pytest.approx(0.1 * np.arange(1, count + 1))
            for name in UNITS:
                if run[name].dtype.kind == "f":
                    assert np.isfinite(run[name].values).all(), name
            # Values, not the fill of arrays that were only made longer.
            assert float(run["position"][-1].sel(space="x").mean()) == pytest.approx(12.5 * MM, abs=2 * MM)
            assert int(run["iterations"].min()) >= 1
            run.close()


@pytest.mark.slow
class TestPaper:
    """Section V: 40 s to the switch, 6-10 s of transition, for the whole range of p_ele."""

    @pytest.fixture(scope="class")
    @classmethod
    def nominal(cls) -> dict[str, Any]:
        return moved("turn-over").summary

    @staticmethod
    def is_turned_over_and_stays(summary: dict[str, Any]) -> None:
        assert summary["turned_over"]
        assert abs(summary["tip_angle_at_switch_deg"] - 90.0) < 15.0
        assert summary["stayed_over_s"] >= 10.0
        assert summary["final_normal_z"] < -0.8

    def test_turns_over(self, nominal: dict[str, Any]):
        self.is_turned_over_and_stays(nominal)
        assert 36.0 <= nominal["t_switch_s"] <= 44.0
        assert 6.0 <= nominal["t_transition_s"] <= 10.0
        assert nominal["peak_voltage_V"] <= 10.0

    @pytest.mark.parametrize("p_ele", [0.017, 0.023])
    def test_turns_over_at_the_ends_of_the_range(self, p_ele: float):
        self.is_turned_over_and_stays(moved("turn-over", f"material.p_ele={p_ele} cm^2/mA").summary)

    def test_half_the_time_step_switches_at_the_same_time(self, nominal: dict[str, Any]):
        halved = moved("turn-over", "simulation.time_step=25 ms").summary
        assert halved["t_switch_s"] == pytest.approx(nominal["t_switch_s"], rel=0.02)
        self.is_turned_over_and_stays(halved)

    def test_switched_early_it_falls_back_flat(self):
        motion = moved("early-switch")
        summary = motion.summary
        assert summary["t_switch_s"] < 36.0
        assert not summary["turned_over"]
        assert summary["final_normal_z"] > 0.95
        assert summary["final_height_mm"] < 0.8
        assert np.abs(np.degrees(np.asarray(motion.frames.observation.tip_angles)[-1])).max() < 15.0
