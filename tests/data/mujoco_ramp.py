"""Makes mujoco_ramp.npz: where MuJoCo 4 leaves the starfish at the end of the ramp of benchmarks/peer_mujoco.py.

python tests/data/mujoco_ramp.py      with MuJoCo 4 installed (pip install mujoco-core); some minutes
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
MESH_SIZE, TIME_STEP, FLOOR_STIFFNESS = 0.9e-3, 2e-3, 10.0


def main() -> None:
    sys.path[:0] = [str(ROOT / "src"), str(ROOT / "benchmarks")]
    import peer_mujoco as peer  # pyright: ignore[reportMissingImports] - found by the line above

    plant = peer.starfish_plant(MESH_SIZE)
    options = replace(peer.CONVERGED, floor_stiffness=FLOOR_STIFFNESS)
    write(peer.run_ramp(plant, TIME_STEP, options).end, float(plant.stiffness[0]))


def write(end: np.ndarray, stiffness: float) -> None:
    """`end` positions [m], (3, n), to 10 nm; `stiffness` [N/m] of every spring."""
    np.savez_compressed(
        Path(__file__).with_suffix(".npz"),
        made_by="tests/data/mujoco_ramp.py",
        end=np.round(end, 8).astype(np.float32),
        stiffness=stiffness,
        mesh_size=MESH_SIZE,
        time_step=TIME_STEP,
        floor_stiffness=FLOOR_STIFFNESS,
    )


if __name__ == "__main__":
    main()
