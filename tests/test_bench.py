"""The loop, its clocks, its log, and what it drives: a simulated gel seen late and through noise, and a recording.

| what is done | what must be |
|---|---|
| ticks under a clock moved by hand | due at k times the period; jitter and missed ticks as the clock had them |
| a tick that lasts longer than a period | the next ones are left out, the last voltages held, the times stay whole |
| a paced clock | pace times the other clock's time; stands still; as fast as it is waited for |
| the simulated gel under constant voltages | the same motion as `simulate.rollout` |
| its eye without noise | the gel's own points, `delay` seconds ago |
| its eye with noise | mean and standard deviation as they were asked for |
| log written, read | the same numbers; a line cut off half way is no line, at whatever byte it was cut |
| log of a process that is killed with signal 9 | whole up to the last tick |
| log on a disk that is full | an error, and whole lines |
| log played as a plant | the sightings and voltages of then |
| turn-over in closed loop, p_ele 15 % off, noise, 100 ms delay | over, and stays so, 20 seeds of 20 |
| an hour of it | memory flat, every safety look in time, every tick in the log |
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from gelbot.bench import Decision, drive
from gelbot.clock import HandClock, PacedClock
from gelbot.controllers.choice import with_controller
from gelbot.errors import BadInput
from gelbot.live.drivers import Programmed
from gelbot.plant import Sighting, as_seen
from gelbot.plants.build import Simulated, simulated
from gelbot.plants.played import PlayedPlant, recording
from gelbot.plants.simulated import Meanwhile, Noise, SimulatedEye, SimulatedGel
from gelbot.record.log import BenchLog, open_log
from gelbot.scenario.build import Experiment, build
from gelbot.scenario.load import load
from gelbot.simulate import rollout

SEEN = as_seen([0.0, 0.0, 1e-3], [0.0, 0.0, 1.0], np.zeros((3, 5)), np.zeros(5))


class Still:
    """A plant that does not move; it keeps what it was given, with the time."""

    def __init__(self, clock: HandClock) -> None:
        self.clock, self.given = clock, list[tuple[float, float]]()

    def observe(self) -> Sighting:
        return Sighting(self.clock.now(), SEEN, 1.0)

    def apply(self, voltages: np.ndarray) -> np.ndarray:
        self.given.append((self.clock.now(), float(voltages[0])))
        return voltages


class Slow:
    """A driver that asks for 1, 2, 3, ... volts, and needs so long [s] for it."""

    def __init__(self, clock: HandClock, needs: list[float]) -> None:
        self.clock, self.needs, self.count = clock, needs, 0

    def decide(self, time: float, seen: object) -> Decision:
        self.clock.move(self.needs[self.count])
        self.count += 1
        return Decision(np.array([float(self.count)]), 0, 0.0, np.nan)


def test_ticks_come_at_whole_periods():
    clock = HandClock(5.0)
    ticks = list(drive(Still(clock), Slow(clock, [0.01] * 10), clock, 0.1, 1.0))
    assert [tick.time for tick in ticks] == pytest.approx([0.1 * k for k in range(10)])
    assert [tick.took for tick in ticks] == pytest.approx([0.01] * 10)
    assert all(tick.jitter == pytest.approx(0.0, abs=1e-9) and tick.missed == 0 for tick in ticks)


def test_a_late_tick_holds_the_last_voltages_and_the_next_ones_are_left_out():
    clock = HandClock()
    plant = Still(clock)
    ticks = list(drive(plant, Slow(clock, [0.01, 0.35, 0.01, 0.01]), clock, 0.1, 0.6))
    assert [tick.time for tick in ticks] == pytest.approx([0.0, 0.1, 0.4, 0.5])
    assert [tick.missed for tick in ticks] == [0, 0, 2, 0]
    assert [tick.number for tick in ticks] == [0, 1, 2, 3]
    # Over at 0.45 s, it begins the tick of 0.4 s 50 ms late; the one after it is in time again.
    assert [tick.jitter for tick in ticks] == pytest.approx([0.0, 0.0, 0.05, 0.0], abs=1e-9)
    assert [time for time, _ in plant.given] == pytest.approx([0.01, 0.45, 0.46, 0.51])


def test_a_paced_clock():
    wall = HandClock()
    clock = PacedClock(wall, 4.0, running=False)
    wall.move(1.0)
    assert clock.now() == 0.0
    clock.go()
    wall.move(0.5)
    assert clock.now() == pytest.approx(2.0)
    clock.wait_until(3.0)
    assert wall.now() == pytest.approx(1.75)
    clock.set_pace(0.5)
    wall.move(1.0)
    assert clock.now() == pytest.approx(3.5)
    clock.stop()
    wall.move(1.0)
    clock.wait_until(9.0)
    assert clock.now() == pytest.approx(3.5)
    clock.set_pace(None)
    clock.wait_until(9.0)
    assert clock.now() == pytest.approx(3.5)  # it stands still
    clock.go()
    clock.wait_until(9.0)
    assert clock.now() == 9.0
    clock.set_back(8.0)
    assert clock.now() == 8.0


# -- the simulated gel and its eye

COARSE = ["body.mesh_size=1.8 mm"]


@pytest.fixture(scope="module")
def coarse() -> Experiment:
    return build(load("turn-over", COARSE).scenario)


def test_the_simulated_gel_moves_as_in_a_rollout(coarse):
    volts = np.array([(-1.0) ** k * 5.0 for k in range(16)])
    clock = HandClock()
    gel = SimulatedGel(coarse, lambda: volts)
    for now in (0.03, 0.1, 0.12, 0.38, 0.5, 1.0):
        gel.advance(now)
        assert now - 0.05 < gel.time <= now + 1e-6
    clock.move(1.0)

    def hold(memory, time, seen):
        return memory, memory, None

    dt = jnp.asarray(0.05)
    state, _, frames = rollout(coarse.model, coarse.state, hold, jnp.asarray(volts), dt, 10, 2)
    np.testing.assert_allclose(gel.state.positions, state.positions, atol=1e-9)
    np.testing.assert_allclose(gel.seen.centre, frames.observation.centre[-1], atol=1e-9)
    assert float(jnp.abs(state.positions - coarse.state.positions).max()) > 1e-5


def test_an_eye_without_noise_sees_the_past(coarse):
    gel = SimulatedGel(coarse, lambda: np.full(16, 10.0) * np.array([-1.0] + [1.0] * 15))
    eye = SimulatedEye(gel, Noise(0.0, 0.0), delay=0.1)
    past = {}
    for k in range(1, 12):
        now = 0.05 * k
        sighting = eye.look(now)
        past[k] = gel.seen.centre
        assert sighting.time == pytest.approx(max(0.0, now - 0.1))
        if k > 2:
            np.testing.assert_array_equal(sighting.observation.centre, past[k - 2])
    eye.covered = True
    assert eye.look(0.7).confidence == 0.0


def test_noise_is_as_large_as_it_is_said_to_be(coarse):
    gel = SimulatedGel(coarse, lambda: np.zeros(16))
    eye = SimulatedEye(gel, Noise(1e-4, 0.05), delay=0.0, seed=7)
    truth = gel.seen
    draws = [eye._sighting(0.0).observation for _ in range(2000)]
    for name, size in (("centre", 1e-4), ("tips", 1e-4), ("tip_angles", 0.05)):
        off = np.stack([getattr(draw, name) - getattr(truth, name) for draw in draws])
        assert np.abs(off.std(axis=0) / size - 1.0).max() < 0.07
        assert np.abs(off.mean(axis=0)).max() < 4.0 * size / np.sqrt(2000)
    normals = np.stack([draw.normal for draw in draws])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert normals[:, 0].std() == pytest.approx(0.05, rel=0.07)


# -- the log


def row(k: int) -> dict[str, Any]:
    return {
        "time": 0.1 * k,
        "seen_time": 0.1 * k - 0.1,
        "confidence": 1.0,
        "centre": np.array([1e-3, 2e-3, 1e-3 * k]),
        "normal": np.array([0.0, 0.0, 1.0]),
        "tip_position": np.arange(15.0).reshape(3, 5) * 1e-3 + k,
        "tip_angle": np.full(5, 0.1 * k),
        "voltage": np.array([1.5, -2.5]) * k,
        "measured_current": None if k == 1 else np.array([0.1, -0.1]),
        "reference": np.nan if k == 0 else 5e-3,
        "phase": 1,
        "missed": 0,
    }


def written(path: Path, count: int = 3) -> BenchLog:
    log = BenchLog(path, {"scenario_name": "test", "limit": 10.0})
    for k in range(count):
        log.tick(row(k))
    return log


def test_what_is_logged_is_read_again(tmp_path):
    log = written(tmp_path / "bench.log")
    log.event(0.2, "stopped: the user")
    read = open_log(tmp_path / "bench.log")  # while it is still being written
    log.close()
    assert read.attrs["scenario_name"] == "test"
    assert read.attrs["events"] == [(0.2, "stopped: the user")]
    np.testing.assert_allclose(read["time"], [0.0, 0.1, 0.2])
    for k in range(3):
        for name in ("centre", "tip_position", "tip_angle", "voltage"):
            np.testing.assert_allclose(read[name].isel(time=k), row(k)[name], rtol=1e-6)
    assert np.isnan(read["reference"].values).tolist() == [True, False, False]
    assert np.isnan(read["measured_current"].values[:, 0]).tolist() == [False, True, False]
    assert read["voltage"].attrs["units"] == "V"
    with pytest.raises(BadInput, match="a file that does not exist yet"):
        BenchLog(tmp_path / "bench.log", {})


def test_a_log_that_was_cut_anywhere_ends_before_the_cut(tmp_path):
    written(tmp_path / "bench.log").close()
    data = (tmp_path / "bench.log").read_bytes()
    ends = [k + 1 for k, byte in enumerate(data) if byte == ord("\n")]
    for cut in range(ends[1], len(data)):
        (tmp_path / "cut.log").write_bytes(data[:cut])
        assert open_log(tmp_path / "cut.log").sizes["time"] == sum(end <= cut for end in ends) - 1


@pytest.mark.parametrize("content", [b"", b"{}\n", b"\x00\xff\n", b"[1]\n", b'{"format": "something else"}\n'])
def test_what_is_no_log_is_said_so(tmp_path, content):
    (tmp_path / "bench.log").write_bytes(content)
    with pytest.raises(BadInput, match="a log that gelbot live wrote"):
        open_log(tmp_path / "bench.log")


WRITER = """
import sys
from pathlib import Path
from typing import Any
sys.path.insert(0, {tests!r})
from test_bench import row
from gelbot.record.log import BenchLog
log = BenchLog(Path({path!r}), {{}})
k = 0
while True:
    log.tick(row(k))
    print(k, flush=True)
    k += 1
