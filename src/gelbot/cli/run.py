"""`gelbot run`: one scenario, simulated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, folder_for, kept_in, plain_errors, print_json, stoppable
from gelbot.errors import SimulationFailed


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
        folder = folder_for(out, "runs", loaded.scenario.name)

        from gelbot.run import run_scenario

        with stoppable(kept_in(folder)):
            try:
                summary = run_scenario(loaded, folder, movie=movie, progress=not as_json)
            except SimulationFailed:
                if folder.exists():
                    typer.echo(f"gelbot: what was computed is kept in {folder}", err=True)
                raise
    if as_json:
        print_json(summary)
    else:
        from gelbot.show.table import print_summary

        print_summary(summary)
        typer.echo(f"results in {folder}")
