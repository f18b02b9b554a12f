"""Run the checks named on the command line, and see to it that each of them looked at something.

    python tools/check.py lint      style, types, layers
    python tools/check.py quick     the tests that take seconds
    python tools/check.py tests     all tests

A linter pointed at a folder that does not exist is content, and so is a run without a test. So the files are counted
first, and a check that saw fewer of them fails.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
PROGRAMS = Path(sys.executable).parent


class Seen(NamedTuple):
    """How the output of a check tells what it saw: numbers or lines that match `pattern`; `least` of `what` will do."""

    pattern: str
    least: int
    what: str

    def total(self, output: str) -> int:
        """The sum of what matches: a number counts as itself, anything else as one."""
        return sum(int(found) if found.isdigit() else 1 for found in re.findall(self.pattern, output, re.MULTILINE))


class Check(NamedTuple):
    """A command and what it must have seen; it is shown while it runs when it is `live`, else only when it fails."""

    command: str
    seen: tuple[Seen, ...]
    live: bool = False


def count(*folders: str, name: str = "*.py") -> int:
    """Files of this name below `folders`, one at least: to look at nothing is to fail."""
    return max(1, sum(len(list((ROOT / folder).rglob(name))) for folder in folders))


FOLDERS = ("src", "tests", "tools", "examples", "benchmarks")
ALL_FILES = Seen(r"\.py$", count(*FOLDERS), "files")
# Half of the files each, for what a file compiles serves all of it; who is done first takes over from the other.
TWO_CORES = "pytest -n 2 --dist worksteal"
PASSED = Seen(r"(\d+) passed", count("tests", name="test_*.py"), "tests")
# What measures real time would measure the other half of the tests too.
SOME_PASSED = PASSED._replace(least=10)

CHECKS = {
    "lint": (
        Check(f"ruff check --show-files {' '.join(FOLDERS)}", (ALL_FILES,)),
        Check(f"ruff check {' '.join(FOLDERS)}", (Seen("All checks passed", 1, "verdict on these files"),)),
        Check(
            f"ruff format --check {' '.join(FOLDERS)}",
            (ALL_FILES._replace(pattern=r"(\d+) files? already formatted"),),
        ),
        Check("basedpyright --stats", (ALL_FILES._replace(pattern=r"Total files checked: (\d+)"),)),
        Check(
            "lint-imports --no-cache --no-logo",
            (
                Seen(r"Analyzed (\d+) files", count("src"), "files"),
                Seen(r"Contracts: (\d+) kept", 1, "contracts"),
            ),
        ),
    ),
    "quick": (
        Check(f"{TWO_CORES} -m 'not slow and not realtime'", (PASSED,), live=True),
        Check("pytest -m 'realtime and not slow'", (SOME_PASSED,), live=True),
    ),
    "tests": (
        Check(f"{TWO_CORES} -m 'not realtime'", (PASSED,), live=True),
        Check("pytest -m realtime", (SOME_PASSED,), live=True),
    ),
}


def main(names: list[str]) -> int:
    if not names or not set(names) <= set(CHECKS):
        print(f"name at least one of: {', '.join(CHECKS)}")
        return 2
    failures = [failure for name in names for check in CHECKS[name] for failure in run(check)]
    for failure in failures:
        print(f"FAILED {failure}")
    return 1 if failures else 0


def run(check: Check) -> list[str]:
    """Run one check, print its line, and return what is wrong, nothing as a rule."""
    program, *arguments = shlex.split(check.command)
    if check.live:
        print(f"-- {check.command}", flush=True)
    output = ""
    with subprocess.Popen(
        [PROGRAMS / program, *arguments], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        for line in process.stdout or ():
            output += line
            if check.live:
                print(line, end="", flush=True)
    failures = [
        f"{check.command}: looked at {seen.total(output)} {seen.what}, expected {seen.least} at least"
        for seen in check.seen
        if seen.total(output) < seen.least
    ]
    if process.returncode:  # then the counts tell nothing
        failures = [f"{check.command}: exit code {process.returncode}"]
    if not check.live:
        saw = ", ".join(f"{seen.total(output)} {seen.what}" for seen in check.seen)
        print(output if failures else f"ok {check.command}: {saw}", flush=True)
    return failures


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