"""


@pytest.mark.slow
def test_a_log_whose_writer_is_killed_is_whole(tmp_path):
    path = tmp_path / "bench.log"
    code = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for line in writer.stdout:
            if int(line) == 200:
                break
        writer.kill()
        rest = writer.stdout.read().split()
    written_ = max(200, *(int(k) for k in rest[:-1])) if len(rest) > 1 else 200
    read = open_log(path)
    assert read.sizes["time"] > written_
    np.testing.assert_allclose(read["time"], 0.1 * np.arange(read.sizes["time"]), atol=1e-6)


def test_a_log_on_a_full_disk_stays_whole(tmp_path):
    log = written(tmp_path / "bench.log")
    size = (tmp_path / "bench.log").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, hard))  # room for a part of a line
    try:
        with pytest.raises(OSError, match="File too large"):
            log.tick(row(3))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert open_log(tmp_path / "bench.log").sizes["time"] == 3
    log.tick(row(3))  # there is room again
    log.close()
    assert open_log(tmp_path / "bench.log").sizes["time"] == 4


def test_a_log_is_played_as_a_plant(tmp_path):
    written(tmp_path / "bench.log", 5).close()
    clock = HandClock(3.0)
    plant = PlayedPlant(recording(tmp_path)[0], clock)
    for k, tick in enumerate(drive(plant, Slow(clock, [0.0] * 9), clock, 0.1, 0.5)):
        np.testing.assert_allclose(tick.seen.observation.centre, row(k)["centre"], rtol=1e-6)
        np.testing.assert_allclose(tick.given, row(k)["voltage"], rtol=1e-6)
        assert tick.seen.time == pytest.approx(3.0 + 0.1 * k - 0.1)
    assert not plant.over
    clock.move(0.2)
    assert plant.over
    assert plant.observe().confidence == 0.0


# -- the closed loop


def turned_over(seconds_over: float, bench: Simulated, programme: object, duration: float) -> tuple[bool, list[object]]:
    """Whether the gel lies on its back during the last `seconds_over`, and the ticks."""
    bench.plant.guard.arm()
    clock, since, ticks = bench.plant.clock, np.inf, []
    for tick in drive(bench.plant, Programmed(programme), clock, 0.1, duration):
        ticks.append(tick)
        over = float(bench.gel.seen.normal[2]) < -0.8
        since = (tick.time if since == np.inf else since) if over else np.inf
    bench.plant.guard.close()
    return bool(ticks[-1].time - since >= seconds_over), ticks


@pytest.mark.slow
def test_the_turn_over_in_closed_loop_20_seeds_of_20():
    """The gel adsorbs 15 % less or more than its model; the camera sees it 100 ms late, 0.1 mm and 2 degrees off."""
    nominal = build(with_controller(load("turn-over"), "planned").scenario)
    gels = [
        build(with_controller(load("turn-over", [f"material.p_ele={p} cm^2/mA"]), "planned").scenario, nominal)
        for p in (0.02 * 0.85, 0.02 * 1.15)
    ]
    camera = nominal.scenario.camera
    assert (camera.delay, camera.position_noise) == (0.1, 1e-4)
    over = [
        turned_over(5.0, simulated(nominal, gels[seed % 2], HandClock(), seed=seed), nominal.programme, 30.0)[0]
        for seed in range(20)
    ]
    assert over == [True] * 20


HOUR = """
import json, sys
from pathlib import Path
from typing import Any
from gelbot.engine import prepare_engine
prepare_engine()
import numpy as np
from gelbot.bench import drive
from gelbot.clock import HandClock, WallClock
from gelbot.live.drivers import Programmed
from gelbot.live.keeping import Keeping
from gelbot.live.ready import Source, make_ready
from gelbot.live.twin import Twin
from gelbot.plants.build import simulated

