"""The study of random networks, cut short."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(autouse=True)
def study(monkeypatch):
    """The study's module."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return import_module("network_cases")


@pytest.mark.parametrize("seed", [2, 3])
def test_teams(study, seed):
    """Both partitions end with the team asked for and a centroidal rest."""
    assert study.team_case(seed) == (True, True)


def test_counts(study):
    """The bound is kept in every graph, and half of it does not always do."""
    found = [study.graph_case(seed) for seed in range(40)]
    assert all(exact for exact, _ in found)
    assert not all(half for _, half in found)


def test_gaps(study):
    """Deferred acceptance is never better than the least total distance, and seldom much worse."""
    gaps = [study.gap_case(seed) for seed in range(40)]
    assert min(gaps) >= -1e-12 and 0.0 < max(gaps) < 1.0
    assert sum(gaps) / 40 < 0.2


def test_steps(study):
    """Times are of the same order, at any load."""
    law_s, shapely_s = study.step_times(300, 3, 0)
    assert 0.2 < law_s / shapely_s < 20.0


def test_localisation(study):
    """From the ring the bound is met and goes on falling; by the law it nearly stops."""
    found = study.localisation(1, 4, 24)
    for agents in (3, 6):
        assert 0.3 < found[f"{agents} ring"][1] < 2.0
        # Bounds half-way and at the end.
        assert found[f"{agents} ring"][3] < 0.8 * found[f"{agents} ring"][2]
        assert found[f"{agents} law"][3] > 0.8 * found[f"{agents} law"][2]
        assert found[f"{agents} law"][3] > 2.0 * found[f"{agents} ring"][3]
