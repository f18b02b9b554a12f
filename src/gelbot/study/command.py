"""`gelbot study`: one or several controllers on the same robots, with a progress bar and a table."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import TextColumn

from gelbot.controllers.choice import CONTROLLERS
from gelbot.errors import BadInput
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.show.progress import RUNS_OF, runs_bar
from gelbot.show.study_table import print_comparison, print_study
from gelbot.study.campaign import REQUEST, Request, asked_in, begin_study, cluster, prepare_study, run_study
from gelbot.study.compare import compare
from gelbot.study.report import Report

COMPARISON = "comparison.json"


class Asked(NamedTuple):
    """A study as it was asked for on the command line."""

    loaded: Loaded
    runs: int
    seed: int
    vary: tuple[str, ...]
    controllers: tuple[str, ...]
    programme: Path | None
    direction: str | None = None


def conduct(folder: Path, asked: Asked | None, scheduler: str | None, progress: bool) -> dict[str, Any]:
    """Begin the study in `folder`, or go on with it where nothing is `asked`; print it, and return what --json prints.

    One controller has the folder to itself. Several have a folder each in it, and what sets them apart is written to
    comparison.json.
    """
    if asked is None:
        _parts(folder)
    with nullcontext() if scheduler is None else cluster(scheduler) as executor:
        if asked is not None:
            _begin(folder, asked)
        made = [_run(part, executor, progress) for part in _parts(folder)]
    if len(made) == 1:
        if progress:
            print_study(made[0].study)
        return made[0].study
    comparison = compare(made)
    write_text(folder / COMPARISON, json.dumps(comparison, indent=2) + "\n")
    if progress:
        print_comparison(comparison)
    return comparison


def _begin(folder: Path, asked: Asked) -> None:
    several = len(asked.controllers) > 1
    if len(set(asked.controllers)) < len(asked.controllers):
        raise BadInput("--controller", " ".join(asked.controllers), "each once")
    for controller in asked.controllers:
        if controller not in CONTROLLERS:
            raise BadInput("--controller", controller, "one of " + ", ".join(CONTROLLERS))
    requests = [Request(asked.runs, asked.seed, asked.vary, controller) for controller in asked.controllers]
    prepared = [prepare_study(asked.loaded, request, asked.programme, asked.direction) for request in requests]
    for loaded, request in zip(prepared, requests, strict=True):
        begin_study(loaded, request, folder / request.controller if several else folder)
    if several:
        write_text(folder / REQUEST, json.dumps({"controllers": asked.controllers}, indent=2) + "\n")


def _parts(folder: Path) -> list[Path]:
    """The folder of each controller's study: the folder itself where there is one."""
    try:
        asked = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput("--resume", str(folder), "the folder of a study (request.json)") from error
    several = asked.get("controllers") if isinstance(asked, dict) else None
    return [folder / name for name in several] if several else [folder]


def _run(folder: Path, executor: Any, progress: bool) -> Report:
    """One controller's study, with a bar that says how many have worked so far."""
    console = Console(stderr=True)
    _, asked = asked_in(folder)
    counted, met_so_far = TextColumn(RUNS_OF), TextColumn("[bold]{task.fields[met]} met")
    bar = runs_bar(console, progress, TextColumn("{task.description}"), counted, met_so_far)
    with bar:
        task = bar.add_task(asked.controller, total=asked.runs, met=0)
        met = 0

        def tell(rows: list[dict[str, Any]]) -> None:
            nonlocal met
            met += sum(row["met"] for row in rows)
            bar.update(task, advance=len(rows), met=met)

        return run_study(folder, executor, tell)
