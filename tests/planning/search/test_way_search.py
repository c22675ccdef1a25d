"""Bending ways: what it finds is never worse, the same for the same seed, and told apart."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.planning.candidates import Budget
from planopt.planning.search.way_search import commands_of, distinct, search_ways

START = np.array([1.0, -2.0])


def drive(turn, speed):
    """Steps of at most one metre in the open."""
    heading = np.cumsum(turn, axis=0)
    steps = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return START + np.cumsum(steps, axis=0).transpose(1, 0, 2)


def some_ways(horizon, count=9):
    """Ways in all directions."""
    rng = np.random.default_rng(0)
    return drive(rng.uniform(-2, 2, (horizon, count)), rng.uniform(0.2, 1.0, (horizon, count)))


def near(place):
    """Worth: how near the last place is to a place."""
    return lambda ways: -np.linalg.norm(ways[:, -1] - place, axis=1)


@pytest.mark.parametrize("horizon", [1, 2, 9])
def test_commands_drive_the_ways(horizon):
    """Turns and speeds are read off and driven again."""
    ways = some_ways(horizon)
    ways[0, -1] = ways[0, -2] if horizon > 1 else START
    np.testing.assert_allclose(drive(*commands_of(START, ways, 1.0)), ways, atol=1e-12)


@pytest.mark.parametrize("horizon", [1, 6])
def test_search_improves(horizon):
    """The best is better than at the start and comes first; what is found is told apart."""
    ways, value = some_ways(horizon), near(START + 0.4 * horizon)
    found, worths = search_ways(START, ways, 1.0, drive, value, np.random.default_rng(1))
    assert worths[0] > value(ways).max()
    np.testing.assert_allclose(worths, value(found))
    assert (np.diff(worths) <= 0.0).all()
    for number, way in enumerate(found[1:], start=1):
        assert (np.abs(found[:number] - way).max(axis=(1, 2)) > 0.5).all()


def test_best_way_stays():
    """A way that nothing is better than is found again."""
    best = drive(np.zeros((4, 1)), np.ones((4, 1)))
    ways = np.concatenate([some_ways(4), best])
    found, _ = search_ways(START, ways, 1.0, drive, near(best[0, -1]), np.random.default_rng(1))
    np.testing.assert_array_equal(found[0], best[0])


def test_a_spent_budget_hands_the_best_ways_on():
    """Nothing is bent any more; the best of what there is comes first."""
    ways, value = some_ways(5), near(START + 2.0)
    spent = Budget(search_ends_s=0.0)
    found, worths = search_ways(START, ways, 1.0, drive, value, np.random.default_rng(1), spent)
    assert worths[0] == value(ways).max()
    assert all((way == ways).all(axis=(1, 2)).any() for way in found)


def test_same_seed_finds_the_same():
    """To the last bit."""
    ways, value = some_ways(5), near(START + 3.0)
    once, again = (
        search_ways(START, ways, 1.0, drive, value, np.random.default_rng(4))[0] for _ in range(2)
    )
    np.testing.assert_array_equal(once, again)


def test_distinct_keeps_the_best_of_each_group():
    """Near ones are left out, in order of worth."""
    ways = np.array([0.0, 0.1, 5.0, 5.1, 9.0])[:, None, None] * np.ones((1, 3, 2))
    kept = distinct(ways, np.array([1.0, 2.0, 7.0, 6.0, 0.0]), 0.5, 2)
    np.testing.assert_array_equal(kept, [2, 1])
