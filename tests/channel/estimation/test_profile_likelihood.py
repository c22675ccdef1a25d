"""Profiles against brute force, the fit, and the coverage of their intervals."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import minimize
from simulated_channel import simulated

from planopt.channel.estimation.covariance_fit import covariance_bounds
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.least_squares import least_squares
from planopt.channel.estimation.likelihood_data import likelihood_data
from planopt.channel.estimation.profile import CUT_95, Profile
from planopt.channel.estimation.profile_likelihood import (
    profile_likelihood,
    profiles_around,
)
from planopt.channel.estimation.restricted_likelihood import evaluate
from planopt.channel.parameters import ChannelParameters, Station, mean_model
from planopt.errors import InputError

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((50.0, 50.0), 10.0))
NAMES = ("shadow_std_db", "multipath_std_db", "decorrelation_m")


def brute_force(measurements, parameter, value):
    """The largest log likelihood with one parameter fixed, from many starts by another method."""
    axis = NAMES.index(parameter)
    model = mean_model(measurements.positions_m, ~measurements.censored, CHANNEL.station, True)
    limits = examine(measurements, CHANNEL.station).decorrelation_bounds_m
    bounds = covariance_bounds(least_squares(model, measurements).variance_db2, limits)
    box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
    data = likelihood_data(model, measurements, CHANNEL)
    others = [i for i in range(3) if i != axis]
    fixed = math.log(value) * (1.0 if axis == 2 else 2.0)

    def loss(free):
        logs = np.insert(free, axis, fixed)
        return -evaluate(data, tuple(np.exp(logs))).log_likelihood

    grid = [np.linspace(*box[i], 6)[1:-1] for i in others]
    starts = [np.array([a, b]) for a in grid[0] for b in grid[1]]
    return -min(
        minimize(loss, start, method="Nelder-Mead", bounds=box[others], options={"xatol": 1e-5}).fun
        for start in starts
    )


@pytest.mark.parametrize("parameter", NAMES)
def test_is_the_largest_likelihood_over_the_others(parameter):
    """At each value the profile is what a search over the other two from sixteen starts finds."""
    measurements = simulated(CHANNEL, 1, 40, 300.0)
    values = getattr(CHANNEL, parameter) * np.array([0.4, 1.0, 1.7])
    found = profile_likelihood(measurements, CHANNEL.station, parameter, values)
    for value in values:
        at = found.log_likelihood[np.argmin(np.abs(found.values - value))]
        assert at == pytest.approx(brute_force(measurements, parameter, value), abs=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_top_is_the_fit(share):
    """Each profile's largest value is at the fit's estimate and is the fit's log likelihood."""
    measurements = simulated(CHANNEL, 2, 80, 300.0, share)
    fit = fit_channel(measurements, CHANNEL.station)
    for profile in profiles_around(measurements, CHANNEL.station):
        estimate = getattr(fit.parameters, profile.parameter)
        assert profile.estimate == pytest.approx(estimate, rel=1e-2)
        assert profile.log_likelihood.max() == pytest.approx(fit.log_likelihood, abs=1e-3)
        assert (np.diff(profile.values) > 0.0).all()
        assert profile.measurements == 80


def test_rounded_powers():
    """Whole 6 dB steps: the profile is of the likelihood of intervals, as the fit's."""
    exact = simulated(CHANNEL, 3, 60, 300.0)
    rounded = dataclasses.replace(
        exact, power_dbm=6.0 * np.round(exact.power_dbm / 6.0), resolution_db=np.full(60, 6.0)
    )
    fit = fit_channel(rounded, CHANNEL.station)
    found = profile_likelihood(rounded, CHANNEL.station, "shadow_std_db", np.array([4.0, 9.0]))
    assert found.log_likelihood.max() == pytest.approx(fit.log_likelihood, abs=1e-2)


def test_intervals_cover_the_truth():
    """Over channels the 95 % intervals of all three contain the truth about that often."""
    inside = []
    for seed in range(30):
        measurements = simulated(CHANNEL, 50 + seed, 70, 150.0)
        for profile in profiles_around(measurements, CHANNEL.station):
            low, high = profile.interval_95()
            assert low <= profile.estimate <= high
            inside.append(low <= getattr(CHANNEL, profile.parameter) <= high)
    assert np.mean(inside) > 0.88


def test_interval_of_a_normal_likelihood():
    """A parabola in the logarithm has its cut where it is, between the values too."""
    values = 2.0 * np.exp(np.array([-1.0, -0.4, 0.0, 0.3, 1.1]))
    drop = -0.5 * (np.log(values / 2.0) / 0.25) ** 2
    profile = Profile("decorrelation_m", values, drop - 7.0, 2.0, 10)
    expected = 2.0 * np.exp(np.array([-1.0, 1.0]) * 0.25 * math.sqrt(2.0 * CUT_95))
    np.testing.assert_allclose(profile.interval_95(), expected, rtol=1e-12)
    fine, curve = profile.curve(50)
    np.testing.assert_allclose(curve, -0.5 * (np.log(fine / 2.0) / 0.25) ** 2, atol=1e-12)
    inner = Profile("decorrelation_m", values[1:4], 0.1 * drop[1:4], 2.0, 10)
    assert inner.interval_95() == (0.0, math.inf)


@pytest.mark.parametrize(
    ("parameter", "values", "words"),
    [
        ("n_pl", [2.0], "no profile"),
        ("decorrelation_m", [0.0, 3.0], "not positive"),
        ("decorrelation_m", [math.inf], "not positive"),
    ],
)
def test_what_has_no_profile(parameter, values, words):
    """Other parameters, and values that no parameter can have."""
    measurements = simulated(CHANNEL, 5, 30, 300.0)
    with pytest.raises(InputError, match=words):
        profile_likelihood(measurements, CHANNEL.station, parameter, np.array(values))


def test_too_few_measurements():
    """Where the fit assumes the covariance there is nothing to profile."""
    with pytest.raises(InputError, match="no likelihood"):
        profiles_around(simulated(CHANNEL, 6, 4, 300.0), CHANNEL.station)
