"""What `gelbot live` does: make the bench, show the page, wait, and leave with zero volts."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from types import FrameType
from typing import NamedTuple

from gelbot.clock import be_in_time
from gelbot.engine import keep_compiled, prepare_engine
from gelbot.errors import BadInput
from gelbot.live.admission import check_token
from gelbot.live.apart import served_apart
from gelbot.live.eyes import camera_eye, check_camera
from gelbot.live.ready import DRIVERS, Source
from gelbot.live.session import Session
from gelbot.live.setups import BenchSetup, PlayedSetup, Setup, SimulatedSetup
from gelbot.plants.build import real_supply
from gelbot.record.result_folder import checked_folder, free_folder
from gelbot.scenario.schema import Scenario

DEFAULT = "turn-over"
STOP_KEYS = (" ", "\x1b", "\r", "\n", "q")
"""Space, Escape, Enter, q: in the terminal each is an emergency stop."""
LOOK = 0.05
"""So often [s] the keyboard is looked at, and whether all is over."""


class Asked(NamedTuple):
    """The options of the command, see there."""

    scenario: str | None
    plant: str
    changes: tuple[str, ...]
    real: tuple[str, ...]
    controller: str | None
    pace: str
    seed: int
    host: str
    port: int
    token: str | None
    browser: bool
    start: bool
    out: Path | None


def live_bench(asked: Asked, say: Callable[[str], None]) -> None:
    """Run the bench until Ctrl-C or SIGTERM; `say` tells the user. Raises `BadInput` before anything is live."""
    be_in_time()  # before there are threads
    prepare_engine()
    keep_compiled()
    over = Over()
    with stopping(over):
        setup = setup_of(asked)
        source = source_of(asked, setup)
        scenario = source.load(asked.changes).scenario
        check_asked(asked, scenario)
        if asked.real:
            source.load([*asked.changes, *asked.real])
        name = scenario.name
        folder = free_folder(Path("live"), name) if asked.out is None else checked_folder(asked.out)
        say("building the bench")
        elsewhere = None if asked.out is not None else partial(free_folder, Path("live"))
        session = Session(setup, source, folder, asked.changes, asked.real, say, elsewhere)
        over.is_late = True
        try:
            if asked.controller is not None:
                session.drive_with(asked.controller)
            with served_apart(session, asked.host, asked.port, asked.token) as address:
                _serve(session, address, asked, over, say)
        finally:
            session.close()
    say(f"ended, all electrodes at zero volts{session.keeping.told()}")


def _serve(session: Session, address: str, asked: Asked, over: Over, say: Callable[[str], None]) -> None:
    """Until it is `over`; then zero volts, before the page is closed, which takes its time."""
    try:
        for text in session.news():
            say(text)
        say(f"{session.setup.words}: the bench is at {address}")
        say("emergency stop: the red button, or the space bar, here or there; Ctrl-C ends it")
        with keyboard(lambda: session.emergency_stop("the keyboard")):
            if asked.browser:
                # A browser in the terminal would not come back.
                Thread(target=webbrowser.open, args=(address,), name="browser", daemon=True).start()
            if asked.start and not over.is_set:
                session.start()
            while not over.is_set:
                if over.is_held:
                    over.is_held = False
                    session.emergency_stop("Ctrl-Z")
                # Here, and not where it happens: a terminal that is held up must hold up nothing else.
                for text in session.news():
                    say(text)
                time.sleep(LOOK)
    finally:
        session.halt("the program was ended")


class Over:
    """What signals have asked for: the end (`is_set`), a stop (`is_held`). Without a lock, for a signal may come in the
    middle of anything. `is_late`: the bench is made, and there is something to end in good order."""

    is_set = is_held = is_late = False


def check_asked(asked: Asked, scenario: Scenario) -> None:
    """What can be seen to be wrong before anything is built. Raises `BadInput`."""
    check_token(asked.token)
    if asked.controller is not None and asked.controller not in DRIVERS:
        raise BadInput("--controller", asked.controller, "one of " + ", ".join(DRIVERS))
    if asked.plant == "bench":
        check_camera(scenario.camera)


def setup_of(asked: Asked) -> Setup:
    """The plant that was asked for. Raises `BadInput`."""
    pace = _pace(asked.pace)
    if asked.real and asked.plant != "simulated":
        raise BadInput("--real", asked.real[0], "with --plant simulated only: other gels are as they are")
    if asked.plant == "simulated":
        return SimulatedSetup(pace, asked.seed)
    if asked.plant == "bench":
        return bench_setup()
    if not Path(asked.plant).exists():
        allowed = "simulated, bench, or a recording: a bench.log of gelbot live, or a run's folder"
        raise BadInput("--plant", asked.plant, allowed)
    return PlayedSetup(Path(asked.plant), pace)


def bench_setup() -> Setup:
    """The supply and the camera of the scenario."""
    return BenchSetup(lambda ready, clock: real_supply(ready.nominal, clock), camera_eye)


def source_of(asked: Asked, setup: Setup) -> Source:
    """The scenario that was asked for; of a recording, its own."""
    if asked.scenario is not None:
        return Source(asked.scenario)
    if isinstance(setup, PlayedSetup) and setup.scenario_text:
        return Source(asked.plant, setup.scenario_text)
    return Source(DEFAULT)


def _pace(text: str) -> float | None:
    if text == "fast":
        return None
    try:
        pace = float(text)
    except ValueError:
        pace = 0.0
    if not 1.0 <= pace < 1e3:
        raise BadInput("--pace", text, "1 or more, or fast: as fast as it goes")
    return pace


@contextmanager
def stopping(over: Over) -> Iterator[None]:
    """Signals that would end the program, or let it stand still, tell `over`; before the bench is made, they end it."""

    def end(number: int, frame: FrameType | None) -> None:
        over.is_set = True
        if not over.is_late:
            raise KeyboardInterrupt

    def hold(number: int, frame: FrameType | None) -> None:
        over.is_held = True

    handlers = dict.fromkeys(("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"), end) | {"SIGTSTP": hold}
    # Some systems do not have them all.
    known = {
        kind: signal.signal(kind, does) for name, does in handlers.items() if (kind := getattr(signal, name, None))
    }
    try:
        yield
    finally:
        for kind, handler in known.items():
            signal.signal(kind, handler)


@contextmanager
def keyboard(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` when one of the `STOP_KEYS` is pressed in the terminal, if this is one."""
    if not sys.stdin.isatty():
        yield
        return
    done = Event()
    with _key_by_key():
        thread = Thread(target=_read_keys, args=(stop, done), name="keyboard", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def _read_keys(stop: Callable[[], None], done: Event) -> None:
    import select

    while not done.is_set():
        if select.select([sys.stdin], [], [], LOOK)[0]:
            # All that is there, past Python's own buffer, which `select` does not see.
            keys = os.read(sys.stdin.fileno(), 1024).decode(errors="replace")
            if not keys:
                return
            if any(key in STOP_KEYS for key in keys):
                with contextlib.suppress(Exception):  # the next key must be heard too
                    stop()


@contextmanager
def _key_by_key() -> Iterator[None]:
    """A terminal that hands over each key at once; it is put back at the end."""
    try:
        import termios
        import tty
    except ImportError:  # then keys come line by line
        yield
        return
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        with contextlib.suppress(termios.error):
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
