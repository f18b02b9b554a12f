"""Waiting for what another thread, another process or a browser does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 180.0
"""Seconds in which what must come, comes: a busy machine takes a while."""


def until(what: Callable[[], Any], patience: float = PATIENCE, page: Any = None) -> Any:
    """What `what` gives once it is true. Raises `AssertionError` when that takes longer than `patience` [s].

    With a `page` of a browser, the page goes on meanwhile: it answers what it is asked only while somebody waits for
    it.
    """
    end = time.monotonic() + patience
    while not (found := what()):
        assert time.monotonic() < end, "it did not come"
        if page is None:
            time.sleep(0.02)
        else:
            page.wait_for_timeout(20)
    return found
