"""The page in a real browser, before a session made of paper: what is clicked arrives, what moves is seen."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
from PIL import Image
from playwright.sync_api import Browser, Page
from viser import _messages as messages
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from browser import (
    CANVAS,
    NO_BROWSER,
    browser_fixture,  # noqa: F401 - pytest finds it there, as "browser"
    choose,
    click_electrode,
    electrode_on_page,
    field,
    open_page,
    press,
    write,
)
from gelbot.errors import BadInput, GelbotError
from gelbot.live import colours, page, shared
from gelbot.live.between import Between
from gelbot.live.hand import SOON, Hand, wanted
from gelbot.live.look import GONE, SILENCE, SILENT
from gelbot.live.plates import FRAMES, OPACITY, SOLID, short
from gelbot.live.plots import History
from gelbot.live.seat import Seat
from gelbot.live.serve import Served, serve
from gelbot.live.shared import Errands, Rest
from gelbot.live.view import on_screen
from toy import SCENARIOS, Toy
from waiting import until

pytestmark = pytest.mark.realtime
in_browser = pytest.mark.skipif(bool(NO_BROWSER), reason=NO_BROWSER or "there is one")
BEFORE = "element => getComputedStyle(element, '::before').content"
"""What stands before an element by the style sheet alone."""
ELECTRODE = 15
"""One that stands in the first view."""


@pytest.fixture
def toy() -> Iterator[Toy]:
    with Toy(camera=False) as session:
        yield session


@pytest.fixture
def served(toy: Toy) -> Iterator[Served]:
    with serve(toy, port=0) as page:
        yield page


def called(toy: Toy, name: str) -> list[tuple[Any, ...]]:
    """What was asked of the session under this name, without the name."""
    return [call[1:] for call in toy.calls if call[0] == name]


def asked(toy: Toy, page: Page, name: str, *what: object) -> bool:
    return bool(until(lambda: what in called(toy, name), page=page))


class Piped(Toy):
    """As over a pipe: one question at a time, and while the test holds `pipe`, no answer. The stop has its own."""

    def __init__(self) -> None:
        super().__init__(camera=False)
        self.pipe = threading.RLock()
        for name in ("moment", "stage", "start", "reset", "choose", "change", "drive_with", "set_voltage"):
            setattr(self, name, self._through(getattr(self, name)))
        for name in ("set_pattern", "set_reference", "scenarios", "step", "pause", "record", "set_pace"):
            setattr(self, name, self._through(getattr(self, name)))

    def _through(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        def ask(*arguments: Any) -> Any:
            with self.pipe:
                return plain(*arguments)

        return ask


@pytest.fixture
def piped() -> Iterator[Piped]:
    session = Piped()
    with session:
        yield session


@pytest.fixture
def shown(piped: Piped) -> Iterator[Served]:
    with serve(piped, port=0) as page:
        yield page


@contextmanager
def plain_browser(served: Served) -> Iterator[ClientConnection]:
    """What says that it is a browser, and sends what it likes."""
    before = len(served.page.browsers())
    wire = connect(
        f"ws://127.0.0.1:{served.port}/", origin=Origin(f"http://127.0.0.1:{served.port}"),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], compression=None, max_size=None, max_queue=None,
    )  # fmt: skip
    with wire:
        # From above, with all plates in the picture.
        place, middle = (12.5, 12.5, 300.0), (12.5, 12.5, 0.0)
        camera = (0.0, 1.0, 0.0, 0.0), place, 1.0, 0.1, 1e3, 600, 800, middle, (0.0, 1.0, 0.0)
        send(wire, messages.ViewerCameraMessage(*camera))
        until(lambda: len(served.page.browsers()) > before, 5.0)
        yield wire


def send(wire: ClientConnection, message: messages.Message) -> None:
    wire.send(msgspec.msgpack.encode({"type": type(message).__name__, **dataclasses.asdict(message)}))


def control(served: Served, label: str) -> Any:
    """The control with this label, or the group with a button of this name."""
    for handle in served.page._server.gui._gui_input_handle_from_uuid.values():
        properties: Any = handle._impl.props
        if getattr(properties, "label", "") == label or label in getattr(properties, "options", ()):
            return handle
    raise LookupError(label)


def put(wire: ClientConnection, served: Served, label: str, value: object = True) -> None:
    send(wire, messages.GuiUpdateMessage(control(served, label)._impl.uuid, {"value": value}))


def click(wire: ClientConnection, electrode: int) -> None:
    ray = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    send(wire, messages.SceneNodeClickMessage(f"/stage/electrodes/panes/{electrode}", None, *ray, (0.5, 0.5), None))


def drag(wire: ClientConnection) -> None:
    send(wire, messages.TransformControlsDragStartMessage("/reference"))
    send(wire, messages.TransformControlsUpdateMessage("/reference", (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 4.0)))


def stroke(wire: ClientConnection, phase: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    nowhere, name = (0.0, 0.0, 0.0), "/stage/electrodes/frames/0"
    send(wire, messages.SceneNodeDragMessage(phase, name, None, nowhere, start, nowhere, end, "left", "cmd/ctrl"))


def paint(wire: ClientConnection) -> None:
    send(wire, messages.ScenePointerMessage("rect-select", None, None, [(0.0, 0.0), (1.0, 1.0)], "shift"))


# Without a browser.


@pytest.mark.parametrize(
    "what",
    [
        lambda wire, served: put(wire, served, "start", "start"),
        lambda wire, served: put(wire, served, "driven by", "servo"),
        lambda wire, served: put(wire, served, "scenario", "lift"),
        lambda wire, served: put(wire, served, "height, mm", 2.0),
        lambda wire, served: put(wire, served, "all zero"),
        lambda wire, served: put(wire, served, "set pattern at the brush's volts"),
        lambda wire, served: (put(wire, served, "body.width", "20 mm"), put(wire, served, "build")),
        lambda wire, served: click(wire, 3),
        lambda wire, served: paint(wire),
        lambda wire, served: drag(wire),
        lambda wire, served: stroke(wire, "start", (0.0, 0.0), (1.0, 1.0)),
    ],
    ids=["start", "driver", "scenario", "height", "zero", "pattern", "build", "click", "rectangle", "handle", "stroke"],
)
def test_the_stop_waits_for_nothing_that_was_asked_before(piped: Piped, shown: Served, what: Any) -> None:
    with plain_browser(shown) as wire:
        with piped.pipe:
            what(wire, shown)
            until(lambda: not shown.page._errands.is_idle, 5.0)
            put(wire, shown, "EMERGENCY STOP")
            until(lambda: called(piped, "emergency_stop") == [("browser 1",)], 1.0)
        until(lambda: shown.page._errands.is_idle, 5.0)


def test_what_waited_when_the_stop_came_is_not_done(piped: Piped, shown: Served) -> None:
    with plain_browser(shown) as wire:
        with piped.pipe:
            presses = (("driven by", "servo"), ("driven by", "planned"), ("reset", "reset"), ("start", "start"))
            for count, (what, value) in enumerate(presses, start=1):
                put(wire, shown, what, value)
                until(lambda count=count: shown.page._errands._sent == count, 5.0)
            put(wire, shown, "EMERGENCY STOP")
            until(lambda: called(piped, "emergency_stop"), 1.0)
        until(lambda: shown.page._errands.is_idle, 5.0)
        assert called(piped, "reset") == called(piped, "start") == []
        assert called(piped, "drive_with") == [("servo",)]  # was on its way
        assert piped.moment().state == "stopped"
        until(lambda: control(shown, "driven by").value == "servo", 5.0)
        # After it everything is done again.
        put(wire, shown, "reset", "reset")
        until(lambda: called(piped, "reset"), 5.0)


def test_a_stroke_paints_each_plate_once(toy: Toy, served: Served) -> None:
    with plain_browser(served) as wire, plain_browser(served) as watcher:
        client = served.page.browsers()[0]
        until(lambda: client.camera.update_timestamp, 5.0)
        first, second, last = (tuple(served.page.places(client)[:, k].tolist()) for k in (0, 1, 3))
        stroke(watcher, "start", first, last)
        stroke(wire, "start", first, first)
        until(lambda: called(toy, "set_voltage") == [(0, 5.0)], 5.0)
        stroke(wire, "update", first, second)
        stroke(wire, "update", first, first)
        stroke(wire, "end", first, last)
        until(lambda: called(toy, "set_voltage") == [(k, 5.0) for k in range(4)], 5.0)
        # What goes on without having begun, paints nothing; another one paints anew.
        stroke(wire, "update", first, last)
        stroke(wire, "start", second, second)
        until(lambda: len(called(toy, "set_voltage")) == 5, 5.0)
        assert called(toy, "set_voltage")[-1] == (1, 5.0)


@pytest.mark.parametrize("is_real", [False, True])
def test_a_real_gel_goes_at_its_own_pace(toy: Toy, is_real: bool) -> None:
    toy._stage = replace(toy.stage(), is_real=is_real)
    with serve(toy, port=0) as served:
        assert control(served, "pace").options == (("1x",) if is_real else ("1x", "2x", "4x", "fastest"))


def test_what_was_chosen_stays_where_the_same_stands_anew(toy: Toy, served: Served) -> None:
    with plain_browser(served) as wire:
        put(wire, served, "brush, V", 2.0)
        put(wire, served, "body.width", "20 mm")
        until(lambda: served.page._panel._texts["body.width"].value == "20 mm", 5.0)
        same = toy._stage = replace(toy.stage(), rest=toy.stage().rest.copy())
        until(lambda: served.page._stage is same, 5.0)
        assert served.page._panel.brush.value == 2.0
        assert served.page._panel._texts["body.width"].value == "20 mm"
        toy._stage = replace(same, settings={**same.settings, "body.width": "18 mm"})
        until(lambda: served.page._panel._texts["body.width"].value == "18 mm", 5.0)


def test_several_values_that_need_each_other_go_together(toy: Toy, served: Served) -> None:
    with plain_browser(served) as wire:
        put(wire, served, "body.width", "wide")
        put(wire, served, "electrodes.gap", "20 mm")
        put(wire, served, "build")
        until(lambda: called(toy, "change") == [({"body.width": "wide", "electrodes.gap": "20 mm"},)], 5.0)
        until(lambda: (line := served.page._panel._error) is not None and line.visible, 5.0)
        # What was refused stays written, and the rest is put right.
        put(wire, served, "body.width", "20 mm")
        put(wire, served, "build")
        until(lambda: served.page._stage.settings == {"body.width": "20 mm", "electrodes.gap": "20 mm"}, 5.0)


def test_plates_are_frames_or_solid(toy: Toy, served: Served) -> None:
    with plain_browser(served) as wire:
        panes = served.page._scene.plates._panes
        assert {pane.opacity for pane in panes} == {OPACITY[FRAMES]}
        put(wire, served, "plates", SOLID)
        until(lambda: {pane.opacity for pane in panes} == {OPACITY[SOLID]}, 5.0)
        click(wire, 3)
        toy.start()
        until(lambda: tuple(panes[3].color) == colours.of_volts(5.0, 10.0), 5.0)


def test_what_is_asked_is_done_in_order_and_the_last_is_shown(piped: Piped, shown: Served) -> None:
    with plain_browser(shown) as wire, plain_browser(shown) as watcher:
        with piped.pipe:
            # As fast as a person could: a choice is read when its turn comes in the page, not when it was sent.
            for count, name in enumerate(("servo", "planned", "nobody", "predictive"), start=1):
                put(wire, shown, "driven by", name)
                until(lambda count=count: shown.page._panel.controller._asked_for == count, 5.0)
            put(watcher, shown, "driven by", "by hand")
        until(lambda: len(called(piped, "drive_with")) == 4, 5.0)
        assert [name for (name,) in called(piped, "drive_with")] == ["servo", "planned", "nobody", "predictive"]
        until(lambda: control(shown, "driven by").value == "predictive", 5.0)
        put(wire, shown, "height, mm", -1.0)
        put(wire, shown, "scenario", "no such")
        until(lambda: called(piped, "choose"), 5.0)
        until(lambda: control(shown, "scenario").value == SCENARIOS[0], 5.0)


def test_a_button_that_is_none_calls_nothing(piped: Piped, shown: Served) -> None:
    with plain_browser(shown) as wire:
        for name in ("tampered", "__init__", "step"):
            put(wire, shown, "start", name)
        until(lambda: called(piped, "step"), 5.0)
        assert {call[0] for call in piped.calls} == {"step"}


@pytest.mark.parametrize("state", ["running", "building", "paused", "something new"])
def test_the_driver_leaves_what_may_move(toy: Toy, served: Served, state: str) -> None:
    with plain_browser(served):
        toy._now(state=state)
        until(lambda: served.page._rest._state == state, 5.0)
    until(lambda: called(toy, "emergency_stop") == [("the driving browser was closed",)], 5.0)


@pytest.mark.parametrize("asked_for", [(), ("start", "reset"), ("reset",), ("pause",)])
def test_the_driver_leaves_what_stands(toy: Toy, served: Served, asked_for: tuple[str, ...]) -> None:
    with plain_browser(served) as wire:
        for name in asked_for:
            put(wire, served, "start", name)
        until(lambda: len(toy.calls) == len(asked_for) and served.page._errands.is_idle, 5.0)
        toy._now(state="ready")
        time.sleep(0.2)
    until(lambda: not served.page.browsers(), 5.0)
    time.sleep(0.1)
    assert called(toy, "emergency_stop") == []


@pytest.mark.parametrize("is_accepted", [True, False])
def test_the_driver_leaves_just_after_the_start(piped: Piped, shown: Served, is_accepted: bool) -> None:
    """The session still says that it is ready: it goes in a moment, or the start is still on its way to it."""
    piped.start = lambda: piped.calls.append(("start",))
    held = piped.pipe if not is_accepted else threading.Lock()
    if not is_accepted:
        piped.start = piped._through(piped.start)
    with held:
        with plain_browser(shown) as wire:
            put(wire, shown, "reset", "reset")
            put(wire, shown, "start", "start")
            until(lambda: shown.page._errands._sent == 2, 5.0)
            if is_accepted:
                until(lambda: called(piped, "start"), 5.0)
                time.sleep(0.3)
        until(lambda: called(piped, "emergency_stop") == [("the driving browser was closed",)], 1.0)
    until(lambda: shown.page._errands.is_idle, 5.0)
    assert len(called(piped, "start")) == is_accepted


def test_it_stands_for_certain_only_where_it_said_so_just_now(monkeypatch: pytest.MonkeyPatch) -> None:
    rest = Rest()
    assert not rest.is_certain
    rest.see("ready")
    assert rest.is_certain
    with pytest.raises(BadInput):
        rest.ask("start", lambda: _refuse())
    rest.see("ready")
    assert not rest.is_certain
    with pytest.raises(BadInput):
        rest.ask("change", lambda: _refuse())
    assert not rest.is_certain
    rest.ask("change", lambda: None)
    assert rest.is_certain
    monkeypatch.setattr(shared, "FRESH", 0.0)
    assert not rest.is_certain


def _refuse() -> None:
    raise BadInput("start", "now", "a reset first")


def test_errands_go_on_after_a_mistake_and_end(caplog: pytest.LogCaptureFixture) -> None:
    errands, done = Errands(), list[object]()

    def mistake(_: bool) -> None:
        raise ZeroDivisionError("by nought")

    errands.send(mistake)
    errands.send(done.append)
    until(lambda: errands.is_idle, 5.0)
    errands.close()
    assert done == [False]
    assert "by nought" in caplog.text


@pytest.mark.parametrize(
    "updates",
    [
        {"removed": True},
        {"update_cb": []},
        {"sync_cb": None, "value": True},
        {"is_button": False},
        {"props": None},
        {},
    ],
)
def test_nobody_takes_the_stop_away(toy: Toy, served: Served, updates: dict[str, Any]) -> None:
    with plain_browser(served) as driver, plain_browser(served) as watcher:
        stop = control(served, "EMERGENCY STOP")._impl
        before = (stop.removed, list(stop.update_cb), stop.sync_cb, stop.is_button, stop.props)
        send(watcher, messages.GuiUpdateMessage(stop.uuid, updates))
        # Its own line and button are its own, but not for more than that.
        own = next(iter(served.page.browsers()[1].gui._gui_input_handle_from_uuid.values()))._impl
        send(watcher, messages.GuiUpdateMessage(own.uuid, {"removed": True}))
        time.sleep(0.2)
        assert (stop.removed, list(stop.update_cb), stop.sync_cb, stop.is_button, stop.props) == before
        assert not own.removed
        put(driver, served, "EMERGENCY STOP")
        until(lambda: called(toy, "emergency_stop") == [("browser 1",)], 5.0)


def test_nobody_leaves_files_here(served: Served) -> None:
    with plain_browser(served):
        own = served.page.browsers()[0]._websock_connection
        for interface in (served.page._server._websock_server, own):
            assert messages.GuiUpdateMessage in interface._incoming_handlers
            assert messages.FileTransferStartUpload not in interface._incoming_handlers
            assert messages.FileTransferPart not in interface._incoming_handlers


def test_a_page_that_hangs_stops(toy: Toy, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(page, "LOOK_EVERY", 0.1)
    monkeypatch.setattr(page, "PATIENCE", 1.0)
    with serve(toy, port=0) as served:
        time.sleep(1.5)
        assert called(toy, "emergency_stop") == []
        awake = threading.Event()
        served.page._server._event_loop.call_soon_threadsafe(awake.wait, 20.0)
        began = time.perf_counter()
        until(lambda: called(toy, "emergency_stop"), 5.0)
        assert time.perf_counter() - began < 3.0
        time.sleep(1.5)
        awake.set()
        time.sleep(0.5)
        assert called(toy, "emergency_stop") == [("the page, which hangs",)]
    assert caplog.text.count("has not answered") == 1


def test_a_bench_that_has_ended_is_told_and_not_asked_again(
    toy: Toy, served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    times: list[float] = []

    def ended(*_: object) -> Any:
        times.append(time.monotonic())
        raise GelbotError("the bench has ended") from EOFError()

    with plain_browser(served) as wire:
        toy.moment = toy.emergency_stop = ended  # pyright: ignore[reportAttributeAccessIssue]
        until(lambda: "the bench has ended" in served.page._status.content, 5.0)
        time.sleep(0.5)
        assert len(times) == 1
        with caplog.at_level(logging.WARNING):
            put(wire, served, "EMERGENCY STOP")
            until(lambda: len(times) == 2, 5.0)
    until(lambda: len(times) == 3, 5.0)  # the driver has gone, and the session cannot say that it stands
    until(lambda: caplog.text.count("the bench has ended") == 2, 5.0)
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize("error", [ZeroDivisionError("by nought"), GelbotError("a mistake in the program")])
def test_a_mistake_in_a_picture_is_told_once_and_the_page_goes_on(
    toy: Toy, served: Served, caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    plain, times = toy.moment, list[float]()

    def mistaken() -> Any:
        times.append(time.monotonic())
        raise error

    toy.moment = mistaken
    time.sleep(1.5)
    assert 2 <= len(times) <= 5
    assert caplog.text.count("could not be shown") == 1
    toy.moment = plain
    with plain_browser(served):
        until(lambda: "gelbot-state" in served.page._status.content, 5.0)


def test_the_last_one_who_leaves_a_free_seat_counts_as_the_driver() -> None:
    seat = Seat()
    for browser in (0, 1):
        seat.arrive(browser)
    assert seat.hand_over(0)
    assert not seat.leave(0)
    assert not seat.leave(7)
    assert seat.leave(1)
    assert not seat.leave(1)
    seat.arrive(2)
    assert seat.driver == 2


def test_the_first_drives_and_the_others_watch() -> None:
    seat = Seat()
    seat.arrive(0)
    seat.arrive(1)
    assert seat.driver == 0
    assert not seat.take_over(1)
    assert not seat.hand_over(1)
    assert not seat.leave(1)
    assert seat.drives(0)
    assert not seat.drives(1)
    assert not seat.drives(None)


def test_a_seat_that_was_left_is_free() -> None:
    seat = Seat()
    seat.arrive(0)
    seat.arrive(1)
    assert seat.leave(0)
    assert seat.driver is None
    assert seat.take_over(1)
    assert not seat.take_over(0)
    assert seat.leave(1)
    seat.arrive(2)
    assert seat.driver == 2


def test_a_seat_that_was_handed_over_is_taken_by_who_asks() -> None:
    seat = Seat()
    seat.arrive(0)
    seat.arrive(1)
    assert seat.hand_over(0)
    seat.arrive(2)
    assert seat.driver is None
    assert seat.take_over(1)
    assert not seat.hand_over(0)


def test_nodes_go_from_moment_to_moment_and_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    with Toy(camera=False) as toy:
        first = toy.moment()
    rest = first.positions
    second = replace(first, number=1, time=0.1, positions=rest + 1.0)
    third = replace(first, number=2, time=0.2, positions=rest + 2.0)
    monkeypatch.setattr("gelbot.live.between.LAG", 1.0)
    between = Between()
    assert between.positions(first, 0.0) is rest
    np.testing.assert_allclose(between.positions(second, 0.1), rest)
    np.testing.assert_allclose(between.positions(second, 0.15), rest + 0.5)
    assert between.positions(second, 0.2) is second.positions
    np.testing.assert_allclose(between.positions(third, 0.25), rest + 1.0)
    # Another beginning, and a step after a long rest, are no motion.
    assert between.positions(first, 0.3) is rest
    assert between.positions(second, 5.0) is second.positions


def test_the_last_minute_is_kept_and_no_more() -> None:
    with Toy(camera=False) as toy:
        stage, moment = toy.stage(), toy.moment()
    history = History(stage)
    for tick in range(2_000):
        assert history.add(replace(moment, number=tick, time=0.1 * tick, reference=3e-3))
        assert not history.add(replace(moment, number=tick, time=0.1 * tick))
    clock, seen, simulated, wanted = history.heights()
    assert clock[-1] - clock[0] <= 60.0 + 1e-9
    assert len(clock) == 600
    assert np.isnan(seen).all()
    np.testing.assert_allclose(simulated, 0.5)
    np.testing.assert_allclose(wanted, 3.0)
    assert len(history.volts()) == len(history.currents()) == 17
    history.add(replace(moment, time=0.0))
    assert len(history.heights()[0]) == 2


def test_a_plate_is_switched_on_and_off_and_several_at_once() -> None:
    with Toy(camera=False) as toy:
        hand = Hand(toy, period=0.0)
        hand.toggle(3, 5.0)
        time.sleep(SOON)
        hand.toggle(3, 5.0)
        hand.put([1, 99, 2], -4.0)
        assert called(toy, "set_voltage") == [(3, 5.0), (3, 0.0), (1, -4.0), (99, -4.0), (2, -4.0)]
        np.testing.assert_allclose(wanted(toy.moment())[:4], [0.0, -4.0, -4.0, 0.0])
        with pytest.raises(BadInput, match="limit"):
            hand.put([1, 2], 99.0)
        # Where something else drives, a plate that has these volts has not got them by hand.
        time.sleep(SOON)
        toy._now(controller="servo")
        hand.toggle(1, -4.0)
        assert called(toy, "set_voltage")[-1] == (1, -4.0)
        toy.emergency_stop("a test")
        toy._now(asked=np.ones(16))
        assert not wanted(toy.moment()).any()


def test_a_second_click_before_the_session_has_told_of_the_first_switches_off() -> None:
    with Toy(camera=False) as toy:
        silent = replace(toy.moment(), state="running")
        toy.moment = lambda: silent  # pyright: ignore[reportAttributeAccessIssue]
        hand = Hand(toy, period=0.1)
        hand.toggle(3, 5.0)
        hand.toggle(3, 5.0)
        assert called(toy, "set_voltage") == [(3, 5.0), (3, 0.0)]
        # What it has not told in time, it has not done.
        hand.toggle(3, 5.0)
        time.sleep(0.1 + SOON)
        hand.toggle(3, 5.0)
        assert called(toy, "set_voltage")[2:] == [(3, 5.0), (3, 5.0)]


def test_names_lose_what_they_share() -> None:
    assert short(["electrode 0", "electrode 11"]) == ["0", "11"]
    assert short(["left ring", "right ring"]) == ["left ring", "right ring"]
    assert short(["only one"]) == ["only one"]
    assert short(["a", "a"]) == ["a", "a"]


def test_colours_are_those_of_the_movie() -> None:
    red, blue, none = (colours.of_volts(v, 10.0) for v in (10.0, -10.0, 0.0))
    assert red[0] > 150 > red[2]
    assert blue[2] > 150 > blue[0]
    assert min(none) > 230
    assert colours.of_volts(99.0, 10.0) == red
    assert colours.of_volts(float("nan"), 10.0) == none
    assert colours.of_adsorption(12).shape == (12, 3)


def test_nothing_is_left_when_it_closes() -> None:
    before = threading.active_count()
    for _ in range(2):
        with Toy(camera=False) as toy, serve(toy, port=0) as served:
            served.close()
    assert threading.active_count() == before


# With one.


@in_browser
@pytest.mark.slow
def test_a_plate_is_clicked_and_the_body_moves(browser: Browser, toy: Toy, served: Served) -> None:
    page = browser.new_page()
    asked_for: list[str] = []
    page.on("request", lambda request: asked_for.append(request.url))
    page.close()
    with open_page(browser, served.url) as page:
        assert page.title() == "gelbot"
        click_electrode(page, served, ELECTRODE)
        assert asked(toy, page, "set_voltage", ELECTRODE, 5.0)
        until(lambda: toy.moment().asked[ELECTRODE] == 5.0, page=page)
        before = page.locator(CANVAS).screenshot()
        sent = served.page.pictures
        press(page, "start")
        assert asked(toy, page, "start")
        until(lambda: served.page.pictures > sent + 20, page=page)
        until(lambda: page.locator(CANVAS).screenshot() != before, page=page)
        click_electrode(page, served, ELECTRODE)
        assert asked(toy, page, "set_voltage", ELECTRODE, 0.0)
        press(page, "EMERGENCY STOP")
        assert asked(toy, page, "emergency_stop", "browser 1")
        page.get_by_text("stopped by browser 1").wait_for()
        press(page, "start")
        page.get_by_text("reset first, then start").wait_for()
        press(page, "reset")
        assert asked(toy, page, "reset")


@in_browser
@pytest.mark.slow
def test_nothing_is_fetched_from_anywhere_else(browser: Browser, served: Served) -> None:
    context = browser.new_context()
    urls: list[str] = []
    context.on("request", lambda request: urls.append(request.url))
    open_page(context, served.url)
    context.close()
    here = (f"http://127.0.0.1:{served.port}/", f"blob:http://127.0.0.1:{served.port}/", "data:")
    assert [url for url in urls if not url.startswith(here)] == []
    assert len(urls) > 0


@in_browser
@pytest.mark.slow
def test_a_rectangle_paints_the_plates_in_it(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as page:
        page.get_by_text("show", exact=True).click()
        press(page, "above")
        page.wait_for_timeout(1500)
        corner, end = (electrode_on_page(page, served, k) for k in (8, 13))
        page.keyboard.down("Shift")
        page.mouse.move(corner[0] - 15, corner[1] - 15)
        page.mouse.down()
        page.mouse.move(end[0], end[1], steps=4)
        page.mouse.move(end[0] + 15, end[1] + 15, steps=4)
        page.mouse.up()
        page.keyboard.up("Shift")
        for electrode in (8, 9, 12, 13):
            assert asked(toy, page, "set_voltage", electrode, 5.0)
        assert {call[0] for call in called(toy, "set_voltage")} == {8, 9, 12, 13}
        press(page, "all zero")
        until(lambda: (15, 0.0) in called(toy, "set_voltage"), page=page)


@in_browser
@pytest.mark.slow
def test_ctrl_and_drag_paint_the_plates_on_the_way(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as page:
        before = served.page.browsers()[0].camera.position
        places = [electrode_on_page(page, served, k) for k in (4, 6, 10)]
        page.mouse.move(places[0][0] - 1, places[0][1])
        page.wait_for_timeout(100)
        page.mouse.move(*places[0])
        page.keyboard.down("Control")
        page.mouse.down()
        for place in places[1:]:
            page.mouse.move(*place, steps=6)
            page.wait_for_timeout(100)
        page.mouse.up()
        page.keyboard.up("Control")
        until(lambda: {call[0] for call in called(toy, "set_voltage")} == {4, 5, 6, 10}, page=page)
        np.testing.assert_allclose(served.page.browsers()[0].camera.position, before)


@in_browser
@pytest.mark.slow
def test_all_plates_are_in_the_first_view_until_the_user_turns_it(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url, 1280, 720) as page:
        client = served.page.browsers()[0]

        def outer() -> Any:
            """How far to the sides and up and down the plates go, as shares of the picture."""
            rims = on_screen(client.camera, np.concatenate(served.page._scene.plates.rims, axis=1))
            return rims.min(axis=1), rims.max(axis=1)

        def is_filled() -> bool:
            low, high = outer()
            return bool((low > 0.03).all() and (high < 0.97).all() and (high - low).max() > 0.8)

        for width, height in ((1280, 720), (1920, 1080), (800, 700)):
            page.set_viewport_size({"width": width, "height": height})
            electrode_on_page(page, served, 0)
            until(is_filled, page=page)
        # From here on it is the user's own.
        box = page.locator(CANVAS).bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 20, box["y"] + box["height"] - 20)
        page.wait_for_timeout(100)
        page.mouse.down()
        page.mouse.move(box["x"] + 80, box["y"] + box["height"] - 60, steps=6)
        page.mouse.up()
        page.wait_for_timeout(1500)
        turned = client.camera.position
        page.set_viewport_size({"width": 1280, "height": 720})
        electrode_on_page(page, served, 0)
        page.wait_for_timeout(500)
        np.testing.assert_allclose(client.camera.position, turned, rtol=1e-3)


@in_browser
@pytest.mark.slow
def test_the_gel_is_seen_from_above(browser: Browser, toy: Toy, served: Served) -> None:
    """One plate hangs over its middle: through its frame the gel is green, a solid one hides it."""
    with open_page(browser, served.url) as page:
        toy._now(adsorption=np.full(toy.stage().faces.shape[1], 0.6))
        served.page._look(served.page.browsers()[0], "above")
        page.wait_for_timeout(1500)
        x, y = electrode_on_page(page, served, 6)
        clip: Any = {"x": x - 3, "y": y - 3, "width": 6, "height": 6}

        def green() -> float:
            picture = np.array(Image.open(BytesIO(page.screenshot(clip=clip))), np.float64)
            return float((picture[..., 1] - picture[..., 2]).mean())

        through = green()
        assert through > 25.0
        page.get_by_text("show", exact=True).click()
        page.wait_for_timeout(500)  # what unfolds, moves
        choose(page, "plates", SOLID)
        until(lambda: green() < 0.5 * through, page=page)
        click_electrode(page, served, 6)
        assert asked(toy, page, "set_voltage", 6, 5.0)


@in_browser
@pytest.mark.slow
def test_panes_have_their_colours_below_the_water(browser: Browser, toy: Toy, served: Served) -> None:
    toy._now(given=np.full(16, 10.0), asked=np.full(16, 10.0))
    with open_page(browser, served.url, 1280, 720, sharp=1.0) as page:
        # Those that no message covers, and not the one above the gel.
        shown = {k: electrode_on_page(page, served, k) for k in (4, 5, *range(7, 16))}

        def pale() -> list[int]:
            picture = np.array(Image.open(BytesIO(page.screenshot())), np.float64)
            return [k for k, (x, y) in shown.items() if np.ptp(picture[int(y), int(x), :3]) < 15.0]

        page.wait_for_timeout(1000)
        until(lambda: pale() == [], 15.0, page)


@in_browser
@pytest.mark.slow
def test_a_watcher_moves_nothing_and_stops_everything(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as driver, open_page(browser, served.url) as watcher:
        watcher.get_by_text("Watching; browser 1 drives.").wait_for()
        press(driver, "start")
        assert asked(toy, driver, "start")
        click_electrode(watcher, served, ELECTRODE, browser=1)
        watcher.get_by_text("Browser 1 drives.", exact=True).wait_for()
        write(watcher, "height, mm", "2")
        height = field(watcher, "height, mm")
        until(lambda: height.input_value() == "0", page=watcher)
        press(watcher, "pause")
        press(watcher, "take over")
        watcher.get_by_text("can hand over").wait_for()
        assert called(toy, "set_voltage") == called(toy, "pause") == called(toy, "set_reference") == []
        assert toy.moment().state == "running"
        press(watcher, "EMERGENCY STOP")
        assert asked(toy, watcher, "emergency_stop", "browser 2")
        press(driver, "hand over")
        driver.get_by_text("Watching; nobody drives.").wait_for()
        press(watcher, "take over")
        watcher.get_by_text("You drive (browser 2).").wait_for()
        press(watcher, "reset")
        assert asked(toy, watcher, "reset")


@in_browser
@pytest.mark.slow
def test_closing_the_driver_s_tab_stops_at_once(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as driver, open_page(browser, served.url) as watcher:
        click_electrode(driver, served, ELECTRODE)
        press(driver, "start")
        until(lambda: toy.moment().given[ELECTRODE] == 5.0, page=driver)
        closing = time.perf_counter()
        driver.close()
        until(lambda: toy.moment().state == "stopped", page=watcher)
        assert called(toy, "emergency_stop") == [("the driving browser was closed",)]
        assert not toy.moment().given.any()
        # Of these the browser itself takes some to close the page.
        assert toy.stopped_at - closing < 1.0
        watcher.get_by_text("Watching; nobody drives.").wait_for()
        press(watcher, "take over")
        watcher.get_by_text("You drive (browser 2).").wait_for()


@in_browser
@pytest.mark.slow
def test_a_page_that_is_left_alone_says_so(browser: Browser, toy: Toy) -> None:
    with serve(toy, port=0) as served:
        page = open_page(browser, served.url)
        stop = page.locator("button", has_text="EMERGENCY STOP")
        ready, seat = page.get_by_text("ready", exact=True), page.get_by_text("You drive")
        assert stop.is_visible()
        assert ready.is_visible()
        assert seat.is_visible()
        over = stop.locator("xpath=..")
        assert over.evaluate(BEFORE) == "none"
    try:
        until(lambda: GONE in over.evaluate(BEFORE), page=page)
        assert not stop.is_visible()
        assert not ready.is_visible()
        assert not seat.is_visible()
    finally:
        page.close()


@in_browser
@pytest.mark.slow
def test_a_page_that_hears_nothing_says_so(browser: Browser, toy: Toy, served: Served) -> None:
    """As behind a pulled cable, of which a connection does not know."""
    with open_page(browser, served.url) as page:
        stop = page.get_by_role("button", name="EMERGENCY STOP")
        over = stop.locator("xpath=..")
        page.wait_for_timeout(1.5e3 * SILENCE)
        assert over.evaluate(BEFORE) == "none"
        served.page._done.set()
        until(lambda: SILENT in over.evaluate(BEFORE), page=page)
        # It may still be heard.
        stop.click()
        assert asked(toy, page, "emergency_stop", "browser 1")


@in_browser
@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "focus"),
    [("Escape", ""), ("Escape", "height, mm"), ("Space", ""), ("Space", "record")],
)
def test_a_key_stops(browser: Browser, toy: Toy, served: Served, key: str, focus: str) -> None:
    with open_page(browser, served.url) as page:
        if focus:
            field(page, focus).focus()
        page.keyboard.press(key)
        assert asked(toy, page, "emergency_stop", "browser 1")
        page.wait_for_timeout(200)
        assert called(toy, "record") == []


@in_browser
@pytest.mark.slow
def test_the_space_bar_stops_and_presses_no_button(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as page:
        page.get_by_role("button", name="reset").focus()
        page.keyboard.press("Space")
        assert asked(toy, page, "emergency_stop", "browser 1")
        page.wait_for_timeout(300)
        assert called(toy, "reset") == []
        assert toy.moment().state == "stopped"


@in_browser
@pytest.mark.slow
def test_settings_wait_for_the_button_and_a_bad_one_changes_nothing(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as page:
        page.get_by_text("body and electrodes").click()
        stage = toy.stage()
        write(page, "body.width", "wide")
        press(page, "build")
        line = page.locator(".gelbot-error")
        line.wait_for()
        assert "body.width: got 'wide'; allowed: a length" in (line.text_content() or "")
        assert toy.stage() is stage
        assert called(toy, "change") == [({"body.width": "wide"},)]
        write(page, "body.width", "20 mm")
        page.wait_for_timeout(500)
        assert len(called(toy, "change")) == 1
        press(page, "build")
        until(lambda: served.page._panel.stage.settings["body.width"] == "20 mm", page=page)
        # It stays open: there may be more to change.
        until(lambda: field(page, "body.width").is_visible() and page.get_by_role("button", name="build").is_visible())
        page.get_by_text("scenario", exact=True).first.click()


@in_browser
@pytest.mark.slow
def test_what_the_driver_chooses_arrives(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url) as page:
        choose(page, "driven by", "servo")
        assert asked(toy, page, "drive_with", "servo")
        choose(page, "pace", "fastest")
        assert asked(toy, page, "set_pace", None)
        field(page, "record").click()
        assert asked(toy, page, "record", True)
        write(page, "height, mm", "4")
        assert asked(toy, page, "set_reference", 4e-3)
        press(page, "as in the programme")
        assert asked(toy, page, "set_reference", None)
        press(page, "set pattern at the brush's volts")
        assert asked(toy, page, "set_pattern", "ridge", 5.0)
        press(page, "step")
        assert asked(toy, page, "step")
        page.get_by_text("scenario", exact=True).first.click()
        choose(page, "scenario", "lift")
        assert asked(toy, page, "choose", "lift")
        until(lambda: served.page._panel.stage.name == "lift", page=page)
        click_electrode(page, served, ELECTRODE)
        assert asked(toy, page, "set_voltage", ELECTRODE, 5.0)


@in_browser
@pytest.mark.slow
def test_the_stop_stays_in_sight(browser: Browser, toy: Toy, served: Served) -> None:
    with open_page(browser, served.url, 1000, 600) as page:
        for folder in ("show", "scenario", "body and electrodes"):
            page.get_by_text(folder, exact=True).first.click()
        page.wait_for_timeout(500)
        stop = page.get_by_role("button", name="EMERGENCY STOP")
        build = page.get_by_role("button", name="build")
        before = stop.bounding_box()
        build.scroll_into_view_if_needed()
        after = stop.bounding_box()
        assert before is not None
        assert after is not None
        assert 0.0 < after["y"] <= before["y"]
        assert page.get_by_role("button", name="hand over").bounding_box()["y"] < after["y"]  # pyright: ignore
        # Where it is seen it is also hit.
        page.mouse.click(after["x"] + 0.5 * after["width"], after["y"] + 0.5 * after["height"])
        assert asked(toy, page, "emergency_stop", "browser 1")
        # And what is said then does not push it away.
        page.get_by_text("stopped", exact=True).wait_for()
        assert stop.bounding_box() == after


@in_browser
@pytest.mark.slow
def test_the_reference_is_dragged(browser: Browser, toy: Toy, served: Served) -> None:
    toy.drive_with("servo")
    toy.set_reference(3e-3)
    toy.start()
    with open_page(browser, served.url) as page:
        until(lambda: served.page._scene.reference.handle.visible, page=page)
        page.wait_for_timeout(1000)
        client = served.page.browsers()[0]
        foot = np.array(served.page._scene.reference.handle.position)[:, None]
        box = page.locator(CANVAS).bounding_box()
        assert box is not None

        def place(up: float) -> tuple[float, float]:
            x, y = on_screen(client.camera, foot + np.array([[0.0], [0.0], [up]]))[:, 0]
            return box["x"] + x * box["width"], box["y"] + y * box["height"]

        def dragged() -> bool:
            return any(call[0] is not None and call[0] > 4e-3 for call in called(toy, "set_reference"))

        page.mouse.move(*place(1.5))
        page.wait_for_timeout(200)
        page.mouse.down()
        for up in np.linspace(1.5, 5.5, 12):
            page.mouse.move(*place(float(up)))
            page.wait_for_timeout(60)
        until(dragged, page=page)
        page.mouse.up()


@in_browser
@pytest.mark.slow
def test_memory_and_threads_stand_still_while_browsers_come_and_go(browser: Browser, toy: Toy, served: Served) -> None:
    toy.drive_with("servo")
    toy.start()
    kept: list[int] = []
    threads: list[int] = []
    for _ in range(3):
        page = open_page(browser, served.url)
        toy.reset()
        toy.start()
        page.wait_for_timeout(1500)
        page.close()
        until(lambda: not served.page.browsers())
        kept.append(len(served.page._server._websock_server._broadcast_buffer.message_from_id))
        threads.append(threading.active_count())
    assert kept[-1] <= kept[0] + 20
    assert threads[-1] <= threads[0] + 8
