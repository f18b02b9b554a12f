"""A study from its request to its folder: computed in batches, resumable, reported."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

from gelbot.controllers.choice import with_controller
from gelbot.ensemble import workers
from gelbot.errors import BadInput, GelbotError
from gelbot.motion.reach import check_has_motion
from gelbot.scenario.load import Loaded
from gelbot.study.batches import Task, batches, rows_of, run_batches
from gelbot.study.report import Report, report, write_report
from gelbot.study.request_file import read_request, write_request
from gelbot.study.scatter import checked_spreads, draw, spreads

REQUEST = "request.json"
BATCH = 10
"""Runs of a batch: some seconds, which is what a kill can lose."""

PATIENCE = "10s"
"""So long a scheduler may take to answer."""

OnRows = Callable[[list[dict[str, Any]]], None]
"""Is told the rows of each batch that is done."""


class Request(NamedTuple):
    """What a study was asked for, `runs` of them: all that its numbers depend on."""

    runs: int
    seed: int
    vary: tuple[str, ...]
    controller: str
    batch: int = BATCH


def prepare_study(
    loaded: Loaded, request: Request, programme: Path | None = None, direction: str | None = None
) -> Loaded:
    """The scenario of a study, with the programme of its controller. Raises `BadInput` for one that cannot be done."""
    if request.runs < 1:
        raise BadInput("-n", request.runs, "1 run or more")
    if request.batch < 1:
        raise BadInput("batch", request.batch, "1 run or more")
    check_has_motion(loaded, ": a study counts how often it does")
    draw(checked_spreads(loaded, request.vary), request.seed, 0)
    prepared = with_controller(loaded, request.controller, programme, direction)
    checked_spreads(prepared, request.vary)
    return prepared


def begin_study(prepared: Loaded, request: Request, folder: Path) -> None:
    """Write request and scenario into `folder`, from where the study can go on."""
    write_request(folder / REQUEST, prepared, request._asdict())


def asked_in(folder: Path) -> tuple[Loaded, Request]:
    """The study that was begun in `folder`. Raises `BadInput` where there is none, or another gelbot's."""
    loaded, asked = read_request(folder / REQUEST, Request._fields, "study", "study of one controller")
    return loaded, Request(**{**asked, "vary": tuple(asked["vary"])})


def run_study(folder: Path, executor: Executor | None = None, on_rows: OnRows | None = None) -> Report:
    """Compute what is missing of the study in `folder`, and report all of it.

    Batches go to `executor`, or to a process for each core. The report does not depend on where and in how many goes
    they were computed.
    """
    loaded, request = asked_in(folder)
    task = Task(loaded, request.vary, request.seed, request.controller)
    every = batches(folder, request.runs, request.batch)
    open_ones = [batch for batch in every if not batch.file.exists()]
    tell = on_rows or (lambda rows: None)
    for batch in every:
        if batch not in open_ones:
            tell(rows_of(batch))
    if open_ones:
        own = min(len(open_ones), os.cpu_count() or 1)
        with workers(own) if executor is None else nullcontext(executor) as pool:
            for rows in run_batches(task, open_ones, pool):
                tell(rows)
    rows = [row for batch in every for row in rows_of(batch)]
    scatter = {one.key: one.text for one in spreads(loaded, request.vary)}
    made = report(loaded, request.controller, request.seed, rows, scatter)
    write_report(made, folder)
    return made


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a dask.distributed scheduler at `address`, where gelbot is installed too. Raises `GelbotError`."""
    try:
        from distributed import Client, KilledWorker
        from distributed.comm.addressing import get_address_host_port
    except ImportError as error:
        raise GelbotError("--scheduler needs dask.distributed. Try: pip install 'gelbot[cluster]'") from error
    # That it lost its scheduler is said below.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    try:
        get_address_host_port(address, strict=True)
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise BadInput(
            "--scheduler", address, f"the address of a running scheduler, such as tcp://host:8786 ({error})"
        ) from error
    with client:
        try:
            yield client.get_executor()
        except (KilledWorker, CancelledError) as error:
            lost = "lost worker after worker" if isinstance(error, KilledWorker) else "is gone"
            raise GelbotError(f"the cluster at {address} {lost}. gelbot study --resume DIR goes on") from error
