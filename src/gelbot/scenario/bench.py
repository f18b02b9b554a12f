"""The tables [supply] and [camera] of a scenario: what gives the voltages, and what sees the gel."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from gelbot.errors import NOTHING
from gelbot.hardware.limits import UNCONNECTED
from gelbot.scenario.fields import Angle, Checked, Count, Dimension, Number, Table, wrong

NEEDED = {
    "serial": {"port": 'a serial port, such as "/dev/ttyACM0" or "COM3"'},
    "scpi": {
        "resource": 'a VISA address, such as "TCPIP0::192.168.1.20::INSTR"',
        "profile": "the name of a profile, or a .toml file",
    },
    "ni": {"name": 'the name of a card, such as "Dev1"'},
}
"""The keys that a kind of device must have, with what they hold."""


@dataclass(frozen=True)
class PerElectrode(Checked):
    """One value for all electrodes, or a list with one for each, as `each` says. Read as a tuple."""

    each: Checked

    @property
    def allowed(self) -> str:
        return f"{self.each.allowed}, or a list of such values, one for each electrode"

    def parse(self, given: object) -> tuple[Any, ...]:
        try:
            return tuple(self.each.parse(value) for value in (given if isinstance(given, list) and given else [given]))
        except PydanticCustomError as error:
            raise wrong("", given, self.allowed) from error


class Device(Table):
    """The device behind the supply, of one `kind`; what a kind needs stands in docs/hardware.md.

    "twin": none, a simulated one. "serial": a serial DAC at `port`, `baud`. "scpi": an instrument at the VISA
    `resource`, in the words of a `profile`, by name or file. "ni": an analogue output card, `name`. It answers within
    `timeout` [s], and puts its outputs at zero by itself where it has heard nothing for `watchdog` [s].
    """

    kind: Literal["twin", "serial", "scpi", "ni"] = "twin"
    port: str | None = None
    baud: Annotated[int, Count(ge=300, le=12_000_000)] = 115_200
    resource: str | None = None
    profile: str | None = None
    visa_library: str = ""
    name: str | None = None
    channel_count: Annotated[int, Count(ge=1, le=1024)] | None = None
    timeout: Annotated[float, Dimension("s", ge=1e-3, le=0.1)] = 0.1
    watchdog: Annotated[float, Dimension("s", ge=0.15, le=0.25)] = 0.2

    @field_validator("profile")
    @classmethod
    def _beside_the_scenario(cls, profile: str, info: ValidationInfo) -> str:
        return _beside(profile, info) if profile.endswith(".toml") else profile

    @model_validator(mode="after")
    def _has_what_it_needs(self) -> Device:
        for key, allowed in NEEDED.get(self.kind, {}).items():
            if not getattr(self, key):
                raise wrong(key, NOTHING, f'{allowed}: a supply of kind "{self.kind}" needs it')
        return self


class Supply(Table):
    """What the electrodes may get: the largest voltage `limit` [V], either way, the sum of positive currents
    `current_limit` [A], how fast a voltage may change, `slew_limit` [V/s], and the whole `charge_limit` [C].

    `channels`: the channel of each electrode, -1 where it has none, in order where the key is left out. An electrode
    has `gain` times the volts of its channel plus `offset` [V]: the amplifier, one for all or one for each electrode.
    """

    limit: Annotated[float, Dimension("V", gt=0)]
    current_limit: Annotated[float, Dimension("A", gt=0)] | None = None
    slew_limit: Annotated[float, Dimension("V/s", gt=0)] | None = None
    charge_limit: Annotated[float, Dimension("C", gt=0)] | None = None
    channels: tuple[Annotated[int, Count(ge=UNCONNECTED, le=1023)], ...] | None = None
    gain: Annotated[tuple[float, ...], PerElectrode(Number())] = (1.0,)
    offset: Annotated[tuple[float, ...], PerElectrode(Dimension("V"))] = (0.0,)
    device: Device = Device()

    @field_validator("gain")
    @classmethod
    def _amplifies(cls, gain: tuple[float, ...]) -> tuple[float, ...]:
        if 0.0 in gain:
            raise wrong("", 0.0, "a gain other than 0: such an electrode could have no voltage")
        return gain

    def check_channels(self, count: int) -> None:
        """One channel for each of `count` electrodes, none of them twice; a gain and an offset for all or for each."""
        if self.channels is not None:
            if len(self.channels) != count:
                raise wrong("supply.channels", f"{len(self.channels)} channels", f"{count}, one for each electrode")
            used = [channel for channel in self.channels if channel != UNCONNECTED]
            twice = next((channel for channel in used if used.count(channel) > 1), None)
            if twice is not None:
                raise wrong("supply.channels", f"channel {twice} twice", "each channel for one electrode")
        for key in ("gain", "offset"):
            given = len(getattr(self, key))
            if given not in (1, count):
                raise wrong(f"supply.{key}", f"{given} values", f"one value, or {count}, one for each electrode")


class Camera(Table):
    """What sees the gel: a camera at `source`, the number of a USB camera, a file, or the address of a stream.

    "rendered": a simulated gel is drawn as a camera would see it, from the "side", standing towards `azimuth` [rad]
    from the gel (0 is the x axis), or from "above". `calibration`: a file that says how a real one sees the tank;
    `background`: its picture of the tank without gel. Pictures are `delay` [s] old when they arrive; without one for
    `lost_after` [s] the electrodes get zero volts, and the run ends after `patience` [s]. Without a source, a simulated
    gel is seen with `position_noise` [m] on each coordinate of a point and `angle_noise` [rad] on each angle (standard
    deviations).
    """

    source: int | str | None = None
    view: Literal["side", "above"] = "side"
    azimuth: Angle | None = None
    calibration: str | None = None
    background: str | None = None
    delay: Annotated[float, Dimension("s", ge=0, le=2)] = 0.1
    lost_after: Annotated[float, Dimension("s", ge=0.05, le=0.25)] = 0.25
    patience: Annotated[float, Dimension("s", ge=0, le=3600)] = 5.0
    position_noise: Annotated[float, Dimension("m", ge=0, le=1e-2)] = 0.1e-3
    angle_noise: Annotated[float, Dimension("rad", ge=0, le=1)] = float(np.radians(2.0))

    @field_validator("source")
    @classmethod
    def _is_there(cls, source: int | str | None, info: ValidationInfo) -> int | str | None:
        if not isinstance(source, str) or source == "rendered" or "://" in source:
            return source
        for file in (_beside(source, info), source):
            if Path(file).exists():
                return file
        allowed = 'the number of a USB camera, a file that is there, the address of a stream, or "rendered"'
        raise wrong("", source, allowed, "".join(get_close_matches(source, ["rendered"], 1)))

    @field_validator("calibration", "background")
    @classmethod
    def _beside_the_scenario(cls, calibration: str, info: ValidationInfo) -> str:
        return _beside(calibration, info)


def _beside(file: str, info: ValidationInfo) -> str:
    return str(Path((info.context or {}).get("folder", "")) / file)
