"""How fast the page of `gelbot live` is, and what it costs the control loop beside it.

With a real browser on the same machine, which draws with the processor and takes most of it; and with one that is
elsewhere, or has a GPU: a program that takes all pictures and draws none.

python benchmarks/live.py      the rows, as JSON; two minutes
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

Rows = list[dict[str, Any]]

WARM, MEASURED, ALONE = 12.0, 20.0, 10.0
"""Seconds until all shaders are made, those that count, and those without a page."""
TICK = 3e-3
"""What the control loop does in each tick of 100 ms takes about that [s]."""
WIDTH, HEIGHT = 1000, 700
FRAMES = "window.__viserTestpoints.rendererInfo.render.frame"
CLOSINGS = 5
SWITCH = 2e-4
"""As a session has it [s]: a thread that computes gives way soon, so that a tick does not wait Python's usual 5 ms."""
ELSEWHERE = """
import sys, msgspec, viser
from websockets.sync.client import connect
url = sys.argv[1]
there = {"type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "fov": 0.5,
         "near": 0.1, "far": 9.0, "image_height": 700, "image_width": 1000, "look_at": (0.0, 0.0, 0.0),
         "up_direction": (0.0, 0.0, 1.0)}
protocol = f"viser-v{viser.__version__}"
with connect("ws" + url[4:], origin=url[:-1], subprotocols=[protocol], max_size=None, compression=None) as wire:
    wire.send(msgspec.msgpack.encode(there))
    for _ in wire:
        pass
"""
"""A browser that draws nothing: it says where its camera stands, and takes what comes."""


def busy() -> None:
    """A control tick's work: half of it in Python, half in numpy."""
    end = time.perf_counter() + TICK
    matrix = np.eye(60)
    while time.perf_counter() < end:
        matrix = matrix @ matrix
        sum(math.sqrt(k) for k in range(400))


def row(name: str, value: float, unit: str, target: float | None = None, note: str = "", headline: str = "") -> Any:
    """A row of the table; `headline`: its name in that object of bench.json."""
    found = {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}
    return {**found, "headline": headline} if headline else found


def rows() -> Rows:
    """Pictures a second, the control ticks meanwhile, and how soon the volts are gone when the browser is."""
    from browser import NO_BROWSER  # pyright: ignore[reportMissingImports]

    return [*whole(), *elsewhere(), *([] if NO_BROWSER else [*pictures(), *closing()])]


def whole() -> Rows:
    """The turn-over as `gelbot live` has it: a simulated gel, its simulator beside it, log and page, and a browser
    elsewhere."""
    from gelbot.clock import be_in_time
    from gelbot.engine import keep_compiled, prepare_engine

    be_in_time()
    prepare_engine()
    keep_compiled()
    from gelbot.live.apart import served_apart
    from gelbot.live.ready import Source
    from gelbot.live.session import Session
    from gelbot.live.setups import SimulatedSetup

    with TemporaryDirectory() as folder:
        session = Session(SimulatedSetup(), Source("turn-over"), Path(folder))
        try:
            session.drive_with("planned")
            with served_apart(session, "127.0.0.1", 0, None) as url:
                taker = subprocess.Popen([sys.executable, "-c", ELSEWHERE, url])
                try:
                    time.sleep(WARM)
                    session.start()
                    time.sleep(MEASURED)
                    moment = session.moment()
                finally:
                    taker.kill()
                    taker.wait()
        finally:
            session.close()
    ticks, nodes = moment.ticks, moment.positions.shape[1]
    note = (
        f"{nodes} nodes, {ticks.count} ticks, {ticks.late} late, longest {1e3 * ticks.longest:.1f} ms; {moment.state}"
    )
    return [
        row("live: tick of the whole bench, median", 1e3 * ticks.median, "ms", None, note),
        row("live: tick of the whole bench, 99 %", 1e3 * ticks.p99, "ms", 20.0, note, "live_bench_tick_p99_ms"),
    ]


