"""What a driver's exception says, short enough for a message of ours."""

from __future__ import annotations


def first_line(error: Exception) -> str:
    """The first line of the text of `error`, or what kind it is where it has none."""
    return (str(error).strip() or type(error).__name__).partition("\n")[0]
