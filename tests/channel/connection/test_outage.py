"""Longest outage and delivered data: enumeration, stretches one by one, conservation."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.stats import binomtest
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    Traffic,
    condition,
    delivered_data,
    joint_prediction,
    longest_outage,
)
from planopt.channel.joint import SampledDistribution, longest_run, sent_and_lost
from planopt.channel.path_connectivity import prefix_probabilities

CHANNEL = ChannelParameters(-30.0, 3.0, 5.0, 15.0, 1.5, Station((0.0, 0.0)))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
PATH = np.column_stack([np.linspace(60.0, 30.0, 7), 40.0 + 10.0 * np.cos(np.arange(7.0))])
TIMES = np.array([0.0, 1.0, 2.5, 3.0, 5.0, 6.0, 9.0])
LEGS = np.hypot(*np.diff(PATH, axis=0).T)
THRESHOLD = -82.0


def rng():
    return np.random.default_rng(3)


def independent():
    """A channel whose places are independent, and their probabilities after the first."""
    channel = dataclasses.replace(CHANNEL, shadow_std_db=0.0, multipath_std_db=6.0)
    posterior = condition(channel, NOTHING, theta="known")
    return posterior, posterior.connectivity(PATH, THRESHOLD)[1:]


def test_independent_places_by_enumeration():
    """Expected values and tails over all 2^6 outcomes, in metres, seconds and bits."""
    posterior, chance = independent()
    traffic = Traffic(link_bps=2.0, waiting_bits=9.0)
    drives = np.array(list(itertools.product([False, True], repeat=6)))
    weight = np.where(drives, chance, 1.0 - chance).prod(axis=1)
    padded = np.column_stack([np.zeros(len(drives), dtype=bool), drives])
    found = longest_outage(posterior, PATH, TIMES, THRESHOLD, 40_000, rng())
    sent = delivered_data(posterior, PATH, TIMES, THRESHOLD, traffic, 9.0, 40_000, rng())
    exact = [
        (found.metres, longest_run(LEGS, ~padded[:, 1:])),
        (found.seconds, longest_run(np.diff(TIMES), ~padded[:, 1:])),
        (sent.delivered_bits, np.minimum(9.0, 2.0 * (drives @ np.diff(TIMES)))),
    ]
    for sampled, values in exact:
        mean = sampled.mean()
        assert abs(mean.value - weight @ values) < 2.0 * (mean.high - mean.low)
        limit = float(np.median(values)) + 0.01
        tail = sampled.exceedance(limit)
        expected = weight[values > limit].sum()
        assert abs(tail.value - expected) < 2.0 * (tail.high - tail.low)


def test_never_connected_is_the_joint_probability():
    """P(the outage is the whole path) and P(nothing delivered) by the multivariate normal."""
    posterior = condition(CHANNEL, simulated(CHANNEL, 1, 10, 60.0))
    prediction = joint_prediction(posterior, PATH[1:])
    out = prefix_probabilities(
        THRESHOLD - prediction.mean_db, prediction.covariance_db2, rng()
    ).probability[-1]
    assert 0.01 < out < 0.99
    whole = longest_outage(posterior, PATH, TIMES, THRESHOLD, 40_000, rng())
    sent = delivered_data(posterior, PATH, TIMES, THRESHOLD, Traffic(1.0, 5.0), 9.0, 40_000, rng())
    error = 4.0 * np.sqrt(out * (1.0 - out) / 40_000) + 2e-4
    assert abs(whole.metres.exceedance(LEGS.sum() - 1e-6).value - out) < error
    assert abs(whole.seconds.exceedance(9.0 - 1e-6).value - out) < error
    assert abs(1.0 - sent.delivered_bits.exceedance(0.0).value - out) < error


def test_deadline_cuts():
    """Later deadlines deliver more, drive by drive; at the start nothing is delivered."""
    posterior, _ = independent()
    earlier, later, start = (
        delivered_data(
            posterior, PATH, TIMES, THRESHOLD, Traffic(1.0, 100.0), deadline, 500, rng()
        ).delivered_bits.draws
        for deadline in (4.0, 9.0, 0.0)
    )
    assert (earlier <= later).all()
    assert earlier.max() <= 4.0
    assert earlier.mean() < later.mean()
    assert (start == 0.0).all()


def by_small_steps(durations, drive, traffic, step=1e-3):
    waiting, delivered = traffic.waiting_bits, 0.0
    for duration, now in zip(durations, drive[1:], strict=True):
        for _ in range(round(duration / step)):
            waiting += traffic.source_bps * step
            sent = min(waiting, traffic.link_bps * step) if now else 0.0
            delivered += sent
            waiting = min(waiting - sent, traffic.buffer_bits)
    return delivered, waiting


@pytest.mark.parametrize(
    "traffic",
    [
        Traffic(3.0, waiting_bits=2.0, source_bps=1.0, buffer_bits=4.0),
        Traffic(1.0, source_bps=2.0, buffer_bits=3.0),
        Traffic(5.0, waiting_bits=20.0),
        Traffic(2.0, source_bps=2.0, buffer_bits=0.0),
    ],
)
def test_fluid_against_small_steps(traffic):
    """Links faster and slower than the source, with and without a buffer."""
    drives = np.random.default_rng(0).random((4, len(TIMES))) < 0.5
    delivered, lost, waiting = sent_and_lost(np.diff(TIMES), drives, traffic)
    for number, drive in enumerate(drives):
        expected = by_small_steps(np.diff(TIMES), drive, traffic)
        assert delivered[number] == pytest.approx(expected[0], abs=0.02)
        assert waiting[number] == pytest.approx(expected[1], abs=0.02)
    total = traffic.waiting_bits + traffic.source_bps * 9.0
    np.testing.assert_allclose(delivered + lost + waiting, total)
    assert (lost >= 0.0).all()


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
