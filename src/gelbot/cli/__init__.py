"""The command line: words in, words out. What takes long to import is imported by the command that needs it."""

from __future__ import annotations

# They add themselves to the program, in the order in which it lists them.
# isort: off
from gelbot.cli import scenarios, run, field, study, plan, directions, live, calibrate  # noqa: F401
# isort: on

from gelbot.cli.common import app

__all__ = ["app"]
