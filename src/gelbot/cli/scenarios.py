"""`gelbot scenarios`, `gelbot show`: what comes with gelbot."""

from __future__ import annotations

from typing import Annotated

import typer

from gelbot.cli.common import app, plain_errors, print_json, print_table


@app.command()
def scenarios(as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the scenarios that come with gelbot."""
    from gelbot.scenario import description, names

    with plain_errors():
        rows = [(name, description(name)) for name in names()]
    if as_json:
        print_json([{"name": name, "description": text} for name, text in rows])
    else:
        print_table(("scenario", "what it shows"), rows)


@app.command()
def show(name: Annotated[str, typer.Argument(help="A built-in scenario.")]) -> None:
    """Print a built-in scenario as it is, to be copied and edited."""
    from gelbot.scenario import built_in_text

    with plain_errors():
        text = built_in_text(name)
    # Bytes, so that it reads again whatever encoding the terminal has.
    typer.echo(text.encode(), nl=False)
