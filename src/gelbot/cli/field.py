"""`gelbot field`: the electric field of a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, folder_for, kept_in, plain_errors, stoppable


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
        folder = folder_for(out, "fields", loaded.scenario.name)

        from gelbot.field_report.asked import Request
        from gelbot.field_report.report import report_field

        with stoppable(kept_in(folder, "field.json")):
            request = Request(voltages, template, amplitude, tuple(planes or ()), points, gel_conductivity, run, time)
            report = report_field(loaded, request, folder, progress=not as_json)
    if as_json:
        from gelbot.record.json_text import as_text

        typer.echo(as_text(report), nl=False)
    else:
        from gelbot.show.field_table import print_field

        print_field(report)
        typer.echo(f"results in {folder}")
