"""The command line: words in, words out. What takes long to import is imported by the command that needs it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
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

    All is written. The engine, stopped while it compiles, would crash when the interpreter takes it apart.
    """
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"gelbot: stopped{kept()}", err=True)
        sys.stderr.flush()
        os._exit(STOPPED)


def _kept_in(folder: Path, mark: str = "") -> Callable[[], str]:
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
    programme: Annotated[
        Path | None, typer.Option(help="Play the programme of this file, such as one that gelbot plan found.")
    ] = None,
    planned: Annotated[bool, typer.Option("--planned", help="Play the programme planned for this scenario.")] = False,
    direction: Annotated[
        str | None, typer.Option(help='Play it in the direction of the body nearest to this one, such as "90 deg".')
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: runs/NAME)")] = None,
    movie: Annotated[bool, typer.Option("--movie/--no-movie", help="Make the movie.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON, and nothing else.")] = False,
) -> None:
    """Simulate a scenario; numbers, plots and a movie go to the output folder."""
    with plain_errors():
        from gelbot.scenario import load

        loaded = load(scenario, changes or [])
        if programme is not None or planned or direction is not None:
            from gelbot.controllers.choice import with_controller

            loaded = with_controller(loaded, "planned", programme, direction)
        folder = _folder(out, "runs", loaded.scenario.name)

        from gelbot.run import run_scenario

        with stoppable(_kept_in(folder)):
            try:
                summary = run_scenario(loaded, folder, movie=movie, progress=not as_json)
            except SimulationFailed:
                if folder.exists():
                    typer.echo(f"gelbot: what was computed is kept in {folder}", err=True)
                raise
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

        with stoppable(_kept_in(folder, "field.json")):
            from gelbot.field_report.asked import Request
            from gelbot.field_report.report import report_field

            request = Request(voltages, template, amplitude, tuple(planes or ()), points, gel_conductivity, run, time)
            report = report_field(loaded, request, folder, progress=not as_json)
    if as_json:
        from gelbot.record.json_text import as_text

        typer.echo(as_text(report), nl=False)
    else:
        from gelbot.show.field_table import print_field

        print_field(report)
        typer.echo(f"results in {folder}")


@app.command()
def study(
    scenario: Annotated[str | None, typer.Argument(help="A built-in scenario or a scenario file.")] = None,
    runs: Annotated[int | None, typer.Option("-n", "--runs", help="How many runs. (default: 100)")] = None,
    seed: Annotated[
        int | None, typer.Option(help="The same seed gives the same robots, whatever the controller. (default: 1)")
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=RANGE",
            help="What scatters, beside the scenario's own [scatter]: material.p_l='+-10 %', "
            "body.thickness='0.9 mm .. 1.1 mm', 'normal 5 %', '4 mm | 5 mm'; fixed takes a key out. Repeatable.",
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(
            help="template, servo, planned or predictive; several are compared on the same robots. (default: servo)"
        ),
    ] = None,
    programme: Annotated[Path | None, typer.Option(help="The programme file of --controller planned.")] = None,
    direction: Annotated[
        str | None,
        typer.Option(help='Of --controller planned: the body\'s direction nearest to this, such as "90 deg".'),
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value. Repeatable.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Send the runs to this dask.distributed scheduler.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: studies/NAME)")] = None,
    resume: Annotated[Path | None, typer.Option(metavar="DIR", help="Go on with a study that was stopped.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print study.json, and nothing else.")] = False,
) -> None:
    """Run a scenario many times, with what is never known exactly scattered, and count how often it works."""
    with plain_errors():
        from gelbot.study.command import Asked, conduct

        folder = resume
        if folder is None:
            if scenario is None:
                raise BadInput("scenario", "nothing", "a scenario, or --resume with the folder of a study", "turn-over")
            from gelbot.scenario import load

            loaded = load(scenario, changes or [])
            folder = _folder(out, "studies", loaded.scenario.name)
            asked = Asked(
                loaded,
                100 if runs is None else runs,
                1 if seed is None else seed,
                tuple(vary or ()),
                tuple(controller or ("servo" if direction is None else "planned",)),
                programme,
                direction,
            )
        else:
            asked = None
            given = (scenario, runs, seed, changes or None, vary or None, controller or None, programme, direction, out)
            if any(one is not None for one in given):
                raise BadInput("--resume", str(resume), "alone: what was asked for stands in the folder")
        with stoppable(lambda: f". gelbot study --resume {folder} goes on"):
            made = conduct(folder, asked, scheduler, progress=not as_json)
    if as_json:
        _print_json(made)
    else:
        typer.echo(f"results in {folder}")


