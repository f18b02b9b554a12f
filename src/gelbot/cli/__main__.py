"""`python -m gelbot.cli`, where the command itself is not on the path."""

from gelbot.cli import main

main()
