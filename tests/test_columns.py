"""Tables from files: headers with units in each of their forms, SI values out, each mistake named with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelbot.columns import read_columns
from gelbot.errors import BadInput

NEEDED = {"x": "m", "y": "m"}
OPTIONAL = {"z": "m", "name": "text", "turn": "rad", "size": "m", "size_x": "m", "weight": ""}


def table(folder: Path, text: str) -> dict[str, list]:
    file = folder / "table.csv"
    file.write_text(text, encoding="utf-8")
    return read_columns(file, NEEDED, OPTIONAL)


@pytest.mark.parametrize("header", ["x [mm],y [mm]", "x (mm), y (mm)", "x_mm,y_mm", "x[mm] , y(mm)", '"x [mm]","y_mm"'])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_the_header_says_the_unit(tmp_path: Path, header: str, separator: str):
    found = table(tmp_path, header.replace(",", separator) + f"\n1.5{separator} -2e1\n")
    assert found == {"line": [2], "x": [pytest.approx(1.5e-3)], "y": [pytest.approx(-20e-3)]}


def test_all_kinds_of_columns(tmp_path: Path):
    text = "\ufeff# from the bench\nturn [deg],name,x [cm],y [in],weight,size_x_mm,size [m]\r\n"
    text += "180,a b,1,1,7,3,\r\n\r\n  # half\n,,2,0,,,4\n"
    found = table(tmp_path, text)
    assert found["line"] == [3, 6]
    assert found["turn"] == [pytest.approx(np.pi), None]
    assert found["name"] == ["a b", None]
    assert found["x"] == pytest.approx([0.01, 0.02])
    assert found["y"] == pytest.approx([0.0254, 0.0])
    assert found["weight"] == [7.0, None]
    assert found["size_x"] == [pytest.approx(3e-3), None]
    assert found["size"] == [None, 4.0]
    assert "z" not in found


# The text, where the mistake is, what is given, a part of what is allowed.
MISTAKES = [
    ("x [mm]\n1\n", "header", "x [mm]", 'a column "y [mm]"'),
    ("x [mm],y\n1,2\n", "header", "y", 'the unit in the header, such as "y [mm]"'),
    ("x [mm],y [s]\n1,2\n", "header", "y [s]", "a length with the unit in the header"),
    ("x [mm],y [furlings]\n1,2\n", "header", "y [furlings]", "a length"),
    ("x [mm],y [mm],wieght\n1,2,3\n", "header", "wieght", '"weight"'),
    ("x [mm],y [mm],weight [kg]\n1,2,3\n", "header", "weight [kg]", "weight, without a unit"),
    ("x [mm],y [mm],x [m]\n1,2,3\n", "header", "two columns x", "once"),
    ("x [mm],y [mm]\n1,2\n1,2,3\n", "line 3", "3 cells", "2 cells"),
    ("x [mm],y [mm]\n\n1,two\n", "line 3", "two", "a finite number, with a decimal point, in the column y [mm]"),
    ("x [mm];y [mm]\n1,5;2\n", "line 2", "1,5", "a decimal point"),
    ("x [mm],y [mm]\n1,nan\n", "line 2", "nan", "a finite number"),
    ("x [mm],y [mm]\n1,2 mm\n", "line 2", "2 mm", "its unit stands in the header"),
    ("x [mm],y [mm]\n1,\n", "line 2", "nothing in the column y [mm]", "a value in every line"),
    ('x [mm],y [mm]\n1,"2\n', "line 2", '1,"2', "cells of a CSV file"),
    ("x [mm],y [mm]\n# nothing\n", None, "no line of values", "at least one line"),
    ("", "header", "", "a column"),
]


@pytest.mark.parametrize(("text", "place", "given", "allowed"), MISTAKES)
def test_a_mistake_names_its_line(tmp_path: Path, text: str, place: str | None, given: str, allowed: str):
    with pytest.raises(BadInput) as refused:
        table(tmp_path, text)
    file = str(tmp_path / "table.csv")
    assert refused.value.where == (file if place is None else f"{file}, {place}")
    assert refused.value.given == given
    assert allowed in str(refused.value)


def test_a_file_that_cannot_be_read(tmp_path: Path):
    with pytest.raises(BadInput, match="No such file"):
        read_columns(tmp_path / "none.csv", NEEDED)
    (tmp_path / "latin.csv").write_bytes(b"x [mm],y [\xb5m]\n1,2\n")
    with pytest.raises(BadInput, match="UTF-8"):
        read_columns(tmp_path / "latin.csv", NEEDED)
