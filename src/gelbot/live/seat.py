"""Who drives: one browser at a time, the others watch."""

from __future__ import annotations

import threading


class Seat:
    """The driver's seat. Browsers are known by their numbers; all methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._there: set[int] = set()
        self._driver: int | None = None
        self._free_for_all = False

    @property
    def driver(self) -> int | None:
        """The number of the browser that drives, None while the seat is free."""
        return self._driver

    def arrive(self, browser: int) -> None:
        """A browser connects; it drives if nobody does, unless the seat was handed over to those who were there."""
        with self._lock:
            self._there.add(browser)
            if self._driver is None and not self._free_for_all:
                self._driver = browser

    def leave(self, browser: int) -> bool:
        """A browser goes. Returns whether it drove; the seat is free then.

        Where it was handed over and nobody took it, the last one who goes counts as the driver.
        """
        with self._lock:
            was_there, was_for_all = browser in self._there, self._free_for_all
            self._there.discard(browser)
            if not self._there:
                self._free_for_all = False
            if self._driver != browser:
                return was_there and was_for_all and not self._there
            self._driver = None
            return True

    def hand_over(self, browser: int) -> bool:
        """The driver gets up; whoever takes over first drives. Returns whether `browser` was the driver."""
        with self._lock:
            if self._driver != browser:
                return False
            self._driver, self._free_for_all = None, True
            return True

    def take_over(self, browser: int) -> bool:
        """Take the seat if it is free. Returns whether `browser` drives now."""
        with self._lock:
            if self._driver is None and browser in self._there:
                self._driver, self._free_for_all = browser, False
            return self._driver == browser

    def drives(self, browser: int | None) -> bool:
        """Whether this browser drives."""
        return browser is not None and self._driver == browser
