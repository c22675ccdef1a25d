"""Intervals of sampled distributions: coverage, closed forms, ends."""

import numpy as np
import pytest
from scipy.stats import binomtest

from planopt import InputError
from planopt.channel.outage import SampledDistribution


def test_intervals_cover():
    """Of 400 samples of an exponential law at least 92 % of each interval hold the truth."""
    generator = np.random.default_rng(0)
    held = np.zeros(3)
    for _ in range(400):
        sample = SampledDistribution(generator.exponential(1.0, 300))
        found = (sample.mean(), sample.quantile(0.9), sample.exceedance(2.0))
        truth = (1.0, np.log(10.0), np.exp(-2.0))
        held += [part.low <= true <= part.high for part, true in zip(found, truth, strict=True)]
        assert all(part.low <= part.value <= part.high for part in found)
    assert (held >= 0.92 * 400).all()
    assert (held <= 0.99 * 400).all()


@pytest.mark.parametrize("limit", [-1.0, 3.5, 8.9, 20.0])
def test_exceedance_is_scipys(limit):
    """Clopper and Pearson's interval, at the ends too."""
    sample = SampledDistribution(np.arange(10.0))
    above = int((sample.draws > limit).sum())
    expected = binomtest(above, 10).proportion_ci(0.95, method="exact")
    found = sample.exceedance(limit)
    assert found.value == above / 10
    assert found.low == pytest.approx(expected.low, abs=1e-12)
    assert found.high == pytest.approx(expected.high, abs=1e-12)


@pytest.mark.parametrize("draws", [np.zeros(1), np.zeros((3, 2))])
def test_no_distribution(draws):
    """At least two draws of one number."""
    with pytest.raises(InputError, match="at least 2"):
        SampledDistribution(draws)