def resident():
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024.0

ready = make_ready(Source("turn-over"), ["body.mesh_size=1.8 mm"], [])
clock = HandClock()
bench = simulated(ready.nominal, ready.real, clock, seed=1)
twin, keeping, guard = Twin(ready.nominal, 0.0), Keeping(Path(sys.argv[1])), bench.plant.guard
keeping.begin(ready, "soak")
keeping.open()
guard.arm()
memory, count, looks = {}, 0, guard.checks
for tick in drive(bench.plant, Programmed(ready.nominal.programme), clock, 0.1, float(sys.argv[2]), WallClock()):
    twin.advance(clock.now())
    twin.voltages = tick.given
    twin.arrows()
    keeping.tick(tick, tick.given, guard.measured, twin)
    count += 1
    if count % 1000 == 0:
        memory[count] = resident()
keeping.close()
guard.close()
print(json.dumps({"ticks": count, "memory": memory, "looks": guard.checks - looks, "gap": guard.longest_gap,
                  "reason": guard.reason}))
"""


@pytest.mark.slow
def test_an_hour_on_the_bench(tmp_path):
    """An hour of simulated time in some minutes: nothing grows, nothing is missed."""
    ran = subprocess.run(
        [sys.executable, "-c", HOUR, str(tmp_path), "3600"], capture_output=True, text=True, check=True, timeout=1500
    )
    found = json.loads(ran.stdout)
    assert found["reason"] is None
    assert found["ticks"] == 36_000
    assert found["looks"] >= 2 * 36_000  # each tick looks when it sees and when it applies
    assert found["gap"] == pytest.approx(0.1)
    memory = np.array(list(found["memory"].values()))
    # From the tenth minute on; what an hour adds must not show.
    assert memory[6:].max() - memory[6:].min() < 8.0, memory
    log = open_log(tmp_path / "bench.log")
    np.testing.assert_allclose(log["time"], 0.1 * np.arange(36_000), atol=1e-6)
    assert int(log["missed"].sum()) == 0
    assert (log["confidence"].values == 1.0).all()


def test_a_gel_that_moves_while_its_loop_waits_moves_as_one_that_does_not(coarse):
    def driven(meanwhile: bool) -> tuple[np.ndarray, list[float]]:
        clock = HandClock()
        bench = simulated(coarse, coarse, clock, seed=2)
        bench.plant.guard.arm()
        waiting = Meanwhile(clock, bench.gel) if meanwhile else clock
        ticks = drive(bench.plant, Programmed(coarse.programme), waiting, 0.1, 2.0)
        heights = [float(np.asarray(tick.seen.observation.centre)[2]) for tick in ticks]
        bench.plant.guard.close()
        return np.asarray(bench.gel.state.positions), heights

    (one, seen), (other, seen_too) = driven(False), driven(True)
    np.testing.assert_allclose(one, other, atol=1e-12)
    assert seen == seen_too
