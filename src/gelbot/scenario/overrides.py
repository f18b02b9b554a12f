"""Changing single values of a scenario's text, with its comments kept."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import tomlkit

from gelbot.errors import BadInput, Nothing

Change = tuple[list[str], object]
"""A path of keys, with numbers for the places in a list, and the value to put there; NOTHING removes it."""


def with_overrides(text: str, overrides: Sequence[str]) -> str:
    """`text` (valid TOML) with each of `overrides`, written key=value, applied in turn.

    A key is a dotted path, with numbers for the places in a list. A value is TOML; what is not, is a text.
    Raises `BadInput` for an override that cannot be read or whose path leads nowhere.
    """
    return with_changes(text, [_change(override) for override in overrides])


def override_keys(overrides: Sequence[str]) -> tuple[str, ...]:
    """The dotted keys of `overrides`."""
    return tuple(".".join(_change(override)[0]) for override in overrides)


def with_changes(text: str, changes: Sequence[Change]) -> str:
    """`text` (valid TOML) with `changes` made in turn; raises `BadInput` for a path that leads nowhere."""
    plain = tomllib.loads(text)
    for path, value in changes:
        put(plain, path, deepcopy(value))
    try:
        document = tomlkit.parse(text)
        for path, value in changes:
            put(document, path, deepcopy(value))
        changed = tomlkit.dumps(document)
        if tomllib.loads(changed) == plain:
            return changed
    except Exception:  # tomlkit's documents take changes that they cannot write
        pass
    # Without its comments the text is always right.
    return tomlkit.dumps(plain)


def _change(override: str) -> Change:
    key, equals, value = override.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not equals or not all(path):
        raise BadInput("--set", override, 'key=value, such as body.thickness="1 mm"')
    value = value.strip()
    try:
        read = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        if value[:1] in ("[", "{", '"', "'"):
            raise BadInput("--set", override, f"a TOML value after the sign = ({error})") from error
        return path, value
    # A line break in the value could smuggle in a second key.
    return path, read["value"] if len(read) == 1 else value


def put(document: Any, path: list[str], value: object) -> None:
    """Set the value at `path` of parsed TOML, in place; raises `BadInput` for a path that leads nowhere."""
    table = document
    for part in path[:-1]:
        if isinstance(table, dict) and part not in table:
            table[part] = {}
        table = table[_place(table, part, path)]
    place = _place(table, path[-1], path)
    if isinstance(value, Nothing):
        table.pop(place, None)
    else:
        table[place] = value


def _place(table: Any, part: str, path: list[str]) -> Any:
    """The key `part` of a table, or the number `part` of a place in a list."""
    if isinstance(table, dict):
        return part
    if not isinstance(table, list):
        raise BadInput("--set", ".".join(path), f"a key that leads through tables and lists: {part} is below a value")
    if not part.isascii() or not part.isdigit() or int(part) >= len(table):
        raise BadInput("--set", ".".join(path), f"a number from 0 to {len(table) - 1} in place of {part}")
    return int(part)
