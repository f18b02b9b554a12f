"""The robots of a study: each has its own draw of everything that scatters."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any
from zlib import crc32

import numpy as np

from gelbot.ensemble import scenario_of
from gelbot.errors import BadInput
from gelbot.scenario.load import Loaded
from gelbot.scenario.ranges import Spread, overridden, spread


def spreads(loaded: Loaded, vary: Sequence[str]) -> tuple[Spread, ...]:
    """What scatters: the scenario's own [scatter], with `vary` (key=range) in its place or beside it.

    A range that is `fixed` takes a key out. Raises `BadInput` for what cannot be read, or fits no key.
    """
    data = tomllib.loads(loaded.text)
    return tuple(spread(key, text, data, where) for key, (text, where) in _texts(loaded, vary).items())


def checked_spreads(loaded: Loaded, vary: Sequence[str]) -> tuple[Spread, ...]:
    """`spreads`, of which each fits the scenario: its middle is a value that is allowed. Raises `BadInput`.

    Not all others need be: robots that the scenario does not allow are failed runs.
    """
    found = spreads(loaded, vary)
    for one, (_, where) in zip(found, _texts(loaded, vary).values(), strict=True):
        try:
            scenario_of(loaded, {one.key: one.value(np.full(one.size, 0.5))})
        except BadInput as error:
            raise error.inside(where) from error
    return found


def _texts(loaded: Loaded, vary: Sequence[str]) -> dict[str, tuple[str, str]]:
    """The range of each key, and where it stands."""
    where = f"{loaded.source}: scatter"
    return overridden(loaded.scenario.scatter, where, "--vary", vary, 'material.p_l="+-10 %"')


def draw(scattered: Sequence[Spread], seed: int, run: int) -> dict[str, Any]:
    """What changes for number `run`. It depends on the seed, the run and each key alone: not on how many runs there
    are, nor on what else scatters."""
    if seed < 0:
        raise BadInput("--seed", seed, "0 or more")
    return {
        one.key: one.value(np.random.default_rng([seed, run, crc32(one.key.encode())]).uniform(size=one.size))
        for one in scattered
    }
