"""Faults of the live bench: a session drives the reference device over a pty, and a simulated gel lies under it.

After each of them: the device's outputs at zero volts within 300 ms of the fault, the log whole, one clear message.

| fault | what ends it |
|---|---|
| camera lost for 2 s | zero volts while it is lost; then the run goes on |
| camera lost for good | zero volts; stopped after the scenario's patience |
| device unplugged in mid-write | the device's own watchdog; stopped |
| one garbled reply | nothing: the line is sent again |
| garbled replies without end | the device's own watchdog; stopped |
| hung device | the device's own watchdog; stopped |
| stalled controller | the guard; stopped |
| a driver that makes a mistake, asks for nan | the guard; stopped |
| disk full | the guard; stopped |
| clock that goes back, or jumps ahead | the guard; stopped |
| kill -9 of the whole program | the device's own watchdog |
| SIGTERM, SIGINT | zero volts on the way out |
| emergency stop: page, keyboard | the guard; stopped until a reset |
"""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from gelbot.bench import Decision
from gelbot.clock import Clock
from gelbot.errors import GelbotError
from gelbot.hardware.reference_device import ReferenceDevice
from gelbot.hardware.serial_supply import SerialSupply
from gelbot.hardware.served_device import ServedDevice
from gelbot.live.ready import Source
from gelbot.live.session import Session
from gelbot.live.setups import BenchSetup
from gelbot.plants.simulated import Noise, SimulatedEye, SimulatedGel
from gelbot.record.log import open_log
from gelbot.scenario.build import Experiment
from waiting import until

WITHIN = 0.3
"""Zero volts at the latest after this long [s]."""
SEEN = 0.3
"""Why a device went to zero volts is told at the latest so long [s] after it did."""
CALM = 0.03
"""A test that could not look for longer than this [s] was held up itself: then it says nothing, and is done again."""
COARSE = "body.mesh_size=1.8 mm"

pytestmark = [pytest.mark.slow, pytest.mark.realtime]


class TankEye(SimulatedEye):
    """The eye of a simulated gel that lies under the served device."""

    def __init__(self, experiment: Experiment, clock: Clock, device: ServedDevice) -> None:
        gel = SimulatedGel(experiment, device.outputs, clock.now())
        gel.compile()
        super().__init__(gel, Noise(1e-4, 0.03), 0.1)

    def picture(self) -> None:
        return None

    def close(self) -> None:
        pass


class Tank:
    """A session, the device that it drives, and the eye that sees what comes of it."""

    def __init__(self, session: Session, device: ServedDevice, setup: BenchSetup) -> None:
        self.session, self.device, self._setup = session, device, setup

    @property
    def eye(self) -> TankEye:
        eye = self._setup._eye
        assert isinstance(eye, TankEye)
        return eye

    def runs(self) -> None:
        """Start it by hand, and wait until the device gives voltages."""
        self.session.set_pattern("ridge", 5.0)
        self.session.start()
        self.lives()

    def lives(self) -> None:
        """Wait until it gives voltages, and goes on to."""
        until(lambda: self.device.outputs().any() or self.session.moment().state == "stopped")
        time.sleep(0.3)
        moment = self.session.moment()
        self.on_time(moment.message)
        assert moment.state == "running", moment.message

    def on_time(self, message: str | None = None) -> None:
        """Nobody was silent for too long, by the present message if none is given. Raises `Busy`: nothing was done
        here that could make them."""
        message = self.session.moment().message if message is None else message
        if "silent" in message or "waiting" in message or "stood still" in message:
            raise Busy

    def fault(self, cause: Callable[[], object]) -> float:
        """What it took [s] from the beginning of a fault to zero volts."""
        if not self.device.outputs().any():
            time.sleep(SEEN)
            self.on_time()
            pytest.fail(f"zero volts before the fault: {self.session.moment().message}")
        began = time.monotonic()
        cause()
        return zero_after(self.device, began)

    def ended(self, says: str) -> None:
        """It has stopped, says why, and its log is whole up to that."""
        until(lambda: self.session.moment().state == "stopped")
        time.sleep(0.1)
        assert not self.device.outputs().any()
        message = self.session.moment().message
        if says not in message:
            self.on_time(message)
        assert says in message
        assert "\n" not in message
        with pytest.raises(GelbotError, match="Press reset first"):
            self.session.start()
        self.log(says)

    def log(self, says: str) -> None:
        read = open_log(self.session.keeping.folder / "bench.log")
        assert read.sizes["time"] > 2
        assert np.isfinite(read["voltage"].values).all()
        assert (np.diff(read["time"]) > 0.0).all()
        assert any(says in event.text for event in read.attrs["events"]), read.attrs["events"]


