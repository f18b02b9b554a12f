"""The field as an xarray data set, which netCDF can hold: electrodes, body, and the field on planes."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from gelbot import __version__
from gelbot.field.operating_point import OperatingPoint
from gelbot.field.outlines import outlines
from gelbot.field_report.asked import Drive
from gelbot.field_report.moment import Moment
from gelbot.field_report.sampling import Sampled
from gelbot.scenario.schema import Scenario

METRE = {"units": "m"}


def field_dataset(
    scenario: Scenario,
    point: OperatingPoint,
    drive: Drive,
    moment: Moment,
    planes: list[Sampled],
    gel_conductivity: float | None,
) -> xr.Dataset:
    """All that pictures need. On plane k, from 0: `potential_k`, `current_density_k`, and its grid's coordinates."""
    array, tank = point.solution.problem.array, point.solution.problem.tank
    electrode = ("electrode",)
    table: dict[str, tuple[tuple[str, ...], Any, str, str]] = {
        "electrode_centre": (("space", "electrode"), array.centres, "m", "middles of the electrodes"),
        "electrode_outline": (
            ("space", "outline_corner", "electrode"),
            outlines(array),
            "m",
            "corners of the electrodes, after a gap those of a hole",
        ),
        "electrode_axis": (
            ("space", "electrode"),
            np.stack([e.frame[:, 2] for e in array.electrodes], axis=1),
            "1",
            "own z axes of the electrodes: fronts of plates look along them",
        ),
        "electrode_backing": (
            electrode,
            np.array([e.backing for e in array.electrodes]),
            "m",
            "insulated backs' thickness",
        ),
        "voltage": (electrode, point.asked, "V", "voltages asked of the supply, 0 where it is not connected"),
        "electrode_potential": (electrode, point.voltages, "V", "voltages that the electrodes have"),
        "electrode_current": (electrode, point.currents, "A", "currents from the electrodes into the tank"),
        "mean_current_density": (electrode, point.mean_density, "A/m^2", "currents over the conducting areas"),
        "conductance": (
            ("electrode", "electrode_to"),
            point.solution.conductance,
            "S",
            "current of one per volt of the other",
        ),
        "body_position": (("space", "node"), moment.positions, "m", "nodes of the gel"),
        "body_faces": (("corner", "face"), moment.faces.astype(np.int32), "1", "nodes of the gel's surface triangles"),
    }
    coords: dict[str, Any] = {
        "space": ["x", "y", "z"],
        "electrode_name": (electrode, [e.name for e in array.electrodes]),
        "electrode_state": (electrode, list(point.states)),
    }
    for k, sampled in enumerate(planes):
        letters = [f"{letter}_{k}" for letter in "xyz"]
        (normal,), (right, up) = [letters.pop(sampled.plane.axis)], letters
        coords[right] = ((right,), sampled.right, METRE)
        coords[up] = ((up,), sampled.up, METRE)
        coords[normal] = ((), sampled.plane.value, METRE)
        table[f"potential_{k}"] = ((up, right), sampled.potential, "V", f"potential on the plane {sampled.plane}")
        table[f"current_density_{k}"] = (
            ("space", up, right),
            sampled.current_density,
            "A/m^2",
            f"current density on the plane {sampled.plane}",
        )
    return xr.Dataset(
        {
            name: (dims, values, {"units": unit, "long_name": text})
            for name, (dims, values, unit, text) in table.items()
        },
        coords=coords,
        attrs={
            "title": f"electric field of the scenario {scenario.name}",
            "scenario_name": scenario.name,
            "drive": drive.source,
            "body": moment.source,
            "conductivity": point.solution.problem.conductivity,
            "gel_conductivity": np.nan if gel_conductivity is None else gel_conductivity,
            # From low to high x, y, z; NaN where the solution goes on.
            "boundaries": [np.nan if b is None else b for bounds in tank.planes for b in bounds],
            "planes": "; ".join(str(sampled.plane) for sampled in planes),
            "plane_axes": "".join("xyz"[sampled.plane.axis] for sampled in planes),
            "gelbot_version": __version__,
            "Conventions": "SI units; lengths and axes as in gelbot's docs/conventions.md",
        },
    )
