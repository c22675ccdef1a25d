"""Climbing: to the known optimum, never down, told apart, also where steps are blocked."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.planning.candidates import Budget
from planopt.planning.search.local_ranking import climb_paths, distinct

START = np.array([1.0, -2.0])


def drive(turn, speed):
    """Steps of at most one metre in the open."""
    heading = np.cumsum(turn, axis=0)
    steps = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return START + np.cumsum(steps, axis=0).transpose(1, 0, 2)


def some_ways(horizon, count=9):
    """Ways in all directions."""
    rng = np.random.default_rng(0)
    return drive(rng.uniform(-1, 1, (horizon, count)), rng.uniform(0.4, 0.9, (horizon, count)))


def near(places):
    """Worth: minus the squared distances of all places of a way from given ones."""

    def slope(ways):
        return -((ways - places) ** 2).sum(axis=(1, 2)), -2.0 * (ways - places)

    return slope


def climbed(ways, slope, rounds=(30, 30), followed=(9, 9), move=drive):
    """The climb without limits that matter."""
    return climb_paths(START, ways, 1.0, move, slope, rounds, followed, 0.5)


@pytest.mark.parametrize("horizon", [1, 2, 6])
def test_reachable_places_are_reached(horizon):
    """The worth is 0 where a way is the wanted one, which some way finds."""
    wanted = some_ways(horizon, 1)[0]
    found, worths = climbed(some_ways(horizon), near(wanted))
    assert worths[0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found[0], wanted, atol=1e-3)


def test_a_spent_budget_hands_the_best_ways_on():
    """Nothing climbs any more; the best of what there is comes first."""
    ways, slope = some_ways(4), near(some_ways(4, 1)[0] + 0.3)
    spent = Budget(search_ends_s=0.0)
    found, worths = climb_paths(START, ways, 1.0, drive, slope, (9, 9), (9, 9), 0.5, spent)
    assert worths[0] == slope(ways)[0].max()
    assert all((way == ways).all(axis=(1, 2)).any() for way in found)


def test_places_out_of_reach_are_approached_at_full_speed():
    """The nearest way is straight, every step as long as may be."""
    wanted = START + np.array([3.0, 4.0]) * 100.0 * np.ones((4, 1))
    found, _ = climbed(some_ways(4), near(wanted))
    straight = START + np.arange(1, 5)[:, None] * np.array([0.6, 0.8])
    np.testing.assert_allclose(found[0], straight, atol=2e-2)


def test_no_way_goes_down_and_the_best_comes_first():
    """Even after a single step, and with a worth that is not concave."""

    def slope(ways):
        x = ways[..., 0]
        return np.sin(3.0 * x).sum(axis=1), np.stack([3.0 * np.cos(3.0 * x), 0.0 * x], axis=-1)

    ways = some_ways(5)
    before = slope(ways)[0]
    for rounds in ((0,), (1,), (7,)):
        found, worths = climbed(ways, slope, rounds, (9,))
        assert worths[0] >= before.max()
        assert (np.diff(worths) <= 0.0).all()
        np.testing.assert_array_equal(worths, slope(found)[0])
        for number, way in enumerate(found[1:], start=1):
            assert (np.abs(found[:number] - way).max(axis=(1, 2)) > 0.5).all()


def test_ways_that_are_turned_aside_still_climb():
    """Behind a wall at x = 2 the nearest way to a place beyond it goes up to the wall."""

    def walled(turn, speed):
        ways = drive(turn, speed)
        return np.stack([np.minimum(ways[..., 0], 2.0), ways[..., 1]], axis=-1)

    wanted = np.tile([3.0, -2.0], (3, 1))
    ways = np.minimum(some_ways(3), [2.0, np.inf])
    slope = near(wanted)
    found, worths = climbed(ways, slope, move=walled)
    assert (found[..., 0] <= 2.0).all()
    assert worths[0] > slope(ways)[0].max()


def test_a_worth_that_is_no_number_is_never_taken():
    """Ways that may not be driven are worth minus infinity."""

    def slope(ways):
        worth, by_place = near(START + 2.0)(ways)
        return np.where(ways[:, -1, 1] > -1.0, -np.inf, worth), by_place

    ways = some_ways(3)
    ways = ways[ways[:, -1, 1] < -1.2]
    _, worths = climbed(ways, slope)
    assert np.isfinite(worths).all()


def test_distinct_keeps_the_best_of_each_group():
    """Near ones are left out, in order of worth."""
    ways = np.array([0.0, 0.1, 5.0, 5.1, 9.0])[:, None, None] * np.ones((1, 3, 2))
    kept = distinct(ways, np.array([1.0, 2.0, 7.0, 6.0, 0.0]), 0.5, 2)
    np.testing.assert_array_equal(kept, [2, 1])
