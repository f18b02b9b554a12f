"""How long a picture takes: silhouette, examples, fit, on one core; and what it costs to begin.

python benchmarks/camera.py               a table, half a minute

The video is rendered from a simulated turn-over, watched from the side and from above. A picture's time is that of the
processor, on one core: what else the machine does is not counted.
"""

from __future__ import annotations

import os
import time
from typing import Any

# Before anything counts the cores.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402

MM, DEG = 1e-3, np.pi / 180.0
TARGET = 1e3 / 30.0
"""Milliseconds a picture may take at 30 pictures a second."""
FASTEST = 1.0 / 30.0


def row(name: str, value: float, unit: str, target: float | None = None, note: str = "") -> dict[str, Any]:
    return {"name": name, "value": float(value), "unit": unit, "target": target, "note": note}


def simulated(p_ele: float) -> tuple[Any, Any]:
    """Time [s] and positions [m] of a planned turn-over, and its experiment."""
    import jax

    from gelbot.controllers.choice import with_controller
    from gelbot.ensemble import experiment_of
    from gelbot.run import march
    from gelbot.scenario import load
    from gelbot.scenario.build import disturbed

    loaded = with_controller(load("turn-over", ["simulation.duration=24 s"]), "planned")
    experiment = experiment_of(loaded, {"material.p_ele": f"{p_ele} cm^2/mA"})
    model = disturbed(experiment, experiment.model, experiment.state.positions)
    times = {"wall_s": 0.0, "compile_s": 0.0}
    chunks = list(march(experiment, model, experiment.state, {}, times, at_once=True))
    frames = jax.tree.map(lambda *parts: np.concatenate(parts), *chunks)
    return experiment, (np.asarray(frames.time), np.asarray(frames.positions))


def rows() -> list[dict[str, Any]]:
    import cv2

    from gelbot.body.tips import tips_of
    from gelbot.hardware.calibration import Calibration
    from gelbot.hardware.habits import habits_of, together
    from gelbot.hardware.rendered import Light, render
    from gelbot.hardware.segment import mean_picture
    from gelbot.hardware.tracking import Tracker, flat_pose
    from gelbot.hardware.umbrella import Mesh, umbrella_of

    cv2.setNumThreads(1)
    experiment, (when, positions) = simulated(0.02)
    body, pose = experiment.body, experiment.scenario.body.pose
    side = np.where(body.nodes[2] > body.thickness / 2.0, 0.5, -0.5) * body.thickness
    outline, tips = body.outline.points.T, tips_of(body.outline).points.T
    sheet = umbrella_of(outline, body.thickness, tips, Mesh(body.nodes[:2], side, body.faces))
    start = flat_pose(sheet, (float(pose.position[0]), float(pose.position[1])), float(pose.heading))
    begun = time.perf_counter()
    examples = [habits_of(sheet, simulated(p)[1][1][::2], start) for p in (0.0175, 0.0185, 0.0215, 0.0225)]
    habits = together(*examples)
    made = time.perf_counter() - begun
    found = [
        row("camera: examples from four runs", made, "s", note=f"simulated and laid through; {len(habits.centre[0])}")
    ]

    rng, light = np.random.default_rng(0), Light()
    nothing = (np.zeros((3, 0)), np.zeros((3, 0), np.int64))
    views: tuple[tuple[str, Any, float], ...] = (("side", 4 * MM, 0.0), ("above", 0.0, 90 * DEG))
    for view, height, elevation in views:
        place = (14 * MM, 14 * MM, float(height))
        camera = Calibration(view, -45 * DEG, elevation, 0.0, place, 150 * MM, 16e3, 0.0, 640, 480)  # pyright: ignore
        empty = mean_picture([render(*nothing, camera, light, rng) for _ in range(4)])
        for known, name in ((habits, "with examples"), (None, "without")):
            tracker = Tracker(sheet, camera, start, empty, known)
            tracker.scene.prepare()
            took, lost = [], 0
            for k in range(len(when)):
                picture = render(positions[k], body.faces, camera, light, rng)
                begun = time.thread_time()
                seen = tracker.look(picture, 0.1 + k * FASTEST)
                took.append(1e3 * (time.thread_time() - begun))
                lost += seen.lost
            note = f"95 %: {np.quantile(took, 0.95):.1f} ms; lost {lost} of {len(took)}; 640 x 480"
            found.append(row(f"camera: a picture from {view}, {name}", float(np.median(took)), "ms", TARGET, note))
    return found


if __name__ == "__main__":
    for one in rows():
        print(f"{one['name']:48} {one['value']:8.2f} {one['unit']:3} {one['note']}")