class Busy(Exception):
    """The machine was so busy that times say nothing."""


def zero_after(device: ServedDevice, began: float) -> float:
    """How long after `began` [s] the device's outputs are zero. Raises `Busy`."""
    looked, longest = time.monotonic(), 0.0
    while device.outputs().any():
        assert time.monotonic() < began + 20.0, "the electrodes stay live"
        time.sleep(0.002)
        longest, looked = max(longest, time.monotonic() - looked), time.monotonic()
    took = time.monotonic() - began
    if took >= WITHIN and longest > CALM:
        raise Busy
    print(f"zero volts after {1e3 * took:.0f} ms")  # with pytest -s
    return took


def calmly(test: Callable[..., None]) -> Callable[..., None]:
    """Do a test that found the machine `Busy` again, up to four times."""

    @functools.wraps(test)
    def done(tmp_path: Path, *args: object, **kwargs: object) -> None:
        for attempt in range(5):
            try:
                return test(tmp_path / str(attempt), *args, **kwargs)
            except Busy:
                print("the machine was busy")
        pytest.fail("the machine was busy five times")

    return done


@contextmanager
def made(tmp_path: Path, patience: str = "1 s") -> Iterator[Tank]:
    with ServedDevice(ReferenceDevice(16)).start() as device:
        setup = BenchSetup(
            lambda ready, clock: SerialSupply(device.port, watchdog=0.2),
            lambda ready, clock, tell: TankEye(ready.nominal, clock, device),
            "reference device",
        )
        session = Session(setup, Source("turn-over"), tmp_path / "live", (COARSE, f"camera.patience={patience}"))
        try:
            yield Tank(session, device, setup)
        finally:
            session.close()


@calmly
def test_a_camera_lost_for_two_seconds(tmp_path):
    with made(tmp_path, patience="5 s") as tank:
        tank.runs()
        # The sighting that the guard knows is one period old when the hand comes.
        assert tank.fault(lambda: setattr(tank.eye, "covered", True)) < WITHIN
        assert "waiting for the camera" in tank.session.moment().message
        time.sleep(2.0)
        assert not tank.device.outputs().any()
        tank.eye.covered = False
        tank.lives()
        tank.log("zero volts: waiting for the camera")
        tank.log("all is seen again: going on")


