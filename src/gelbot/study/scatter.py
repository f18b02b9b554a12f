"""The robots of a study: each has its own draw of everything that scatters."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any
from zlib import crc32

import numpy as np

from gelbot.errors import BadInput
from gelbot.scenario.load import Loaded
from gelbot.scenario.ranges import Spread, spread


def spreads(loaded: Loaded, vary: Sequence[str]) -> tuple[Spread, ...]:
    """What scatters: the scenario's own [scatter], with `vary` (key=range) in its place or beside it.

    A range that is `fixed` takes a key out. Raises `BadInput` for what cannot be read, or fits no key.
    """
    data = tomllib.loads(loaded.text)
    texts = {key: (text, f"{loaded.source}: scatter.{key}") for key, text in loaded.scenario.scatter.items()}
    for given in vary:
        key, equals, text = given.partition("=")
        key, text = key.strip(), text.strip().strip("\"'")
        if not equals or not key:
            raise BadInput("--vary", given, 'key=range, such as material.p_l="+-10 %"')
        if text == "fixed":
            texts.pop(key, None)
        else:
            texts[key] = (text, f"--vary {key}")
    return tuple(spread(key, text, data, where) for key, (text, where) in texts.items())


def draw(scattered: Sequence[Spread], seed: int, run: int) -> dict[str, Any]:
    """What changes for number `run`. It depends on the seed, the run and each key alone: not on how many runs there
    are, nor on what else scatters."""
    return {
        one.key: one.value(np.random.default_rng([seed, run, crc32(one.key.encode())]).uniform(size=one.size))
        for one in scattered
    }
