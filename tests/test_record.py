"""Runs on disk survive a kill at any moment; the summary's numbers are those of runs with known answers."""

from __future__ import annotations

import json
import pkgutil
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

from gelbot.errors import BadInput
from gelbot.record.run_store import RunStore, open_run
from gelbot.record.summary import summarise

NODES, ELECTRODES, TIPS, FRAMES = 40, 16, 5, 10


def static() -> xr.Dataset:
    return xr.Dataset(
        {"rest_position": (("space", "node"), np.zeros((3, NODES)), {"units": "m", "long_name": "rest position"})},
        coords={"space": ["x", "y", "z"]},
        attrs={"scenario_name": "turn-over", "phase_names": ["a", "b"], "status": "running", "limit": 10.0},
    )


def chunk(k: int, count: int = FRAMES) -> xr.Dataset:
    """Frame number f has f in all places."""
    frame = np.arange(k * FRAMES, k * FRAMES + count, dtype=float)
    return xr.Dataset(
        {
            "position": (("time", "space", "node"), np.tile(frame[:, None, None], (1, 3, NODES)), {"units": "m"}),
            "voltage": (("time", "electrode"), np.tile(frame[:, None], (1, ELECTRODES)), {"units": "V"}),
            "phase": (("time",), frame.astype(np.int32)),
        },
        coords={"time": ("time", 0.1 * frame, {"units": "s"})},
    )


def assert_whole(run: xr.Dataset, frames: int) -> None:
    assert run.sizes["time"] == frames
    expected = np.arange(frames)
    np.testing.assert_allclose(run["time"], 0.1 * expected)
    for name in ("position", "voltage", "phase"):
        values = run[name].values.reshape(frames, -1)
        np.testing.assert_array_equal(values, np.broadcast_to(expected[:, None], values.shape))


def test_what_goes_in_comes_out(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        store = RunStore.create(tmp_path / "run.zarr", static())
        assert open_run(tmp_path / "run.zarr").attrs["status"] == "running"
        for k in range(3):
            store.append(chunk(k))
            assert_whole(open_run(tmp_path / "run.zarr"), (k + 1) * FRAMES)
        store.append(chunk(3, count=4))
        store.finish("finished")
        run = open_run(tmp_path / "run.zarr")
    assert_whole(run, 34)
    assert run.attrs["status"] == "finished"
    assert run.attrs["phase_names"] == ["a", "b"]
    assert list(run["space"].values) == ["x", "y", "z"]
    assert run["position"].attrs["units"] == "m"
    assert run["time"].attrs["units"] == "s"
    assert run["position"].dtype == np.float64
    assert run["phase"].dtype == np.int32
    assert run["position"].encoding["chunks"] == (FRAMES, 3, NODES)
    # The arrays' own metadata says the same as the consolidated one.
    assert_whole(xr.open_zarr(tmp_path / "run.zarr", consolidated=False), 34)


def test_a_chunk_may_follow_a_short_one(tmp_path: Path) -> None:
    store = RunStore.create(tmp_path / "run.zarr", static())
    whole = xr.concat([chunk(0), chunk(1)], dim="time")
    for start, end in ((0, 7), (7, 9), (9, 20)):
        store.append(whole.isel(time=slice(start, end)))
    assert_whole(open_run(tmp_path / "run.zarr"), 20)


def test_bad_use_is_refused(tmp_path: Path) -> None:
    store = RunStore.create(tmp_path / "run.zarr", static())
    with pytest.raises(BadInput, match=r"run\.zarr"):
        RunStore.create(tmp_path / "run.zarr", static())
    with pytest.raises(BadInput, match="nothing"):
        open_run(tmp_path / "nothing")
    store.append(chunk(0))
    with pytest.raises(ValueError, match="voltage"):
        store.append(chunk(1).drop_vars("voltage"))
    assert_whole(open_run(tmp_path / "run.zarr"), FRAMES)


@pytest.mark.parametrize(
    ("write", "done", "frames"),
    [
        ("zarr.Array.__setitem__", 0, FRAMES),
        ("zarr.Array.__setitem__", 2, FRAMES),
        ("gelbot.record.run_store._replace", 0, FRAMES),
        # From here on the root promises the second chunk, and all of its values are there; the arrays follow.
        ("gelbot.record.run_store._replace", 1, 2 * FRAMES),
        ("gelbot.record.run_store._replace", 3, 2 * FRAMES),
    ],
)
def test_a_death_between_any_two_writes_leaves_whole_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: str, done: int, frames: int
) -> None:
    """The writer dies in the second chunk, when `write` has been called `done` times."""
    store = RunStore.create(tmp_path / "run.zarr", static())
    store.append(chunk(0))
    original, calls = pkgutil.resolve_name(write), iter(range(100))

    def dying(*args):
        if next(calls) >= done:
            raise KeyboardInterrupt
        return original(*args)

    monkeypatch.setattr(write, dying)
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - either call may be the one that dies
        store.append(chunk(1))
        store.finish("finished")
    monkeypatch.undo()
    assert_whole(open_run(tmp_path / "run.zarr"), frames)
    assert_whole(xr.open_zarr(tmp_path / "run.zarr"), frames)
    # No array's own metadata promises more than that either.
    lengths = [array.shape[0] for _, array in zarr.open_group(tmp_path / "run.zarr", use_consolidated=False).arrays()]
    assert max(n for n in lengths if n != 3) <= frames