def elsewhere() -> Rows:
    """With a browser that takes nothing from this machine's processor."""
    from gelbot.live.serve import serve
    from toy import Toy  # pyright: ignore[reportMissingImports]

    sys.setswitchinterval(SWITCH)
    with Toy(busy, keep_running=True) as toy, serve(toy, port=0) as served:
        taker = subprocess.Popen([sys.executable, "-c", ELSEWHERE, served.url])
        try:
            while served.page.pictures < 30:
                time.sleep(0.1)
            toy.spent.clear()
            sent, began = served.page.pictures, time.perf_counter()
            time.sleep(MEASURED)
            sent, took = served.page.pictures - sent, time.perf_counter() - began
            high = 1e3 * float(np.percentile(toy.spent, 99))
        finally:
            taker.kill()
            taker.wait()
    return [
        row("page: pictures sent, browser elsewhere", sent / took, "1/s", 30.0, "", "live_pictures_per_s"),
        row("page: control tick meanwhile, 99 %", high, "ms", 20.0, "", "live_tick_p99_ms"),
    ]


def pictures() -> Rows:
    """What is sent and drawn, and the time of the ticks."""
    from browser import browser_page  # pyright: ignore[reportMissingImports]
    from gelbot.live.serve import serve
    from toy import Toy  # pyright: ignore[reportMissingImports]

    sys.setswitchinterval(SWITCH)
    with Toy(busy, keep_running=True) as toy:
        time.sleep(ALONE)
        alone = 1e3 * float(np.percentile(toy.spent, 99))
    with Toy(busy, keep_running=True) as toy, serve(toy, port=0) as served:
        nodes = toy.stage().rest.shape[1]
        with browser_page(served.url, WIDTH, HEIGHT) as page:
            page.wait_for_timeout(1e3 * WARM)
            toy.spent.clear()
            sent, drawn, began = served.page.pictures, page.evaluate(FRAMES), time.perf_counter()
            page.wait_for_timeout(1e3 * MEASURED)
            drawn, took = page.evaluate(FRAMES) - drawn, time.perf_counter() - began
            sent = served.page.pictures - sent
            ticks = 1e3 * np.array(toy.spent)
    median, high = np.percentile(ticks, (50, 99))
    note = f"{nodes} nodes, one browser, {len(ticks)} ticks of 10 a second in the same process"
    return [
        row("page: pictures sent, browser here", sent / took, "1/s", 30.0, note),
        row("page: pictures drawn without a GPU", drawn / took, "1/s", None, f"{WIDTH} x {HEIGHT}, half the pixels"),
        row("page: control tick beside it, median", median, "ms", None, f"its own work is {1e3 * TICK:g} ms"),
        row("page: control tick beside it, 99 %", high, "ms", 20.0, f"alone {alone:.1f} ms"),
    ]


def closing() -> Rows:
    """From the moment in which the driver's tab is told to close to zero volts: the longest of a few."""
    from browser import launch, open_page, playwright_behind  # pyright: ignore[reportMissingImports]  # isort: skip

    from gelbot.live.serve import serve
    from toy import Toy  # pyright: ignore[reportMissingImports]

    took = []
    with playwright_behind() as playwright, Toy(busy, keep_running=True) as toy, serve(toy, port=0) as served:
        browser = launch(playwright)
        for _ in range(CLOSINGS):
            toy.reset()
            toy.drive_with("servo")
            page = open_page(browser, served.url, WIDTH, HEIGHT)
            toy.start()
            page.wait_for_timeout(1500.0)
            began = time.perf_counter()
            page.close()
            while toy.moment().state != "stopped":
                time.sleep(0.005)
            took.append(toy.stopped_at - began)
        browser.close()
    return [row("page: driver's tab closed to zero volts, longest", 1e3 * max(took), "ms", 300.0, f"of {CLOSINGS}")]


if __name__ == "__main__":
    print(json.dumps(rows(), indent=2))
