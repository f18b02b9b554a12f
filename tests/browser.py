"""A real browser without a window, for tests and pictures of the page. It draws with the processor, slowly.

`GELBOT_CHROMIUM` says where the browser is, if not in the usual place.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Playwright, sync_playwright

from gelbot.live.serve import Served
from waiting import PATIENCE, until

CHROMIUM = Path(os.environ.get("GELBOT_CHROMIUM", "/usr/bin/chromium"))
FLAGS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
)  # fmt: skip
BEHIND = 10
"""The niceness of browsers."""
CANVAS = "canvas[data-engine]"
NO_BROWSER = "" if CHROMIUM.exists() else f"there is no browser at {CHROMIUM} (apt-get install chromium)"


@contextmanager
def playwright_behind(niceness: int = BEHIND) -> Iterator[Playwright]:
    """Playwright, whose browsers the system runs behind everything else: they draw with the processor, and would take
    it from what is tried. 0: as any other program. Where it cannot be taken back, this process stays where it is."""
    manager, is_root = sync_playwright(), hasattr(os, "geteuid") and os.geteuid() == 0
    before = os.getpriority(os.PRIO_PROCESS, 0) if is_root else 0
    if is_root:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    try:
        started = manager.__enter__()
    finally:
        if is_root:
            os.setpriority(os.PRIO_PROCESS, 0, before)
    try:
        yield started
    finally:
        manager.__exit__(None, None, None)


def launch(playwright: Playwright) -> Browser:
    """The browser."""
    return playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(FLAGS))


@pytest.fixture(scope="module", name="browser")
def browser_fixture() -> Iterator[Browser]:
    """A browser for all tests of a module that imports this."""
    with playwright_behind() as playwright:
        started = launch(playwright)
        yield started
        started.close()


def open_page(
    context: Browser | BrowserContext, url: str, width: int = 1000, height: int = 700, sharp: float = 0.5
) -> Page:
    """A page at `url`, once it is connected and has drawn the scene. `sharp`: its pixels to one of the page."""
    size: Any = {"width": width, "height": height}
    page = context.new_page(viewport=size) if isinstance(context, Browser) else context.new_page()
    page.set_viewport_size(size)
    page.set_default_timeout(1e3 * PATIENCE)
    page.goto(url + ("&" if "?" in url else "?") + f"fixedDpr={sharp:g}")
    page.get_by_text("EMERGENCY STOP").wait_for()
    page.get_by_text("browser", exact=False).first.wait_for()
    page.wait_for_function("window.__viserTestpoints && window.__viserTestpoints.rendererInfo.render.frame > 3")
    return page


@contextmanager
def browser_page(
    url: str, width: int = 1000, height: int = 700, sharp: float = 0.5, niceness: int = BEHIND
) -> Iterator[Page]:
    """A page at `url` in a browser of its own, for the time of a block; as `open_page` and `playwright_behind`."""
    with playwright_behind(niceness) as playwright:
        browser = launch(playwright)
        try:
            yield open_page(browser, url, width, height, sharp)
        finally:
            browser.close()


def electrode_on_page(page: Page, served: Served, electrode: int, browser: int = 0) -> tuple[float, float]:
    """Where the middle of an electrode lies on the page [px]. `browser`: the page's number, from 0, as they came."""
    clients = served.page.browsers()
    box = page.locator(CANVAS).bounding_box()
    assert box is not None
    camera, shape = clients[browser].camera, box["width"] / box["height"]
    # The page tells its camera now and then: until it has, the panels may have come to stand where it still sees. And
    # it looks from elsewhere a little later.
    until(lambda: abs(camera.aspect - shape) < 0.01 * shape, PATIENCE, page)
    until(lambda: _is_at_rest(page, served, browser), PATIENCE, page)
    across, down = served.page.places(clients[browser])[:, electrode]
    place = box["x"] + float(across) * box["width"], box["y"] + float(down) * box["height"]
    assert 0.0 < across < 1.0, f"electrode {electrode} is not in the picture"
    assert 0.0 < down < 1.0, f"electrode {electrode} is not in the picture"
    return place


def _is_at_rest(page: Page, served: Served, browser: int) -> bool:
    """Whether a browser shows the electrodes from where it was told to, or its user wants, and goes on to do so."""
    before = served.page.places(served.page.browsers()[browser])
    page.wait_for_timeout(300)
    after = served.page.places(served.page.browsers()[browser])
    return served.page._gaze.is_settled(browser) and np.allclose(before, after, atol=1e-3)


def click_electrode(page: Page, served: Served, electrode: int, browser: int = 0) -> None:
    """Click on an electrode in the scene, beside its label."""
    x, y = electrode_on_page(page, served, electrode, browser)
    page.mouse.move(x - 1.0, y)
    page.wait_for_timeout(50)
    page.mouse.move(x, y)
    page.mouse.down()
    page.wait_for_timeout(30)
    page.mouse.up()


def press(page: Page, label: str) -> None:
    """Press the button with this label."""
    page.get_by_role("button", name=label, exact=True).click()


def field(page: Page, label: str) -> Locator:
    """What stands beside a label. Not every one is tied to it."""
    return page.locator(f'xpath=//label[normalize-space(.)="{label}"]/ancestor::div[.//input][1]//input').first


def choose(page: Page, label: str, option: str) -> None:
    """Choose one of the options beside a label."""
    field(page, label).click()
    page.get_by_role("option", name=option, exact=True).click()


def write(page: Page, label: str, text: str) -> None:
    """Write this into the field beside a label."""
    field(page, label).fill(text)
    page.wait_for_timeout(150)


def picture(url: str, path: Path, width: int = 1400, height: int = 900, wait: float = 8.0, start: bool = False) -> Path:
    """Write what is seen at `url` to `path` (.png), `wait` seconds after it was opened, or was told to `start`."""
    with browser_page(url, width, height, sharp=1.0) as page:
        close = page.locator(".mantine-Notification-closeButton")
        page.wait_for_timeout(6000.0)
        for _ in range(close.count()):
            close.first.dispatch_event("click")
        if start:
            page.get_by_role("button", name="start", exact=True).click()
        page.wait_for_timeout(1e3 * wait)
        page.screenshot(path=path)
    return path
