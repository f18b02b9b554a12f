"""The command line: words in, words out. What takes long to import is imported by the command that needs it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from gelbot import __version__
from gelbot.errors import BadInput, GelbotError, SimulationFailed

app = typer.Typer(
    help="Simulate, control and understand robots made of electro-active polymer gel.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""


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


@app.command()
def scenarios(as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the scenarios that come with gelbot."""
    from gelbot.scenario import description, names

    with plain_errors():
        rows = [(name, description(name)) for name in names()]
    if as_json:
        _print_json([{"name": name, "description": text} for name, text in rows])
    else:
        _print_table(("scenario", "what it shows"), rows)


@app.command()
def show(name: Annotated[str, typer.Argument(help="A built-in scenario.")]) -> None:
    """Print a built-in scenario as it is, to be copied and edited."""
    from gelbot.scenario import built_in_text

    with plain_errors():
        text = built_in_text(name)
    # Bytes, so that it reads again whatever encoding the terminal has.
    typer.echo(text.encode(), nl=False)


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or a scenario file.")],
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one value, such as body.thickness='1 mm'. Repeatable."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: runs/NAME)")] = None,
    movie: Annotated[bool, typer.Option("--movie/--no-movie", help="Make the movie.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON, and nothing else.")] = False,
) -> None:
    """Simulate a scenario; numbers, plots and a movie go to the output folder."""
    with plain_errors():
        from gelbot.scenario import load

        loaded = load(scenario, changes or [])
        folder = _folder(out, "runs", loaded.scenario.name)

        from gelbot.run import run_scenario

        try:
            summary = run_scenario(loaded, folder, movie=movie, progress=not as_json)
        except SimulationFailed:
            if folder.exists():
                typer.echo(f"gelbot: what was computed is kept in {folder}", err=True)
            raise
        except KeyboardInterrupt:
            kept = f"; what was computed is kept in {folder}" if folder.exists() else ""
            typer.echo(f"gelbot: stopped{kept}", err=True)
            sys.stderr.flush()
            # All is written. The engine, stopped while it compiles, would crash when the interpreter takes it apart.
            os._exit(STOPPED)
    if as_json:
        _print_json(summary)
    else:
        from gelbot.show.table import print_summary

        print_summary(summary)
        typer.echo(f"results in {folder}")


@app.command()
def field(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or a scenario file.")],
    voltages: Annotated[
        str | None, typer.Option(help='One for each electrode, in volts or with units: "-10, 10, 0.5 V, ...".')
    ] = None,
    template: Annotated[str | None, typer.Option(help="A template of voltages, such as ridge.")] = None,
    amplitude: Annotated[
        str | None,
        typer.Option(help='What a template or a pattern is multiplied by, such as "5 V". (default: supply.limit)'),
    ] = None,
    planes: Annotated[
        list[str] | None,
        typer.Option(
            "--plane",
            metavar="AXIS=PLACE",
            help="A plane to draw, such as z=1mm. Repeatable. (default: a section and a view from above of the gel)",
        ),
    ] = None,
    points: Annotated[
        Path | None, typer.Option(help="A CSV file with columns x, y, z: the field there goes to points.csv.")
    ] = None,
    gel_conductivity: Annotated[
        str | None, typer.Option(help='The gel as a conductor of its own, such as "0.4 S/m".')
    ] = None,
    run: Annotated[
        Path | None, typer.Option(help="Take the gel's shape, and the voltages, from this run's folder.")
    ] = None,
    time: Annotated[str | None, typer.Option(help='When in the run, such as "40 s". (default: its end)')] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Change one value, such as electrodes.gap='12 mm'. Repeatable."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: fields/NAME)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print field.json, and nothing else.")] = False,
) -> None:
    """Compute the electric field of a scenario: currents, maps of potential and current density, values at points."""
    with plain_errors():
        from gelbot.scenario import load

        loaded = load(scenario, changes or [])
        folder = _folder(out, "fields", loaded.scenario.name)

        try:
            from gelbot.field_report.asked import Request
            from gelbot.field_report.report import report_field

            request = Request(voltages, template, amplitude, tuple(planes or ()), points, gel_conductivity, run, time)
            report = report_field(loaded, request, folder, progress=not as_json)
        except KeyboardInterrupt:
            kept = f"; what was computed is kept in {folder}" if (folder / "field.json").exists() else ""
            typer.echo(f"gelbot: stopped{kept}", err=True)
            sys.stderr.flush()
            os._exit(STOPPED)
    if as_json:
        from gelbot.record.json_text import as_text

        typer.echo(as_text(report), nl=False)
    else:
        from gelbot.show.field_table import print_field

        print_field(report)
        typer.echo(f"results in {folder}")


@app.command()
def directions(
    body: Annotated[str, typer.Argument(help="A built-in scenario, a scenario file, or an outline drawn in SVG.")],
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="By what share of its reach the outline may miss its image and be symmetric. (default: 0.08)"
        ),
    ] = None,
    width: Annotated[
        str | None,
        typer.Option(help='The width of a drawing, such as "15 mm". (default: its own, one unit being 1 mm)'),
    ] = None,
    solved: Annotated[
        str | None,
        typer.Option(help="Angle of the direction for which there is a programme, in deg. (default: the heading)"),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one value, such as body.arms=7. Repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the results. (default: directions/NAME)")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print directions.json, and nothing else.")] = False,
) -> None:
    """Find the directions in which a body can move, from its symmetry, and which of them one programme serves."""
    with plain_errors():
        from gelbot.directions_report.report import TOLERANCE, report_directions
        from gelbot.directions_report.subject import subject

        chosen = subject(body, width, changes or [])
        folder = _folder(out, "directions", chosen.name)
        report = report_directions(chosen, folder, TOLERANCE if tolerance is None else tolerance, solved)
    if as_json:
        from gelbot.record.json_text import as_text

        typer.echo(as_text(report), nl=False)
    else:
        from gelbot.show.directions_table import print_directions

        print_directions(report)
        typer.echo(f"results in {folder}")


def _folder(out: Path | None, base: str, name: str) -> Path:
    """Where results go: to `out`, or to a folder of `base` that is still free."""
    from gelbot.record.result_folder import checked_folder, free_folder

    return checked_folder(out) if out is not None else free_folder(Path(base), name)


def _print_json(value: object) -> None:
    typer.echo(json.dumps(value, indent=2))


def _print_table(heads: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*heads)
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    Console().print(table)


def main() -> None:
    """The command `gelbot`."""
    app()


if __name__ == "__main__":
    main()
