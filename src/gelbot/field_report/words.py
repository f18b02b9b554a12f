"""The field in plain numbers, and what is said of numbers that need a second look: the content of field.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gelbot import __version__
from gelbot.field.gel_effect import GelEffect
from gelbot.field.operating_point import BUBBLING, CURRENT, ERROR, PANELS, VOLTAGE, Excess, OperatingPoint
from gelbot.field.panels import FEWEST
from gelbot.field_report.asked import Drive, Request
from gelbot.field_report.moment import Moment
from gelbot.field_report.settled import IDLE, without_rounding
from gelbot.scenario.schema import Scenario

NAMED = 4
"""So many electrodes a message names, the worst; of the rest it gives the number."""


def numbers(
    scenario: Scenario,
    request: Request,
    point: OperatingPoint,
    drive: Drive,
    moment: Moment,
    found: list[Excess],
    error: float | None,
) -> dict[str, Any]:
    """Plain numbers with their unit in the name; lists have one entry for each electrode."""
    problem, most = point.solution.problem, abs(point.voltages).max()
    compared = compared_with(problem.panels_per_side)
    names = [electrode.name for electrode in problem.array.electrodes]
    return {
        "name": scenario.name,
        "asked": {key: _as_given(value) for key, value in request._asdict().items()},
        "drive": drive.source,
        "body": moment.source,
        "names": names,
        "states": list(point.states),
        "voltages_V": point.asked.tolist(),
        "electrode_voltages_V": point.voltages.tolist(),
        "currents_A": point.currents.tolist(),
        "mean_current_density_A_m2": point.mean_density.tolist(),
        "total_current_A": point.total_current,
        "net_current_A": point.net_current,
        "power_W": point.power if point.total_current > 0.0 else 0.0,
        "bulk_potential_V": float(without_rounding(np.array(point.bulk_potential), most)),
        "conductance_S": point.solution.conductance.tolist(),
        "conductivity_S_m": problem.conductivity,
        "error_estimate": error,
        "error_estimate_with": compared,
        "asymmetry": point.solution.asymmetry,
        "panels": problem.panels.count,
        "panels_per_side": problem.panels_per_side,
        "warnings": [
            {
                "kind": excess.kind,
                "message": message(excess, names, compared),
                "value": excess.value,
                "threshold": excess.threshold,
                "electrodes": list(excess.electrodes),
            }
            for excess in found
        ],
        "gel": None,
        "planes": [],
        "version": __version__,
    }


def gel_numbers(effect: GelEffect, conductivity: float) -> dict[str, Any]:
    """What a gel of `conductivity` [S/m] changes; lists have one entry for each face of the gel."""
    return {
        "conductivity_S_m": conductivity,
        "relative_change_rms": effect.rms_change,
        "relative_change_max": effect.largest_change,
        "conductance_change": effect.conductance_change,
        "inflow_A_m2": effect.inflow.tolist(),
        "inflow_without_A_m2": effect.without.tolist(),
    }


def compared_with(per_side: int) -> str:
    """With how many panels along a side `error_estimate` compares `per_side` of them: "half" as many, or "twice"."""
    return "half" if per_side >= 2 * FEWEST else "twice"


def message(excess: Excess, names: list[str], compared: str = "half") -> str:
    """What an excess means, with its numbers and what to do; `compared`: what `compared_with` says."""
    value, threshold, who = excess.value, excess.threshold, _named(excess, names)
    if excess.kind == VOLTAGE:
        return f"{who}: {value:.4g} V asked, the supply gives {threshold:.4g} V either way (supply.limit)"
    if excess.kind == CURRENT:
        return f"{value:.4g} A in all, the supply gives {threshold:.4g} A (supply.current_limit)"
    if excess.kind == BUBBLING:
        return (
            f"{who}: a mean of up to {value / 10.0:.3g} mA/cm^2, gas is to be expected from {threshold / 10.0:.3g} "
            "mA/cm^2 on (electrodes.bubbling)"
        )
    if excess.kind == PANELS:
        return (
            f"{who}: a panel's width is {value:.2g} of its distance to the gel, which sees single panels from "
            f"{threshold:.2g} on. Try: more electrodes.panels"
        )
    if excess.kind == ERROR:
        return (
            f"with {compared} as many panels along a side the conductances change by {value * 100.0:.3g} %, more than "
            f"{threshold * 100.0:.3g} %. Try: more electrodes.panels"
        )
    if excess.kind == IDLE:
        if len(excess.electrodes) == 1:
            return f"no current flows: {who} alone is connected. Try: another electrode, driven or grounded"
        return f"no current flows: all driven electrodes have one voltage, {value:.4g} V. Try: voltages that differ"
    raise ValueError(excess.kind)


def _named(excess: Excess, names: list[str]) -> str:
    worst = [names[n] for n in excess.electrodes[:NAMED]]
    more = len(excess.electrodes) - len(worst)
    return ", ".join(worst) + (f" and {more} more" if more else "")


def _as_given(option: Any) -> Any:
    return list(option) if isinstance(option, tuple) else str(option) if isinstance(option, Path) else option
