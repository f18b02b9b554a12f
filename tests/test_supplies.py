"""Supplies, and the devices that they drive.

| identity | one road | the other |
|---|---|---|
| checksum | `crc16` | the published check value; the lines printed in the documents |
| a line | decoded | encoded; with any one bit flipped: refused |
| reference device | its answers and outputs | the protocol's rules; the C++ firmware on the same lines |
| serial supply | what was written | what is on the outputs, through noise, silence, hanging, unplugging |
| watchdog | outputs after the host's death | zero, within 0.3 s |
| SCPI supply | bytes sent | the profile's, one by one; a simulated instrument's memory |
| NI supply | calls of the driver | one write for all channels, a watchdog fed before it |
| any supply | voltages out of range | refused, nothing sent |
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.clock import HandClock
from gelbot.errors import BadInput, SupplyFailed
from gelbot.hardware.devices import SupplySettings, open_supply
from gelbot.hardware.line_protocol import (
    LONGEST_ANSWER,
    LONGEST_REQUEST,
    Answer,
    GarbledLine,
    Identity,
    ReadBack,
    Request,
    crc16,
    decode,
    decode_answer,
    encode,
    encode_answer,
    encode_request,
    identity_of,
    identity_words,
    read_back_of,
    read_back_words,
)
from gelbot.hardware.ni_supply import NiSupply
from gelbot.hardware.reference_device import ReferenceDevice, main, read_conductance
from gelbot.hardware.scpi_profile import load_profile, profile_names, profile_text
from gelbot.hardware.scpi_supply import ScpiSupply
from gelbot.hardware.serial_supply import SerialSupply
from gelbot.hardware.served_device import ServedDevice
from gelbot.hardware.soft_supply import SoftSupply
from gelbot.hardware.supply import Supply

pytestmark = pytest.mark.realtime
ROOT = Path(__file__).parents[1]
VOLTS = np.linspace(-10.0, 10.0, 16).round(3)
words = st.lists(
    st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="*"), min_size=1), min_size=1
)


class TestLines:
    def test_checksum_is_the_published_one(self):
        assert crc16(b"123456789") == 0x29B1
        example = "FFFF at first, 381D after 49, 8E39 after 20, 6F34 after 31"
        assert example in (ROOT / "docs" / "hardware.md").read_text()
        assert [f"{crc16(bytes([0x49, 0x20, 0x31][:count])):04X}" for count in range(4)] == re.findall(
            "[0-9A-F]{4}", example
        )

    @given(words)
    def test_what_is_encoded_is_decoded(self, given_words):
        assert decode(encode(tuple(given_words))) == tuple(given_words)

    @given(st.lists(st.integers(-10000, 10000), min_size=16, max_size=16), st.integers(1, 65535), st.data())
    def test_any_flipped_bit_is_noticed(self, millivolts, number, data):
        line = encode_request(Request("W", number, tuple(millivolts)))
        assert len(line) <= LONGEST_REQUEST
        bit = data.draw(st.integers(0, 8 * len(line) - 1))
        flipped = bytearray(line)
        flipped[bit // 8] ^= 1 << bit % 8
        with pytest.raises(GarbledLine):
            decode(bytes(flipped))

    @given(st.binary(max_size=40))
    def test_noise_is_refused_and_nothing_else_happens(self, noise):
        with pytest.raises(GarbledLine):
            decode(noise + b"\n")

    @pytest.mark.parametrize(
        "line", [b"", b"\n", b"I 1*6F34", b"I 1*6f34\n", b"I  1*0000\n", b"I 1\n", b"I 1*6F34\n\n"]
    )
    def test_what_is_nearly_a_line_is_refused(self, line):
        with pytest.raises(GarbledLine, match="garbled line"):
            decode(line)

    def test_answers(self):
        identity = Identity("dac", 1, 16, -10000, 10000, 200)
        answer = decode_answer(encode_answer(Answer(True, 7, identity_words(identity))))
        assert (answer.done, answer.number, identity_of(answer.words)) == (True, 7, identity)
        read = ReadBack(99999, (-10000,) * 16, (-1000000,) * 16)
        line = encode_answer(Answer(True, 65535, read_back_words(read)))
        assert len(line) <= LONGEST_ANSWER
        assert read_back_of(decode_answer(line).words, 16) == read
        assert read_back_of(("0", "1"), 16) is None
        assert identity_of(("dac", "1")) is None
        with pytest.raises(GarbledLine, match="no answer"):
            decode_answer(encode(("W", "7")))
        with pytest.raises(ValueError, match="printable"):
            encode(("a*b",))

    def test_lines_in_the_documents_are_right(self):
        """Every line with a checksum that is printed for the reader."""
        texts = [ROOT / "docs" / "hardware.md", ROOT / "src" / "gelbot" / "hardware" / "line_protocol.py"]
        lines = [
            line
            for text in texts
            for line in re.findall(r"(?<!\S)([WRZIAN] [^*`\n]*\*[0-9A-F]{4})\b", text.read_text())
        ]
        assert len(lines) >= 8
        for line in lines:
            decode(line.encode() + b"\n")


def asked(
    device: ReferenceDevice, command: str, values: tuple[int, ...] = (), *, now: float = 0.0, number: int = 1
) -> str:
    """The device's answer, without its checksum."""
    answer = device.respond(encode_request(Request(command, number, values)), now)
    return " ".join(decode(answer))


