"""The session: what was stopped stays stopped, whatever was asked for before and is done later.

| order of events | what must be |
|---|---|
| reset, start, and a stop while it is built | stopped, zero volts |
| another driver while it runs, and a stop while that is compiled | stopped; the page sees a bench that runs |
| start, and the end of the program at the same time | zero volts |
| another scenario chosen in the browser | the bench's own limits |
| a change of what is not offered | refused |
| a supply without a watchdog | said to the user, and in the log |
| a scenario that cannot be built | what stood before stands again; one line |
| a reset that fails | stopped, and says why |
| keys that come together, keys while a stop fails | each is heard |
"""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gelbot.errors import BadInput, GelbotError, SupplyFailed
from gelbot.hardware.soft_supply import SoftSupply
from gelbot.live.ready import Source, make_ready
from gelbot.live.session import Session
from gelbot.live.setups import BenchSetup, SimulatedSetup
from gelbot.plants.build import soft_supply
from gelbot.plants.simulated import Noise, SimulatedEye, SimulatedGel
from gelbot.record.log import open_log
from waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.realtime]
COARSE = ["body.mesh_size=1.8 mm"]
PERIOD = "500 ms"
UNHURRIED = [*COARSE, f"programme.control_period={PERIOD}", f"recording.interval={PERIOD}", "recording.chunk=1 s"]
"""A loop that a busy machine does not hold up for too long."""


def runs(session: Session) -> None:
    """Start it by hand, and wait until there are voltages; again where a busy machine held up the loop."""
    for _ in range(3):
        session.set_pattern("ridge", 5.0)
        session.start()
        until(lambda: session.moment().given.any() or session.moment().state == "stopped")
        if session.moment().state != "stopped":
            return
        session.reset()
        until(lambda: session.moment().state == "ready")
    pytest.fail("the machine was busy three times")


@pytest.fixture
def session(tmp_path):
    made = Session(
        SimulatedSetup(), Source("turn-over"), tmp_path / "live", UNHURRIED, elsewhere=lambda name: tmp_path / name
    )
    yield made
    made.close()


def stands(session: Session) -> None:
    """All that was asked for is done, and no electrode has a voltage."""
    time.sleep(1.0)
    until(lambda: session.moment().state not in ("building", "running"))
    assert not session.setup.guard.given.any()
    assert session.setup.guard.reason is not None
    with pytest.raises(GelbotError, match="Press reset first"):
        session.start()


def test_a_stop_during_a_reset_is_not_lost_to_a_start_behind_it(session):
    session.set_pattern("ridge", 5.0)
    session.reset()
    session.start()
    session.emergency_stop("me")
    stands(session)
    session.reset()
    until(lambda: session.moment().state == "ready")
    runs(session)


def test_a_stop_while_another_scenario_is_built(session):
    session.choose("dome")
    session.emergency_stop("me")
    until(lambda: session.stage().name == "dome")
    stands(session)


def test_another_scenario_has_a_folder_of_its_own_and_a_stop_is_news(session, tmp_path):
    session.step()
    until(lambda: session.moment().number == 1)
    session.choose("dome")
    until(lambda: session.stage().name == "dome" and session.moment().state == "ready")
    session.step()
    until(lambda: session.moment().number == 1)
    session.news()
    session.emergency_stop("me")
    until(lambda: "stopped: emergency stop: me" in session.news())
    assert open_log(tmp_path / "live" / "bench.log").attrs["scenario_name"] == "turn-over"
    assert open_log(tmp_path / "dome" / "bench.log").attrs["scenario_name"] == "dome"
    assert session.keeping.told() == f"; what was kept is in {tmp_path / 'live'}, {tmp_path / 'dome'}"


def test_a_voltage_for_an_electrode_that_stands_no_longer(session):
    session.change({"electrodes.columns": "3"})
    session.set_voltage(15, 5.0)
    session.set_pattern("ridge", 5.0)
    until(lambda: len(session.moment().asked) == 12 and session.moment().state == "ready")
    time.sleep(0.1)
    moment = session.moment()
    assert moment.state == "ready", moment.message
    assert not moment.asked.any()
    runs(session)


def test_a_stop_while_the_driver_changes(session, monkeypatch):
    runs(session)
    warmed = session._ready.warm
    monkeypatch.setattr(session._ready, "warm", lambda *which: (time.sleep(0.5), warmed(*which)))
    session.drive_with("planned")
    until(lambda: session._is_changing)
    # Whoever looks takes it for one that runs: a browser that is closed now stops it.
    assert session.moment().state == "running"
    session.emergency_stop("me")
    stands(session)


def test_the_end_of_the_program_is_the_end_whatever_was_asked_for(session):
    runs(session)
    session.halt("the program was ended")
    time.sleep(0.5)
    assert not session.setup.guard.given.any()
    session.reset()
    time.sleep(2.0)
    with pytest.raises(GelbotError, match="the program was ended"):
        session.start()


