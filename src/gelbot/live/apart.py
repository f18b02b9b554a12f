"""The page in a process of its own: what it is busy with, a browser, a picture, the interpreter's lock, cannot hold up
the loop; and when it crashes, the bench stops in good order.

The session answers in this process what the page asks over a pipe; an emergency stop has a pipe to itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import GelbotError
from gelbot.live.actions import Actions
from gelbot.live.far import ASKED, show
from gelbot.live.moment import Moment, Stage

BEGINS_WITHIN = 60.0
"""The page must stand within this time [s]."""
ENDS_WITHIN = 5.0
"""A page that has not gone by itself after this time [s] is ended."""


@contextmanager
def served_apart(actions: Actions, host: str, port: int, token: str | None) -> Iterator[str]:
    """Show `actions` at `host` and `port` as `serve.serve` does, from another process; gives the address.

    Raises what `serve` raises.
    """
    context = get_context("spawn")
    ours, its = zip(*(context.Pipe() for _ in range(3)), strict=True)
    process = context.Process(target=show, args=(*its, host, port, token), name="page", daemon=True)
    process.start()
    for end in its:
        end.close()
    calls, urgent, life = ours
    answering = [_Answering(actions, end) for end in (calls, urgent)]
    try:
        for one in answering:
            one.thread.start()
        yield _address(life)
    finally:
        for one in answering:
            one.is_over = True
        life.close()
        process.join(ENDS_WITHIN)
        if process.is_alive():
            process.kill()
            process.join()
        for one in answering:
            one.close()


def _address(life: Connection) -> str:
    """Wait until the page stands."""
    if not life.poll(BEGINS_WITHIN):
        raise GelbotError("the page did not come up in a minute. Try: again, on a machine that is less busy")
    try:
        found = life.recv()
    except EOFError:
        raise GelbotError("the page ended while it came up; what it said stands above") from None
    if isinstance(found, Exception):
        raise found
    return found


class _Answering:
    """Answers what comes over one pipe, in a thread; `is_over`: the page's end is nothing to be told of any more."""

    def __init__(self, actions: Actions, pipe: Connection) -> None:
        self.is_over = False
        self.thread = Thread(target=self._go_on, name="page", daemon=True)
        self._actions, self._pipe = actions, pipe
        self._stage: Stage | None = None
        self._picture: NDArray[np.uint8] | None = None

    def close(self) -> None:
        """The other side is gone."""
        self.thread.join()
        self._pipe.close()

    def _go_on(self) -> None:
        """Until the other side is gone."""
        try:
            while True:
                name, arguments = self._pipe.recv()
                try:
                    answer = self._answer(name, arguments)
                except Exception as error:  # the page must hear something, whatever it is
                    answer = GelbotError(f"a mistake in the program: {error!r}")
                self._pipe.send(answer)
        except (EOFError, OSError):
            pass
        finally:
            if not self.is_over:
                self._actions.emergency_stop("the end of the page's program")
                self._pipe.close()

    def _answer(self, name: str, arguments: tuple[Any, ...]) -> Any:
        if name not in ASKED:
            return GelbotError(f"{name} is nothing that can be asked for")
        try:
            answer = getattr(self._actions, name)(*arguments)
        except GelbotError as error:
            return error
        # What the page has already is not sent again.
        if isinstance(answer, Stage):
            same, self._stage = answer is self._stage, answer
            return None if same else answer
        if isinstance(answer, Moment):
            same, self._picture = answer.picture is self._picture, answer.picture
            return (replace(answer, picture=None), True) if same else (answer, False)
        return answer
