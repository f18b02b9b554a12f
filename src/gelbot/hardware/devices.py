"""From settings to a supply: whichever kind it is, what comes out is the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from numpy.typing import ArrayLike

from gelbot.clock import Clock
from gelbot.errors import BadInput
from gelbot.hardware.supply import Supply

Kind = Literal["twin", "serial", "scpi", "ni"]


@dataclass(frozen=True)
class SupplySettings:
    """Which supply, and what it needs; "" and None stand for what is not given.

    | kind | needs | takes |
    |---|---|---|
    | twin | | `channel_count`, `lowest`, `highest`, `watchdog` |
    | serial | `port` | `baud`, `channel_count`, `timeout`, `watchdog` |
    | scpi | `resource`, `profile` | `visa_library`, `channel_count`, `timeout` |
    | ni | `device` | `channels` or `channel_count`, `lowest`, `highest`, `timeout`, `watchdog` |

    `watchdog` [s] is how soon the device itself shall go to zero when no voltages come; a device that cannot is
    refused. None: do without. SCPI instruments have none, whatever is asked. `timeout` [s] is the longest that a method
    may take: 0.1, of a SCPI instrument 1. `lowest` and `highest` [V] are the range of a twin or a card; other devices
    know theirs.
    """

    kind: Kind = "twin"
    port: str = ""
    baud: int = 115200
    resource: str = ""
    profile: str = ""
    visa_library: str = ""
    device: str = ""
    channels: str = ""
    channel_count: int | None = None
    lowest: float = -10.0
    highest: float = 10.0
    timeout: float | None = None
    watchdog: float | None = 0.2


def open_supply(
    settings: SupplySettings, *, clock: Clock | None = None, conductance: ArrayLike | None = None
) -> Supply:
    """The supply of these `settings`, at zero volts.

    A twin lives by `clock` and measures with `conductance` [S], shape (c, c); other devices have their own.
    Raises `BadInput` for settings that are missing or cannot work, `SupplyFailed` for a device that does not.
    """
    if settings.kind == "twin":
        from gelbot.hardware.soft_supply import SoftSupply

        count = 16 if settings.channel_count is None else settings.channel_count
        return SoftSupply(
            count,
            clock=clock,
            watchdog=settings.watchdog,
            lowest=settings.lowest,
            highest=settings.highest,
            conductance=conductance,
        )
    if settings.kind == "serial":
        from gelbot.hardware.serial_supply import SerialSupply

        port = _needed("port", settings.port, 'a serial port, such as "/dev/ttyACM0" or "COM3"')
        timeout = 0.1 if settings.timeout is None else settings.timeout
        return SerialSupply(port, settings.baud, timeout, settings.channel_count, watchdog=settings.watchdog)
    if settings.kind == "scpi":
        from gelbot.hardware.scpi_supply import ScpiSupply

        resource = _needed("resource", settings.resource, 'a VISA address, such as "TCPIP0::192.168.1.20::INSTR"')
        profile = _needed("profile", settings.profile, "the name of a profile, or a .toml file")
        timeout = 1.0 if settings.timeout is None else settings.timeout
        return ScpiSupply(resource, profile, timeout, settings.visa_library, channel_count=settings.channel_count)
    if settings.kind == "ni":
        from gelbot.hardware.ni_supply import NiSupply

        device = _needed("device", settings.device, 'the name of a card, such as "Dev1"')
        channels = settings.channels
        if not channels:
            last = (16 if settings.channel_count is None else settings.channel_count) - 1
            channels = f"ao0:{last}" if last else "ao0"
        return NiSupply(
            device,
            channels,
            settings.lowest,
            settings.highest,
            0.1 if settings.timeout is None else settings.timeout,
            watchdog=0.2 if settings.watchdog is None else settings.watchdog,
            require_watchdog=settings.watchdog is not None,
        )
    raise BadInput("supply.kind", settings.kind, ", ".join(get_args(Kind)))


def _needed(key: str, given: str, allowed: str) -> str:
    if not given:
        raise BadInput(f"supply.{key}", given, allowed)
    return given