WRITER = """
import sys
sys.path.insert(0, {here!r})
from pathlib import Path
from test_record import RunStore, chunk, static
store = RunStore.create(Path({folder!r}), static())
for k in range(100000):
    store.append(chunk(k))
    print(k, flush=True)
"""


def test_kill_minus_nine_leaves_a_run_that_opens(tmp_path: Path) -> None:
    here = str(Path(__file__).parent)
    rng = np.random.default_rng(0)
    for attempt in range(5):
        folder = tmp_path / f"{attempt}.zarr"
        script = WRITER.format(here=here, folder=str(folder))
        with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as writer:
            assert writer.stdout is not None
            lines = [writer.stdout.readline() for _ in range(3)]
            assert lines[-1].strip() == "2"
            time.sleep(rng.uniform(0.0, 0.05))
            writer.kill()
            lines += writer.stdout.read().splitlines()
        announced = int(lines[-1]) + 1
        run = open_run(folder)
        # The chunk that was being announced may be there.
        assert run.sizes["time"] in (announced * FRAMES, (announced + 1) * FRAMES)
        assert run.attrs["status"] == "running"
        assert_whole(run, run.sizes["time"])
        assert_whole(xr.open_zarr(folder), run.sizes["time"])


def made_run(normal_z, phase, height=None, **more) -> xr.Dataset:
    """A run with a frame per 0.1 s and known histories of the normal's z, the phase and the height [m]."""
    normal_z, phase = np.asarray(normal_z, float), np.asarray(phase, int)
    count = len(normal_z)
    t = 0.1 * np.arange(count)
    centre = np.zeros((count, 3))
    centre[:, 2] = 0.4e-3 + 5e-3 * np.arange(count) / count if height is None else height
    normal = np.zeros((count, 3))
    normal[:, 2] = normal_z
    current = np.zeros((count, 4))
    current[:, 0], current[:, 1:] = 3e-3, -1e-3
    angles = np.zeros((count, TIPS))
    angles[:, 2] = np.radians(np.arange(count))
    voltage = np.zeros((count, 4))
    voltage[:, 0] = -9.5
    variables = {
        "centre": (("time", "space"), centre),
        "normal": (("time", "space"), normal),
        "electrode_current": (("time", "electrode"), current),
        "voltage": (("time", "electrode"), voltage),
        "tip_angle": (("time", "tip"), angles),
        "phase": (("time",), phase),
        "iterations": (("time",), np.arange(count)),
    }
    attrs = {"scenario_name": "turn-over", "status": "finished", "precision": "float64"}
    return xr.Dataset({**variables, **more}, coords={"time": t}, attrs=attrs)


