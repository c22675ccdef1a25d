"""Longest outage and delivered data: enumeration, the closed loop's metric, conservation."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated_channel import simulated

from planopt import InputError
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
from planopt.channel.outage import longest_runs
from planopt.channel.path_connectivity import prefix_probabilities
from planopt.planning.loop.metrics import longest_outage_m

CHANNEL = ChannelParameters(-30.0, 3.0, 5.0, 15.0, 1.5, Station((0.0, 0.0)))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
PATH = np.column_stack([np.linspace(60.0, 30.0, 7), 40.0 + 10.0 * np.cos(np.arange(7.0))])
TIMES = np.array([0.0, 1.0, 2.5, 3.0, 5.0, 6.0, 9.0])
LEGS = np.hypot(*np.diff(PATH, axis=0).T)
THRESHOLD = -82.0


def rng():
    """A fresh source."""
    return np.random.default_rng(3)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(2, 12))
def test_runs_are_the_closed_loops_metric(seed, count):
    """Each drive as planopt.planning.loop.metrics counts it."""
    generator = np.random.default_rng(seed)
    legs = generator.uniform(0.0, 5.0, count - 1)
    connected = generator.random((5, count)) < 0.5
    expected = [longest_outage_m(legs, drive[1:]) for drive in connected]
    np.testing.assert_allclose(longest_runs(legs, connected), expected)


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
        (found.metres, longest_runs(LEGS, padded)),
        (found.seconds, longest_runs(np.diff(TIMES), padded)),
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


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"positions_m": PATH[:1]}, "positions_m"),
        ({"times_s": TIMES[:-1]}, "times_s"),
        ({"times_s": TIMES[::-1]}, "times_s"),
        ({"times_s": np.where(TIMES > 5.0, np.nan, TIMES)}, "times_s"),
        ({"threshold_dbm": np.nan}, "threshold_dbm"),
        ({"count": 1}, "count"),
        ({"count": 0}, "count"),
    ],
)
def test_bad_arguments(changes, named):
    """The argument is named."""
    arguments = {
        "positions_m": PATH,
        "times_s": TIMES,
        "threshold_dbm": THRESHOLD,
        "count": 10,
        "generator": rng(),
    }
    with pytest.raises(InputError, match=named):
        longest_outage(independent()[0], **{**arguments, **changes})


@pytest.mark.parametrize("deadline", [-1.0, 9.5, np.nan])
def test_deadline_off_the_path(deadline):
    """What happens after the path's end is not guessed."""
    with pytest.raises(InputError, match="deadline_s"):
        delivered_data(independent()[0], PATH, TIMES, THRESHOLD, Traffic(1.0), deadline, 10, rng())
