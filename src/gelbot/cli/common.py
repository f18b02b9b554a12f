"""What all commands share: the program itself, its errors, where results go."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from gelbot import __version__
from gelbot.errors import BadInput, GelbotError

app = typer.Typer(
    help="Simulate, control and understand robots made of electro-active polymer gel.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""


UNMET = 3
"""Exit code of a search that found no programme for what was asked."""


@contextmanager
def plain_errors() -> Iterator[None]:
    """Say an error on one line and leave: with 2 for bad input, 1 for the rest. Other faults are not caught."""
    try:
        yield
    except GelbotError as error:
        typer.echo(f"gelbot: {error}", err=True)
        raise typer.Exit(2 if isinstance(error, BadInput) else 1) from None
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        typer.echo(f"gelbot: {place}{error.strerror or error}", err=True)
        raise typer.Exit(1) from None


@contextmanager
def stoppable(kept: Callable[[], str] = lambda: "") -> Iterator[None]:
    """Say after Ctrl-C that it stopped, and what is `kept`, and leave at once.

    All is written. The engine, stopped while it compiles, would crash when the interpreter takes it apart. What takes
    long to import is imported before: a package stopped there may take it for a fault of its own.
    """
    with _ctrl_c_raises():
        try:
            yield
        except KeyboardInterrupt as stop:
            typer.echo(f"gelbot: stopped{kept()}", err=True)
            sys.stderr.flush()
            _let_go(stop)
            os._exit(STOPPED)


def _let_go(error: BaseException | None) -> None:
    """Give back what the frames hold that an `error` came through: locks that processes share would be complained of
    behind the prompt."""
    while error is not None:
        traceback.clear_frames(error.__traceback__)
        error = error.__context__
    gc.collect()


@contextmanager
def _ctrl_c_raises() -> Iterator[None]:
    """Ctrl-C raises `KeyboardInterrupt` in here, where it would end the program at once."""
    ends = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    if ends:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        if ends:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def kept_in(folder: Path, mark: str = "") -> Callable[[], str]:
    """Where what was computed is kept, when there is something: the file `mark` in `folder`, or the folder itself."""
    return lambda: f"; what was computed is kept in {folder}" if (folder / mark).exists() else ""


def _say_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gelbot {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_say_version, is_eager=True)
    ] = False,
) -> None:
    """Simulate, control and understand robots made of electro-active polymer gel."""


def folder_for(out: Path | None, base: str, name: str) -> Path:
    """Where results go: to `out`, or to a folder of `base` that is still free."""
    from gelbot.record.result_folder import checked_folder, free_folder

    return checked_folder(out) if out is not None else free_folder(Path(base), name)


def print_json(value: object) -> None:
    typer.echo(json.dumps(value, indent=2))


def print_table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*heads)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)
