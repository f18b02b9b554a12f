"""The page of `gelbot live`: what a session does, in a browser, and what a user does there, to the session."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from html import escape
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from viser import _messages as messages

from gelbot.errors import GelbotError
from gelbot.live import look
from gelbot.live.actions import Actions
from gelbot.live.gaze import Gaze
from gelbot.live.hand import Hand, wanted
from gelbot.live.moment import Moment, Stage
from gelbot.live.panels import Panel, status
from gelbot.live.plots import Plots
from gelbot.live.scene import Scene
from gelbot.live.seat import Seat
from gelbot.live.seats import Seats
from gelbot.live.shared import Errands, Permit, Rest
from gelbot.live.stroke import Strokes
from gelbot.live.view import ALL, FIELD_OF_VIEW, MM, on_screen, view

_log = logging.getLogger(__name__)

RATE = 30.0
"""Pictures a second."""
SLOW = {"picture": 3, "status": 6, "plots": 8}
"""Every how many pictures the rest is sent."""
AGAIN = 1.0
"""Seconds before another try, after a picture that could not be shown."""
LOOK_EVERY, PATIENCE = 1.0, 3.0
"""Seconds between looks whether the server's own thread, which hears the stop, still answers, and how long it may take
to."""
LEFT, RIGHT = 280.0, 310.0
"""Widths of the panels [px]."""


class Page:
    """Shows `actions` in all browsers of `server`, from a thread of its own, until `close`."""

    def __init__(self, server: viser.ViserServer, actions: Actions) -> None:
        self._server, self._actions = server, actions
        self.seat = Seat()
        self._errands, self._rest = Errands(), Rest()
        self._permit = Permit(self.seat, self._errands)
        self.pictures = 0
        """Pictures sent so far: those in which something had moved."""
        self._closing = False
        try:
            self._build_frame()
            self._seats, self._gaze, self._strokes = Seats(self.seat), Gaze(), Strokes()
            self._stage: Stage = actions.stage()
            self._compose()
        except BaseException:
            self._errands.close()
            raise
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)
        self._done = threading.Event()
        self._threads = [
            threading.Thread(target=what, name=name, daemon=True)
            for name, what in (("gelbot page", self._loop), ("gelbot page watch", self._watch))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Show nothing more. A session that runs goes on: whoever closes the page on purpose stops it on purpose."""
        self._closing = True
        self._done.set()
        for thread in self._threads:
            thread.join()
        self._errands.close()

    def browsers(self) -> dict[int, viser.ClientHandle]:
        """Who is there, by number."""
        return self._server.get_clients()

    def places(self, client: viser.ClientHandle) -> NDArray[np.float64]:
        """Where a browser shows the middles of the electrodes: shares of its picture from the upper left, (2, e)."""
        return on_screen(client.camera, self._scene.plates.centres())

    def _build_frame(self) -> None:
        """What stays when the scenario changes."""
        server, gui = self._server, self._server.gui
        server.scene.set_up_direction("+z")
        # Without shadows and without the reflections of surroundings that are not there: three times as many pictures
        # where a processor draws them.
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.configure_environment_map(None)
        server.scene.add_light_hemisphere(
            "/light", intensity=1.6, sky_color=(255, 255, 255), ground_color=(215, 215, 210)
        )
        server.initial_camera.fov = float(FIELD_OF_VIEW)
        gui.configure_theme(control_width="small", show_logo=False, show_share_button=False, brand_color=(0, 90, 150))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT)
        # Above all that changes, so that it stays where it is.
        stop = gui.add_button(
            "EMERGENCY STOP", color="red", order=0.1, hint="Zero volts at once. Keys: Escape, space bar"
        )
        stop.on_click(self._stop_pressed)
        self._status = gui.add_html("", order=0.2)
        gui.add_html(look.style(stop._impl.uuid), order=0.0)
        self._beat = gui.add_html(look.beat(0), order=0.0)
        words = "Zero volts at once"
        gui.add_command("Emergency stop", description=words, hotkey="escape").on_trigger(self._stop_pressed)
        gui.add_command("Stop", description=words, hotkey="space").on_trigger(self._stop_pressed)
        server._websock_server.queue_message(messages.RunJavascriptMessage(source=look.SCRIPT))
        left = gui.add_panel()
        self._tab = left.add_tab("measured")
        left.dock_left()
        left.set_width(LEFT)
        server.scene.on_rect_select(modifier="shift")(self._paint_inside)  # pyright: ignore[reportArgumentType]

    def _compose(self, is_built: bool = False) -> None:
        """Draw the stage and its controls; `is_built`: it is the one before, changed."""
        self._scene = Scene(self._server.scene, self._stage)
        self._scene.plates.on_pointer(self._click, self._stroke)
        self._scene.reference.handle.on_update(self._drag)
        self._hand = Hand(self._actions, self._stage.control_period)
        gui = self._server.gui
        self._panel = Panel(gui, self._permit, self._actions, self._hand, self._rest, self._look, is_built)
        with self._tab:
            self._plots = Plots(gui, self._stage)
        first = view(self._stage, ALL)
        self._server.initial_camera.position, self._server.initial_camera.look_at = first.position, first.target

    def _recompose(self, stage: Stage) -> None:
        """Another stage: everything that belonged to the old one goes."""
        is_other = stage.name != self._stage.name
        self._stage = stage
        for part in (self._plots, self._panel, self._scene):
            part.remove()
        self._compose(not is_other)
        for client in self._server.get_clients().values():
            if is_other:
                self._look(client, ALL)
            else:
                self._later(self._gaze.refit, client, stage)

    def _loop(self) -> None:
        due, number, complained = time.perf_counter(), 0, ""
        shown: Moment | None = None
        while not self._done.is_set():
            try:
                shown = self._picture(number, shown)
            except Exception as error:
                # Whatever it is: the page goes on, and says so. The loop does not know of it.
                self._rest.see("")
                text = str(error) if isinstance(error, GelbotError) else repr(error)
                self._status.content = f'<div class="gelbot-error">{escape(text)}</div>'
                if isinstance(error.__cause__, EOFError | OSError):
                    # The other end of the pipe is closed: nobody will answer any more.
                    return
                if text == complained:
                    self._done.wait(AGAIN)
                else:
                    is_told = isinstance(error, GelbotError)
                    _log.error("a picture could not be shown: %s", text, exc_info=None if is_told else error)
                complained = text
            number += 1
            if number % RATE == 0:
                self._beat.content = look.beat(number // int(RATE))
            due = max(due + 1.0 / RATE, time.perf_counter() - 1.0 / RATE)
            self._done.wait(max(0.0, due - time.perf_counter()))

    def _watch(self) -> None:
        """Whoever looks at a page that hangs could press its button for nothing: then this thread does it.

        It is not the one that makes the pictures, which may have to wait for the session.
        """
        heard, has_stopped = threading.Event(), False
        asked = time.monotonic()
        heard.set()
        while not self._done.wait(LOOK_EVERY):
            if heard.is_set():
                has_stopped = False
                heard.clear()
                asked = time.monotonic()
                self._later(heard.set)
            elif not has_stopped and time.monotonic() - asked >= PATIENCE:
                has_stopped = True
                _log.error("the page has not answered for %.0f s: emergency stop", PATIENCE)
                self._stop("the page, which hangs")

    def _picture(self, number: int, shown: Moment | None) -> Moment:
        stage = self._actions.stage()
        if stage is not self._stage:
            # Where nothing else stands, what was chosen and written on the page stays as it is.
            if not stage.is_like(self._stage):
                with self._server.atomic():
                    self._recompose(stage)
            self._stage = stage
        moment = self._actions.moment()
        self._rest.see(moment.state)
        if len(moment.given) == len(self._stage.outlines) and moment.positions.shape == self._stage.rest.shape:
            self._show(moment, number, moment is not shown)
        # Otherwise it is of a stage that comes or goes just now.
        return moment

    def _show(self, moment: Moment, number: int, is_new: bool) -> None:
        if is_new:
            self._plots.keep(moment)
        if not self._server.get_clients():
            return
        scene, panel = self._scene, self._panel
        scene.side, scene.look, scene.show_arrows = panel.side.value, panel.plates.value, panel.arrows.value
        with self._server.atomic():
            self.pictures += scene.update(moment, wanted(moment), time.perf_counter()) > 0
        if number % SLOW["picture"] == 0:
            self._plots.show_picture(moment.picture)
        if number % SLOW["status"] == 0:
            self._status.content = status(moment)
            panel.update(moment)
            scene.plates.show_labels(panel.labels.value)
        if number % SLOW["plots"] == 0:
            self._plots.update()

    async def _come(self, client: viser.ClientHandle) -> None:
        self.seat.arrive(client.client_id)
        self._seats.seat_at(client)
        self._gaze.follow(client, self._stage)

    async def _go(self, client: viser.ClientHandle) -> None:
        # The volts first, then the rest.
        drove = self.seat.leave(client.client_id)
        if drove:
            # What it asked for and was not done yet can still be a start.
            stands = self._errands.is_idle and self._rest.is_certain
            if not self._closing and not stands:
                self._stop("the driving browser was closed")
        self._permit.forget(client.client_id)
        self._gaze.forget(client.client_id)
        self._strokes.end(client.client_id)
        self._seats.take_from(client)

    # In the server's own thread, which is kept free for it: nothing that was asked of the session stands before it.
    async def _stop_pressed(self, event: viser.GuiEvent | viser.CommandEvent) -> None:
        if event.client_id is not None:
            self._stop(f"browser {event.client_id + 1}")

    def _stop(self, who: str) -> None:
        """The emergency stop. A reset and a start that were asked for before it and still wait are dropped."""
        self._errands.drop()
        try:
            self._actions.emergency_stop(who)
        except GelbotError as error:
            _log.warning("no stop, by %s: %s", who, error)

    def _click(self, electrode: int, client: viser.ClientHandle) -> None:
        """The brush's volts on a plate that was clicked, none on one that has them."""
        self._permit.do(client, partial(self._hand.toggle, electrode, self._panel.brush.value))

    def _stroke(self, event: viser.SceneNodeDragEvent[viser.MeshHandle]) -> None:
        """The brush's volts on all plates that the pointer passes over."""
        client = event.client
        if event.phase == "start":
            self._strokes.begin(client.client_id, event.start_screen_pos)
        rims = self._scene.plates.rims
        passed = self._strokes.go_on(client.client_id, client.camera, rims, event.end_screen_pos)
        if event.phase == "end":
            self._strokes.end(client.client_id)
        if passed:
            self._permit.do(client, partial(self._hand.put, passed, self._panel.brush.value))

    async def _paint_inside(self, event: viser.SceneRectSelectEvent) -> None:
        """The brush's volts on all plates whose middle lies in the rectangle."""
        places = self.places(event.client)
        low, high = np.array(event.screen_min)[:, None], np.array(event.screen_max)[:, None]
        inside = np.flatnonzero(np.all((places >= low) & (places <= high), axis=0)).tolist()
        self._permit.do(event.client, partial(self._hand.put, inside, self._panel.brush.value))

    async def _drag(self, event: viser.TransformControlsEvent) -> None:
        """The reference is dragged by its handle."""
        reference, shown, client = self._scene.reference, self._panel.reference, event.client
        if client is None:
            return
        height = round(max(0.0, float(event.target.position[2])), 2)
        moves = self.seat.drives(client.client_id) and event.phase != "end"
        reference.dragged = moves
        if event.phase == "start":
            return
        if event.phase == "end":
            reference.stand()
            return
        self._permit.do(
            client,
            partial(self._actions.set_reference, height / MM),
            done=partial(shown.put, height),
            undone=reference.stand,
        )

    def _look(self, client: viser.ClientHandle, name: str) -> None:
        self._later(self._gaze.look, client, self._stage, name)

    def _later(self, what: Callable[..., None], *arguments: Any) -> None:
        """Do this in the server's own thread."""
        with suppress(RuntimeError):  # the server has ended
            self._server._event_loop.call_soon_threadsafe(what, *arguments)
