"""`gelbot study`, `gelbot map`: a scenario many times."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, folder_for, plain_errors, print_json, stoppable
from gelbot.errors import BadInput


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
            folder = folder_for(out, "studies", loaded.scenario.name)
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
        print_json(made)
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
        folder = folder_for(out, "maps", loaded.scenario.name)
        with stoppable():
            made = sweep(loaded, Axes(x, y, columns, rows), controller, programme, folder, progress=not as_json)
    if as_json:
        print_json(made)
    else:
        typer.echo(f"met at {made['met']} of {made['n']} points; results in {folder}")
