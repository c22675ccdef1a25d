"""The interval of a ratio over groups: known cases, and how often it holds."""

import numpy as np
import pytest
from scipy import stats

from planopt import InputError
from planopt.channel.calibration import grouped_ratio


def test_groups_of_one_size_are_students_interval():
    """Equal denominators make it the ordinary interval of a mean of group means."""
    means = np.array([0.91, 0.95, 0.93, 0.99, 0.90])
    found = grouped_ratio(means * 40.0, np.full(5, 40.0))
    low, high = stats.t.interval(0.95, 4, means.mean(), stats.sem(means))
    assert found.value == pytest.approx(means.mean())
    assert (found.low, found.high) == pytest.approx((low, high))


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


def test_root_and_floor():
    """The root is of all three; no share is below zero."""
    found = grouped_ratio(np.array([0.0, 9.0]), np.array([1.0, 1.0]))
    assert found.low == 0.0
    root = found.root()
    assert (root.value, root.low, root.high) == pytest.approx((4.5**0.5, 0.0, found.high**0.5))


@pytest.mark.parametrize(("over", "under"), [([1.0], [2.0]), ([0.0, 0.0], [0.0, 0.0]), ([], [])])
def test_no_interval(over, under):
    """One group, or nothing to divide by."""
    with pytest.raises(InputError):
        grouped_ratio(np.array(over), np.array(under))
