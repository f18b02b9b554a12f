"""One field from a scenario to a folder of results: numbers, a data set, pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from rich.console import Console

from gelbot.engine import prepare_engine
from gelbot.errors import BadInput
from gelbot.field.charge import FieldSolution, build_problem, error_estimate, solve
from gelbot.field.electrodes import ElectrodeArray
from gelbot.field.gel import gel_panels
from gelbot.field.gel_effect import gel_effect
from gelbot.field.images import Tank
from gelbot.field.operating_point import Limits, OperatingPoint, excesses, operating_point
from gelbot.field_report.asked import Drive, Plane, Request, drive, gel_conductivity, planes, points
from gelbot.field_report.dataset import field_dataset
from gelbot.field_report.moment import Moment, at_start, of_run
from gelbot.field_report.sampling import Sampled, field_at, on_electrode, sample, view
from gelbot.field_report.settled import idle, settled
from gelbot.field_report.words import gel_numbers, numbers
from gelbot.record.json_text import as_text
from gelbot.record.whole_file import write_text, write_through
from gelbot.scenario.build import electrode_array, field_tank
from gelbot.scenario.load import Loaded

FIELD, NUMBERS, POINTS, SCENARIO = "field.nc", "field.json", "points.csv", "scenario.toml"
"""What a field's folder holds, beside the pictures."""

Floats = NDArray[np.float64]
Say = Callable[[str], None]


class Question(NamedTuple):
    """What is asked, checked: all that can be wrong with a request is found before anything is computed."""

    array: ElectrodeArray
    tank: Tank
    moment: Moment
    drive: Drive
    planes: list[Plane]
    points: Floats | None
    gel_conductivity: float | None


def report_field(loaded: Loaded, request: Request, out: Path, progress: bool = True) -> dict[str, Any]:
    """Compute the field that `request` asks for, write everything into the folder `out`, return what field.json says.

    Raises `BadInput` before anything is written; each file appears when it is complete.
    """
    prepare_engine()
    question = checked(loaded, request)
    scenario, gel = loaded.scenario, question.gel_conductivity
    with Console(stderr=True, quiet=not progress).status("solving the field") as status:
        field = _solved(loaded, question)
        undisturbed = settled(operating_point(field, question.drive.voltages, scenario.electrodes.states))
        point = undisturbed if gel is None else _with_gel(loaded, question, gel)
        error = error_estimate(field)
        if error is not None and not np.isfinite(error):
            error = None  # one electrode alone has no conductance
        sampled, values = _sampled(question, point, status.update)
        limits = Limits(scenario.supply.limit, scenario.supply.current_limit, scenario.electrodes.bubbling)
        found = excesses(point, limits, question.moment.positions, error)
        found += idle(point)
        report = numbers(scenario, request, point, question.drive, question.moment, found, error)
        if gel is not None:
            report["gel"] = gel_numbers(gel_effect(point, undisturbed), gel)
        data = field_dataset(scenario, point, question.drive, question.moment, sampled, gel)

        out.mkdir(parents=True, exist_ok=True)
        write_through(out / FIELD, lambda draft: data.to_netcdf(draft, engine="scipy", format="NETCDF3_64BIT"))
        write_text(out / SCENARIO, loaded.text)
        if question.points is not None and values is not None:
            write_text(out / POINTS, _points_text(question.points, *values))
        try:
            _draw(data, sampled, out, status.update, report["planes"])
        finally:
            # Who stops the drawing has the numbers all the same, with the pictures that are there.
            write_text(out / NUMBERS, as_text(report))
    return report


def checked(loaded: Loaded, request: Request) -> Question:
    """What `request` means for this scenario. Raises `BadInput` for all that is wrong with it."""
    scenario = loaded.scenario
    array, walls = electrode_array(scenario), field_tank(scenario)
    if request.run is None and request.time is not None:
        raise BadInput("--time", request.time, "a time of the run that --run names")
    try:
        moment = at_start(scenario) if request.run is None else of_run(request.run, request.time, array)
    except BadInput as error:
        raise error if request.run is not None else error.inside(loaded.source) from error
    return Question(
        array,
        walls,
        moment,
        drive(request, scenario, array, moment),
        planes(request, walls, moment),
        None if request.points is None else points(request.points, walls),
        gel_conductivity(request, scenario),
    )


def _solved(loaded: Loaded, question: Question) -> FieldSolution:
    scenario = loaded.scenario
    return solve(
        build_problem(question.array, question.tank, scenario.solution.conductivity, scenario.electrodes.panels_used)
    )


def _with_gel(loaded: Loaded, question: Question, conductivity: float) -> OperatingPoint:
    """The same electrodes with the gel as a conductor of its own."""
    scenario, moment = loaded.scenario, question.moment
    sigma = scenario.solution.conductivity
    gel = gel_panels(moment.positions, moment.faces, conductivity, sigma)
    problem = build_problem(question.array, question.tank, sigma, scenario.electrodes.panels_used, gel)
    return settled(operating_point(solve(problem), question.drive.voltages, scenario.electrodes.states))


def _sampled(question: Question, point: OperatingPoint, say: Say) -> tuple[list[Sampled], tuple[Floats, Floats] | None]:
    """The field on all planes, and at the points that were asked for."""
    low, high = view(question.array, question.moment.positions, question.tank)
    sampled = []
    for plane in question.planes:
        say(f"the field on {plane}")
        sampled.append(sample(point, plane, low, high))
    if question.points is None:
        return sampled, None
    say(f"the field at {question.points.shape[1]} points")
    potential, density = field_at(point, question.points)
    # On a plate the current goes to both sides, and along its edge without bound.
    density[:, on_electrode(question.points, point.solution.problem.panels)] = np.nan
    return sampled, (potential, density)


def _points_text(places: Floats, potential: Floats, density: Floats) -> str:
    """A CSV table of the field at points, with all digits."""
    lines = ["x [m],y [m],z [m],potential [V],ix [A/m^2],iy [A/m^2],iz [A/m^2]"]
    table = np.concatenate([places, potential[None], density])
    lines += [",".join(repr(value) for value in row) for row in table.T.tolist()]
    return "\n".join(lines) + "\n"


def _draw(data: xr.Dataset, sampled: list[Sampled], out: Path, say: Say, drawn: list[dict[str, Any]]) -> None:
    """Pictures of all planes; `drawn` gets their files' names, plane by plane."""
    from gelbot.show.field_map import draw_plane

    for k, plane in enumerate(s.plane for s in sampled):
        say(f"drawing {plane}")
        name = f"plane-{'xyz'[plane.axis]}{plane.value * 1e3:g}mm"
        files = draw_plane(data, k, [out / f"{name}.png", out / f"{name}.pdf"])
        drawn.append({"plane": str(plane), "pictures": [file.name for file in files]})