class TestReferenceDevice:
    def test_its_answers(self):
        device = ReferenceDevice(2, conductance=[[0.01, -0.002], [-0.002, 0.01]])
        assert asked(device, "I") == "A 1 reference-dac 1 2 -10000 10000 200"
        assert asked(device, "W", (5000, -10000), number=9) == "A 9 0"
        assert asked(device, "R") == "A 1 0 5000 -10000 70000 -110000"
        assert device.outputs(0.1).tolist() == [5.0, -10.0]
        assert asked(device, "Z") == "A 1 0"
        assert device.outputs(0.1).tolist() == [0.0, 0.0]
        assert asked(ReferenceDevice(2), "R") == "A 1 0 0 0"

    @pytest.mark.parametrize(
        ("words", "answer"),
        [
            (("W", "3", "1", "10001"), "N 3 range"),
            (("W", "3", "1", "1.5"), "N 3 number"),
            (("W", "3", "1"), "N 3 count"),
            (("R", "3", "1"), "N 3 count"),
            (("X", "3"), "N 3 command"),
            (("W", "0", "1", "1"), "N 0 number"),
            (("W", "65536", "1", "1"), "N 0 number"),
            (("W",), "N 0 number"),
        ],
    )
    def test_what_it_refuses_changes_nothing(self, words, answer):
        device = ReferenceDevice(2)
        asked(device, "W", (100, 200))
        assert " ".join(decode(device.respond(encode(words), 0.1))) == answer
        assert device.outputs(0.1).tolist() == [0.1, 0.2]
        assert device.left(0.1) == pytest.approx(0.1)  # nor does it feed the watchdog

    def test_a_garbled_line_is_answered_and_an_empty_one_is_not(self):
        device = ReferenceDevice(2)
        assert " ".join(decode(device.respond(b"W 1 1 2*0000\n", 0.0))) == "N 0 crc"
        assert " ".join(decode(device.respond(encode(("W", "1", "9" * 300)), 0.0))) == "N 0 crc"
        assert device.respond(b"\n", 0.0) == b""

    def test_watchdog(self):
        device = ReferenceDevice(2, watchdog=0.2)
        asked(device, "W", (1000, 2000), now=1.0)
        assert device.left(1.05) == pytest.approx(0.15)
        assert device.outputs(1.199).tolist() == [1.0, 2.0]
        assert asked(device, "R", now=1.15) == "A 1 0 1000 2000"  # reading does not feed it
        assert device.outputs(1.201).tolist() == [0.0, 0.0]
        assert asked(device, "R", now=1.3) == "A 1 1 0 0"
        assert asked(device, "W", (1000, 2000), now=2.0) == "A 1 1"  # and the next voltages are taken
        asked(device, "Z", now=2.1)
        assert asked(device, "R", now=9.0) == "A 1 1 0 0"  # at zero there is nothing to expire
        endless = ReferenceDevice(1, watchdog=0.0)
        asked(endless, "W", (1000,))
        assert endless.outputs(1e6).tolist() == [1.0]

    def test_settings_that_cannot_work(self):
        for settings in ({"channel_count": 17}, {"lowest": 1.0}, {"watchdog": -1.0}, {"conductance": [[1.0]]}):
            with pytest.raises(BadInput):
                ReferenceDevice(**settings)


class TestSoftSupply:
    def test_watchdog_by_its_clock(self):
        clock = HandClock()
        supply = SoftSupply(2, clock=clock)
        supply.write(np.array([1.0, -2.0]))
        clock.move(0.19)
        assert supply.outputs().tolist() == [1.0, -2.0]
        clock.move(0.02)
        assert supply.outputs().tolist() == [0.0, 0.0]
        assert supply.expired_count == 0  # not known before it is written to, as with a real one
        supply.write(np.array([1.0, -2.0]))
        assert supply.expired_count == 1
        assert supply.outputs().tolist() == [1.0, -2.0]
        supply.write(np.zeros(2))
        clock.move(1.0)
        supply.write(np.zeros(2))
        assert supply.expired_count == 1  # it was at zero before
        without = SoftSupply(2, clock=clock, watchdog=None)
        without.write(np.array([1.0, -2.0]))
        clock.move(1e6)
        assert without.outputs().tolist() == [1.0, -2.0]

    def test_steps_and_currents(self):
        supply = SoftSupply(2, clock=HandClock(), resolution=0.25, conductance=np.diag([0.01, 0.02]))
        supply.write(np.array([1.1, -2.4]))
        volts, amperes = supply.read()
        assert volts is not None
        assert amperes is not None
        assert volts.tolist() == [1.0, -2.5]
        assert amperes == pytest.approx([0.01, -0.05])
        assert SoftSupply(2).read().amperes is None

    def test_what_is_written_is_its_own(self):
        supply = SoftSupply(2, clock=HandClock())
        volts = np.array([1.0, 2.0])
        supply.write(volts)
        volts[:] = 9.0
        supply.outputs()[:] = 9.0
        assert supply.outputs().tolist() == [1.0, 2.0]

    def test_closed_is_zero(self):
        supply = SoftSupply(2, clock=HandClock())
        supply.write(np.array([1.0, 2.0]))
        supply.close()
        supply.close()
        assert supply.outputs().tolist() == [0.0, 0.0]
        with pytest.raises(SupplyFailed, match="was closed"):
            supply.write(np.zeros(2))
        with pytest.raises(SupplyFailed, match="was closed"):
            supply.read()

    @pytest.mark.parametrize(
        "settings",
        [
            {"channel_count": 0},
            {"watchdog": 0.0},
            {"resolution": -1.0},
            {"lowest": 1.0},
            {"conductance": np.ones(3)},
            {"conductance": np.full((16, 16), np.nan)},
        ],
    )
    def test_settings_that_cannot_work(self, settings):
        with pytest.raises(BadInput):
            SoftSupply(**settings)


@pytest.fixture
def served() -> Iterator[ServedDevice]:
    """A device whose watchdog waits for a busy machine."""
    with ServedDevice(ReferenceDevice(watchdog=5.0, conductance=np.diag(np.full(16, 0.002)))).start() as device:
        yield device


@contextmanager
def opened(device: ServedDevice, **settings: Any) -> Iterator[SerialSupply]:
    # A busy machine must not fail a test: whoever waits for silence says so by `hurried`.
    supply = SerialSupply(device.port, **{"timeout": 1.0, **settings})
    try:
        yield supply
    finally:
        supply.close()


