"""The guard: what reaches the electrodes, whatever is asked for and whoever falls silent.

| what is asked or happens | what must be |
|---|---|
| any voltages, any times, any order of calls (hypothesis) | limit, slew and current are kept at every moment |
| a pattern that draws too much current | the same pattern, smaller, with exactly the current allowed |
| a constant voltage for a time | charge = current x time; stops when it is used up |
| channels, gain, offset | electrodes -> channels -> electrodes is the identity; unconnected ones stay at 0 V |
| the loop falls silent | zero volts within its limit and one look; stopped |
| the camera falls silent, and comes back, or not | zero volts while it is silent; goes on, or stopped in the end |
| the clock goes back, or stands still | stopped |
| a voltage that is no number, too few of them | stopped, nothing of it reaches the supply |
| a supply that fails, measures too much current, gives other voltages | stopped |
| stop | zero volts, and no call brings voltages back before a reset |
| in real time, the loop's thread ends | zero volts within 300 ms |
"""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelbot.clock import HandClock, WallClock
from gelbot.errors import BenchStopped, SupplyFailed
from gelbot.hardware.guard import CAMERA, LOOP, Guard, Watch
from gelbot.hardware.limits import UNCONNECTED, Limits, Wiring, straight
from gelbot.hardware.soft_supply import SoftSupply
from gelbot.hardware.supply import Reading

WATCHES = {LOOP: Watch(0.2), CAMERA: Watch(0.2, patience=5.0)}
PERIOD = 0.1

CONDUCTANCE = np.array([[3.0, -1.0, -2.0], [-1.0, 2.0, -1.0], [-2.0, -1.0, 3.0]]) * 1e-3
"""Of three electrodes in an insulated tank: symmetric, and its rows sum to zero [S]."""


class Bench:
    """A guard on a soft supply under a clock that is moved by hand; `said` is what the guard told."""

    def __init__(self, limits: Limits, count: int = 3, supply: SoftSupply | None = None) -> None:
        self.clock, self.said = HandClock(), list[str]()
        self.supply = supply or SoftSupply(count, clock=self.clock, watchdog=None, lowest=-100.0, highest=100.0)
        self.guard = Guard(self.supply, straight(count), limits, self.clock, WATCHES, self.said.append)
        self.guard.arm()

    def tick(self, voltages: object, seconds: float = PERIOD, camera: bool = True) -> np.ndarray:
        self.clock.move(seconds)
        if camera:
            self.guard.feed(CAMERA)
        return self.guard.apply(np.array(voltages, float))


@given(
    asked=st.lists(st.tuples(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3), st.floats(0.01, 0.15)), max_size=8)
)
def test_whatever_is_asked_for_the_limits_are_kept(asked):
    limits = Limits(10.0, slew=50.0, current=0.02, conductance=CONDUCTANCE)
    bench = Bench(limits)
    seen = [np.zeros(3)]
    for voltages, seconds in asked:
        last = seen[-1]
        bench.tick(voltages, seconds)
        now = bench.supply.outputs()
        assert np.abs(now).max() <= 10.0 + 1e-12
        # Towards zero the current limit may go faster: it is there to protect.
        assert np.abs(now).max() <= np.abs(last).max() + 50.0 * seconds + 1e-9
        assert np.maximum(CONDUCTANCE @ now, 0.0).sum() <= 0.02 * (1.0 + 1e-12)
        seen.append(now)
    assert bench.guard.reason is None


def test_a_voltage_rises_no_faster_than_the_slew_and_arrives():
    bench = Bench(Limits(10.0, slew=20.0))
    given_ = [bench.tick([10.0, -10.0, 1.0]) for _ in range(7)]
    assert [v[0] for v in given_] == pytest.approx([2.0, 4.0, 6.0, 8.0, 10.0, 10.0, 10.0])
    assert [v[1] for v in given_] == pytest.approx([-2.0, -4.0, -6.0, -8.0, -10.0, -10.0, -10.0])
    assert all(v[2] == 1.0 for v in given_)


def test_the_slew_counts_from_the_last_command_not_from_the_last_heartbeat():
    bench = Bench(Limits(10.0, slew=20.0))
    bench.tick([0.0, 0.0, 0.0])
    bench.clock.move(0.09)
    bench.guard.check()  # a heartbeat
    bench.clock.move(0.01)
    bench.guard.feed(CAMERA)
    assert bench.guard.apply(np.array([10.0, 0.0, 0.0]))[0] == pytest.approx(2.0)


