"""How long the field of an array takes: panels, influences, solution, each case in a process of its own.

python benchmarks/field.py            all cases, as a table
python benchmarks/field.py 16x100     one case, as JSON: seconds to build, to solve, peak memory, accuracy
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any

CASES = {"16x100": (4, 10, 1.0), "16x144": (4, 12, None), "16x400": (4, 20, 20.0), "64x100": (8, 10, 20.0)}
"""Electrodes x panels: electrodes along a side of the array, panels along a side of a plate, target [s]."""
MEMORY = 2000.0
"""Target for the memory of the largest array [MB]."""


def measure(name: str) -> dict[str, float | None]:
    """Build and solve one array of plates in a tank with floor, surface and walls; best of a few runs."""
    import resource

    from gelbot.engine import prepare_engine
    from gelbot.field.charge import build_problem, error_estimate, solve
    from gelbot.field.electrodes import square_array
    from gelbot.field.images import Tank

    prepare_engine()
    along, per_side, _ = CASES[name]
    width = along * 25e-3 + 30e-3
    array, tank = square_array(along, along, 10e-3, 15e-3, 15e-3), Tank(-1e-3, 30e-3, (width, width))
    best, seconds, solution = 1e9, (0.0, 0.0), None
    for _ in range(3 if along * per_side <= 48 else 1):
        began = time.perf_counter()
        problem = build_problem(array, tank, 0.19, per_side)
        built = time.perf_counter()
        solution = solve(problem)
        ended = time.perf_counter()
        if ended - began < best:
            best, seconds = ended - began, (built - began, ended - built)
    assert solution is not None
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    error = error_estimate(solution)
    return {"build_s": seconds[0], "solve_s": seconds[1], "memory_MB": memory, "error_estimate": error}


def rows() -> list[dict[str, Any]]:
    """The rows of the benchmark's table."""
    table: list[dict[str, Any]] = []
    for name, (_, _, target) in CASES.items():
        output = subprocess.run([sys.executable, __file__, name], capture_output=True, text=True, check=True).stdout
        found = json.loads(output)
        note = f"build {found['build_s']:.2f} s, solve {found['solve_s']:.2f} s"
        note += f", halving the panels changes conductances by {found['error_estimate']:.1e}"
        total = found["build_s"] + found["solve_s"]
        table.append({"name": f"field of {name} panels", "value": total, "unit": "s", "target": target, "note": note})
        if name == "64x100":
            table.append({"name": f"field of {name} panels, peak memory", "value": found["memory_MB"], "unit": "MB",
                          "target": MEMORY, "note": "of the whole process"})  # fmt: skip
    return table


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(json.dumps(measure(sys.argv[1])))
    else:
        for row in rows():
            print(f"{row['name']:40s} {row['value']:10.3g} {row['unit']:4s} target {row['target']}   {row['note']}")
