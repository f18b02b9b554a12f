"""`gelbot plan`: a search for voltages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import UNMET, app, folder_for, plain_errors, print_json, stoppable
from gelbot.errors import BadInput


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
            folder = folder_for(out, "plans", loaded.scenario.name)
            asked = Asked(tuple(choose or ()), tuple(vary or ()), **numbers)
        else:
            loaded = asked = None
            if scenario is not None or changes or vary or choose or programme or out or numbers:
                raise BadInput("--resume", str(resume), "alone: what was asked for stands in the folder")
        with stoppable(lambda: f". gelbot plan --resume {folder} goes on"):
            found = seek(folder, loaded, asked, progress=not as_json)
    if as_json:
        print_json(found)
    else:
        typer.echo(f"results in {folder}")
    if not found["met"]:
        raise typer.Exit(UNMET)
