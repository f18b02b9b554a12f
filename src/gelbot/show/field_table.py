"""The table of a field's electrodes, its totals and its warnings on the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

ALL_UP_TO = 20
"""More electrodes than this, and only the largest currents are shown."""
LARGEST = 10


def electrode_table(report: Mapping[str, Any]) -> Table:
    """Voltage, current and mean current density of the electrodes; of many, those with the largest currents."""
    currents, states = report["currents_A"], report["states"]
    shown = list(range(len(currents)))
    if len(shown) > ALL_UP_TO:
        shown = sorted(shown, key=lambda n: -abs(currents[n]))[:LARGEST]
    table = Table(title=Text(f"{report['name']}: {report['drive']}"))
    table.add_column("electrode")
    for head in ("voltage [V]", "current [mA]", "mean density [mA/cm^2]"):
        table.add_column(Text(head), justify="right")
    driven = all(state == "driven" for state in states)
    if not driven:
        table.add_column("state")
    for n in shown:
        name, plain = report["names"][n], f"electrode {n}"
        density = report["mean_current_density_A_m2"][n] / 10.0
        cells = [str(n) if name == plain else f"{n} {name}", f"{report['electrode_voltages_V'][n]:.4g}"]
        cells += [f"{currents[n] * 1e3:.4g}", f"{density:.3g}", *([] if driven else [states[n]])]
        table.add_row(*(Text(cell) for cell in cells))
    return table


def print_field(report: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the table, then totals, what the gel changes, and the warnings."""
    console = console or Console()
    console.print(electrode_table(report))
    lines = []
    if len(report["currents_A"]) > ALL_UP_TO:
        lines.append(f"the {LARGEST} largest currents of {len(report['currents_A'])} electrodes; all are in field.json")
    lines.append(
        f"the supply gives {report['total_current_A']:.4g} A and {report['power_W']:.4g} W; "
        f"potential of the bulk {report['bulk_potential_V']:.4g} V"
    )
    error, gel = report["error_estimate"], report["gel"]
    change = (
        "how far they are from the truth is not known"
        if error is None
        else f"with {report['error_estimate_with']} as many along a side conductances change by {error:.2%}"
    )
    lines.append(f"{report['panels']} panels; {change}")
    if gel is not None and report["total_current_A"] > 0.0:
        lines.append(
            f"a gel of {gel['conductivity_S_m']:.4g} S/m changes the current into it by "
            f"{gel['relative_change_rms']:.1%} (rms; at most {gel['relative_change_max']:.1%} of the largest), "
            f"conductances by {gel['conductance_change']:.2%}"
        )
    lines += [f"warning: {warning['message']}" for warning in report["warnings"]]
    for line in lines:
        console.print(line, highlight=False, markup=False)
