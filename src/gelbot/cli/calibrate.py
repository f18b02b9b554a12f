"""`gelbot calibrate`: how a camera sees the tank."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelbot.cli.common import app, plain_errors, print_json, stoppable
from gelbot.errors import BadInput


@app.command()
def calibrate(
    source: Annotated[
        str, typer.Argument(metavar="PICTURE|CAMERA|BOARD.svg", help="A picture, a camera, or a board to be printed.")
    ],
    view: Annotated[str, typer.Option(help="side or above.")] = "side",
    azimuth: Annotated[
        str, typer.Option(help="Where the camera stands, seen from the gel; from above, the lower edge of its picture.")
    ] = "0 deg",
    elevation: Annotated[str | None, typer.Option(help="How far above the horizon it stands. (default: level)")] = None,
    distance: Annotated[
        str | None, typer.Option(help='From its lens to the gel, such as "150 mm". (default: telecentric)')
    ] = None,
    board: Annotated[
        str | None, typer.Option(help="A checkerboard's inner corners, such as 9x6; --at is its lower left one.")
    ] = None,
    square: Annotated[str, typer.Option(help="The side of its squares.")] = "2 mm",
    click: Annotated[
        list[str] | None, typer.Option(metavar="X,Y", help="Two points, in pixels, that are --apart. Twice.")
    ] = None,
    apart: Annotated[str | None, typer.Option(help='How far the two are apart, such as "15 mm".')] = None,
    known: Annotated[
        str | None, typer.Option(metavar="X,Y", help="The pixel that shows the place --at. (default: the first click)")
    ] = None,
    at: Annotated[str, typer.Option(metavar="X,Y,Z", help="That place in the tank.")] = "0 mm, 0 mm, 0 mm",
    floor: Annotated[
        list[str] | None, typer.Option(metavar="X,Y", help="Two points on a level line, the left one first. Twice.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="The file to write.")] = Path("camera.toml"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the calibration as JSON, in SI units.")] = False,
) -> None:
    """Find how a camera sees the tank, from a checkerboard or two clicks; or draw the board: a name that ends in
    .svg."""
    with plain_errors():
        from gelbot.hardware.calibrating import Asked, calibrate
        from gelbot.hardware.calibration import as_table, write_checkerboard
        from gelbot.units import quantity

        if source.endswith(".svg"):
            from gelbot.hardware.calibrating import corners_of

            if Path(source).exists():
                raise BadInput("board", source, "a file that does not exist yet")
            write_checkerboard(Path(source), corners_of(board or "9x6"), quantity(square, "m", "--square"))
            typer.echo(f"{source}: print it at 100 % and measure its 10 mm")
            return
        words = tuple(click or ()), apart, known, at, tuple(floor or ())
        with stoppable():
            found = calibrate(Asked(source, view, azimuth, distance, elevation, board, square, *words), out)
    if as_json:
        print_json(as_table(found))
    else:
        lines = out.with_suffix(".png")
        typer.echo(f"{found.scale * 1e-3:.4g} pixels per mm; written to {out}, and lines to look at to {lines}")