@calmly
def test_a_camera_lost_for_good(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()
        assert tank.fault(lambda: setattr(tank.eye, "covered", True)) < WITHIN
        tank.ended("the camera has been silent for 1")


@calmly
def test_a_device_unplugged_in_mid_write(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()

        def unplug() -> None:
            tank.device.hangs = True  # what is being written then stays in the line
            time.sleep(0.05)
            tank.device.unplug()

        assert tank.fault(unplug) < WITHIN
        tank.ended("the port failed")


@calmly
def test_one_garbled_reply_is_no_fault(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()
        tank.device.garbled_count = 1
        end = time.monotonic() + 0.5
        while time.monotonic() < end and tank.device.outputs().any():
            time.sleep(0.002)
        time.sleep(SEEN)
        # Had the reply been what made it silent, it would be silent each time.
        moment = tank.session.moment()
        tank.on_time(moment.message)
        assert tank.device.garbled_count == 0
        assert moment.state == "running", moment.message
        assert tank.device.outputs().any()


@calmly
def test_garbled_replies_without_end(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()

        # All that is sent to it is garbled too: it would otherwise go on with the voltages that it understands.
        def garble() -> None:
            tank.device.garbled_count = tank.device.deaf_count = 1000

        assert tank.fault(garble) < WITHIN
        tank.ended("garbled")


@calmly
def test_a_hung_device(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()
        assert tank.fault(lambda: setattr(tank.device, "hangs", True)) < WITHIN
        tank.ended("within 0.1 s. Try: whether it has power")


class Stalled:
    """A driver that does not come back for a while, or makes a mistake, or asks for nonsense."""

    def __init__(self, then: Callable[[], Decision]) -> None:
        self.then = then

    def decide(self, time: float, seen: object) -> Decision:
        return self.then()


def nan() -> Decision:
    return Decision(np.full(16, np.nan), 0, 0.0, np.nan)


def mistake() -> Decision:
    raise KeyError("pattern")


def sleep() -> Decision:
    time.sleep(2.0)
    return Decision(np.full(16, 5.0), 0, 0.0, np.nan)


@pytest.mark.parametrize(
    ("then", "says"),
    [
        (sleep, "the control loop has been silent for 0.2"),
        (mistake, "a mistake in the program: KeyError('pattern')"),
        (nan, "the controller asked for nan V on electrode 0"),
    ],
)
@calmly
def test_a_controller_that_fails(tmp_path, then, says):
    with made(tmp_path) as tank:
        tank.runs()
        assert tank.fault(lambda: setattr(tank.session._helm, "driver", Stalled(then))) < WITHIN
        tank.ended(says)


@calmly
def test_a_full_disk(tmp_path):
    with made(tmp_path) as tank:
        import resource

        tank.runs()
        log = tank.session.keeping.folder / "bench.log"
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

        def fill() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (log.stat().st_size + 50, hard))

        try:
            assert tank.fault(fill) < WITHIN
            until(lambda: tank.session.moment().state == "stopped")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert tank.session.moment().message == f"{log} cannot be written: File too large"
        assert open_log(log).sizes["time"] > 2
        assert log.read_bytes().endswith(b"}\n")


@pytest.mark.parametrize(("jump", "says"), [(-0.7, "the clock went back by"), (30.0, "stood still for 30")])
@calmly
def test_a_clock_that_jumps(tmp_path, jump, says):
    with made(tmp_path) as tank:
        tank.runs()

        def move() -> None:
            tank._setup.clock._start -= jump

        assert tank.fault(move) < WITHIN
        tank.ended(says)


@calmly
def test_the_emergency_stop(tmp_path):
    with made(tmp_path) as tank:
        tank.runs()
        assert tank.fault(lambda: tank.session.emergency_stop("the page")) < 0.15
        tank.ended("emergency stop: the page")
        tank.session.reset()
        until(lambda: tank.session.moment().state == "ready")
        tank.runs()


# -- the whole program, and what is left of it


@contextmanager
def program(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], ServedDevice]]:
    """`gelbot live` on the reference device; its eye is blind, so it drives by hand and the loop is what lives."""
    with ServedDevice(ReferenceDevice(16)).start() as device:
        code = BLIND.format(port=device.port, folder=str(tmp_path / "live"))
        with subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            try:
                until(lambda: device.outputs().any() or process.poll() is not None, 120.0)
                assert process.poll() is None, process.stderr.read() if process.stderr else ""
                time.sleep(0.5)
                yield process, device
            finally:
                process.kill()


BLIND = """
import sys
from pathlib import Path
from gelbot.live import command
from gelbot.live.command import Asked, live_bench
from gelbot.live.setups import BenchSetup
from gelbot.hardware.serial_supply import SerialSupply
from gelbot.plants.simulated import Noise, SimulatedEye, SimulatedGel
import numpy as np

class TankEye(SimulatedEye):
    def __init__(self, ready, clock, tell):
        gel = SimulatedGel(ready.nominal, lambda: np.zeros(16), clock.now())
        gel.compile()
        super().__init__(gel, Noise(1e-4, 0.03), 0.1)
    def picture(self):
        return None
    def close(self):
        pass

command.bench_setup = lambda: BenchSetup(lambda r, c: SerialSupply({port!r}), TankEye, "reference device")
changes = ("body.mesh_size=1.8 mm", "camera.source=0", "camera.calibration=camera.toml")
live_bench(Asked("turn-over", "bench", changes, (), "planned", "1", 1, "127.0.0.1", 0, None, False,
                 True, Path({folder!r})), print)
"""


@calmly
def test_kill_9_leaves_zero_volts_and_a_whole_log(tmp_path):
    with program(tmp_path) as (process, device):
        killed = time.monotonic()
        process.kill()
        assert zero_after(device, killed) < WITHIN
        time.sleep(0.1)
        assert not device.outputs().any()
    read = open_log(tmp_path / "live" / "bench.log")
    assert read.sizes["time"] > 2


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGINT])
@calmly
def test_signals_end_it_with_zero_volts(tmp_path, kind):
    with program(tmp_path) as (process, device):
        sent = time.monotonic()
        os.kill(process.pid, kind)
        assert zero_after(device, sent) < WITHIN
        out, _ = process.communicate(timeout=20.0)
        assert process.returncode == 0
        assert "ended, all electrodes at zero volts" in out
        assert not device.outputs().any()
    read = open_log(tmp_path / "live" / "bench.log")
    assert any("the program was ended" in event.text for event in read.attrs["events"])
