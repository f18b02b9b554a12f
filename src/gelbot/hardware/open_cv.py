"""OpenCV, imported when it is needed, with one line for whoever has not installed it."""

from __future__ import annotations

import os
from functools import cache
from typing import Any

from gelbot.errors import CameraFailed


@cache
def _loaded() -> Any:
    # What cannot be opened is said by whoever wanted it, on one line.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
    import cv2

    # Of a picture this small more threads take longer, and they would take the core of the loop.
    cv2.setNumThreads(1)
    return cv2


def cv2_of(what: str) -> Any:
    """The module `cv2`. Raises `CameraFailed`, for `what` needs it, when it is not installed."""
    try:
        return _loaded()
    except ImportError as error:
        advice = 'pip install "gelbot[hardware]", or make hardware'
        raise CameraFailed(what, "OpenCV is not installed", advice) from error
