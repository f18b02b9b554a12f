"""All benchmarks: prints a table and writes bench.json, with the machine they ran on. `make bench` calls this.

Times depend on what else the machine does: run it on a quiet one.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

HERE = Path(__file__).resolve().parent
PARTS = ("field", "lead_field", "mechanics", "camera", "live")
"""The benchmarks, each a program of this folder with a function `rows`."""
PROGRAM = "import json, {0}; print(json.dumps({0}.rows()))"


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    model = platform.processor()
    cpu = Path("/proc/cpuinfo")
    if cpu.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "jax": version("jax"),
        "numpy": version("numpy"),
    }


def left_out() -> list[str]:
    """Rows that this machine cannot give, and why."""
    reasons = []
    if find_spec("mujoco") is None:
        reasons.append("MuJoCo is not installed (pip install mujoco-core): no rows of it, and no ratios to it")
    if not Path("/usr/bin/chromium").exists():
        reasons.append("no Chromium at hand (apt-get install chromium): no rows of the page in a browser")
    if shutil.which("nvidia-smi") is None:
        reasons.append("no GPU at hand: no rows of Newton; accelerator.py, which is run alone, wants one too")
    return reasons


def main() -> int:
    on = machine()
    rows: list[dict[str, Any]] = []
    console = Console()
    for part in PARTS:
        with console.status(f"measuring {part}"):
            # Threads are set when the array engine starts: each part in a process of its own.
            environment = {**os.environ, "NPROC": str(os.cpu_count())} if part == "lead_field" else dict(os.environ)
            done = subprocess.run(
                [sys.executable, "-c", PROGRAM.format(part)],
                cwd=HERE, env=environment, stdout=subprocess.PIPE, text=True, check=True,
            )  # fmt: skip
        rows += [{"part": part, **row} for row in json.loads(done.stdout.splitlines()[-1])]
    table = Table(title=f"{on['processor']}, {on['cores']} cores, load {on['load']}")
    for head in ("", "measured", "target", ""):
        table.add_column(head, justify="right" if head in ("measured", "target") else "left")
    for row in rows:
        target = "" if row["target"] is None else f"{row['target']:g} {row['unit']}"
        table.add_row(row["name"], f"{row['value']:.3g} {row['unit']}", target, row.get("note", ""))
    console.print(table)
    headline = {row.pop("headline"): row["value"] for row in rows if "headline" in row}
    found = {"machine": on, "headline": headline, "left_out": left_out(), "rows": rows}
    Path("bench.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    for reason in found["left_out"]:
        console.print(f"left out: {reason}")
    console.print("written to bench.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
