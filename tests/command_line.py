"""What the tests of commands share."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from gelbot.cli import app


def refused(*arguments: str) -> str:
    """The message of a refused command; it stands alone on the error output, and nothing was written."""
    before = sorted(Path().rglob("*"))
    result = CliRunner().invoke(app, list(arguments))
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("gelbot: ")
    assert result.stderr.count("\n") == 1
    assert sorted(Path().rglob("*")) == before
    return result.stderr
