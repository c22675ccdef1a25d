"""Steps of searches for connection, and that these end: ``connect_search.py``, few starts."""

from __future__ import annotations

import pytest
from connect_search import searches

from planopt import load


@pytest.mark.parametrize("name", ["connect_rooftop", "connect_street"])
def test_searches_connect(benchmark, name):
    """From two seeded starts of each library problem, one step ahead."""
    problem = load(name)
    found = benchmark.pedantic(lambda: list(searches(problem, [1], 2, 5)), rounds=1)
    assert [search.outcome for search in found] == ["completed"] * 2
    # docs/results.md has ratios of up to 3.2 for starts of a street.
    assert sum(search.driven_m for search in found) < 3.5 * sum(own.shortest_m for own in found)


def test_the_plain_search_connects(benchmark):
    """What searches are compared with, from one start."""
    problem = load("connect_rooftop")
    found = benchmark.pedantic(lambda: list(searches(problem, [], 1, 5, plain=True)), rounds=1)
    assert [search.outcome for search in found] == ["completed"]
    assert len(found[0].step_s) * problem.step_length_m >= found[0].driven_m
