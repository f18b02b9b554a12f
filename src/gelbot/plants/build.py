"""From a scenario to the plant that is controlled: wiring, limits, guard, supply, and what sees the gel."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from gelbot.clock import Clock
from gelbot.errors import BadInput
from gelbot.hardware.devices import SupplySettings, open_supply
from gelbot.hardware.guard import CAMERA, LOOP, Guard, Watch
from gelbot.hardware.limits import UNCONNECTED, Limits, Wiring
from gelbot.hardware.soft_supply import SoftSupply
from gelbot.hardware.supply import Supply
from gelbot.plants.guarded import Eye, GuardedPlant
from gelbot.plants.simulated import Noise, SimulatedEye, SimulatedGel
from gelbot.scenario.build import Experiment
from gelbot.scenario.schema import Scenario

LOOP_SILENT, LOOP_LATE = 0.25, 0.1
"""A loop that has not applied anything for this long [s], or for a period and the second of these, is stalled."""
ROOM = 1.5
"""A simulated supply reaches so far beyond the scenario's limit."""

Tell = Callable[[str], None]


def wiring_of(scenario: Scenario, channel_count: int | None = None) -> Wiring:
    """Which channel feeds which electrode. Raises `BadInput` for a channel beyond the `channel_count` of the device."""
    supply, states = scenario.supply, scenario.electrodes.states
    count = len(states)
    given = range(count) if supply.channels is None else supply.channels
    # What is grounded, floating or off hangs on no channel.
    channel = np.array([c if state == "driven" else UNCONNECTED for c, state in zip(given, states, strict=True)])
    needed = int(channel.max(initial=-1)) + 1
    if channel_count is not None and needed > channel_count:
        electrode = int(np.argmax(channel))
        what = f"channel {needed - 1} for electrode {electrode}"
        raise BadInput("supply.channels", what, f"channels from 0 to {channel_count - 1}: the device has no more")
    gain, offset = (np.broadcast_to(np.array(part, float), count) for part in (supply.gain, supply.offset))
    return Wiring(channel, gain, offset, channel_count or max(needed, 1))


def limits_of(experiment: Experiment) -> Limits:
    """The scenario's limits, with the currents that its field gives for its voltages."""
    supply = experiment.scenario.supply
    return Limits(
        voltage=supply.limit,
        slew=np.inf if supply.slew_limit is None else supply.slew_limit,
        current=np.inf if supply.current_limit is None else supply.current_limit,
        charge=np.inf if supply.charge_limit is None else supply.charge_limit,
        conductance=experiment.field.conductance @ experiment.connection,
    )


def guard_of(
    experiment: Experiment,
    supply: Supply,
    clock: Clock,
    on_event: Tell,
    gel_clock: Clock | None = None,
    slack: float = LOOP_LATE,
) -> Guard:
    """The guard over `supply`, which watches the loop and the camera.

    They may be silent for a control period and the `slack` [s], at least.
    """
    scenario = experiment.scenario
    camera, late = scenario.camera, scenario.programme.control_period + slack
    watches = {
        LOOP: Watch(max(LOOP_SILENT, late)),
        # It is the loop that looks.
        CAMERA: Watch(max(camera.lost_after, late), camera.patience),
    }
    wiring = wiring_of(scenario, supply.channel_count)
    _check_zero(wiring, supply)
    return Guard(supply, wiring, limits_of(experiment), clock, watches, on_event, gel_clock)


def _check_zero(wiring: Wiring, supply: Supply) -> None:
    """Zero volts on every electrode is something that the supply can give, or a `BadInput`."""
    zero = wiring.to_channels(np.zeros(len(wiring.channel)))
    lowest, highest = (np.broadcast_to(end, zero.shape) for end in (supply.lowest, supply.highest))
    beyond = (zero < lowest - 1e-9) | (zero > highest + 1e-9)
    if beyond.any():
        k = int(np.argmax(beyond))
        given = f"an offset for which channel {k} must give {zero[k]:.3g} V for zero volts on its electrode"
        raise BadInput(
            "supply.offset", given, f"one that {supply.name} can undo, from {lowest[k]:g} V to {highest[k]:g} V"
        )


def soft_supply(experiment: Experiment, clock: Clock, watchdog: float | None = None) -> SoftSupply:
    """The soft twin of the scenario's supply: it reaches as far, measures the currents, and has a watchdog."""
    scenario, wiring = experiment.scenario, wiring_of(experiment.scenario)
    fed = wiring.channel >= 0
    most = ROOM * (scenario.supply.limit + np.abs(wiring.offset).max()) / np.abs(wiring.gain).min()
    load = np.zeros((wiring.channel_count, wiring.channel_count))
    matrix = (experiment.field.conductance @ experiment.connection) * wiring.gain
    load[np.ix_(wiring.channel[fed], wiring.channel[fed])] = matrix[np.ix_(fed, fed)]
    return SoftSupply(
        wiring.channel_count,
        clock=clock,
        watchdog=scenario.supply.device.watchdog if watchdog is None else watchdog,
        lowest=-most,
        highest=most,
        conductance=load,
    )


class Simulated(NamedTuple):
    """A simulated bench: the `plant`, its `gel`, the `eye` that sees it, and the `supply` that feeds it."""

    plant: GuardedPlant
    gel: SimulatedGel
    eye: Eye
    supply: SoftSupply


def simulated(
    nominal: Experiment,
    real: Experiment,
    clock: Clock,
    guard_clock: Clock | None = None,
    seed: int = 0,
    on_event: Tell = lambda text: None,
    eye_of: Callable[[SimulatedGel], Eye] | None = None,
    slack: float = LOOP_LATE,
) -> Simulated:
    """A bench whose gel is that of `real`, guarded as the scenario of `nominal` says.

    The gel goes by `clock`, silence is measured by the `guard_clock`, where there is another one. `eye_of` makes what
    sees the gel, if not the simulated eye with the scenario's noise. With more `slack` [s], a busy machine lets the gel
    take its time, where on the bench it would be stopped.
    """
    camera, period = nominal.scenario.camera, nominal.scenario.programme.control_period
    silence = clock if guard_clock is None else guard_clock
    # Where no thread keeps it alive between ticks, it must outlast a period.
    watchdog = max(nominal.scenario.supply.device.watchdog, period + slack)
    supply = soft_supply(nominal, silence, watchdog)
    guard = guard_of(nominal, supply, silence, on_event, clock, slack)
    gel = SimulatedGel(real, lambda: guard.wiring.to_electrodes(supply.outputs()), clock.now())
    if eye_of is None:
        eye: Eye = SimulatedEye(gel, Noise(camera.position_noise, camera.angle_noise), camera.delay, seed)
    else:
        eye = eye_of(gel)
    return Simulated(GuardedPlant(guard, eye, clock), gel, eye, supply)


def real_supply(experiment: Experiment, clock: Clock) -> Supply:
    """The device that the scenario names. Raises `BadInput` and `SupplyFailed`."""
    device = experiment.scenario.supply.device
    if device.kind == "twin":
        return soft_supply(experiment, clock)
    settings = SupplySettings(
        kind=device.kind,
        port=device.port or "",
        baud=device.baud,
        resource=device.resource or "",
        profile=device.profile or "",
        visa_library=device.visa_library,
        device=device.name or "",
        channel_count=device.channel_count,
        timeout=device.timeout,
        watchdog=device.watchdog,
    )
    return open_supply(settings)
