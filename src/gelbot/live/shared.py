"""Controls that everybody sees and one browser may use: what a watcher does with them is undone.

The server's own thread hears the emergency stop, and must be free for it: what is asked of the session may have to wait
for an answer, and is done by a thread beside it, one thing after the other.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import viser

from gelbot.errors import GelbotError
from gelbot.live.seat import Seat

T = TypeVar("T")
_log = logging.getLogger(__name__)

QUIET = 2.0
"""Seconds in which a browser is not told the same thing again."""
FRESH = 2.0
"""Seconds after which what the session told of itself says nothing any more."""
STANDING = ("ready", "stopped")
GO, ANEW = ("start", "step"), ("reset", "choose", "change")
"""What sets the gel moving, and what ends that for certain: the session does one after the other."""


def _nothing() -> None:
    pass


class Errands:
    """Does what it is sent, in order, in a thread of its own, until `close`.

    An errand is told whether it was dropped before its turn came: it does nothing then but clean up.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[int, Callable[[bool], object]] | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._era = self._sent = self._done = 0
        self._thread = threading.Thread(target=self._run, name="gelbot page errands", daemon=True)
        self._thread.start()

    @property
    def is_idle(self) -> bool:
        """Whether everything that was sent is done."""
        return self._sent == self._done

    def send(self, errand: Callable[[bool], object]) -> None:
        """Do `errand` when its turn comes."""
        with self._lock:
            self._sent += 1
            self._waiting.put((self._era, errand))

    def drop(self) -> None:
        """What waits now is dropped. Returns at once, whatever is being done."""
        with self._lock:
            self._era += 1

    def close(self) -> None:
        """Do nothing more; the thread has ended then. What is being done is waited for."""
        self.drop()
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (sent := self._waiting.get()) is not None:
            era, errand = sent
            try:
                errand(era != self._era)
            except Exception:
                _log.exception("something that was asked for on the page could not be done")
            self._done += 1


class Rest:
    """Whether the session stands for certain: by what it told last, and by what was asked of it."""

    def __init__(self) -> None:
        self._may_go = False
        self._state, self._when = "", -FRESH

    def see(self, state: str) -> None:
        """What a new moment says."""
        self._state, self._when = state, time.monotonic()

    def ask(self, name: str, what: Callable[[], object]) -> None:
        """Do `what`, which asks the session for the action `name`. Raises what it raises."""
        # The session does later what it accepts now: until something else comes after a start, it may go at any time,
        # whatever it says of itself.
        self._may_go = self._may_go or name in GO
        what()
        self._may_go = self._may_go and name not in ANEW

    @property
    def is_certain(self) -> bool:
        """Whether nothing moves, and nothing that was asked will move anything."""
        return not self._may_go and self._state in STANDING and time.monotonic() - self._when < FRESH


class Permit:
    """Lets the driver do things, by `errands`, and tells everybody else that they watch."""

    def __init__(self, seat: Seat, errands: Errands) -> None:
        self.seat = seat
        self._errands = errands
        self._told: dict[int, float] = {}

    def may(self, client: viser.ClientHandle) -> bool:
        """Whether the browser `client` drives; if not, it is told why it may do nothing."""
        if self.seat.drives(client.client_id):
            return True
        driver = self.seat.driver
        who = "nobody drives: take over first" if driver is None else f"browser {driver + 1} drives"
        self._tell(client, "You are watching", who[0].upper() + who[1:] + ".", "blue")
        return False

    def do(
        self,
        client: viser.ClientHandle,
        what: Callable[[], object],
        done: Callable[[], object] = _nothing,
        undone: Callable[[], object] = _nothing,
    ) -> None:
        """Do `what` for the browser `client` when its turn comes, if it drives, then `done`; `undone` if it cannot be
        done, or may not. Returns at once."""

        def errand(is_dropped: bool) -> None:
            # Who has gone since, or handed over, moves nothing any more.
            may = not is_dropped and self.seat.drives(client.client_id)
            try:
                may = may and self.attempt(client, what)
            except BaseException:
                undone()
                raise
            (done if may else undone)()

        if self.may(client):
            self._errands.send(errand)
        else:
            undone()

    def attempt(self, client: viser.ClientHandle, what: Callable[[], object]) -> bool:
        """Do `what` now, whoever asks. Returns whether it could be done; if not, the browser knows why."""
        try:
            what()
        except GelbotError as error:
            client.add_notification("Not possible", str(error), auto_close_seconds=8.0, color="red")
            return False
        return True

    def forget(self, client: int) -> None:
        """A browser has gone."""
        self._told.pop(client, None)

    def _tell(self, client: viser.ClientHandle, title: str, body: str, color: Any) -> None:
        now = time.monotonic()
        if now - self._told.get(client.client_id, -QUIET) >= QUIET:
            self._told[client.client_id] = now
            client.add_notification(title, body, auto_close_seconds=3.0, color=color)


class Shared(Generic[T]):
    """A control with a value: `act` is called with what the driver chose; if that fails, or a watcher chose, the value
    goes back to what it was.
    """

    def __init__(self, permit: Permit, handle: Any, act: Callable[[T], object] | None = None) -> None:
        self.handle: Any = handle
        self._permit, self._act = permit, act
        self._asked_for = 0
        self.value: T = handle.value
        handle.on_update(self._asked)

    def put(self, value: T) -> None:
        """Show another value without acting on it."""
        if value != self.value:
            self.value = value
            self.handle.value = value

    # A coroutine, so that it sees the values in the order in which they were chosen.
    async def _asked(self, event: Any) -> None:
        # Without a browser it was the program itself that put the value there.
        if event.client is None:
            return
        value: T = event.target.value
        if not self._permit.may(event.client):
            self.handle.value = self.value
            return
        act = self._act
        if act is None:
            self.value = value
            return
        self._asked_for += 1
        number = self._asked_for

        def done() -> None:
            self.value = value
            show()

        def show() -> None:
            # Where something else was chosen meanwhile, its own turn comes.
            if number == self._asked_for and self.handle.value != self.value:
                self.handle.value = self.value

        self._permit.do(event.client, lambda: act(value), done, show)


def on_press(permit: Permit, button: Any, act: Callable[[], Callable[[], object] | None]) -> None:
    """When the driver presses `button`, call what `act` gives, if it gives something: `act` itself is called at once,
    and reads what the controls say then.
    """

    async def pressed(event: Any) -> None:
        if event.client is not None and permit.may(event.client) and (what := act()) is not None:
            permit.do(event.client, what)

    button.on_click(pressed)
