"""Examples are modules, and run here as short as they can: what they print must mean what they say."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_scatter_of_a_dome(capsys: pytest.CaptureFixture[str]) -> None:
    changes = ['simulation.duration="1 s"', 'body.mesh_size="1.5 mm"']
    found = load("scatter").study("dome", changes, runs=2, shift_mm=0.5, turn_deg=3.0, seed=1)
    assert len(capsys.readouterr().out.splitlines()) == len(found) == 2
    for one in found:
        assert one.converged
        assert np.isnan(one.switch)
        assert one.stayed == 0.0


def test_a_moved_start_is_a_rigid_motion() -> None:
    scatter = load("scatter")
    experiment = scatter.build(scatter.load("dome", ['body.mesh_size="1.5 mm"']).scenario)
    before = np.asarray(experiment.state.positions)
    after = np.asarray(scatter.moved(experiment, np.array([1e-3, -2e-3]), np.radians(30.0)))
    assert after[2] == pytest.approx(before[2])
    assert after.mean(axis=1) - before.mean(axis=1) == pytest.approx([1e-3, -2e-3, 0.0], abs=1e-6)
    first, last = before[:, :1] - before, after[:, :1] - after
    assert np.linalg.norm(last, axis=0) == pytest.approx(np.linalg.norm(first, axis=0), abs=1e-12)
