"""Scenarios from their files: the ones that come with gelbot, and the user's own."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelbot.errors import NOTHING, BadInput

if TYPE_CHECKING:
    from gelbot.scenario.overrides import Change
    from gelbot.scenario.schema import Scenario

SIZE_MOST = 10_000_000
"""A file with more bytes than this is no scenario."""


@dataclass(frozen=True)
class Loaded:
    """A checked `scenario`; its exact `text` (TOML that reads as the same scenario); its `source`: a name or a path."""

    scenario: Scenario
    text: str
    source: str


def names() -> list[str]:
    """The names of the built-in scenarios, sorted."""
    entries = (files("gelbot.scenario") / "library").iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml"))


def built_in_text(name: str) -> str:
    """The text of the built-in scenario `name`; raises `BadInput` when there is none of this name."""
    if name not in names():
        near = get_close_matches(name, names(), 1)
        raise BadInput("scenario", name, "a built-in scenario: " + ", ".join(names()), "".join(near))
    return (files("gelbot.scenario") / "library" / f"{name}.toml").read_text(encoding="utf-8")


def description(name: str) -> str:
    """What the built-in scenario `name` shows, in one paragraph."""
    return " ".join(str(tomllib.loads(built_in_text(name))["description"]).split())


def load(name_or_path: str, overrides: Sequence[str] = ()) -> Loaded:
    """The built-in scenario of this name, or the one in this file, with `overrides` (key=value) applied, checked.

    The text names no other file: an outline from an SVG file stands in it as points, electrodes from a file as a list.
    Raises `BadInput` for everything that is wrong with name, file or content.
    """
    from gelbot.scenario.overrides import override_keys, with_changes, with_overrides

    text, folder = _read(name_or_path)
    data = _parsed(text, name_or_path)
    if overrides:
        text = with_overrides(text, overrides)
        data = _parsed(text, name_or_path)
    overridden = override_keys(overrides)
    scenario = checked(data, name_or_path, folder, overridden)
    changes = _without_files(scenario)
    if changes:
        text = with_changes(text, changes)
        scenario = checked(_parsed(text, name_or_path), name_or_path, folder, overridden)
    return Loaded(scenario, text, name_or_path)


def _without_files(scenario: Scenario) -> list[Change]:
    """What has to change in a scenario's text to name no file: the copy in a run folder must stand alone."""
    changes: list[Change] = []
    if getattr(scenario.body, "svg", None) is not None:
        points = [[f"{value!r} m" for value in point] for point in scenario.body.outline().points.tolist()]
        changes += [(["body", "points"], points), (["body", "svg"], NOTHING), (["body", "width"], NOTHING)]
    if scenario.electrodes.file is not None:
        from gelbot.scenario.electrode_shapes import SHAPE_KEYS

        replaced = ("file", "gap", "origin", *SHAPE_KEYS)
        changes += [(["electrodes", key], NOTHING) for key in replaced]
        changes += [(["electrodes", "layout"], "list"), (["electrodes", "places"], scenario.electrodes.as_list())]
    return changes


def _read(name_or_path: str) -> tuple[str, Path]:
    """The text, and the folder in which the files that it names lie."""
    if name_or_path in names():
        return built_in_text(name_or_path), Path()
    path = Path(name_or_path)
    kind = f"a scenario file, or a built-in scenario: {', '.join(names())}"
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_MOST + 1)
    except FileNotFoundError as error:
        near = get_close_matches(name_or_path, names(), 1)
        raise BadInput("scenario", name_or_path, f"{kind}; there is no such file", "".join(near)) from error
    except IsADirectoryError as error:
        raise BadInput("scenario", name_or_path, f"{kind}; this is a folder") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput("scenario", name_or_path, f"{kind} that can be read ({reason})") from error
    if len(content) > SIZE_MOST:
        raise BadInput("scenario", name_or_path, f"{kind}; this one has more than {SIZE_MOST} bytes")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n"), path.parent
    except UnicodeDecodeError as error:
        given = f"byte {error.start} that is no UTF-8"
        raise BadInput(name_or_path, given, "a scenario: TOML text in UTF-8") from error


def _parsed(text: str, source: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(source, str(error), "TOML; values with units stand in quotes", 'gap = "15 mm"') from error
    except RecursionError as error:
        raise BadInput(source, "lists within lists without end", "TOML of a scenario") from error


def checked(data: dict[str, Any], source: str, folder: Path = Path(), overridden: tuple[str, ...] = ()) -> Scenario:
    """The scenario of parsed TOML; `source` and the keys that were `overridden` are for messages. Raises `BadInput`."""
    from pydantic import ValidationError

    from gelbot.scenario.explain import explained
    from gelbot.scenario.schema import Scenario

    try:
        return Scenario.model_validate(data, context={"folder": str(folder)})
    except ValidationError as error:
        raise explained(error, source, overridden) from error