def test_too_much_current_makes_the_same_pattern_smaller():
    asked = np.array([10.0, -4.0, 2.0])
    total = np.maximum(CONDUCTANCE @ asked, 0.0).sum()
    bench = Bench(Limits(10.0, current=0.5 * total, conductance=CONDUCTANCE))
    np.testing.assert_allclose(bench.tick(asked), 0.5 * asked, rtol=1e-12)


def test_charge_is_current_times_time_and_ends_when_it_is_used_up():
    asked = np.array([5.0, 0.0, -5.0])
    total = np.maximum(CONDUCTANCE @ asked, 0.0).sum()
    bench = Bench(Limits(10.0, charge=10.05 * PERIOD * total, conductance=CONDUCTANCE))
    for k in range(10):
        bench.tick(asked)
        assert bench.guard.charge == pytest.approx(k * PERIOD * total)
    bench.tick(asked)
    with pytest.raises(BenchStopped, match="the charge is used up"):
        bench.tick(asked)
    assert not bench.supply.outputs().any()


def test_wiring_there_and_back(rng):
    wiring = Wiring(
        np.array([4, 0, UNCONNECTED, 2]), np.array([2.0, -1.5, 1.0, 10.0]), np.array([0.1, 0.0, 0.3, -1]), 6
    )
    volts = rng.normal(size=4)
    volts[2] = 0.0
    channels = wiring.to_channels(volts)
    assert channels.shape == (6,)
    assert channels[[1, 3, 5]].tolist() == [0.0, 0.0, 0.0]
    assert channels[4] == pytest.approx((volts[0] - 0.1) / 2.0)
    np.testing.assert_allclose(wiring.to_electrodes(channels), volts, atol=1e-14)


def test_zero_volts_are_those_of_the_electrodes_not_of_the_channels():
    clock = HandClock()
    supply = SoftSupply(1, clock=clock, watchdog=None)
    guard = Guard(supply, Wiring(np.array([0]), np.array([2.0]), np.array([0.5]), 1), Limits(10.0), clock, {})
    guard.arm()
    assert guard.apply(np.array([3.0]))[0] == 3.0
    assert supply.outputs()[0] == pytest.approx(1.25)
    guard.stop("test")
    assert supply.outputs()[0] == pytest.approx(-0.25)


def test_a_silent_loop_ends_in_zero_volts():
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 2.0, 3.0])
    for _ in range(10):
        bench.clock.move(0.02)
        bench.guard.feed(CAMERA)
        bench.guard.check()
    assert bench.supply.outputs().any()  # late, but not too late: the last voltages are held
    bench.clock.move(0.02)
    bench.guard.check()
    assert not bench.supply.outputs().any()
    assert bench.said == ["stopped: the control loop has been silent for 0.22 s"]
    with pytest.raises(BenchStopped):
        bench.tick([1.0, 2.0, 3.0])


def test_a_lost_camera_that_comes_back_goes_on():
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 2.0, 3.0])
    for k in range(20):
        given_ = bench.tick([1.0, 2.0, 3.0], camera=False)
        assert given_.any() == (k < 2), k
        assert bench.supply.outputs().any() == (k < 2)
    assert bench.tick([1.0, 2.0, 3.0]).tolist() == [1.0, 2.0, 3.0]
    assert bench.said == ["zero volts: waiting for the camera", "all is seen again: going on"]
    assert bench.guard.reason is None


def test_after_a_loss_the_slew_begins_at_zero():
    bench = Bench(Limits(10.0, slew=20.0))
    for _ in range(6):
        bench.tick([10.0, 0.0, 0.0])
    for _ in range(4):
        bench.tick([10.0, 0.0, 0.0], camera=False)
    assert bench.tick([10.0, 0.0, 0.0])[0] == pytest.approx(2.0)


def test_a_camera_lost_for_good_ends_the_run():
    bench = Bench(Limits(10.0))
    for _ in range(50):
        bench.tick([1.0, 2.0, 3.0], camera=False)
    with pytest.raises(BenchStopped, match=r"the camera has been silent for 5\.1 s"):
        bench.tick([1.0, 2.0, 3.0], camera=False)


