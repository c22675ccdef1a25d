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


def test_steps(study):
    """Times are of the same order, at any load."""
    law_s, shapely_s = study.step_times(300, 3, 0)
    assert 0.2 < law_s / shapely_s < 20.0
