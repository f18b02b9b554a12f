"""snapshots.png, the paper's Fig. 7(b): the body at eight moments."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gelbot.show.gel_view import GelView, Scene
from gelbot.show.plan_view import PlanView
from gelbot.show.style import SETTINGS, add_colour_bars, drawable, is_rhythm, new_figure, phase_name, save

COUNT = 8


def draw_snapshots(run: xr.Dataset, path: Path) -> Path:
    """Write the figure of `run` to the PNG file `path`."""
    run = drawable(run)
    scene = Scene.of(run)
    time, phase = run["time"].values, run["phase"].values
    switch = int(np.argmax(phase >= 1)) if phase.max() >= 1 and not is_rhythm(run) else None
    with matplotlib.rc_context(SETTINGS):
        figure = new_figure(12.0, 7.0, 130)
        for place, k in enumerate(moments(run)):
            left, bottom = 0.005 + 0.2475 * (place % 4), 0.56 - 0.44 * (place // 4)
            view = GelView(figure, (left, bottom, 0.2425, 0.33), scene, labels=False)
            plan = PlanView(figure.add_axes((left + 0.174, bottom + 0.305, 0.066, 0.1131)), scene, labels=False)
            view.show(int(k))
            plan.show(int(k))
            title = f"{time[k]:.1f} s   {'switch' if k == switch else phase_name(run, int(phase[k]))}"
            figure.text(left + 0.008, bottom + 0.385, title, fontsize=11.5, weight="bold")
        bars = [(0.05, 0.045, 0.24, 0.02), (0.37, 0.045, 0.24, 0.02)]
        add_colour_bars(figure, scene.limit, scene.most_adsorption, bars, size=10.0)
        note = "floor marks every 5 mm; arrow: normal of the body's\nupper side; inset: the array from above"
        figure.text(0.67, 0.035, note)
        return save(figure, path)


def moments(run: xr.Dataset) -> NDArray[np.int64]:
    """The numbers of eight frames, in order of time (a short run gives fewer).

    With a switch: the start, two during preparation, the switch, three as the normal turns by equal parts, and the end.
    Without one: eight at equal distances. Where the phases are a rhythm: seven until it ends, and the end.
    """
    count = run.sizes["time"]
    even = np.unique(np.round(np.linspace(0, count - 1, COUNT)).astype(int))
    phase = run["phase"].values
    if phase.max() < 1 or count <= COUNT:
        return even
    if is_rhythm(run):
        last = int(np.flatnonzero(np.diff(phase))[-1]) + 1
        return np.unique([*np.round(np.linspace(0, last, COUNT - 1)).astype(int), count - 1])
    switch = int(np.argmax(phase >= 1))
    angle = np.degrees(np.arccos(np.clip(run["normal"].transpose("time", "space").values[:, 2], -1.0, 1.0)))[switch:]
    # The angle is followed up to its largest value: a body that falls back is seen at its furthest.
    furthest = int(np.argmax(angle > angle.max() - 2.0))
    parts = [int(np.argmax(angle >= share * angle[furthest])) for share in (0.35, 0.65, 1.0)]
    chosen = {0, switch // 3, 2 * switch // 3, switch, *(switch + p for p in parts), count - 1}
    # Moments that coincide (a switch at once, no turning at all) are replaced by the middle of the longest gap.
    while len(chosen) < COUNT:
        ordered = sorted(chosen)
        gaps = np.diff(ordered)
        widest = int(np.argmax(gaps))
        chosen.add(ordered[widest] + int(gaps[widest]) // 2)
    return np.array(sorted(chosen))
