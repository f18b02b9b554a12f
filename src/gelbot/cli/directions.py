"""`gelbot directions`: where a body can go."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, folder_for, plain_errors, stoppable


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
        folder = folder_for(out, "directions", chosen.name)
        with stoppable():
            report = report_directions(chosen, folder, TOLERANCE if tolerance is None else tolerance, solved)
    if as_json:
        from gelbot.record.json_text import as_text

        typer.echo(as_text(report), nl=False)
    else:
        from gelbot.show.directions_table import print_directions

        print_directions(report)
        typer.echo(f"results in {folder}")