def fill(port: str) -> None:
    """Write to `port` until nothing more goes in, for good: the system moves on what it has taken in now and then."""
    other = os.open(port, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        for _ in range(5):
            with contextlib.suppress(BlockingIOError):
                while True:
                    os.write(other, b"x" * 256)
            time.sleep(0.01)
    finally:
        os.close(other)


def hurried(supply: SerialSupply) -> None:
    """From now on it waits for 0.1 s."""
    supply._timeout = 0.1


def line_of(supply: SerialSupply | ScpiSupply) -> Any:
    """The open line to its device, for a test to meddle with."""
    return supply._port if isinstance(supply, SerialSupply) else supply._session


def failure(act: Callable[[], object], within: float) -> str:
    """The one line of the `SupplyFailed` that comes out of `act` in time; other workers may slow the machine down."""
    begun = time.monotonic()
    with pytest.raises(SupplyFailed) as caught:
        act()
    assert time.monotonic() - begun < within + 0.4
    text = str(caught.value)
    assert "\n" not in text
    assert "Try: " in text
    return text


class TestSerialSupply:
    def test_written_is_on_the_outputs(self, served):
        with opened(served) as supply:
            assert (supply.channel_count, supply.lowest, supply.highest, supply.watchdog) == (16, -10.0, 10.0, 5.0)
            assert "reference-dac" in supply.name
            supply.write(VOLTS)
            assert served.outputs() == pytest.approx(VOLTS, abs=5e-4)
            supply.write(VOLTS)
            volts, amperes = supply.read()
            assert volts == pytest.approx(VOLTS, abs=5e-4)
            assert amperes == pytest.approx(0.002 * VOLTS, abs=2e-6)
            supply.write(VOLTS)
        assert not served.outputs().any()

    def test_numbers_go_round(self, served):
        with opened(served) as supply:
            supply._number = 65533
            for _ in range(5):
                supply.write(VOLTS)

    def test_noise_both_ways_is_met_by_one_more_try(self, served):
        with opened(served) as supply:
            for served.garbled_count, served.deaf_count in ((1, 0), (0, 1)):
                supply.write(VOLTS)
                assert served.outputs() == pytest.approx(VOLTS, abs=5e-4)
            served.garbled_count = 2
            assert "garbled" in failure(lambda: supply.write(VOLTS), 1.0)
            supply.write(VOLTS)  # late answers are not taken for this one's

    def test_a_lost_line_is_sent_again(self, served):
        with opened(served) as supply:
            line_of(supply).write(b"W 9 10000")
            supply.write(VOLTS)
            assert served.outputs() == pytest.approx(VOLTS, abs=5e-4)

    def test_a_device_that_says_nothing(self, served):
        with opened(served) as supply:
            hurried(supply)
            served.ignores = True
            assert "no answer to W within 0.1 s" in failure(lambda: supply.write(VOLTS), 0.1)
            assert "no answer to R within 0.1 s" in failure(supply.read, 0.1)
            begun = time.monotonic()
            supply.close()
            assert time.monotonic() - begun < 0.5

    def test_a_device_that_hung_is_at_zero_when_it_wakes_up(self, served):
        with opened(served) as supply:
            supply.write(VOLTS)
            hurried(supply)
            served.hangs = True
            failure(lambda: supply.write(VOLTS), 0.1)
            supply.close()
            served.hangs = False
            time.sleep(0.05)
            assert not served.outputs().any()
            assert served.device.expired_count == 0

    def test_a_line_that_is_full(self, served):
        with opened(served) as supply:
            hurried(supply)
            served.hangs = True
            fill(served.port)
            assert "did not take in W" in failure(lambda: supply.write(VOLTS), 0.1)
            begun = time.monotonic()
            supply.close()
            assert time.monotonic() - begun < 0.5

    def test_an_unplugged_device(self, served):
        with opened(served) as supply:
            supply.write(VOLTS)
            served.unplug()
            assert "port failed at W" in failure(lambda: supply.write(VOLTS), 0.1)
            assert "port failed at R" in failure(supply.read, 0.1)
            supply.close()
            supply.close()
            assert "was closed" in failure(lambda: supply.write(VOLTS), 0.1)

    def test_unplugged_in_the_middle_of_it(self, served):
        import threading

        with opened(served, timeout=2.0) as supply:
            served.ignores = True
            puller = threading.Timer(0.1, served.unplug)
            puller.start()
            assert "port failed at W" in failure(lambda: supply.write(VOLTS), 0.5)
            puller.join()

    @pytest.mark.parametrize("volts", [np.full(16, 10.001), np.full(16, np.nan), np.zeros(15)])
    def test_out_of_range_nothing_is_sent(self, served, volts):
        with opened(served) as supply:
            supply.write(VOLTS)
            sent: list[bytes] = []
            line = line_of(supply)
            line.write, write = sent.append, line.write
            failure(lambda: supply.write(volts), 0.0)
            line.write = write
            assert sent == []
            assert served.outputs().any()

    def test_what_the_device_refuses_is_said(self, served):
        with opened(served) as supply:
            supply.highest = 20.0
            assert "it refused W: range" in failure(lambda: supply.write(np.full(16, 15.0)), 0.1)

    def test_expiries_are_counted(self):
        with ServedDevice(ReferenceDevice()).start() as served, opened(served) as supply:
            supply.write(VOLTS)
            assert supply.expired_count == 0
            time.sleep(0.25)
            supply.write(VOLTS)
            assert supply.expired_count == 1

    def test_who_it_is_is_checked(self):
        device = ReferenceDevice(8, watchdog=0.5)
        with ServedDevice(device).start() as served:
            with pytest.raises(SupplyFailed, match="8 channels; 16 are asked for"):
                SerialSupply(served.port, channel_count=16)
            with pytest.raises(SupplyFailed, match="a watchdog of 500 ms; asked for is one of 200 ms"):
                SerialSupply(served.port, watchdog=0.2)
            device.identity = device.identity._replace(version=2)
            with pytest.raises(SupplyFailed, match="speaks version 2"):
                SerialSupply(served.port)
            device.identity = device.identity._replace(version=1, lowest=5)
            with pytest.raises(SupplyFailed, match="0 V must be in its range"):
                SerialSupply(served.port)
            served.ignores = True
            with pytest.raises(SupplyFailed, match="no answer to I"):
                SerialSupply(served.port, patience=0.1)

    def test_a_board_that_starts_anew_when_it_is_opened_is_waited_for(self, served):
        import threading

        served.ignores = True
        starter = threading.Timer(0.3, setattr, (served, "ignores", False))
        starter.start()
        with opened(served):
            starter.join()

    def test_two_hosts_are_one_too_many(self, served):
        with opened(served), pytest.raises(SupplyFailed, match="cannot be opened"):
            SerialSupply(served.port)

    def test_settings_that_cannot_work(self, served):
        with pytest.raises(SupplyFailed, match=r"cannot be opened.*Try: its path"):
            SerialSupply("/dev/no-such-port")
        with pytest.raises(BadInput, match="or more at 9600 baud"):
            SerialSupply(served.port, baud=9600)
        with pytest.raises(BadInput, match="timeout"):
            SerialSupply(served.port, timeout=0.0)
        with pytest.raises(BadInput, match="baud"):
            SerialSupply(served.port, baud=0)


HOST = """
import sys, time
import numpy as np
from gelbot.hardware.serial_supply import SerialSupply
supply = SerialSupply(sys.argv[1], timeout=0.5, watchdog=0.2)
while True:
    supply.write(np.full(16, 5.0))
    print("written", flush=True)
    time.sleep(0.02)
"""


@contextmanager
def started(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


class TestProgram:
    def test_a_killed_host_leaves_zero_volts(self, tmp_path):
        table = tmp_path / "outputs.csv"
        device_arguments = ("-m", "gelbot.hardware.reference_device", "--outputs", str(table))
        with started(*device_arguments) as device:
            assert device.stdout is not None
            port = device.stdout.readline().strip()
            with started("-c", HOST, port) as host:
                assert host.stdout is not None
                for _ in range(5):
                    assert host.stdout.readline() == "written\n"
                killed = time.monotonic()
                host.send_signal(signal.SIGKILL)
                host.wait(5)
            until = time.monotonic() + 2.0
            while time.monotonic() < until and len(table.read_text().splitlines()) < 4:
                time.sleep(0.02)
            device.terminate()
            assert device.wait(5) == 0
        rows = np.loadtxt(table, delimiter=",", skiprows=1)
        assert rows[:, 1:].tolist() == [[0.0] * 16, [5.0] * 16, [0.0] * 16]
        assert 0.15 < rows[-1, 0] - killed < 0.3

    def test_conductance_from_a_file(self, tmp_path, capsys):
        table = tmp_path / "conductance.csv"
        table.write_text("1,2\n3,4\n")
        assert read_conductance(table).tolist() == [[1.0, 2.0], [3.0, 4.0]]
        np.save(tmp_path / "conductance.npy", np.eye(3))
        assert read_conductance(tmp_path / "conductance.npy").tolist() == np.eye(3).tolist()
        assert main(["--channels", "3", "--conductance", str(table)]) == 2
        assert "3 x 3" in capsys.readouterr().err
        assert main(["--conductance", str(tmp_path / "none.npy")]) == 2
        error = capsys.readouterr().err
        assert "--conductance" in error
        assert error.count("\n") == 1


class ScriptedSession:
    """A line on which exactly `script` must be said: (sent, answered), None where nothing is."""

    def __init__(self, script: list[tuple[bytes, bytes | None]]) -> None:
        self.script, self.answers, self.timeout, self.closed, self.clear_count = script, [], 0, False, 0

    def write_raw(self, message: bytes) -> None:
        assert self.script, f"{message!r} was not expected"
        sent, answer = self.script.pop(0)
        assert message == sent
        if answer is not None:
            self.answers.append(answer)

    def read_raw(self) -> bytes:
        if not self.answers:
            raise TimeoutError("VI_ERROR_TMO")
        return self.answers.pop(0)

    def clear(self) -> None:
        self.clear_count += 1
        self.answers.clear()

    def close(self) -> None:
        self.closed = True


NO_ERROR = b'+0,"No error"\n'
KEYSIGHT_OPENING: list[tuple[bytes, bytes | None]] = [
    (b"*IDN?\n", b"Keysight Technologies,E36312A,MY1,1.0\n"),
    (b"*CLS\n", None),
    (b"SYST:ERR?\n", NO_ERROR),
    (b"VOLT 0.000,(@1);:VOLT 0.000,(@2);:VOLT 0.000,(@3)\n", None),
    (b"SYST:ERR?\n", NO_ERROR),
    (b"OUTP ON,(@1:3)\n", None),
    (b"SYST:ERR?\n", NO_ERROR),
]
KEYSIGHT_CLOSING: list[tuple[bytes, bytes | None]] = [
    (b"VOLT 0.000,(@1);:VOLT 0.000,(@2);:VOLT 0.000,(@3)\n", None),
    (b"OUTP OFF,(@1:3)\n", None),
]


@contextmanager
def said(*script: tuple[bytes, bytes | None], timeout: float = 1.0) -> Iterator[ScpiSupply]:
    session = ScriptedSession([*KEYSIGHT_OPENING, *script, *KEYSIGHT_CLOSING])
    supply = ScpiSupply("bench", "keysight-e36312a", timeout, session=session)
    yield supply
    supply.close()
    supply.close()
    assert session.script == []
    assert session.closed


class TestScpiBytes:
    def test_set_and_measure(self):
        with said(
            (b"VOLT 1.500,(@1);:VOLT 0.000,(@2);:VOLT 25.000,(@3)\n", None),
            (b"SYST:ERR?\n", NO_ERROR),
            (b"MEAS:VOLT? (@1)\n", b"+1.49900000E+00\n"),
            (b"MEAS:VOLT? (@2)\n", b"+0.00000000E+00\n"),
            (b"MEAS:VOLT? (@3)\n", b"+2.49990000E+01\n"),
            (b"MEAS:CURR? (@1)\n", b"+1.00000000E-03\n"),
            (b"MEAS:CURR? (@2)\n", b"+0.00000000E+00\n"),
            (b"MEAS:CURR? (@3)\n", b"+2.00000000E-02\n"),
        ) as supply:
            assert supply.channel_count == 3
            assert supply.watchdog is None
            supply.write(np.array([1.5, 0.0, 25.0]))
            volts, amperes = supply.read()
            assert volts == pytest.approx([1.499, 0.0, 24.999])
            assert amperes == pytest.approx([1e-3, 0.0, 2e-2])

    @pytest.mark.parametrize("volts", [[-0.1, 0.0, 0.0], [6.001, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0]])
    def test_out_of_range_nothing_is_sent(self, volts):
        with said() as supply:
            failure(lambda: supply.write(np.array(volts)), 0.0)

    def test_the_instrument_complains(self):
        with said(
            (b"VOLT 1.000,(@1);:VOLT 0.000,(@2);:VOLT 0.000,(@3)\n", None),
            (b"SYST:ERR?\n", b'-222,"Data out of range"\n'),
        ) as supply:
            text = failure(lambda: supply.write(np.array([1.0, 0.0, 0.0])), 0.0)
            assert "after set it reports" in text
            assert "Data out of range" in text

    def test_silence_and_a_late_answer(self):
        with said(
            (b"VOLT 1.000,(@1);:VOLT 0.000,(@2);:VOLT 0.000,(@3)\n", None),
            (b"SYST:ERR?\n", None),
            (b"MEAS:VOLT? (@1)\n", b"what\n"),
            (b"MEAS:VOLT? (@2)\n", b"0\n"),
            (b"MEAS:VOLT? (@3)\n", b"0\n"),
        ) as supply:
            assert "SYST:ERR? was not over within 1 s" in failure(lambda: supply.write(np.array([1.0, 0.0, 0.0])), 0.0)
            line_of(supply).answers.append(NO_ERROR)
            assert "is no 3 numbers" in failure(supply.read, 0.0)
            assert line_of(supply).clear_count == 1

    def test_another_instrument_is_left_alone(self):
        session = ScriptedSession([(b"*IDN?\n", b"KEITHLEY,2230-30-1,1,1\n")])
        with pytest.raises(SupplyFailed, match="it says it is 'KEITHLEY"):
            ScpiSupply("bench", "keysight-e36312a", session=session)
        assert session.closed
        assert session.script == []

    def test_one_that_does_not_answer_is_left_alone(self):
        session = ScriptedSession([(b"*IDN?\n", None)])
        with pytest.raises(SupplyFailed, match=r"\*IDN\? was not over within 1 s"):
            ScpiSupply("bench", "keysight-e36312a", session=session)
        assert session.closed
        assert session.script == []

    def test_closing_never_raises(self):
        session = ScriptedSession(list(KEYSIGHT_OPENING))
        supply = ScpiSupply("bench", "keysight-e36312a", session=session)
        supply.close()  # each message fails
        assert session.closed
        assert "was closed" in failure(lambda: supply.write(np.zeros(3)), 0.0)

    def test_one_command_for_all_then_a_trigger(self, tmp_path):
        file = tmp_path / "mine.toml"
        file.write_text("""
name = "mine"
channels = ["A", "B"]
lowest = "-5 V"
highest = "5 V"
write_terminator = "\\r\\n"
identity = "mine"
set = "LEVELS {volts}"
separator = " "
number_format = ".1e"
apply = "*TRG"
measure_volts = "LEVELS?"
output_off = ["OFF {channel}"]
""")
        session = ScriptedSession(
            [
                (b"*IDN?\r\n", b"mine"),
                (b"SYST:ERR?\r\n", b"0"),
                (b"LEVELS 0.0e+00 0.0e+00\r\n", None),
                (b"*TRG\r\n", None),
                (b"SYST:ERR?\r\n", b"0"),
                (b"SYST:ERR?\r\n", b"0"),
                (b"LEVELS?\r\n", b"1, -2\r\n"),
                (b"LEVELS 0.0e+00 0.0e+00\r\n", None),
                (b"*TRG\r\n", None),
                (b"OFF A\r\n", None),
                (b"OFF B\r\n", None),
            ]
        )
        supply = ScpiSupply("bench", file, session=session)
        volts, amperes = supply.read()
        assert volts == pytest.approx([1.0, -2.0])
        assert amperes is None
        supply.close()
        assert session.script == []


SIMULATED = """
spec: "1.1"
devices:
  dp832:
    eom:
      TCPIP INSTR: {q: "\\n", r: "\\n"}
    error:
      error_queue:
        - {q: ":SYST:ERR?", default: '0,"No error"', command_error: '-113,"Undefined header"'}
    dialogues:
      - {q: "*IDN?", r: "RIGOL TECHNOLOGIES,DP832,DP8A000000001,00.01.14"}
      - {q: "*CLS"}
      - {q: ":MEAS:CURR? CH1", r: "0.0100"}
      - {q: ":MEAS:CURR? CH2", r: "0.0000"}
      - {q: ":MEAS:CURR? CH3", r: "0.0200"}
    properties:
CHANNELS
resources:
  TCPIP0::bench::inst0::INSTR: {device: dp832}
"""
CHANNEL = """
      voltNUMBER:
        default: 1.0
        getter: {q: ":MEAS:VOLT? CHNUMBER", r: "{:.4f}"}
        setter: {q: ":SOURNUMBER:VOLT {:.3f}"}
        specs: {min: 0, max: 32, type: float}
      outputNUMBER:
        default: "OFF"
        getter: {q: ":OUTP? CHNUMBER", r: "{:s}"}
        setter: {q: ":OUTP CHNUMBER,{:s}"}
        specs: {valid: ["ON", "OFF"], type: str}
"""


class TestScpiSimulated:
    @pytest.fixture
    def library(self, tmp_path: Path) -> str:
        pytest.importorskip("pyvisa_sim")
        file = tmp_path / "bench.yaml"
        channels = "".join(CHANNEL.replace("NUMBER", str(number)) for number in (1, 2, 3))
        file.write_text(SIMULATED.replace("CHANNELS", channels))
        return f"{file}@sim"

    def test_a_whole_life(self, library):
        settings = SupplySettings("scpi", resource="TCPIP0::bench::inst0::INSTR", profile="rigol-dp832")
        supply = open_supply(SupplySettings(**{**vars(settings), "visa_library": library, "channel_count": 3}))
        assert isinstance(supply, ScpiSupply)
        supply.write(np.array([1.5, 30.0, 5.0]))
        volts, amperes = supply.read()
        assert volts == pytest.approx([1.5, 30.0, 5.0])
        assert amperes == pytest.approx([0.01, 0.0, 0.02])
        line_of(supply).write_raw(b"NONSENSE\n")
        with pytest.raises(SupplyFailed, match="Undefined header"):
            supply.write(np.zeros(3))
        supply.close()

    def test_no_such_instrument(self, library):
        with pytest.raises(SupplyFailed, match=r"cannot be opened|it says it is ''"):
            ScpiSupply("TCPIP0::nowhere::inst0::INSTR", "rigol-dp832", visa_library=library)

    def test_no_such_library(self):
        pytest.importorskip("pyvisa")
        with pytest.raises(BadInput, match="visa_library"):
            ScpiSupply("TCPIP0::bench::inst0::INSTR", "rigol-dp832", visa_library="@nonsense")


class TestProfiles:
    @pytest.mark.parametrize("name", profile_names())
    def test_those_that_come_with_gelbot(self, name):
        profile = load_profile(name)
        assert profile.messages(profile.set, [0.0] * len(profile.channels))
        assert profile_text(name).startswith("#")

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ('name = "Rigol DP832"', "", "mine.toml: name: got 'nothing'; allowed: a value: the key must be there"),
            ("{volts}", "{volt}", r"mine.toml: set: got .*the placeholders \{channel\} \{volts\} and no other"),
            (" {volts}", "", "set: a command with the placeholder"),
            ('"5 V"]', "]", "highest: got .*; allowed: one voltage, or 3 for the channels"),
            ('"5 V"]', '"5"]', "highest: got '5'; allowed: a voltage with its unit"),
            ('"0 V"', '"1 V"', "channel 1: a range that 0 V is in"),
            ("(?i)rigol", "(", "identity: got .*; allowed: a regular expression"),
            ('".3f"', '".3q"', "number_format: got .*; allowed: a format of one number"),
            ("init =", "inits =", "got 'inits'; allowed: the keys name, channels"),
            ("[1, 2, 3]", "7", "channels: got 7"),
            ("name =", "name", "allowed: a TOML file"),
        ],
    )
    def test_mistakes_have_their_place(self, tmp_path, old, new, message):
        file = tmp_path / "mine.toml"
        text = profile_text("rigol-dp832")
        assert old in text
        file.write_text(text.replace(old, new))
        with pytest.raises(BadInput, match=message) as caught:
            load_profile(file)
        assert "\n" not in str(caught.value)

    def test_unknown_ones(self, tmp_path):
        with pytest.raises(BadInput, match="keysight-e36312a"):
            load_profile("no-such")
        with pytest.raises(BadInput, match="built-in are"):
            load_profile(tmp_path / "no-such.toml")


