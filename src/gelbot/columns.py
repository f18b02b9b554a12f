"""Tables of measured or drawn things: CSV files with a header that says each column's unit, SI values out.

The header's cells read `x [mm]`, `x (mm)` or `x_mm`. Commas, semicolons or tabs separate cells, whichever the header
has most of; empty lines and lines that begin with # do not count.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from gelbot.errors import BadInput
from gelbot.units import allowed_quantity, quantity

TEXT = "text"
"""The unit of a column of words."""
LINE = "line"
"""The column of line numbers that every table has."""
SIZE_MOST = 50_000_000
"""A file with more bytes than this is no table of ours."""


class Column(NamedTuple):
    """A column of the file: its `name`, its SI `unit`, the header's unit in it (`factor`), how the `header` reads."""

    name: str
    unit: str
    factor: float
    header: str


def read_columns(
    path: Path, needed: Mapping[str, str], optional: Mapping[str, str] | None = None, passes_over: bool = False
) -> dict[str, list]:
    """The columns of the CSV file `path`, by name, in SI.

    `needed` and `optional` hold for each column its SI unit: "m", "V"..., "" for plain numbers, "text" for words. A
    column of `optional` that the file does not have is not in the result, and an empty cell of one is None. The column
    "line" holds the lines' numbers in the file. Columns of other names are an error, or are passed over. Raises
    `BadInput` that names the file and the line, what stands there and what is allowed.
    """
    wanted = {**needed, **(optional or {})}
    rows = _rows(path)
    number, header = next(rows, (1, []))
    columns = _columns(header, wanted, set(needed), f"{path}, header", passes_over)
    found: dict[str, list] = {LINE: [], **{column.name: [] for column in columns if column is not None}}
    for number, row in rows:
        where = f"{path}, line {number}"
        if len(row) != len(columns):
            raise BadInput(where, f"{len(row)} cells", f"{len(columns)} cells, as many as the header has")
        found[LINE].append(number)
        for column, cell in zip(columns, row, strict=True):
            if column is not None:
                found[column.name].append(_value(cell, column, column.name in needed, where))
    if not found[LINE]:
        raise BadInput(str(path), "no line of values", "at least one line below the header")
    return found


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and cells, stripped, of all lines that count."""
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_MOST + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput(str(path), "no file that can be read", f"a CSV file ({reason})") from error
    if len(content) > SIZE_MOST:
        raise BadInput(str(path), f"more than {SIZE_MOST} bytes", "a CSV file of at most as many")
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise BadInput(str(path), f"byte {error.start} that is no UTF-8", "a CSV file in UTF-8") from error
    separator = None
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        separator = separator or max(",;\t", key=line.count)
        try:
            (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True)
        except csv.Error as error:
            raise BadInput(f"{path}, line {number}", line, f"cells of a CSV file ({error})") from error
        yield number, [cell.strip() for cell in cells]


def _columns(
    header: list[str], wanted: Mapping[str, str], needed: set[str], where: str, passes_over: bool
) -> list[Column | None]:
    """What each cell of the header means, None for a column that is passed over."""
    columns = [None if passes_over and _is_other(cell, wanted) else _column(cell, wanted, where) for cell in header]
    names = [column.name for column in columns if column is not None]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(where, f"two columns {name}", "each column once")
    for name in wanted:
        if name in needed and name not in names:
            raise BadInput(where, ", ".join(header), f"a column {_example(name, wanted[name])}")
    return columns


def _is_other(cell: str, wanted: Mapping[str, str]) -> bool:
    """Whether a header's cell names none of the columns: x [furlong] is an x with a wrong unit, x_error is another."""
    name = re.split(r"[ \[(]", cell, maxsplit=1)[0]
    if name in wanted:
        return False
    try:
        _column(cell, wanted, "")
    except BadInput:
        return True
    return False


def _column(cell: str, wanted: Mapping[str, str], where: str) -> Column:
    # size_x_mm is size_x in mm: of two names that fit, the longer is meant.
    fitting = [
        name for name in wanted if cell == name or cell.startswith((f"{name} ", f"{name}[", f"{name}(", f"{name}_"))
    ]
    if not fitting:
        allowed = "the columns " + ", ".join(_example(name, unit) for name, unit in wanted.items())
        raise BadInput(where, cell, allowed, "".join(get_close_matches(cell.split(" ")[0], wanted, 1, 0.7)))
    name = max(fitting, key=len)
    unit, written = wanted[name], cell[len(name) :].strip(" _")
    if written[:1] + written[-1:] in ("[]", "()"):
        written = written[1:-1].strip()
    if unit in ("", TEXT):
        if written:
            raise BadInput(where, cell, f"{name}, without a unit")
        return Column(name, unit, 1.0, cell)
    try:
        return Column(name, unit, quantity(f"1 {written}", unit, where), cell)
    except BadInput as error:
        kind = allowed_quantity(unit).partition(" with its unit")[0]
        raise BadInput(where, cell, f"{kind} with the unit in the header, such as {_example(name, unit)}") from error


def _value(cell: str, column: Column, is_needed: bool, where: str) -> Any:
    if not cell:
        if is_needed:
            raise BadInput(where, f"nothing in the column {column.header}", "a value in every line")
        return None
    if column.unit == TEXT:
        return cell
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        allowed = f"a finite number, with a decimal point, in the column {column.header}"
        raise BadInput(where, cell, allowed + (": its unit stands in the header" if column.unit else ""))
    return value * column.factor


def _example(name: str, unit: str) -> str:
    """How a header names a column."""
    if unit in ("", TEXT):
        return f'"{name}"'
    written = {"m": "mm", "rad": "deg"}.get(unit, unit)
    return f'"{name} [{written}]"'
