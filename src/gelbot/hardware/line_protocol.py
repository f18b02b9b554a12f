"""The lines that go to a serial supply and come back: text to words and words to text. See docs/hardware.md.

A line is words, `*`, the checksum of the words in four hexadecimal digits, and a line feed:

    W 7 10000 -5000*4BA3        set all channels [mV]           A 7 0*EDFB                          done
    R 8*4D8F                    read back                       A 8 0 10000 -5000 1200 -600*....    [mV], then [uA]
    Z 9*F40F                    all channels to zero            A 9 0*....
    I 10*....                   who are you                     A 10 NAME VERSION CHANNELS LOWEST HIGHEST WATCHDOG*....

The second word is a sequence number from 1 to 65535; the answer carries the same, and after it how often the watchdog
has expired. `N 7 range*62C2` refuses; number 0 answers a line that could not be read. Host and reference device both
use this file, and a firmware does the same in C++.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from gelbot.errors import GelbotError

VERSION = 1
HIGHEST_NUMBER = 65535
UNREADABLE = 0
"""The number of an answer to a line whose own number could not be trusted."""
LONGEST_REQUEST, LONGEST_ANSWER = 255, 511
"""How many bytes a line may have, its line feed included."""
COMMANDS = ("W", "R", "Z", "I")
REASONS = ("crc", "command", "count", "number", "range")
"""Why a device refuses: line not readable, no such command, wrong count of words, a word is no number, out of range."""

WORDS = re.compile(rb"[!-)+-~]+(?: [!-)+-~]+)*")
CHECKSUM = re.compile(rb"[0-9A-F]{4}")
INTEGER = re.compile(r"-?[0-9]{1,9}")


class GarbledLine(GelbotError):
    """A `line` that is not of the protocol, or whose checksum does not fit; `what` says which."""

    def __init__(self, line: bytes, what: str) -> None:
        self.line, self.what = line, what
        super().__init__(f"garbled line {line[:60]!r}: {what}")


class Request(NamedTuple):
    """What the host asks: one of `COMMANDS`, its `number`, and for `W` the voltages of all channels [mV]."""

    command: str
    number: int
    millivolts: tuple[int, ...] = ()


class Answer(NamedTuple):
    """What the device says: whether it did what request `number` asked (`done`), and the `words` after it."""

    done: bool
    number: int
    words: tuple[str, ...] = ()


class Identity(NamedTuple):
    """What a device says it is: name, version of the protocol, channels, range [mV], watchdog [ms], 0 for none."""

    name: str
    version: int
    channel_count: int
    lowest: int
    highest: int
    watchdog: int


class ReadBack(NamedTuple):
    """What a device measures: how often its watchdog has expired, [mV] and [uA] of all channels, () for no currents."""

    expired_count: int
    millivolts: tuple[int, ...]
    microamperes: tuple[int, ...]


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, begun with 0xFFFF, no reflection; of b"123456789" it is 0x29B1."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        crc &= 0xFFFF
    return crc


def encode(words: tuple[str, ...]) -> bytes:
    """The line of `words`, with checksum and line feed. Raises `ValueError` for what no line can hold."""
    body = " ".join(words).encode("ascii")
    if not WORDS.fullmatch(body):
        raise ValueError(f"words of printable characters without a star, not {words!r}")
    return b"%s*%04X\n" % (body, crc16(body))


def decode(line: bytes) -> tuple[str, ...]:
    """The words of `line`, which ends in its only line feed. Raises `GarbledLine`."""
    if not line.endswith(b"\n"):
        raise GarbledLine(line, "it has no end")
    body, star, checksum = line[:-1].rpartition(b"*")
    if not star or not CHECKSUM.fullmatch(checksum):
        raise GarbledLine(line, "it has no checksum")
    if int(checksum, 16) != crc16(body):
        raise GarbledLine(line, f"its checksum is {checksum.decode()}, that of its words {crc16(body):04X}")
    if not WORDS.fullmatch(body):
        raise GarbledLine(line, "its words are not printable characters with single spaces between")
    return tuple(body.decode("ascii").split(" "))


def encode_request(request: Request) -> bytes:
    """The line of a `request`."""
    return encode((request.command, str(request.number), *map(str, request.millivolts)))


def encode_answer(answer: Answer) -> bytes:
    """The line of an `answer`."""
    return encode(("A" if answer.done else "N", str(answer.number), *answer.words))


def decode_answer(line: bytes) -> Answer:
    """The answer in `line`. Raises `GarbledLine`."""
    words = decode(line)
    if len(words) < 2 or words[0] not in ("A", "N") or not is_number(words[1]):
        raise GarbledLine(line, "it is no answer")
    return Answer(words[0] == "A", int(words[1]), words[2:])


def is_number(word: str) -> bool:
    """Whether `word` may be the number of a request, or of an answer to one that could not be read."""
    return re.fullmatch(r"[0-9]{1,5}", word) is not None and int(word) <= HIGHEST_NUMBER


def integers(words: tuple[str, ...]) -> tuple[int, ...] | None:
    """The whole numbers that all `words` are, or None."""
    return tuple(map(int, words)) if all(INTEGER.fullmatch(word) for word in words) else None


def identity_words(identity: Identity) -> tuple[str, ...]:
    """What follows the number in the answer to `I`."""
    return tuple(map(str, identity))


def identity_of(words: tuple[str, ...]) -> Identity | None:
    """The identity in an answer's `words`, or None where they are something else."""
    values = integers(words[1:6])
    return Identity(words[0], *values) if values is not None and len(values) == 5 else None


def read_back_words(read: ReadBack) -> tuple[str, ...]:
    """What follows the number in the answer to `R`."""
    return tuple(map(str, (read.expired_count, *read.millivolts, *read.microamperes)))


def read_back_of(words: tuple[str, ...], channel_count: int) -> ReadBack | None:
    """What a device of `channel_count` channels has measured, or None where `words` are something else."""
    values = integers(words)
    if values is None or len(values) not in (1 + channel_count, 1 + 2 * channel_count):
        return None
    return ReadBack(values[0], values[1 : 1 + channel_count], values[1 + channel_count :])
