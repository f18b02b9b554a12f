"""Folders for results: each holds one run or one field, and nothing that stands there is written over."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from gelbot.errors import BadInput

MARKS = {
    "run.zarr": "a run",
    "bench.log": "a bench run",
    "summary.json": "a run",
    "field.json": "a field",
    "field.nc": "a field",
    "points.csv": "points of a field",
    "request.json": "a study",
    "asked.json": "a search for a programme",
    "map.json": "a map",
    "directions.json": "directions",
}
"""A folder that holds one of these holds results."""


def free_folder(base: Path, name: str) -> Path:
    """The folder `base`/`name`, or the first of `base`/`name`-2, -3, ... that holds no results yet."""
    folder, count = base / name, 1
    while _held(folder) is not None:
        count += 1
        folder = base / f"{name}-{count}"
    return checked_folder(folder)


def checked_folder(folder: Path) -> Path:
    """`folder`, to which results can be written; it need not exist yet. Raises `BadInput` otherwise; leaves nothing."""
    allowed = "a folder that does not exist yet, or one without results in it"
    try:
        held = _held(folder)
        if held is not None:
            raise BadInput("--out", str(folder), allowed, f"another --out: this folder holds {held} already")
        nearest = folder.absolute()
        while not _exists(nearest):
            nearest = nearest.parent
        if not nearest.is_dir():
            raise BadInput("--out", str(folder), allowed, f"another --out: {nearest} is no folder")
        _try_to_write(folder, nearest)
    except OSError as error:
        raise BadInput("--out", str(folder), f"{allowed} ({error.strerror})") from error
    return folder


def _try_to_write(folder: Path, nearest: Path) -> None:
    """Raise `BadInput` unless a folder can be made in `nearest`: rights alone do not tell, such as in /proc."""
    try:
        TemporaryDirectory(prefix=".gelbot-", dir=nearest).cleanup()
    except OSError as error:
        advice = f"another --out, outside {nearest}"
        raise BadInput("--out", str(folder), "a folder that can be written", advice) from error


def _exists(path: Path) -> bool:
    """Whether something stands at `path`, a broken link too. Raises `OSError` for names that cannot exist."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _held(folder: Path) -> str | None:
    """What `folder` holds, in words."""
    return next((what for mark, what in MARKS.items() if os.path.lexists(folder / mark)), None)
