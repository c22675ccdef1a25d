"""Ratios over groups and reliability tables: known cases, and how often intervals hold."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from planopt.channel.calibration import (
    EDGES,
    FEWEST_GROUPS,
    grouped_ratio,
    reliability,
    share_interval,
)


def test_groups_of_one_size_are_students_interval():
    """The interval of a mean of group means; the root is of all three, and no share below zero."""
    means = np.array([0.91, 0.95, 0.93, 0.99, 0.90])
    found = grouped_ratio(means * 40.0, np.full(5, 40.0))
    low, high = stats.t.interval(0.95, 4, means.mean(), stats.sem(means))
    assert found.value == pytest.approx(means.mean())
    assert (found.low, found.high) == pytest.approx((low, high))
    found = grouped_ratio(np.array([0.0, 9.0]), np.array([1.0, 1.0]))
    assert found.low == 0.0
    root = found.root()
    assert (root.value, root.low, root.high) == pytest.approx((4.5**0.5, 0.0, found.high**0.5))


def test_interval_holds_where_members_belong_together():
    """Errors that a group shares: the interval holds, one that counts members would not."""
    generator = np.random.default_rng(0)
    held, naive = 0, 0
    for _ in range(400):
        size = generator.integers(20, 60, 25).astype(float)
        shared = generator.standard_normal(25) * 0.3
        found = grouped_ratio((1.0 + shared) * size, size)
        held += found.low <= 1.0 <= found.high
        naive += abs(found.value - 1.0) <= 1.96 * 0.3 / np.sqrt(size.sum())
    assert 0.91 <= held / 400 <= 0.98
    assert naive / 400 < 0.5


def test_bins_partition_the_predictions():
    """Every prediction is in one bin, on an edge in the upper one, NaN in none."""
    generator = np.random.default_rng(0)
    predicted = np.concatenate([generator.uniform(size=500), EDGES, [np.nan]])
    realised = generator.uniform(size=len(predicted)) < 0.5
    groups = np.arange(len(predicted)) % 7
    bins = reliability(predicted, realised, groups)
    assert [(one.low, one.high) for one in bins] == list(pairwise(EDGES))
    assert sum(one.count for one in bins) == 500 + len(EDGES)
    for one in bins:
        inside = (predicted >= one.low) & (predicted < one.high)
        if one.high == 1.0:
            inside |= predicted == 1.0
        assert one.count == inside.sum()
        assert one.groups == len(set(groups[inside]))
        assert one.predicted == pytest.approx(predicted[inside].mean())
        assert one.realised == pytest.approx(realised[inside].mean())


def test_no_interval_from_few_groups():
    """Four runs give none, five do, however many steps each has."""
    for groups in (FEWEST_GROUPS - 1, FEWEST_GROUPS):
        count = 20 * groups
        [one] = reliability(np.full(count, 0.9), np.arange(count) % 10 != 0, np.arange(count) // 20)
        assert (one.interval is None) == (groups < FEWEST_GROUPS)
        assert (one.agrees is None) == (one.interval is None)


def test_intervals_of_shares():
    """Exact binomial for one outcome a group; runs connected throughout count as groups."""
    groups, hits = 40, 31
    low, high = share_interval(np.arange(groups) < hits, np.ones(groups))
    exact = stats.binomtest(hits, groups).proportion_ci(0.95, method="exact")
    fewer = stats.beta.ppf(
        [0.025, 0.975], [hits * 39 / 40, hits * 39 / 40 + 1], [9 * 39 / 40 + 1, 9 * 39 / 40]
    )
    assert (low, high) == pytest.approx(tuple(fewer))
    assert low < exact.low and high > exact.high
    low, high = share_interval(np.full(20, 50.0), np.full(20, 50.0))
    assert high == 1.0
    worth = 20 * (stats.t.ppf(0.975, 999) / stats.t.ppf(0.975, 19)) ** 2
    assert low == pytest.approx(0.025 ** (1.0 / worth))
    assert share_interval(np.zeros(20), np.full(20, 50.0)) == pytest.approx((0.0, 1.0 - low))


@pytest.mark.parametrize("share", [0.7, 0.995])
@pytest.mark.parametrize("together", [0.0, 0.3])
def test_interval_holds_where_steps_belong_together(share, together):
    """Runs that share their luck (Gaussian copula): 95 % of intervals hold the truth, or more."""
    generator = np.random.default_rng(int(1e4 * share + 10 * together))
    held = ordinary = 0
    for _ in range(400):
        sizes = 1.0 + generator.poisson(15, 20)
        luck = generator.standard_normal(20) * np.sqrt(together)
        chance = stats.norm.cdf((stats.norm.ppf(share) - luck) / np.sqrt(1.0 - together))
        connected = generator.binomial(sizes.astype(int), chance).astype(float)
        low, high = share_interval(connected, sizes)
        held += low <= share <= high
        counted = stats.binomtest(int(connected.sum()), int(sizes.sum())).proportion_ci(0.95)
        ordinary += counted.low <= share <= counted.high
    assert held >= 0.93 * 400
    if together and share < 0.99:
        assert ordinary < 0.85 * 400