@pytest.mark.parametrize(("jump", "says"), [(-0.5, "the clock went back by 0.5 s"), (3.0, "stood still for 3 s")])
def test_a_clock_that_jumps(jump, says):
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 2.0, 3.0])
    with pytest.raises(BenchStopped, match=says):
        bench.tick([1.0, 2.0, 3.0], jump)
    assert not bench.supply.outputs().any()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ([1.0, np.nan, 0.0], "nan V on electrode 1"),
        ([1.0, 0.0, -np.inf], "-inf V on electrode 2"),
        ([1.0, 2.0], "2 voltages for 3 electrodes"),
    ],
)
def test_what_is_no_voltage_stops_it(asked, says):
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    with pytest.raises(BenchStopped, match=says):
        bench.tick(asked)
    assert not bench.supply.outputs().any()


class Broken(SoftSupply):
    """A supply that fails: `write` when `refuses`; it measures what it is told to."""

    refuses = False
    measured: Reading | None = None

    def write(self, volts):
        if self.refuses:
            raise SupplyFailed("broken", "it does not answer", "looking at its cable")
        super().write(volts)

    def read(self):
        return self.measured or super().read()


def broken_bench(limits: Limits) -> tuple[Bench, Broken]:
    supply = Broken(3, watchdog=None, clock=HandClock())
    return Bench(limits, supply=supply), supply


def test_a_supply_that_fails():
    bench, supply = broken_bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    supply.refuses = True
    with pytest.raises(BenchStopped, match=r"broken: it does not answer\. Try: looking at its cable"):
        bench.tick([2.0, 1.0, 1.0])
    assert len(bench.said) == 2
    assert "zero volts were not acknowledged" in bench.said[0]


def test_a_supply_that_measures_too_much_current():
    bench, supply = broken_bench(Limits(10.0, current=0.1))
    bench.tick([1.0, 1.0, 1.0])
    supply.measured = Reading(None, np.array([0.08, 0.04, -0.12]))
    with pytest.raises(BenchStopped, match=r"measures 0.12 A in all; the limit is 0.1 A"):
        bench.tick([1.0, 1.0, 1.0])
    assert not supply.outputs().any()


def test_a_supply_that_gives_other_voltages_than_it_was_told():
    bench, supply = broken_bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    supply.measured = Reading(np.array([1.0, 6.0, 1.0]), None)
    bench.tick([1.0, 1.0, 1.0])  # once may be a reading between two voltages
    with pytest.raises(BenchStopped, match="channel 1 has 6 V where it was told 1 V"):
        bench.tick([1.0, 1.0, 1.0])


def test_after_a_stop_nothing_but_a_reset_brings_voltages_back():
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    bench.guard.stop("the user")
    bench.guard.stop("somebody later")
    assert bench.guard.reason == "the user"
    for call in (lambda: bench.tick([1.0, 1.0, 1.0]), bench.guard.arm):
        with pytest.raises(BenchStopped, match="the user"):
            call()
    bench.guard.rest()
    bench.guard.feed(LOOP)
    bench.guard.check()
    assert not bench.supply.outputs().any()
    bench.guard.reset()
    assert not bench.tick([1.0, 1.0, 1.0]).any()  # not armed yet
    bench.guard.arm()
    assert bench.tick([1.0, 1.0, 1.0]).tolist() == [1.0, 1.0, 1.0]
    assert bench.said == ["stopped: the user"]


def test_the_device_is_kept_awake_while_the_loop_lives():
    clock = HandClock()
    supply = SoftSupply(1, clock=clock, watchdog=0.15)
    guard = Guard(supply, straight(1), Limits(10.0), clock, {LOOP: Watch(1.0)})
    guard.arm()
    guard.apply(np.array([4.0]))
    for _ in range(40):
        clock.move(0.02)
        guard.check()
        assert supply.outputs()[0] == 4.0


@pytest.mark.realtime
def test_in_real_time_a_thread_that_ends_leaves_zero_volts_within_300_ms():
    clock = WallClock()
    supply = SoftSupply(2, clock=clock, watchdog=None)
    guard = Guard(supply, straight(2), Limits(10.0), clock, WATCHES)
    guard.watch()
    try:
        guard.arm()
        for _ in range(3):
            guard.feed(CAMERA)
            guard.apply(np.array([5.0, -5.0]))
            time.sleep(0.05)
        last, times = time.monotonic(), []
        while supply.outputs().any() and time.monotonic() - last < 1.0:
            times.append(time.monotonic())
            time.sleep(0.002)
        # The looks of this test must have come in time themselves: on a busy machine they may not.
        if max(b - a for a, b in pairwise([last, *times])) < 0.05:
            assert time.monotonic() - last < 0.3
        assert guard.reason is not None
    finally:
        guard.close()


