"""`gelbot live` as it is used: the real session behind the page, a real browser before it.

A control period of half a second leaves a busy machine, on which the browser draws with the processor, time for both.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from browser import (
    CANVAS,
    NO_BROWSER,
    browser_fixture,  # noqa: F401 - pytest finds it there, as "browser"
    click_electrode,
    open_page,
    press,
)
from gelbot.live.ready import Source
from gelbot.live.serve import Served, serve
from gelbot.live.session import Session
from gelbot.live.setups import SimulatedSetup
from gelbot.record.log import open_log
from waiting import until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(bool(NO_BROWSER), reason=NO_BROWSER or "there is one"),
]
UNHURRIED = [
    "body.mesh_size=1.8 mm",
    "programme.control_period=500 ms",
    "recording.interval=500 ms",
    "recording.chunk=1 s",
]


def drawn(page: Page) -> bytes:
    return page.locator(CANVAS).screenshot()


def in_view(page: Page, served: Served) -> int:
    """The electrode that is seen nearest to the middle of the first view."""
    until(served.page.browsers, page=page)
    places = served.page.places(served.page.browsers()[0])
    return int(np.argmin(np.abs(places - 0.5).max(axis=0)))


def test_a_click_gives_volts_the_gel_moves_and_stops(browser, tmp_path):
    session = Session(SimulatedSetup(), Source("turn-over"), tmp_path / "live", UNHURRIED)
    try:
        with serve(session, port=0) as served:
            page = open_page(browser, served.url)
            assert session.stage().controllers[0] == "by hand"
            electrode = in_view(page, served)
            click_electrode(page, served, electrode)
            until(lambda: session.moment().asked[electrode] != 0.0, page=page)
            assert session.moment().controller == "by hand"
            volts = session.moment().asked[electrode]
            before, shape = drawn(page), session.moment().positions
            press(page, "start")
            until(lambda: session.moment().state == "running", page=page)
            until(lambda: session.moment().given[electrode] == volts, page=page)
            # The gel is seen to move: its nodes in the session, and its picture in the browser.
            until(lambda: np.abs(session.moment().positions - shape).max() > 2e-4, page=page)
            until(lambda: drawn(page) != before, page=page)
            press(page, "EMERGENCY STOP")
            until(lambda: session.moment().state == "stopped", page=page)
            assert not session.moment().given.any()
            page.get_by_text("emergency stop").first.wait_for()
            # Nothing goes before a reset.
            press(page, "start")
            page.wait_for_timeout(300)
            assert session.moment().state == "stopped"
            press(page, "reset")
            until(lambda: session.moment().state == "ready", page=page)
            page.close()
    finally:
        session.close()
    log = open_log(tmp_path / "live" / "bench.log")
    assert log["voltage"].values[:, electrode].max() == pytest.approx(volts)
    assert any("emergency stop: browser 1" in event.text for event in log.attrs["events"])


def test_another_scenario_and_another_body(browser, tmp_path):
    session = Session(SimulatedSetup(), Source("turn-over"), tmp_path / "live", UNHURRIED)
    try:
        with serve(session, port=0) as served:
            page = open_page(browser, served.url)
            nodes = session.stage().rest.shape[1]
            session.change({"body.width": "18 mm"})
            until(lambda: session.stage().settings["body.width"] == "18 mm", page=page, patience=90.0)
            assert session.stage().rest.shape[1] != nodes
            session.choose("strip")
            until(
                lambda: session.stage().name == "strip" and session.moment().state == "ready", page=page, patience=90.0
            )
            page.wait_for_timeout(500)
            assert session.stage().settings["body.shape"] == "strip"
            page.get_by_text("strip", exact=False).first.wait_for(state="attached")
            page.close()
    finally:
        session.close()


@pytest.mark.parametrize("ends", ["browser", "program"])
def test_the_command_itself(browser, tmp_path, ends):
    """The page in its own process: the driving browser is closed, or the program is ended, while the gel moves."""
    for attempt in range(3):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        said = command(browser, folder, ends)
        log = open_log(folder / "live" / "bench.log")
        texts = [event.text for event in log.attrs["events"]]
        # On a machine that is too busy for the loop the guard stops it first, as it should: then nothing is shown here.
        if not any("has been silent" in text for text in texts):
            break
    else:
        pytest.fail("the machine was busy three times")
    assert "ended, all electrodes at zero volts; what was kept is in live" in said
    assert "Traceback" not in said
    assert log.sizes["time"] > 2
    says = "the driving browser was closed" if ends == "browser" else "the program was ended"
    assert any(says in text for text in texts), texts


def command(browser: Browser, folder: Path, ends: str) -> str:
    """Run it in `folder` until it is ended; what it said."""
    words = [sys.executable, "-m", "gelbot", "live", "turn-over", "--no-browser", "--port", "0", "--out", "live"]
    for change in UNHURRIED:
        words += ["--set", change]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as program:
        try:
            assert program.stdout is not None
            said = [program.stdout.readline() for _ in range(3)]
            url = said[1].split()[-1]
            assert url.startswith("http://127.0.0.1:"), said
            page = open_page(browser, url)
            press(page, "start")
            wait_for_event(folder, "started")
            page.wait_for_timeout(2500)
            if ends == "browser":
                page.close()
                wait_for_event(folder, "stopped")
            os.kill(program.pid, signal.SIGINT)
            rest = program.communicate(timeout=30.0)[0]
            if ends != "browser":
                page.close()
        finally:
            program.kill()
            program.wait()
    assert program.returncode == 0
    return rest


def wait_for_event(folder: Path, says: str) -> None:
    path = folder / "live" / "bench.log"
    until(lambda: path.exists() and any(says in event.text for event in open_log(path).attrs["events"]))