class FakeDriver:
    """What of nidaqmx is used, written down call by call."""

    def __init__(self, has_watchdog: bool) -> None:
        self.calls: list[tuple[Any, ...]] = []
        self.expired = self.broken = False
        driver = self

        class DaqError(Exception):
            pass

        class Task:
            def __init__(self) -> None:
                self.ao_channels = Channels()

            def write(self, data: Any, auto_start: bool, timeout: float) -> None:
                if driver.broken:
                    raise DaqError("the card is gone\n\nTask Name: x\nStatus Code: -88705")
                driver.calls.append(("write", data))

            def close(self) -> None:
                driver.calls.append(("close task",))

        class Channels(list[Any]):
            def add_ao_voltage_chan(self, name: str, min_val: float, max_val: float) -> None:
                driver.calls.append(("channel", name, min_val, max_val))
                device, _, outputs = name.partition("/ao")
                first, _, last = outputs.partition(":")
                for number in range(int(first), int(last or first) + 1):
                    channel = types.SimpleNamespace(name=f"{device}/ao{number}")
                    self.append(types.SimpleNamespace(physical_channel=channel))

        class WatchdogTask:
            def __init__(self, device: str, timeout: float) -> None:
                if not has_watchdog:
                    raise DaqError("Specified operation is not supported.\nStatus Code: -200452")
                driver.calls.append(("watchdog", device, timeout))

            @property
            def expired(self) -> bool:
                return driver.expired

            def cfg_watchdog_ao_expir_states(self, states: list[Any]) -> None:
                driver.calls.append(("expires to", *states))

            def start(self) -> None:
                driver.calls.append(("start watchdog",))

            def reset_timer(self) -> None:
                driver.calls.append(("feed",))

            def clear_expiration(self) -> None:
                driver.expired = False
                driver.calls.append(("clear",))

            def close(self) -> None:
                driver.calls.append(("close watchdog",))

        states = types.SimpleNamespace(VOLTAGE="V")
        self.modules = {
            "nidaqmx": self._module("nidaqmx", Task=Task),
            "nidaqmx.constants": self._module("nidaqmx.constants", WatchdogAOExpirState=states),
            "nidaqmx.types": self._module("nidaqmx.types", AOExpirationState=lambda *state: state),
            "nidaqmx.system": self._module("nidaqmx.system"),
            "nidaqmx.system.watchdog": self._module("nidaqmx.system.watchdog", WatchdogTask=WatchdogTask),
        }

    @staticmethod
    def _module(name: str, **contents: Any) -> types.ModuleType:
        module = types.ModuleType(name)
        vars(module).update(contents)
        return module