def test_zero_volts_are_asked_for_until_the_device_says_so():
    bench, supply = broken_bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    supply.refuses = True
    bench.guard.stop("the user")
    assert supply.outputs().any()
    with pytest.raises(BenchStopped):
        bench.guard.arm()
    supply.refuses = False
    bench.clock.move(0.1)
    bench.guard.check()
    assert not supply.outputs().any()
    assert len(bench.said) == 2  # asked again, but told once


def test_what_cannot_be_zero_is_as_near_to_it_as_it_can():
    clock = HandClock()
    supply = SoftSupply(1, clock=clock, watchdog=None, lowest=0.0, highest=10.0)
    guard = Guard(supply, Wiring(np.array([0]), np.array([1.0]), np.array([0.1]), 1), Limits(10.0), clock, {})
    guard.arm()
    guard.apply(np.array([5.0]))
    guard.stop("test")
    assert supply.outputs().tolist() == [0.0]


class Crashing(SoftSupply):
    """A supply whose driver makes a mistake of its own."""

    crashes = False

    def write(self, volts):
        if self.crashes:
            raise ZeroDivisionError("a driver's mistake")
        super().write(volts)


def test_a_mistake_in_a_driver_of_a_supply_is_a_fault_like_any_other():
    supply = Crashing(3, watchdog=None, clock=HandClock())
    bench = Bench(Limits(10.0), supply=supply)
    bench.tick([1.0, 1.0, 1.0])
    supply.crashes = True
    with pytest.raises(BenchStopped, match="the supply failed: ZeroDivisionError"):
        bench.tick([2.0, 1.0, 1.0])
    supply.crashes = False
    bench.clock.move(0.1)
    bench.guard.check()
    assert not supply.outputs().any()


def test_a_supply_that_measures_no_number():
    bench, supply = broken_bench(Limits(10.0, current=0.1))
    bench.tick([1.0, 1.0, 1.0])
    supply.measured = Reading(None, np.array([0.0, np.nan, 0.0]))
    with pytest.raises(BenchStopped, match="measures what is no number"):
        bench.tick([1.0, 1.0, 1.0])


def test_a_device_whose_own_watchdog_expired_does_not_go_back_in_one_step():
    bench, supply = broken_bench(Limits(10.0, slew=20.0))
    for _ in range(5):
        bench.tick([10.0, 0.0, 0.0])
    supply.expired_count = 1
    with pytest.raises(BenchStopped, match="watchdog had expired"):
        bench.tick([10.0, 0.0, 0.0])
    assert not supply.outputs().any()


def test_a_time_of_the_gel_that_goes_back_loosens_no_limit():
    clock, gel_clock = HandClock(), HandClock()
    supply = SoftSupply(2, clock=clock, watchdog=None)
    limits = Limits(5.0, slew=20.0, conductance=CONDUCTANCE[:2, :2])
    guard = Guard(supply, straight(2), limits, clock, {}, gel_clock=gel_clock)
    guard.arm()
    gel_clock.move(0.1)
    np.testing.assert_allclose(guard.apply(np.array([5.0, -5.0])), [2.0, -2.0])
    charge = guard.charge
    gel_clock.move(-0.5)
    np.testing.assert_allclose(guard.apply(np.array([-5.0, 5.0])), [2.0, -2.0])
    assert guard.charge == charge


def test_after_its_end_nothing_reaches_the_supply():
    bench = Bench(Limits(10.0))
    bench.tick([1.0, 1.0, 1.0])
    bench.guard.close()
    bench.guard.stop("somebody late")
    bench.guard.close()
    assert bench.said == ["stopped: somebody late"]
    bench.guard.reset()
    with pytest.raises(BenchStopped, match="the supply was closed"):
        bench.guard.arm()


def test_who_is_told_may_fail():
    clock = HandClock()
    supply = SoftSupply(1, clock=clock, watchdog=None)

    def told(text: str) -> None:
        raise OSError("no room")

    guard = Guard(supply, straight(1), Limits(10.0), clock, {}, told)
    guard.arm()
    guard.apply(np.array([1.0]))
    guard.stop("test")
    assert not supply.outputs().any()
