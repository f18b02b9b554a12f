"""What pydantic found, said as one `BadInput` that names file, key, value and what is allowed."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any, Literal, get_args, get_origin

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from gelbot.errors import NOTHING, BadInput
from gelbot.scenario.fields import Checked, Table
from gelbot.scenario.schema import Scenario

WORDS = {
    "model_type": "a table",
    "dict_type": "a table",
    "model_attributes_type": "a table",
    "tuple_type": "a list",
    "string_type": "a text in quotes",
    "string_pattern_mismatch": "letters, digits, dots, dashes and underlines, not starting with a dot or a dash",
    "too_short": "a list that is not empty",
}

BY_OPTION = " (with --set)"
"""After a key that was given on the command line."""


def explained(error: ValidationError, source: str, overridden: tuple[str, ...] = ()) -> BadInput:
    """The first of the errors as a `BadInput`; `source` names the file, `overridden` the keys that --set gave."""
    # A misspelt key is also a missing one: what stands in the file comes first.
    found = sorted(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    key, given, allowed, advice = _case(found[0])
    by_option = any(f"{key}.".startswith(f"{name}.") or f"{name}.".startswith(f"{key}.") for name in overridden if key)
    where = f"{source}: {key}" if key else source
    return BadInput(where + BY_OPTION if by_option else where, given, allowed, advice, len(found) - 1)


def _case(found: ErrorDetails) -> tuple[str, object, str, str]:
    """Key, value given, what is allowed, and advice."""
    place, kind, context = found["loc"], found["type"], found.get("ctx", {})
    tables, path = _walked(place)
    key, given = ".".join(path), found["input"]
    if kind == "bad_input":
        below = context["key"]
        key = ".".join(part for part in (key, below) if part)
        return key, context["given"], context["allowed"], context["advice"]
    if kind == "extra_forbidden":
        model, unknown = _table_at(place[:-1]), str(place[-1])
        known = list(model.model_fields)
        parent = ".".join(path[:-1])
        allowed = f"in [{parent}] the keys " if parent else "the keys "
        return key, given, allowed + ", ".join(known), "".join(get_close_matches(unknown, known, 1, 0.5))
    if kind == "missing":
        return key, NOTHING, "this key is required: " + _meaning(_table_at(place[:-1]).model_fields[str(place[-1])]), ""
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        tag = given.get("shape", NOTHING) if isinstance(given, dict) else NOTHING
        shapes = [shape for table in tables for shape in _choices(table.model_fields.get("shape"))]
        near = get_close_matches(tag, shapes, 1) if isinstance(tag, str) else []
        return f"{key}.shape", tag, "one of " + ", ".join(shapes), "".join(near)
    if kind == "literal_error":
        return key, given, f"one of {context['expected']}", ""
    return key, given, WORDS.get(kind, found["msg"].removeprefix("Input should be ")), ""


def _table_at(place: tuple[int | str, ...]) -> type[Table]:
    """The table that stands at `place` in a scenario."""
    return _walked(place)[0][0]


def _walked(place: tuple[int | str, ...]) -> tuple[list[type[Table]], list[str]]:
    """The kinds of table that may stand at `place` in a scenario, and the place as the file has it.

    Pydantic names the shape of a body or an obstacle in the place of an error, the file does not.
    """
    tables: list[type[Table]] = [Scenario]
    path: list[str] = []
    for part in place:
        if isinstance(part, str):
            of_this_shape = [t for t in tables if part in _choices(t.model_fields.get("shape"))]
            if of_this_shape:
                tables = of_this_shape
                continue
            tables = [
                inner for t in tables if part in t.model_fields for inner in _tables(t.model_fields[part].annotation)
            ]
        path.append(str(part))
    return tables, path


def _tables(annotation: Any) -> list[type[Table]]:
    """All kinds of table that an annotation allows."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return [annotation]
    return [table for inner in get_args(annotation) for table in _tables(inner)]


def _meaning(field: FieldInfo) -> str:
    """What a field may hold, in words."""
    for mark in field.metadata:
        if isinstance(mark, Checked):
            return mark.allowed
    if _tables(field.annotation):
        return "a table"
    choices = _choices(field)
    return "one of " + ", ".join(repr(value) for value in choices) if choices else "a text in quotes"


def _choices(field: FieldInfo | None) -> tuple[Any, ...]:
    """The values that a field of fixed values allows."""
    if field is None or get_origin(field.annotation) is not Literal:
        return ()
    return get_args(field.annotation)
