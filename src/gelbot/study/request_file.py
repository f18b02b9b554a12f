"""What was asked for, in a folder of its own: whoever goes on with it finds the scenario and every number there."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from gelbot import __version__
from gelbot.errors import BadInput
from gelbot.record.whole_file import write_text
from gelbot.scenario.load import Loaded, load

SCENARIO = "scenario.toml"


def write_request(file: Path, loaded: Loaded, asked: Mapping[str, Any]) -> None:
    """Write the scenario and then, into `file` beside it, what was `asked`: where that stands, all stands."""
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file.parent / SCENARIO, loaded.text)
    told = {**asked, "source": loaded.source, "gelbot": __version__}
    write_text(file, json.dumps(told, indent=2) + "\n")


def read_request(file: Path, fields: Collection[str], what: str, whole: str = "") -> tuple[Loaded, dict[str, Any]]:
    """The scenario and the `fields` that `write_request` wrote. Raises `BadInput` where there are none, or another
    gelbot's; `what` it is of is said, such as "study", and `whole` where the file is of another kind."""
    folder = str(file.parent)
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput("--resume", folder, f"the folder of a {what} ({file.name})") from error
    if not isinstance(told, dict) or not {*fields, "source", "gelbot"} <= told.keys():
        raise BadInput("--resume", folder, f"the folder of a {whole or what} ({file.name})")
    if told["gelbot"] != __version__:
        allowed = f"a {what} of gelbot {__version__}: with another one its runs would not be alike"
        raise BadInput("--resume", f"{folder}, begun with gelbot {told['gelbot']}", allowed)
    loaded = load(str(file.parent / SCENARIO))
    return Loaded(loaded.scenario, loaded.text, told["source"]), {key: told[key] for key in fields}
