"""Controls that everybody sees and one browser may use: what a watcher does with them is undone."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import viser

from gelbot.errors import BadInput
from gelbot.live.seat import Seat

T = TypeVar("T")

QUIET = 2.0
"""Seconds in which a browser is not told the same thing again."""


class Permit:
    """Lets the driver do things, and tells everybody else that they watch."""

    def __init__(self, seat: Seat) -> None:
        self.seat = seat
        self._told: dict[int, float] = {}

    def do(self, client: viser.ClientHandle, what: Callable[[], object]) -> bool:
        """Do `what` for the browser `client`, if it drives. Returns whether it was done; if not, it knows why."""
        if not self.seat.drives(client.client_id):
            driver = self.seat.driver
            who = "nobody drives: take over first" if driver is None else f"browser {driver + 1} drives"
            self._tell(client, "You are watching", who[0].upper() + who[1:] + ".", "blue")
            return False
        return self.attempt(client, what)

    def attempt(self, client: viser.ClientHandle, what: Callable[[], object]) -> bool:
        """Do `what` whoever asks. Returns whether it could be done; if not, the browser knows why."""
        try:
            what()
        except BadInput as error:
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
    goes back to what it was. What is `slow` is done beside the server's own thread, which must hear a stop meanwhile.
    """

    def __init__(
        self, permit: Permit, handle: Any, act: Callable[[T], object] | None = None, slow: bool = False
    ) -> None:
        self.handle: Any = handle
        self._permit, self._act = permit, act
        self.value: T = handle.value
        handle.on_update(self._asked if slow else self._asked_soon)

    def put(self, value: T) -> None:
        """Show another value without acting on it."""
        if value != self.value:
            self.value = value
            self.handle.value = value

    async def _asked_soon(self, event: Any) -> None:
        self._asked(event)

    def _asked(self, event: Any) -> None:
        # Without a browser it was the program itself that put the value there.
        if event.client is None:
            return
        value: T = event.target.value
        act = self._act
        if self._permit.do(event.client, lambda: None if act is None else act(value)):
            self.value = value
        else:
            self.handle.value = self.value


def on_press(permit: Permit, button: Any, act: Callable[[], object]) -> None:
    """Call `act` when the driver presses `button`."""

    async def pressed(event: Any) -> None:
        if event.client is not None:
            permit.do(event.client, act)

    button.on_click(pressed)
