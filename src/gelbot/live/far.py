"""The page's side of the pipe: the session as it is seen from another process, and that process."""

from __future__ import annotations

import signal
from dataclasses import replace
from multiprocessing.connection import Connection
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelbot.clock import be_as_others
from gelbot.errors import GelbotError
from gelbot.live.actions import Actions
from gelbot.live.moment import Moment, Stage

PATIENCE = 20.0
"""An answer must come within this time [s]."""
ASKED = tuple(name for name in vars(Actions) if not name.startswith("_"))
"""What may be asked for over the pipe, and nothing else."""


def show(calls: Connection, urgent: Connection, life: Connection, host: str, port: int, token: str | None) -> None:
    """The page's process: until the other end of `life` is closed, however that came about."""
    from gelbot.live.serve import serve

    # Ctrl-C in a terminal comes to both; the other one sees to it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    be_as_others()
    try:
        served = serve(FarActions(calls, urgent), host, port, token)
    except GelbotError as error:
        life.send(error)
        return
    life.send(served.url)
    try:
        life.recv()
    except (EOFError, OSError):
        pass
    finally:
        served.close()


class FarActions:
    """`Actions` over a pipe; see there what each does."""

    def __init__(self, calls: Connection, urgent: Connection) -> None:
        self._calls, self._urgent = calls, urgent
        self._lock, self._urgent_lock, self._known_lock = Lock(), Lock(), Lock()
        self._stage: Stage | None = None
        self._picture: NDArray[np.uint8] | None = None

    def stage(self) -> Stage:
        """What stands: the same object as long as it is the same."""
        with self._known_lock:
            self._stage = self._ask("stage") or self._stage
            assert self._stage is not None
            return self._stage

    def moment(self) -> Moment:
        """The newest moment."""
        with self._known_lock:
            moment, has_same_picture = self._ask("moment")
            if has_same_picture:
                return replace(moment, picture=self._picture)
            self._picture = moment.picture
            return moment

    def scenarios(self) -> list[str]:
        """The names of the scenarios."""
        return self._ask("scenarios")

    def choose(self, scenario: str) -> None:
        """Another scenario."""
        self._ask("choose", scenario)

    def change(self, changes: dict[str, str]) -> None:
        """Values of the scenario."""
        self._ask("change", changes)

    def start(self) -> None:
        """Go."""
        self._ask("start")

    def pause(self) -> None:
        """Stand still."""
        self._ask("pause")

    def step(self) -> None:
        """One control period."""
        self._ask("step")

    def reset(self) -> None:
        """Back to the beginning."""
        self._ask("reset")

    def emergency_stop(self, who: str) -> None:
        """Zero volts now: past all that waits for an answer."""
        with self._urgent_lock:
            _over(self._urgent, "emergency_stop", (who,))

    def drive_with(self, controller: str) -> None:
        """Who drives."""
        self._ask("drive_with", controller)

    def set_voltage(self, electrode: int, volts: float) -> None:
        """An electrode by hand."""
        self._ask("set_voltage", electrode, volts)

    def set_pattern(self, pattern: str, amplitude: float) -> None:
        """All of them by hand."""
        self._ask("set_pattern", pattern, amplitude)

    def set_reference(self, height: float | None) -> None:
        """What the servo follows."""
        self._ask("set_reference", height)

    def set_pace(self, pace: float | None) -> None:
        """How fast a simulated gel goes."""
        self._ask("set_pace", pace)

    def record(self, wanted: bool) -> None:
        """Keep the gel's shape."""
        self._ask("record", wanted)

    def _ask(self, name: str, *arguments: Any) -> Any:
        with self._lock:
            return _over(self._calls, name, arguments)


def _over(pipe: Connection, name: str, arguments: tuple[Any, ...]) -> Any:
    try:
        pipe.send((name, arguments))
        if not pipe.poll(PATIENCE):
            # What it answers now would be taken for the answer to something else.
            pipe.close()
            raise GelbotError("the bench does not answer")
        answer = pipe.recv()
    except (EOFError, OSError) as error:
        raise GelbotError("the bench has ended") from error
    if isinstance(answer, Exception):
        raise answer
    return answer
