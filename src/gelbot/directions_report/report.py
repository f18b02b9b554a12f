"""The directions of a body, from what was asked to a folder of results: numbers and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gelbot.body.symmetry import rotation, symmetry_group, symmetry_within
from gelbot.body.tips import LEAST
from gelbot.directions_report.common import common_to
from gelbot.directions_report.numbers import numbers
from gelbot.directions_report.subject import Subject, angle_of, checked_tolerance
from gelbot.engine import prepare_engine
from gelbot.errors import BadInput
from gelbot.field.outlines import outlines
from gelbot.plan.directions import check_has_directions, directions, find_tips, largest_miss
from gelbot.record.json_text import as_text
from gelbot.record.whole_file import write_text
from gelbot.show.directions_view import Sketch, draw_directions

NUMBERS, SCENARIO = "directions.json", "scenario.toml"
PICTURES = ("directions.png", "directions.pdf")
TOLERANCE = 0.08
"""Share of its reach by which a body may miss its image: a star drawn by hand is symmetric, one with an arm that is a
tenth longer is not."""
BUMP = 0.5
"""What reaches out of a drawing by less than this share of the tolerance is no tip."""


def report_directions(
    subject: Subject, out: Path, tolerance: float = TOLERANCE, solved: str | None = None
) -> dict[str, Any]:
    """Find the directions of `subject`, write everything into the folder `out`, return what directions.json says.

    `tolerance`: share of the outline's reach; `solved`: the angle of the direction whose solution is known. Raises
    `BadInput` before anything is written.
    """
    report, sketch = _found(subject, checked_tolerance(tolerance), solved)
    out.mkdir(parents=True, exist_ok=True)
    draw_directions(report, sketch, [out / name for name in PICTURES])
    if subject.loaded is not None:
        write_text(out / SCENARIO, subject.loaded.text)
    write_text(out / NUMBERS, as_text(report))
    return report


def _found(subject: Subject, tolerance: float, solved: str | None) -> tuple[dict[str, Any], Sketch]:
    if subject.loaded is None and solved is not None:
        raise BadInput("--solved", solved, "nothing beside a drawing: only a scenario has a programme")
    asked = None if solved is None else angle_of(solved)
    outline = subject.outline
    try:
        check_has_directions(outline)
    except BadInput as error:
        raise error.inside(subject.source) from error
    group = symmetry_within(outline, tolerance)
    # The tips of a scenario's body are those that its runs number; small bumps of a drawing are none.
    least = LEAST if subject.loaded is not None else max(BUMP * tolerance, LEAST)
    tips = find_tips(outline, group, least)
    found = directions(tips, group)
    if not found:
        raise BadInput(subject.source, "an outline with no tip ahead of its centre on any line", "a shape with tips")
    common = None
    if subject.loaded is not None:
        prepare_engine()
        try:
            common = common_to(subject, subject.loaded.scenario, group, found, tolerance, asked)
        except BadInput as error:
            raise (error if error.where.startswith("--") else error.inside(subject.source)) from error
    missed = largest_miss(outline, group)
    report = numbers(subject, tolerance, group, symmetry_group(outline), missed, tips, found, common)
    points = outline.points @ rotation(subject.heading).T
    electrodes = None if common is None else 1e3 * outlines(common.setting.array)
    return report, Sketch(1e3 * points, electrodes)
