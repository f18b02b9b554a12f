"""What `gelbot live` does: make the bench, show the page, wait, and leave with zero volts."""

from __future__ import annotations

import contextlib
import signal
import sys
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
LOOK = 0.2
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
    over = Event()
    with stopping(over):
        setup = setup_of(asked)
        source = source_of(asked, setup)
        scenario = source.load(asked.changes).scenario
        check_asked(asked, scenario)
        name = scenario.name
        folder = free_folder(Path("live"), name) if asked.out is None else checked_folder(asked.out)
        say("building the bench")
        session = Session(setup, source, folder, asked.changes, asked.real)
        try:
            if asked.controller is not None:
                session.drive_with(asked.controller)
            with served_apart(session, asked.host, asked.port, asked.token) as address:
                say(f"the bench is at {address}")
                say("emergency stop: the red button, or the space bar, here or there; Ctrl-C ends it")
                if asked.start:
                    session.start()
                if asked.browser:
                    webbrowser.open(address)
                with keyboard(lambda: session.emergency_stop("the keyboard"), over):
                    while not over.wait(LOOK):
                        pass
                # Before the page is closed, which takes its time.
                session.halt("the program was ended")
        finally:
            session.close()
    say(f"ended, all electrodes at zero volts{session.keeping.told()}")


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
    if not 0.0 < pace < 1e3:
        raise BadInput("--pace", text, "a number above 0, or fast: as fast as it goes")
    return pace


@contextmanager
def stopping(over: Event) -> Iterator[None]:
    """SIGINT and SIGTERM set `over`; before the bench is made ready, they end the program."""

    def end(number: int, frame: FrameType | None) -> None:
        if over.is_set():
            raise KeyboardInterrupt
        over.set()

    known = {kind: signal.signal(kind, end) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in known.items():
            signal.signal(kind, handler)


@contextmanager
def keyboard(stop: Callable[[], None], over: Event) -> Iterator[None]:
    """Call `stop` when one of the `STOP_KEYS` is pressed in the terminal, if this is one."""
    if not sys.stdin.isatty():
        yield
        return
    done = Event()
    with _key_by_key():
        thread = Thread(target=_read_keys, args=(stop, done, over), name="keyboard", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()


def _read_keys(stop: Callable[[], None], done: Event, over: Event) -> None:
    import select

    while not done.is_set() and not over.is_set():
        if select.select([sys.stdin], [], [], LOOK)[0]:
            key = sys.stdin.read(1)
            if not key:
                return
            if key in STOP_KEYS:
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
