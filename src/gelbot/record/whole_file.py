"""Writing a file in one indivisible step: whoever opens it sees all of it, or what stood there before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


def write_text(path: Path, text: str) -> Path:
    """Put `text` at `path`."""
    return write_through(path, lambda draft: draft.write_text(text, encoding="utf-8"))


def write_through(path: Path, write: Callable[[Path], object]) -> Path:
    """Let `write` make a draft beside `path`, then put it at `path`. Nothing is left behind when `write` fails."""
    draft = path.with_name(f".{path.name}.new")
    try:
        write(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
