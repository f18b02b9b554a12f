"""Examples are modules, and run here as short as they can: what they print must mean what they say."""

import importlib.util
from pathlib import Path

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
    found = load("scatter").study("dome", changes, runs=2, shift_mm=0.5, turn_deg=3.0, processes=1)
    lines = capsys.readouterr().out.splitlines()
    assert [text.split()[0] for text in lines] == ["1", "2"]
    assert "NOT CONVERGED" not in "".join(lines)
    for one in found:
        assert one.converged
        assert one.summary["t_switch_s"] is None
        assert one.summary["stayed_over_s"] == 0.0