class TestNiSupply:
    @pytest.fixture
    def driver(self, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> FakeDriver:
        driver = FakeDriver(has_watchdog=getattr(request, "param", True))
        for name, module in driver.modules.items():
            monkeypatch.setitem(sys.modules, name, module)
        return driver

    def test_a_whole_life_with_a_watchdog(self, driver):
        supply = NiSupply("Dev1", "ao0:1", -10.0, 10.0)
        assert (supply.channel_count, supply.watchdog) == (2, 0.2)
        supply.write(np.array([1.0, -2.0]))
        driver.expired = True
        supply.write(np.array([3.0, 4.0]))
        assert supply.expired_count == 1
        assert supply.read() == (None, None)
        supply.close()
        supply.close()
        assert driver.calls == [
            ("channel", "Dev1/ao0:1", -10.0, 10.0),
            ("watchdog", "Dev1", 0.2),
            ("expires to", ("Dev1/ao0", 0.0, "V"), ("Dev1/ao1", 0.0, "V")),
            ("start watchdog",),
            ("feed",),
            ("write", [0.0, 0.0]),
            ("feed",),
            ("write", [1.0, -2.0]),
            ("clear",),
            ("feed",),
            ("write", [3.0, 4.0]),
            ("feed",),
            ("write", [0.0, 0.0]),
            ("close task",),
            ("close watchdog",),
        ]

    @pytest.mark.parametrize("driver", [False], indirect=True)
    def test_a_card_without_a_watchdog_says_so(self, driver):
        supply = NiSupply("Dev1", ["ao0", "ao3"])
        assert supply.watchdog is None
        assert supply.without_watchdog == "Specified operation is not supported."
        supply.write(np.array([1.0, 2.0]))
        supply.close()
        with pytest.raises(SupplyFailed, match="killed, it would keep its voltages"):
            open_supply(SupplySettings("ni", device="Dev1"))
        assert driver.calls[-1] == ("close task",)

    def test_failure_is_one_line(self, driver):
        supply = NiSupply("Dev1", "ao0")
        driver.broken = True
        assert "the card is gone" in failure(lambda: supply.write(np.array([1.0])), 0.0)
        supply.close()
        assert driver.calls[-2:] == [("close task",), ("close watchdog",)]
        assert "was closed" in failure(lambda: supply.write(np.array([1.0])), 0.0)
        assert "the card is gone" in failure(lambda: NiSupply("Dev1", "ao0"), 0.0)

    def test_out_of_range_nothing_is_sent(self, driver):
        supply = NiSupply("Dev1", "ao0", -5.0, 5.0)
        count = len(driver.calls)
        failure(lambda: supply.write(np.array([5.1])), 0.0)
        assert len(driver.calls) == count

    @pytest.mark.parametrize("settings", [{"lowest": 1.0}, {"timeout": 0.0}, {"watchdog": 0.0}, {"channels": ""}])
    def test_settings_that_cannot_work(self, driver, settings):
        with pytest.raises(BadInput):
            NiSupply("Dev1", **{"channels": "ao0", **settings})

    def test_without_the_driver(self):
        pytest.importorskip("nidaqmx")
        if shutil.which("nilsdev"):
            pytest.skip("the driver is here")
        assert "NI-DAQmx" in failure(lambda: NiSupply("Dev1", "ao0"), 5.0)


class TestOpenSupply:
    def test_twin(self):
        clock = HandClock()
        supply: Supply = open_supply(SupplySettings(channel_count=4), clock=clock, conductance=np.eye(4))
        supply.write(np.ones(4))
        volts, amperes = supply.read()
        assert volts == pytest.approx(np.ones(4))
        assert amperes == pytest.approx(np.ones(4))
        supply.close()

    def test_serial(self, served):
        supply = open_supply(SupplySettings("serial", port=served.port, watchdog=5.0))
        supply.write(VOLTS)
        supply.close()

    @pytest.mark.parametrize(
        ("settings", "place"),
        [
            (SupplySettings("serial"), "supply.port"),
            (SupplySettings("scpi", profile="rigol-dp832"), "supply.resource"),
            (SupplySettings("scpi", resource="GPIB0::1::INSTR"), "supply.profile"),
            (SupplySettings("ni"), "supply.device"),
            (SupplySettings("magic"), "supply.kind"),
        ],
    )
    def test_what_is_missing_is_named(self, settings, place):
        with pytest.raises(BadInput) as caught:
            open_supply(settings)
        assert caught.value.where == place

    @pytest.mark.parametrize(("package", "extra"), [("serial", "hardware"), ("pyvisa", "hardware"), ("nidaqmx", "ni")])
    def test_what_to_install_is_said(self, monkeypatch, package, extra):
        monkeypatch.setitem(sys.modules, package, None)  # importing it fails
        settings = {
            "serial": SupplySettings("serial", port="COM3"),
            "pyvisa": SupplySettings("scpi", resource="GPIB0::1::INSTR", profile="rigol-dp832"),
            "nidaqmx": SupplySettings("ni", device="Dev1"),
        }[package]
        with pytest.raises(BadInput, match=re.escape(f'Try: pip install "gelbot[{extra}]"')):
            open_supply(settings)

    def test_nothing_heavy_is_imported_before_it_is_needed(self):
        program = (
            "import sys, gelbot.hardware.devices, gelbot.hardware.serial_supply, gelbot.hardware.scpi_supply, "
            "gelbot.hardware.ni_supply, gelbot.hardware.soft_supply, gelbot.hardware.reference_device\n"
            "print(*sorted(name for name in sys.modules if name in ('jax', 'serial', 'pyvisa', 'nidaqmx', 'pint') or "
            "name.startswith('gelbot.') and not name.startswith('gelbot.hardware')))"
        )
        output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
        assert output.split() == ["gelbot.clock", "gelbot.errors", "gelbot.units"]


HARNESS = """
#include "gelbot_device.h"
// In: time [ms], count of bytes, bytes. Out: count of bytes, answers, outputs [mV].
struct Outputs : gelbot::Board {
    int32_t now[gelbot::channel_count];
    void apply(const long *millivolts) override {
        for (int i = 0; i < gelbot::channel_count; ++i) now[i] = (int32_t)millivolts[i];
    }
    bool measure(long *) override { return false; }
};
int main() {
    Outputs outputs;
    gelbot::Device device(outputs);
    uint32_t head[2];
    static char in[65536], out[65536];
    while (fread(head, 4, 2, stdin) == 2 && fread(in, 1, head[1], stdin) == head[1]) {
        uint32_t count = 0;
        device.expire(head[0]);
        for (uint32_t i = 0; i < head[1]; ++i) {
            const char *answer = device.take(in[i], head[0]);
            memcpy(out + count, answer, strlen(answer));
            count += strlen(answer);
        }
        fwrite(&count, 4, 1, stdout);
        fwrite(out, 1, count, stdout);
        fwrite(outputs.now, 4, gelbot::channel_count, stdout);
        fflush(stdout);
    }
}
"""


BOARD = """
// Stands for the Arduino functions that the sketch uses, and for the converter at its pins.
#include <deque>
#include <stdint.h>
#include <stdio.h>
#include <string>
enum { LOW, HIGH, OUTPUT, MSBFIRST, SPI_MODE0 };
static uint32_t clock_ms = 0;
static int pins[32];
static uint16_t registers[16], outputs_of_converter[16];
static void pinMode(int, int) {}
static void digitalWrite(int pin, int level) {
    pins[pin] = level;
    if (pin == 20 && level == LOW) for (int i = 0; i < 16; ++i) outputs_of_converter[i] = registers[i] = 0x8000;
}
static uint32_t millis() { return clock_ms; }
struct SPISettings { SPISettings(int, int, int) {} };
static struct {
    uint8_t command;
    void begin() {}
    void beginTransaction(const SPISettings &) {}
    void endTransaction() {}
    void transfer(uint8_t byte) { command = byte; }
    void transfer16(uint16_t code) {
        if (pins[17] != LOW || pins[20] == LOW) return;
        if ((command & 0xF0) == 0x00) registers[command & 0x0F] = code;
        if ((command & 0xF0) == 0x90) for (int i = 0; i < 16; ++i) outputs_of_converter[i] = registers[i];
    }
} SPI;
static struct {
    std::deque<char> in;
    std::string out;
    void begin(long) {}
    bool available() { return !in.empty(); }
    int read() { char c = in.front(); in.pop_front(); return c; }
    void print(const char *text) { out += text; }
} Serial;
static struct { void wdt_begin(int) {} void wdt_reset() {} } rp2040;
struct repeating_timer_t {};
typedef bool (*callback)(repeating_timer_t *);
static callback interrupt_ms = 0;
static void add_repeating_timer_ms(int, callback called, void *, repeating_timer_t *) { interrupt_ms = called; }
"""
BENCH = """
#include "gelbot_dac.ino"
static void show(const char *what) {
    printf("%s clear=%d", what, pins[20] == LOW);
    for (int i = 0; i < 16; ++i) printf(" %04X", outputs_of_converter[i]);
    printf(" %s\\n", Serial.out.c_str());
    Serial.out.clear();
}
int main(int, char **arguments) {
    setup();
    show("start");
    for (const char *c = arguments[1]; *c; ++c) Serial.in.push_back(*c);
    loop();
    show("written");
    for (int i = 0; i < 199; ++i) { ++clock_ms; interrupt_ms(0); }
    show("before");
    ++clock_ms;
    interrupt_ms(0);
    show("hung");
    loop();
    show("awake");
}
"""


class Firmware:
    """The C++ of the firmware, as a program."""

    def __init__(self, program: Path) -> None:
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def take(self, data: bytes, milliseconds: int) -> tuple[bytes, list[int]]:
        """Its answers to `data`, and its outputs [mV] after them."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(struct.pack("<II", milliseconds, len(data)) + data)
        self.process.stdin.flush()
        (count,) = struct.unpack("<I", self.process.stdout.read(4))
        answers = self.process.stdout.read(count)
        return answers, list(struct.unpack("<16i", self.process.stdout.read(64)))

    def close(self) -> None:
        self.process.communicate(timeout=5)


some_words = st.one_of(
    st.tuples(st.just("W"), st.integers(0, 70000).map(str), *[st.integers(-10001, 10001).map(str)] * 16),
    st.tuples(st.just("W"), st.just("5"), *[st.integers(-10000, 10000).map(str)] * 16),
    st.tuples(st.sampled_from(["R", "Z", "I", "X", "WW"]), st.sampled_from(["1", "65535", "65536", "007", "-1", "x"])),
    st.lists(st.sampled_from(["W", "R", "1", "-5", "--5", "1e3", "-", "~", "9999999999"]), min_size=1, max_size=20),
)
some_lines = st.one_of(
    some_words.map(lambda given_words: encode(tuple(given_words))),
    st.binary(max_size=300).map(lambda noise: noise.replace(b"\n", b"") + b"\n"),
    st.tuples(some_words, st.integers(0), st.integers(0, 7)).map(
        lambda given_: flipped(encode(tuple(given_[0])), *given_[1:])
    ),
    st.sampled_from([b"\n", b"W 1*0000\n", encode(("W", "1", *("0" * 230,)))]),
)


def flipped(line: bytes, place: int, bit: int) -> bytes:
    """`line` with a bit flipped in one of its characters before the line feed."""
    place %= len(line) - 1
    return (line[:place] + bytes([line[place] ^ (1 << bit)]) + line[place + 1 : -1]).replace(b"\n", b"") + b"\n"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("firmware")
    (folder / "harness.cpp").write_text(HARNESS)
    include = ROOT / "docs" / "firmware" / "gelbot_dac"
    warnings = ["-std=c++11", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["g++", *warnings, "-I", include, "-o", "firmware", "harness.cpp"], cwd=folder, check=True)
    return folder / "firmware"


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
class TestFirmware:
    def test_it_does_what_the_reference_device_does(self, program):
        @given(st.lists(st.tuples(st.integers(0, 250), some_lines), min_size=1, max_size=12))
        def same(lines: list[tuple[int, bytes]]) -> None:
            firmware, device, now = Firmware(program), ReferenceDevice(name="gelbot-dac"), 0
            try:
                for wait, line in lines:
                    now += wait
                    # A hair later than the firmware's whole milliseconds, so that both find the same side of an expiry.
                    seconds = now * 1e-3 * (1.0 + 1e-9)
                    answers, millivolts = firmware.take(line, now)
                    assert answers == device.respond(line, seconds)
                    assert millivolts == np.rint(device.outputs(seconds) * 1e3).tolist()
            finally:
                firmware.close()

        same()

    def test_watchdog_over_the_turn_of_its_clock(self, program):
        """Its milliseconds go round after 49 days."""
        firmware = Firmware(program)
        try:
            firmware.take(encode_request(Request("W", 1, (1000,) * 16)), 2**32 - 100)
            assert firmware.take(b"", 99)[1] == [1000] * 16
            assert firmware.take(b"", 100)[1] == [0] * 16
        finally:
            firmware.close()

    def test_the_sketch_drives_its_converter(self, tmp_path):
        """Codes of the LTC2668, all at once; and a loop that hangs is cleared by the interrupt."""
        sketch = ROOT / "docs" / "firmware" / "gelbot_dac"
        (tmp_path / "SPI.h").write_text(BOARD)
        (tmp_path / "bench.cpp").write_text(BENCH)
        subprocess.run(["g++", "-I.", "-I", sketch, "-o", "bench", "bench.cpp"], cwd=tmp_path, check=True)
        millivolts = (10000, -10000, 0, 5000, *(0,) * 12)
        line = encode_request(Request("W", 7, millivolts)).decode()
        output = subprocess.run([tmp_path / "bench", line], capture_output=True, text=True, check=True).stdout
        seen = {row.split()[0]: row.split()[1:] for row in output.splitlines() if row}
        zero, on = ["8000"] * 16, ["FFFF", "0000", "8000", "C000", *["8000"] * 12]
        assert seen["start"] == ["clear=0", *zero]
        assert seen["written"][:17] == ["clear=0", *on]
        assert seen["written"][17:] == ["A", "7", "0*EDFB"]
        assert seen["before"] == ["clear=0", *on]
        assert seen["hung"] == ["clear=1", *zero]
        assert seen["awake"] == ["clear=0", *zero]
