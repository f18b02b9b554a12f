"""The command `gelbot`, and `python -m gelbot`, where it is not on the path."""

from __future__ import annotations

import signal


def main() -> None:
    """Read the command line and do what it says."""
    # Python's own handler would show pages of what it was just importing; nothing is lost as long as nothing was
    # computed, and what computes says for itself what stops it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from gelbot.cli import app

    app()


if __name__ == "__main__":
    main()
