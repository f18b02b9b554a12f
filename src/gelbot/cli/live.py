"""`gelbot live`: the bench, or a simulated one, in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, plain_errors, stoppable


@app.command()
def live(
    scenario: Annotated[
        str | None,
        typer.Argument(help="A built-in scenario or a scenario file. (default: turn-over)"),
    ] = None,
    plant: Annotated[
        str,
        typer.Option(
            metavar="simulated|bench|FILE", help="What is controlled: a simulated gel, a real one, a recording."
        ),
    ] = "simulated",
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change one value of the scenario. Repeatable."),
    ] = None,
    real: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="How the simulated gel differs from its model: material.p_ele='0.017 cm^2/mA'. Repeatable.",
        ),
    ] = None,
    controller: Annotated[
        str | None, typer.Option(help='Who drives at first: "by hand", programme, servo, planned or predictive.')
    ] = None,
    pace: Annotated[
        str, typer.Option(help="Simulated seconds to one of the wall clock, or fast: as fast as it goes.")
    ] = "1",
    seed: Annotated[int, typer.Option(help="The same seed gives the same noise of a simulated camera.")] = 1,
    host: Annotated[
        str, typer.Option(help="The address to listen on; any but this machine's own needs a token.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port of the page; 0: any that is free.")] = 8080,
    token: Annotated[
        str | None, typer.Option(help="What a browser must know to be let in. (default: made up where one is needed)")
    ] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
    start: Annotated[bool, typer.Option("--start", help="Start at once, without waiting for the page.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for logs and recordings. (default: live/NAME)")
    ] = None,
) -> None:
    """Drive a gel from the browser, with the simulator beside it; Ctrl-C ends it, the space bar stops it."""
    with plain_errors():
        from gelbot.live.command import Asked, live_bench

        asked = Asked(
            scenario=scenario,
            plant=plant,
            changes=tuple(changes or ()),
            real=tuple(real or ()),
            controller=controller,
            pace=pace,
            seed=seed,
            host=host,
            port=port,
            token=token,
            browser=browser,
            start=start,
            out=out,
        )
        # What is stopped while it is built has nothing to keep.
        with stoppable():
            live_bench(asked, typer.echo)
