"""Binned empirical correlation against direct sums over pairs."""

import numpy as np
import pytest

from planopt.channel.estimation.lemma1 import BINS, empirical_correlation


def test_equals_a_sum_over_pairs():
    """Bins, mean lags and mean products agree with a double loop over 40 points."""
    rng = np.random.default_rng(0)
    positions, residual = rng.uniform(0, 10, (40, 2)), rng.standard_normal(40)
    extent = float(np.hypot(*np.ptp(positions, axis=0)))
    found = empirical_correlation(positions, residual, extent)
    sums = {}
    for i in range(40):
        for j in range(i):
            lag = np.hypot(*(positions[i] - positions[j]))
            sums.setdefault(int(lag / (extent / BINS)), []).append((lag, residual[i] * residual[j]))
    expected = np.array([np.mean(sums[k], axis=0) for k in sorted(sums)])
    np.testing.assert_allclose(found.lag_m, expected[:, 0])
    np.testing.assert_allclose(found.covariance_db2, expected[:, 1])
    np.testing.assert_array_equal(found.pairs, [len(sums[k]) for k in sorted(sums)])


def test_blocks_do_not_lose_pairs():
    """More points than one block holds: every pair is counted once, the largest lag included."""
    positions = np.random.default_rng(1).uniform(0, 1, (1200, 2))
    positions[:2] = [[0, 0], [1, 1]]
    found = empirical_correlation(positions, np.ones(1200), np.sqrt(2.0))
    assert found.pairs.sum() == 1200 * 1199 / 2
    np.testing.assert_allclose(found.covariance_db2, 1.0)
    assert found.lag_m[-1] == pytest.approx(np.sqrt(2.0), rel=0.02)