@app.command("map")
def map_(
    scenario: Annotated[str, typer.Argument(help="A built-in scenario or a scenario file.")],
    x: Annotated[str, typer.Option(metavar="KEY=LOW..HIGH", help="What changes from left to right.")],
    y: Annotated[str, typer.Option(metavar="KEY=LOW..HIGH", help="What changes from bottom to top.")],
    columns: Annotated[int, typer.Option(help="Values of x.")] = 20,
    rows: Annotated[int, typer.Option(help="Values of y.")] = 12,
    controller: Annotated[str, typer.Option(help="template, servo, planned or predictive.")] = "servo",
    programme: Annotated[Path | None, typer.Option(help="The programme file of --controller planned.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value. Repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: maps/NAME)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print map.json, and nothing else.")] = False,
) -> None:
    """Run a scenario over a grid of two of its values, and draw where its motion is met."""
    with plain_errors():
        from gelbot.scenario import load
        from gelbot.study.sweep import Axes, sweep

        loaded = load(scenario, changes or [])
        folder = _folder(out, "maps", loaded.scenario.name)
        with stoppable():
            made = sweep(loaded, Axes(x, y, columns, rows), controller, programme, folder, progress=not as_json)
    if as_json:
        _print_json(made)
    else:
        typer.echo(f"met at {made['met']} of {made['n']} points; results in {folder}")


@app.command()
def plan(
    scenario: Annotated[str | None, typer.Argument(help="A built-in scenario or a scenario file.")] = None,
    choose: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=RANGE",
            help="What may be chosen, beside the scenario's own [search]: programme.phases.0.drive='2 V .. 10 V'; "
            "a pattern that is a list is free on every electrode. fixed takes a key out. Repeatable.",
        ),
    ] = None,
    robots: Annotated[
        int | None,
        typer.Option(help="Robots on which each candidate is tried, the first without scatter. (default: 6)"),
    ] = None,
    generations: Annotated[int | None, typer.Option(help="Generations of candidates, at most. (default: 20)")] = None,
    rounds: Annotated[
        int | None,
        typer.Option(help="Rounds: each learns from the robots on which the one before it failed. (default: 2)"),
    ] = None,
    population: Annotated[
        int | None, typer.Option(help="Candidates of a generation. (default: from their size)")
    ] = None,
    check: Annotated[
        int | None,
        typer.Option(help="Robots, none of them used in the search, on which the best is tried. (default: 50)"),
    ] = None,
    gradients: Annotated[
        int | None,
        typer.Option(
            help="Motions to differentiate for a good beginning, where the programme goes by time alone. (default: 20)"
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed finds the same programme. (default: 1)")] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=RANGE", help="What scatters, beside the scenario's own [scatter]. Repeatable."),
    ] = None,
    programme: Annotated[Path | None, typer.Option(help="Begin with the programme of this file.")] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value. Repeatable.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the results. (default: plans/NAME)")] = None,
    resume: Annotated[Path | None, typer.Option(metavar="DIR", help="Go on with a search that was stopped.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print plan.json, and nothing else.")] = False,
) -> None:
    """Find a programme of voltages for a scenario's motion that works for all that scatters, at the least cost."""
    with plain_errors():
        from gelbot.planner.command import Asked, seek

        folder = resume
        numbers = {
            "robots": robots,
            "generations": generations,
            "rounds": rounds,
            "population": population,
            "check": check,
            "seed": seed,
            "gradients": gradients,
        }
        numbers = {key: value for key, value in numbers.items() if value is not None}
        if folder is None:
            if scenario is None:
                raise BadInput(
                    "scenario", "nothing", "a scenario, or --resume with the folder of a search", "turn-over"
                )
            from gelbot.controllers.choice import planned, with_programme
            from gelbot.scenario import load

            loaded = load(scenario, changes or [])
            if programme is not None:
                loaded = with_programme(loaded, planned(loaded, programme)["programme"])
            folder = _folder(out, "plans", loaded.scenario.name)
            asked = Asked(tuple(choose or ()), tuple(vary or ()), **numbers)
        else:
            loaded = asked = None
            if scenario is not None or changes or vary or choose or programme or out or numbers:
                raise BadInput("--resume", str(resume), "alone: what was asked for stands in the folder")
        with stoppable(lambda: f". gelbot plan --resume {folder} goes on"):
            found = seek(folder, loaded, asked, progress=not as_json)
    if as_json:
        _print_json(found)
    else:
        typer.echo(f"results in {folder}")
    if not found["met"]:
        raise typer.Exit(UNMET)


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
