"""Controllers on the same robots: their rates, and pair by pair which is better."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from gelbot.study.report import Report
from gelbot.study.statistics import mean_of, sign_test

PAIRED = ("t_motion_s", "peak_voltage_V", "charge_C")
"""What is compared on pairs in which both met the motion."""


def compare(made: list[Report]) -> dict[str, Any]:
    """Each study, and for each two of them: on how many robots only one met the motion, with McNemar's exact p, and
    the mean differences, second less first, with their bootstrap intervals, where both did."""
    return {
        "studies": [one.study for one in made],
        "pairs": [_pair(a, b) for a, b in combinations(made, 2)],
    }


def _pair(a: Report, b: Report) -> dict[str, Any]:
    both = list(zip(a.rows, b.rows, strict=True))
    won = sum(y["met"] and not x["met"] for x, y in both)
    lost = sum(x["met"] and not y["met"] for x, y in both)
    differences = {}
    for key in PAIRED:
        values = np.array([y[key] - x[key] for x, y in both if x["met"] and y["met"]])
        mean = mean_of(values)
        differences[key] = None if mean is None else mean._asdict()
    return {
        "first": a.study["controller"],
        "second": b.study["controller"],
        "only_first_met": lost,
        "only_second_met": won,
        "p": sign_test(won, lost),
        "second_less_first": differences,
    }
