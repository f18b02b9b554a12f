"""The whole bench without one: the reference device over a pty gives the voltages, a rendered video is the camera.

| what is done | what must be |
|---|---|
| turn-over by the reference device and a rendered video, the loop as on the bench | over, and stays so |
| what the tracker saw meanwhile | the gel that was rendered; never lost |
| a session with a rendered camera | pictures with the outline drawn in, a gel that is found |
| a recording of a session, played | the sightings and the voltages of then; the simulator beside it moves as it did |
| the page's process asks over the pipe | what the session says; each object once; an end is told |
| command line | one line for each mistake, exit code 2, nothing written |
"""

from __future__ import annotations

import multiprocessing
import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from command_line import refused
from gelbot.bench import drive
from gelbot.clock import HandClock, WallClock
from gelbot.errors import BadInput, GelbotError
from gelbot.hardware.reference_device import ReferenceDevice
from gelbot.hardware.serial_supply import SerialSupply
from gelbot.hardware.served_device import ServedDevice
from gelbot.live.apart import _Answering
from gelbot.live.eyes import rendered_eye
from gelbot.live.far import FarActions
from gelbot.live.ready import PLANNED, Source, make_ready
from gelbot.live.session import Session
from gelbot.live.setups import PlayedSetup, SimulatedSetup
from gelbot.plants.build import guard_of
from gelbot.plants.guarded import GuardedPlant
from gelbot.plants.simulated import SimulatedGel
from waiting import until

pytestmark = pytest.mark.realtime
UNHURRIED = [
    "body.mesh_size=1.8 mm",
    "programme.control_period=500 ms",
    "recording.interval=500 ms",
    "recording.chunk=1 s",
]
"""A loop that a busy machine does not hold up for too long."""


@pytest.mark.slow
def test_the_turn_over_by_the_reference_device_and_a_rendered_video():
    """As `gelbot live` runs it, loop, guard, supply and eye; the gel adsorbs 13 % less than its model."""
    ready = make_ready(Source("turn-over"), (), ["material.p_ele=0.0174 cm^2/mA"])
    # The device lives in real time, the gel in that of its pictures, which take their time to be drawn and looked at:
    # on a busy machine longer than a device waits.
    clock, patient = HandClock(), 3.0
    load = ready.nominal.field.conductance @ ready.nominal.connection
    with ServedDevice(ReferenceDevice(16, watchdog=patient, conductance=load)).start() as device:
        supply = SerialSupply(device.port, timeout=1.0, watchdog=patient)
        said: list[str] = []
        guard = guard_of(ready.nominal, supply, clock, said.append)
        gel = SimulatedGel(ready.real, device.outputs)
        eye = rendered_eye(ready, gel, clock, said.append, seed=3, threaded=False)
        plant = GuardedPlant(guard, eye, clock)
        gel.compile()
        ready.warm(PLANNED, plant.observe().observation)
        guard.arm()
        ticks, off, over = [], [], []
        for tick in drive(plant, ready.driver(PLANNED), clock, 0.1, 32.0, WallClock()):
            ticks.append(tick)
            over.append(float(gel.seen.normal[2]) < -0.8)
            if tick.time < 10.0:  # while it rises, slower than the picture is old
                off.append(np.linalg.norm(np.asarray(tick.seen.observation.centre) - gel.seen.centre))
        measured = guard.measured
        guard.close()
    assert all(over[-50:])
    assert min(tick.seen.confidence for tick in ticks[2:]) > 0.0
    assert np.quantile(off[2:], 0.95) < 0.4e-3
    # The device has measured what it gave: the currents of the gel's electrodes, which sum to zero.
    assert measured is not None
    assert np.abs(measured).max() > 1e-3
    assert abs(measured.sum()) < 1e-2 * np.abs(measured).max()
    assert not any("stopped" in text or "waiting" in text for text in said), said


@pytest.mark.slow
def test_a_session_with_a_rendered_camera(tmp_path):
    session = Session(
        SimulatedSetup(),
        Source("dome"),
        tmp_path / "live",
        [*UNHURRIED, "camera.source=rendered", "simulation.duration=8 s"],
    )
    try:
        assert session.stage().has_camera
        session.start()
        until(lambda: session.moment().number > 6 or session.moment().state == "stopped")
        moment = session.moment()
    finally:
        session.close()
    assert moment.picture is not None
    assert moment.picture.shape == (480, 640, 3)
    # The outline is the only thing in colour.
    assert (np.ptp(moment.picture.astype(int), axis=2) > 40).sum() > 50
    assert moment.observed is not None
    assert moment.observed.confidence > 0.0


