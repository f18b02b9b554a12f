"""What an instrument wants to hear: a profile, a small TOML file, instead of a driver. See docs/hardware.md."""

from __future__ import annotations

import re
import tomllib
from importlib import resources
from pathlib import Path
from string import Formatter
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from gelbot.errors import BadInput
from gelbot.units import quantity

Channel = Annotated[str, BeforeValidator(lambda given: str(given) if isinstance(given, int) else given)]


def _command(*fields: str) -> AfterValidator:
    """Checks a command: printable, and no placeholders but `fields`."""

    def check(command: str) -> str:
        try:
            found = [(name, format_, conversion) for _, name, format_, conversion in Formatter().parse(command)]
        except ValueError as error:
            raise ValueError(f"placeholders in braces, {error}") from error
        for name, format_, conversion in found:
            if name is not None and (name not in fields or format_ or conversion):
                raise ValueError(f"the placeholders {' '.join(f'{{{field}}}' for field in fields)} and no other")
        if not command.strip() or not command.isprintable() or not command.isascii():
            raise ValueError("printable ASCII characters")
        return command

    return AfterValidator(check)


def _pattern(pattern: str) -> str:
    try:
        re.compile(pattern)
    except re.error as error:
        raise ValueError(f"a regular expression ({error})") from error
    return pattern


def _number_format(written: str) -> str:
    try:
        float(format(-1.5, written))
    except ValueError as error:
        raise ValueError("a format of one number, such as .3f or .4e") from error
    return written


Plain = Annotated[str, _command()]
OfChannel = Annotated[str, _command("channel")]
OfVolts = Annotated[str, _command("channel", "volts")]
Pattern = Annotated[str, AfterValidator(_pattern)]


class ScpiProfile(BaseModel):
    """How to talk to one kind of instrument.

    A command with `{channel}` is sent for each of `channels`, one without is sent once. `{volts}` is the channel's
    voltage, or in a command for all, the voltages of all of them with `separator` between. With `join`, what is sent
    for each channel goes out as one message with that text between. A query with `{channel}` is answered with one
    number, one without by as many as there are channels, with commas between.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: str = Field(min_length=1)
    channels: list[Channel] = Field(min_length=1)
    lowest: str | list[str] = "0 V"
    highest: str | list[str]
    write_terminator: str = "\n"
    read_terminator: str = "\n"
    baud: int | None = Field(default=None, gt=0)
    identify: Plain = "*IDN?"
    identity: Pattern
    init: list[OfChannel] = []
    output_on: list[OfChannel] = []
    set: OfVolts
    join: str = ""
    separator: str = ","
    number_format: Annotated[str, AfterValidator(_number_format)] = ".3f"
    apply: Plain | None = None
    measure_volts: OfChannel | None = None
    measure_amperes: OfChannel | None = None
    error: Plain | None = "SYST:ERR?"
    no_error: Pattern = r"^\s*[+-]?0\b"
    zero: OfVolts | None = None
    output_off: list[OfChannel] = []

    @model_validator(mode="after")
    def _fits(self) -> ScpiProfile:
        if "{volts}" not in self.set:
            raise ValueError("set: a command with the placeholder {volts}")
        low, high = self.bounds()
        for channel, lowest, highest in zip(self.channels, low, high, strict=True):
            if not lowest <= 0.0 <= highest:
                raise ValueError(f"channel {channel}: a range that 0 V is in, not {lowest:g} V to {highest:g} V")
        return self

    def bounds(self) -> tuple[list[float], list[float]]:
        """The lowest and the highest voltage [V] of each channel."""
        return self._of_each("lowest", self.lowest), self._of_each("highest", self.highest)

    def _of_each(self, key: str, given: str | list[str]) -> list[float]:
        texts = [given] * len(self.channels) if isinstance(given, str) else given
        if len(texts) != len(self.channels):
            raise BadInput(key, given, f"one voltage, or {len(self.channels)} for the channels")
        return [quantity(text, "V", key) for text in texts]

    def messages(self, command: str, volts: list[float] | None = None) -> list[str]:
        """What to send for `command`, `volts` [V] being those of all channels."""
        shown = [format(value, self.number_format) for value in volts or []]
        if "{channel}" not in command:
            return [command.format(volts=self.separator.join(shown))]
        each = [
            command.format(channel=channel, volts=shown[index] if shown else "")
            for index, channel in enumerate(self.channels)
        ]
        return [self.join.join(each)] if self.join and "?" not in command else each


def profile_names() -> list[str]:
    """The profiles that come with gelbot."""
    folder = resources.files("gelbot.hardware").joinpath("profiles")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def profile_text(name: str) -> str:
    """The file of a profile that comes with gelbot, as it stands. Raises `BadInput` for another name."""
    if name not in profile_names():
        allowed = f"{', '.join(profile_names())}, or a file"
        raise BadInput("profile", name, allowed)
    return resources.files("gelbot.hardware").joinpath("profiles", f"{name}.toml").read_text(encoding="utf-8")


def load_profile(profile: str | Path) -> ScpiProfile:
    """The profile of this name, or in this file (a path that ends in .toml). Raises `BadInput`, with its place."""
    path = Path(profile)
    if path.suffix != ".toml":
        return _checked(profile_text(str(profile)), f"profile {profile}")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise BadInput(
            "profile", str(path), f"a file that can be read; built-in are {', '.join(profile_names())}"
        ) from error
    return _checked(text, path.name)


def _checked(text: str, where: str) -> ScpiProfile:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise BadInput(where, str(error), "a TOML file") from error
    try:
        return ScpiProfile.model_validate(table)
    except BadInput as error:
        raise error.inside(where) from error
    except ValidationError as error:
        raise _explained(error, where) from error


def _explained(error: ValidationError, where: str) -> BadInput:
    """The first mistake in one line: its key, what stands there, what is allowed."""
    first: Any = error.errors()[0]
    key = ".".join(map(str, first["loc"]))
    more = error.error_count() - 1
    if first["type"] == "missing":
        return BadInput(f"{where}: {key}", "nothing", "a value: the key must be there", more=more)
    if first["type"] == "extra_forbidden":
        return BadInput(where, key, f"the keys {', '.join(ScpiProfile.model_fields)}", more=more)
    place = f"{where}: {key}" if key else where
    given = first["input"] if key else "the keys together"
    return BadInput(place, given, first["msg"].removeprefix("Value error, "), more=more)