def test_a_body_that_turns_over_and_stays() -> None:
    normal = np.concatenate([np.ones(30), np.linspace(1, -1, 21)[1:], -np.ones(50)])
    phase = np.concatenate([np.zeros(20), np.ones(40), np.full(40, 2)])
    s = summarise(made_run(normal, phase), wall_s=12.5, compile_s=4.0)
    assert s["turned_over"] is True
    assert s["t_switch_s"] == pytest.approx(2.0)
    assert s["z_switch_mm"] == pytest.approx(0.4 + 5.0 * 20 / 100)
    assert s["tip_angle_at_switch_deg"] == pytest.approx(20.0)
    # The ramp falls by 0.1 a frame from frame 29: it is at -0.8 in frame 47 and below it in frame 48.
    assert s["t_transition_s"] == pytest.approx(4.8 - 2.0, abs=0.101)
    assert s["stayed_over_s"] == pytest.approx(9.9 - 4.8, abs=0.101)
    assert s["t_switch_s"] + s["t_transition_s"] + s["stayed_over_s"] == pytest.approx(s["simulated_s"])
    assert s["simulated_s"] == pytest.approx(9.9)
    assert s["peak_voltage_V"] == 9.5
    assert s["peak_current_A"] == pytest.approx(3e-3)
    assert s["charge_C"] == pytest.approx(3e-3 * 9.9)
    assert s["final_normal_z"] == -1.0
    assert s["iterations_max"] == 99
    assert s["iterations_mean"] == pytest.approx(49.5)
    assert (s["wall_s"], s["compile_s"], s["scenario"]) == (12.5, 4.0, "turn-over")
    json.dumps(s, allow_nan=False)


def test_a_body_that_falls_back_flat() -> None:
    normal = np.concatenate([np.ones(30), np.linspace(1, 0.3, 20), np.linspace(0.3, 1, 50)])
    height = np.concatenate([np.linspace(0.4e-3, 3.4e-3, 30), np.linspace(3.4e-3, 0.4e-3, 70)])
    s = summarise(made_run(normal, np.arange(100) >= 30, height), wall_s=1.0, compile_s=None)
    assert s["turned_over"] is False
    assert s["t_transition_s"] is None
    assert s["stayed_over_s"] == 0.0
    assert s["t_switch_s"] == pytest.approx(3.0)
    assert s["max_height_mm"] == pytest.approx(3.4)
    assert s["final_height_mm"] == pytest.approx(0.4)
    json.dumps(s, allow_nan=False)


def test_a_body_that_turns_over_and_rolls_on() -> None:
    normal = np.concatenate([np.ones(20), -np.ones(10), np.ones(20), -np.ones(5), np.zeros(1)])
    s = summarise(made_run(normal, np.arange(56) >= 10), wall_s=1.0, compile_s=1.0)
    assert s["turned_over"] is True
    assert s["t_transition_s"] == pytest.approx(1.0)
    assert s["stayed_over_s"] == 0.0
    again = summarise(made_run(normal[:-1], np.arange(55) >= 10), wall_s=1.0, compile_s=1.0)
    assert again["stayed_over_s"] == pytest.approx(0.4)


def test_a_run_without_a_switch() -> None:
    s = summarise(made_run(np.ones(50), np.zeros(50)), wall_s=1.0, compile_s=1.0)
    keys = ("t_switch_s", "z_switch_mm", "tip_angle_at_switch_deg", "t_transition_s")
    assert all(s[key] is None for key in keys)
    assert s["turned_over"] is False
    assert s["stayed_over_s"] == 0.0


def test_frames_that_are_not_finite_do_not_count() -> None:
    broken = made_run(np.ones(50), np.zeros(50))
    for name in ("centre", "normal", "tip_angle"):
        broken[name][-2:] = np.nan
    s = summarise(broken, wall_s=1.0, compile_s=1.0)
    assert s["simulated_s"] == pytest.approx(4.7)
    json.dumps(s, allow_nan=False)


def test_a_run_that_was_stopped_before_its_first_frame(tmp_path: Path) -> None:
    RunStore.create(tmp_path / "run.zarr", static())
    s = summarise(open_run(tmp_path / "run.zarr"), wall_s=0.1, compile_s=None)
    assert s["turned_over"] is False
    assert s["simulated_s"] == 0.0
    assert s["status"] == "running"
    assert s.keys() == summarise(made_run(np.ones(5), np.zeros(5)), wall_s=0.1, compile_s=None).keys()


def test_a_body_that_leaves_the_tabulated_field_says_when() -> None:
    run = made_run(np.ones(5), np.zeros(5))
    position = np.zeros((5, 3, 2))
    position[:, 2, 0] = -1e-3  # pressed into the floor: no matter
    position[3:, 0, 1] = 0.021
    far = run.assign(position=(("time", "space", "node"), position))
    assert summarise(far, wall_s=0.1, compile_s=None)["left_working_volume_s"] is None
    far.attrs["working_volume"] = [[-0.02, -0.02, 0.0], [0.02, 0.02, 0.014]]
    left = summarise(far, wall_s=0.1, compile_s=None)["left_working_volume_s"]
    assert left == float(far["time"][3])