@pytest.mark.slow
def test_a_recording_of_a_session_is_played(tmp_path):
    def run(setup, source, folder) -> tuple[np.ndarray, np.ndarray]:
        """A dozen steps, counted: what was seen last, and where the simulator has the centre then."""
        session = Session(setup, source, folder, UNHURRIED if source.text is None else ())
        try:
            if source.text is None:
                session.set_pattern("ridge", 10.0)
            for count in range(1, 13):
                session.step()
                until(lambda count=count: session.moment().number == count and session.moment().state == "paused")
            tick = session._last
            assert tick is not None
            return np.asarray(tick.seen.observation.centre), np.asarray(session._twin.gel.seen.centre)
        finally:
            session.close()

    seen, simulated = run(SimulatedSetup(None), Source("turn-over"), tmp_path / "live")
    played = PlayedSetup(tmp_path / "live", None)
    seen_again, simulated_again = run(played, Source("played", played.scenario_text), tmp_path / "again")
    np.testing.assert_allclose(seen_again, seen, rtol=1e-5)
    assert simulated[2] > 0.8e-3
    np.testing.assert_allclose(simulated_again, simulated, atol=1e-6)
    # To its end, and no further.
    session = Session(PlayedSetup(tmp_path / "live", None), Source("played", played.scenario_text), tmp_path / "end")
    try:
        assert session.stage().controllers == ("recording",)
        for act in (lambda: session.set_voltage(0, 5.0), lambda: session.drive_with("planned")):
            with pytest.raises(BadInput, match="those of the recording that is played"):
                act()
        session.start()
        until(lambda: session.moment().message == "the recording has ended")
        np.testing.assert_array_equal(session.moment().asked, session.moment().given)
        assert session.moment().controller == "recording"
        assert session.moment().state == "paused"
        assert 12 <= session.moment().number <= 14
    finally:
        session.close()
    with pytest.raises(BadInput, match="a recording with 16 electrodes"):
        Session(
            PlayedSetup(tmp_path / "live"), Source("turn-over"), tmp_path / "other", [*UNHURRIED, "electrodes.rows=3"]
        )


class Told:
    """A session that says what it was told."""

    def __init__(self) -> None:
        self.told: list[tuple[object, ...]] = []

    def set_voltage(self, electrode: int, volts: float) -> None:
        if electrode > 3:
            raise BadInput("electrode", electrode, "a number from 0 to 3")
        self.told.append((electrode, volts))

    def emergency_stop(self, who: str) -> None:
        self.told.append((who,))

    def scenarios(self) -> list[str]:
        time.sleep(0.5)
        return ["one"]


def test_over_the_pipe_all_is_as_in_one_process():
    ours, its = zip(*(multiprocessing.Pipe() for _ in range(2)), strict=True)
    told = Told()
    answering = [_Answering(told, end) for end in ours]  # pyright: ignore[reportArgumentType]
    for one in answering:
        one.thread.start()
    far = FarActions(*its)
    far.set_voltage(2, 1.5)
    with pytest.raises(BadInput, match="a number from 0 to 3") as error:
        far.set_voltage(7, 1.0)
    assert error.value.given == 7
    with pytest.raises(GelbotError, match="nothing that can be asked for"):
        far._ask("__init__")
    # A stop does not wait for what takes its time.
    slow = Thread(target=far.scenarios)
    slow.start()
    began = time.monotonic()
    far.emergency_stop("me")
    assert time.monotonic() - began < 0.4
    slow.join()
    for end in its:
        end.close()
    for one in answering:
        one.close()
    # The other side went without a word: that is an emergency.
    assert told.told[:2] == [(2, 1.5), ("me",)]
    assert told.told[2:] == [("the end of the page's program",)] * 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["live", "turn-ovr"], "Try: turn-over"),
        (["live", "--plant", "nothing.log"], "simulated, bench, or a recording"),
        (["live", "--plant", "bench"], "camera.source: got nothing"),
        (["live", "--plant", "bench", "--set", "camera.source=0"], "camera.calibration: got nothing"),
        (["live", "--plant", "bench", "--set", "supply.device.kind=serial"], "supply.device.port"),
        (["live", "--plant", "bench", "--real", "material.p_l=0.7"], "with --plant simulated only"),
        (["live", "--pace", "0.5"], "1 or more, or fast"),
        (["live", "--token", "short"], "token"),
        (["live", "--controller", "nobody"], "by hand"),
        (["live", "--set", "supply.channels=[1, 2]"], "16, one for each electrode"),
        (["live", "--set", "camera.delay=3 m"], "a time with its unit"),
    ],
)
def test_mistakes_on_the_command_line(tmp_path, monkeypatch, words, says):
    monkeypatch.chdir(tmp_path)
    assert says in refused(*words, "--no-browser", "--port", "0")
    assert not list(Path().iterdir())
