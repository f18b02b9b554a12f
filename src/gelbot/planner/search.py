"""The search: CMA-ES over what may be chosen, a generation at a time, each kept on disk.

The optimiser (Hansen's CMA-ES, of the library `cmaes`) is asked for candidates and told what they are worth. Both are
written down, so that a search that was stopped is brought back to where it was by telling it everything again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray

from gelbot.errors import GelbotError
from gelbot.planner.objective import Score, from_plain, plain, score, total
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded
from gelbot.scenario.ranges import Spread

SIGMA = 0.25
"""How far the first generation lies around its start, as a share of the ranges."""


class Candidate(NamedTuple):
    """Shares in [0, 1] of the ranges, the values that they stand for, and its scores, one for each robot."""

    shares: NDArray[np.float64]
    changes: dict[str, Any]
    scores: list[Score]

    @property
    def worth(self) -> float:
        return total(self.scores)


def values_of(choices: Sequence[Spread], shares: NDArray[np.float64]) -> dict[str, Any]:
    """The values of all choices for shares in [0, 1], one after the other."""
    values, at = {}, 0
    for one in choices:
        values[one.key] = one.value(shares[at : at + one.size])
        at += one.size
    return values


OnScores = Callable[[int], None]
"""Is told how many more runs are done."""


class Search(NamedTuple):
    """What a search is made of: the scenario, what may be chosen, the robots that scatter, seed and population.

    It begins at the shares `start`, None: at the scenario's own programme.
    """

    loaded: Loaded
    choices: tuple[Spread, ...]
    robots: tuple[dict[str, Any], ...]
    seed: int
    population: int | None
    start: NDArray[np.float64] | None = None

    @property
    def first(self) -> NDArray[np.float64]:
        """Where it begins: its start, or what of the scenario's own programme lies within the ranges."""
        return np.concatenate([one.shares() for one in self.choices]) if self.start is None else self.start

    @property
    def dimension(self) -> int:
        return sum(one.size for one in self.choices)


def optimiser(search: Search) -> CMA:
    """A new optimiser, whose first mean is where the search begins."""
    # With its mean on a bound, half of the candidates would be moved back onto it.
    mean = np.clip(search.first, 0.05, 0.95)
    bounds = np.tile([[0.0, 1.0]], (search.dimension, 1))
    return CMA(mean=mean, sigma=SIGMA, bounds=bounds, seed=search.seed, population_size=search.population)


def generations(
    search: Search, folder: Path, count: int, executor: Executor, on_scores: OnScores
) -> Iterator[list[Candidate]]:
    """`count` generations of candidates with their scores; those that stand in `folder` already are told again.

    Raises `GelbotError` when what stands there was not asked for by this search.
    """
    cma = optimiser(search)
    for number in range(count):
        asked = [cma.ask() for _ in range(cma.population_size)]
        if number == 0 and search.start is not None:
            asked[0] = search.start  # which the optimiser's own mean keeps off the bounds
        file = folder / f"{number:04d}.json"
        if file.exists():
            rows = json.loads(file.read_text(encoding="utf-8"))
            if not np.allclose([row["shares"] for row in rows], asked, rtol=0.0, atol=1e-12):
                raise GelbotError(f"{file} is of another search. Try: another --out folder")
            scores = [from_plain(row["scores"]) for row in rows]
            on_scores(sum(map(len, scores)))
        else:
            scores = _scored(search, asked, executor, on_scores)
            rows = [
                {"shares": list(map(float, shares)), "scores": plain(found)}
                for shares, found in zip(asked, scores, strict=True)
            ]
            folder.mkdir(parents=True, exist_ok=True)
            write_text(file, json.dumps(rows))
        made = [
            Candidate(shares, values_of(search.choices, shares), found)
            for shares, found in zip(asked, scores, strict=True)
        ]
        cma.tell([(one.shares, one.worth) for one in made])
        yield made
        if cma.should_stop():
            return


def _scored(
    search: Search, asked: list[NDArray[np.float64]], executor: Executor, on_scores: OnScores
) -> list[list[Score]]:
    """All robots under all candidates."""
    futures = [
        [
            executor.submit(score, search.loaded, values_of(search.choices, shares), k, robot)
            for k, robot in enumerate(search.robots)
        ]
        for shares in asked
    ]
    try:
        scores = []
        for row in futures:
            found = []
            for future in row:
                found.append(future.result())
                on_scores(1)
            scores.append(found)
        return scores
    finally:
        for row in futures:
            for future in row:
                future.cancel()
