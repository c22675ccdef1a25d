"""A small run of every study of benchmarks/network_control.py."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_studies_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """No move is at fault, and more starts are no worse than runs of Lloyd's method."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import network_control  # pyright: ignore[reportMissingImports]

    try:
        assert network_control.faults(0, 5, 9, 4) == 0
        assert network_control.failures(100, 1, 6)[network_control.QUIET][0] < 1.1
        assert network_control.optima(1, 1, 5)[0] < 1.02
        compared = network_control.horizons(0, 2, 9, 40)
        moving = network_control.moving(0, 2, 9, 6)
        packed = network_control.packing(0, 1, 60)
        crowded = network_control.packing(0, 1, 60, packed=False)
        times = network_control.steps(64, 1)
    finally:
        sys.modules.pop("network_control")
    # With a horizon the network spreads at a lower cost.
    assert compared["speed 5"][0] < 1.0 and compared["acceleration 5"][0] < 1.0
    assert moving["speed held 10"] == pytest.approx([1.0] * 4)
    assert moving["speed led 3"][0] < 1.0
    # Bodies that swap places end near the tightest packing, those that all want the middle do not.
    assert packed["3"][1] < 1.1 and packed["7"][1] < 1.1 and packed["12"][1] < 1.4
    assert all(packed[key][0] < crowded[key][0] + 0.05 for key in packed)
    assert crowded["3"][0] > 1.5
    assert set(times) > {"diagram", "targets"}