def test_the_bench_keeps_its_own_limits(tmp_path):
    session = Session(
        SimulatedSetup(),
        Source("turn-over"),
        tmp_path / "live",
        [*UNHURRIED, "supply.limit=10 V", "supply.current_limit=0.1 A"],
    )
    try:
        for name in ("dome", "turn-over"):
            session.choose(name)
            until(lambda name=name: session.stage().name == name and session.moment().state == "ready")
            assert session._ready.loaded.scenario.supply.current_limit == 0.1
            assert session.setup.guard.limits.current == 0.1
        for key in ("supply.limit", "camera.delay", "programme.control_period", "name"):
            with pytest.raises(BadInput, match="a key of body, electrodes, material, solution"):
                session.change({key: "1 V"})
        with pytest.raises(BadInput, match="one of"):
            session.choose("/etc/passwd")
    finally:
        session.close()


def test_what_cannot_be_built_leaves_what_stood(tmp_path):
    session = Session(SimulatedSetup(), Source("curl"), tmp_path / "live")
    try:
        with pytest.raises(BadInput, match=r"body\.width: got 'wide'; allowed: a length with its unit"):
            session.change({"body.width": "wide"})
        stage = session.stage()
        session.change({"body.pose.lift": "1 mm"})  # a length, but the rod is there
        until(lambda: "overlaps neither walls nor obstacles" in session.moment().message)
        assert session.moment().state == "ready"
        assert session.stage().settings == stage.settings
    finally:
        session.close()


def bench(tmp_path: Path, opens) -> Session:
    def eye(ready, clock, tell):
        gel = SimulatedGel(ready.nominal, lambda: np.zeros(16), clock.now())
        gel.compile()
        seen = SimulatedEye(gel, Noise(1e-4, 0.03), 0.1)
        seen.picture = lambda: None  # pyright: ignore[reportAttributeAccessIssue]
        seen.close = lambda: None  # pyright: ignore[reportAttributeAccessIssue]
        return seen

    return Session(BenchSetup(opens, eye), Source("turn-over"), tmp_path / "live", COARSE)


def test_a_supply_without_a_watchdog_is_told_of(tmp_path):
    session = bench(tmp_path, lambda ready, clock: SoftSupply(16, clock=clock, watchdog=None))
    try:
        assert "has no watchdog" in session.moment().message
        session.start()
        until(lambda: session.moment().number > 2)
    finally:
        session.close()
    assert any("has no watchdog" in event.text for event in open_log(tmp_path / "live" / "bench.log").attrs["events"])


def test_a_supply_that_is_gone_at_a_reset(tmp_path):
    there = [True]

    def opens(ready, clock):
        if not there[0]:
            raise SupplyFailed("the supply", "it is gone", "its cable")
        return soft_supply(ready.nominal, clock)

    session = bench(tmp_path, opens)
    try:
        there[0] = False
        session.reset()
        until(lambda: session.moment().state == "stopped")
        assert "it is gone" in session.moment().message
        with pytest.raises(GelbotError, match="Press reset first"):
            session.start()
        there[0] = True
        session.reset()
        until(lambda: session.moment().state == "ready")
        session.start()
        until(lambda: session.moment().number > 2)
    finally:
        session.close()


def test_a_camera_that_is_not_there_leaves_a_closed_supply_and_no_other_word(tmp_path):
    opened: list[SoftSupply] = []
    said: list[str] = []

    def opens(ready, clock):
        opened.append(soft_supply(ready.nominal, clock))
        return opened[0]

    def eye(ready, clock, tell):
        raise BadInput("camera.background", "README.md", "a picture")

    setup = BenchSetup(opens, eye)
    with pytest.raises(BadInput, match=r"camera\.background"):
        setup.begin(make_ready(Source("turn-over"), COARSE, ()), said.append, said.append)
    setup.close()
    assert not said
    with pytest.raises(SupplyFailed, match="it was closed"):
        opened[0].write(np.zeros(16))


def test_a_bench_with_a_slow_loop_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"at most 0\.15 s on the bench"):
        Session(
            BenchSetup(lambda ready, clock: soft_supply(ready.nominal, clock), lambda *all_: None),  # pyright: ignore
            Source("turn-over"),
            tmp_path / "live",
            [*COARSE, "programme.control_period=200 ms", "recording.interval=200 ms"],
        )


KEYS = """
import sys, time
from gelbot.live.command import keyboard
stops = []
def stop():
    stops.append(time.monotonic())
    print("stop", len(stops), flush=True)
    if len(stops) == 1:
        raise RuntimeError("the first fails")
with keyboard(stop):
    print("ready", flush=True)
    time.sleep(8.0)
"""


def test_every_key_is_heard():
    here, there = pty.openpty()
    with subprocess.Popen([sys.executable, "-c", KEYS], stdin=there, stdout=subprocess.PIPE, text=True) as program:
        try:
            assert program.stdout is not None
            assert program.stdout.readline() == "ready\n"
            os.write(here, b"x ")  # two at once: the second counts
            assert program.stdout.readline() == "stop 1\n"
            os.write(here, b"\x1b")
            assert program.stdout.readline() == "stop 2\n"
            os.write(here, b"abc")
            os.write(here, b"q")
            assert program.stdout.readline() == "stop 3\n"
        finally:
            program.kill()
            os.close(here)
            os.close(there)
