"""How fast the page of `gelbot live` is, and what it costs the control loop beside it.

With a real browser on the same machine, which draws with the processor and takes most of it; and with one that is
elsewhere, or has a GPU: a program that takes all pictures and draws none.

python benchmarks/live.py      the rows, as JSON; three minutes
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

Rows = list[dict[str, Any]]

WARM, MEASURED = 12.0, 20.0
"""Seconds until all shaders are made, and those that count."""
TICK = 3e-3
"""What the control loop does in each tick of 100 ms takes about that [s]."""
WIDTH, HEIGHT = 1000, 700
SIZE = f"{WIDTH} x {HEIGHT}, half the pixels"
MESH = "0.8 mm"
"""332 nodes."""
FRAMES = "window.__viserTestpoints.rendererInfo.render.frame"
CLOSINGS = 5
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
    for message in wire:
        print(end="." if len(message) > 2000 else "", flush=True)
"""
"""A browser that draws nothing: it says where its camera stands, takes what comes, and puts down a dot for each message
with so many bytes [B] that the gel's nodes are in it."""


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

    return [*whole(is_here=False), *([] if NO_BROWSER else [*whole(is_here=True), *closing()])]


def whole(is_here: bool) -> Rows:
    """The turn-over as `gelbot live` has it: a simulated gel, its simulator beside it, log and page, each where it
    belongs, and a browser elsewhere, or one that `is_here` and draws with the same processor."""
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
        session = Session(SimulatedSetup(), Source("turn-over"), Path(folder), (f"body.mesh_size={MESH}",))
        try:
            session.drive_with("programme")
            with served_apart(session, "127.0.0.1", 0, None) as url, browser_at(url, is_here) as (wait, count):
                wait(WARM)
                session.start()
                before, began = count(), time.perf_counter()
                wait(MEASURED)
                rate = (count() - before) / (time.perf_counter() - began)
                moment = session.moment()
        finally:
            session.close()
    ticks, nodes = moment.ticks, moment.positions.shape[1]
    note = f"{nodes} nodes, {ticks.count} ticks, {ticks.late} late, longest {1e3 * ticks.longest:.1f} ms"
    if moment.state != "running":
        note += f"; {moment.state}: {moment.message}"
    where = "here" if is_here else "elsewhere"
    headline = "" if is_here else "live_bench_tick_p99_ms"
    shown = "drawn without a GPU, browser here" if is_here else "sent, browser elsewhere"
    return [
        row(f"live: pictures {shown}", rate, "1/s", None if is_here else 30.0, SIZE if is_here else ""),
        row(f"live: tick of the whole bench, browser {where}, median", 1e3 * ticks.median, "ms", None, note),
        row(f"live: tick of the whole bench, browser {where}, 99 %", 1e3 * ticks.p99, "ms", 20.0, note, headline),
    ]


@contextmanager
def browser_at(url: str, is_here: bool) -> Iterator[tuple[Callable[[float], object], Callable[[], int]]]:
    """How to wait some seconds beside a browser, and how many pictures it has drawn, or taken, so far."""
    from browser import browser_page  # pyright: ignore[reportMissingImports]

    if is_here:
        with browser_page(url, WIDTH, HEIGHT, niceness=0) as page:
            yield lambda seconds: page.wait_for_timeout(1e3 * seconds), lambda: int(page.evaluate(FRAMES))
        return
    with TemporaryFile() as dots:
        taker = subprocess.Popen([sys.executable, "-c", ELSEWHERE, url], stdout=dots)
        try:
            yield time.sleep, lambda: os.fstat(dots.fileno()).st_size
        finally:
            taker.kill()
            taker.wait()


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
