"""How well the station's position is known: closed forms, simulation, and what is not bounded."""

import dataclasses
import math

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station, fit_channel_and_station
from planopt.channel.estimation.station_fit import (
    joint_covariance_m2,
    line_covariance_m2,
    losses,
    position_covariance_m2,
    station_surface,
    theta_by_position,
)
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 3.0, 20.0, 1.0, Station((130.0, 70.0), 10.0))

RADII_M = (40.0, 80.0)
ON_A_RING = 24
WHITE = ChannelParameters(-40.0, 3.0, 0.0, 1.0, 0.3, Station((5.0, -7.0)))


def rings(seed=None):
    """Powers on two rings about the station of `WHITE`, with its white noise or none."""
    angle = np.arange(ON_A_RING) * 2.0 * math.pi / ON_A_RING
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    positions = np.concatenate([radius * ring for radius in RADII_M]) + WHITE.station.position_m
    power = regressors(positions, WHITE.station) @ [WHITE.k_pl_db, WHITE.n_pl]
    if seed is not None:
        power = power + np.random.default_rng(seed).normal(0.0, 0.3, len(power))
    return Measurements(positions, power, np.zeros(len(power), bool))


def ring_variance_m2():
    """Inverse information of either coordinate; by symmetry nothing is shared with theta.

    The sum over a ring of (10 n_PL / ln 10)^2 cos^2 / r^2 / omega^2.
    """
    slope = 10.0 * WHITE.n_pl / math.log(10.0)
    information = slope**2 * sum(0.5 * ON_A_RING / radius**2 for radius in RADII_M) / 0.3**2
    return 1.0 / information


def test_both_ways_agree_with_the_closed_form():
    """The sandwich exactly, the likelihood's moments but for what is cut off, 1 %."""
    expected = ring_variance_m2() * np.eye(2)
    line = line_covariance_m2(rings(0), WHITE)
    np.testing.assert_allclose(line, expected, rtol=1e-6, atol=1e-8)
    noisy = dataclasses.replace(WHITE, n_pl=3.0)
    joint = joint_covariance_m2(rings(), noisy)
    # Student's t with 48 measurements is 5 % wider than the normal.
    np.testing.assert_allclose(joint, expected, rtol=0.1, atol=0.1 * expected[0, 0])


def test_sandwich_against_simulation():
    """Under correlated shadowing the line's position scatters as the sandwich says."""
    channel = dataclasses.replace(CHANNEL, shadow_std_db=0.6, multipath_std_db=0.2)
    base = simulated(channel, 0, 60, 200.0)
    rng = np.random.default_rng(1)
    surface = station_surface(base, channel, has_prior=False)
    mean = regressors(base.positions_m, channel.station) @ [-40.0, 3.0]
    found = []
    for _ in range(120):
        power = mean + surface.lower @ rng.standard_normal(60)
        one = dataclasses.replace(base, power_dbm=power)
        fit = fit_channel_and_station(one, "capped", 10.0, station_method="line")
        found.append(fit.parameters.station.position_m)
    expected = line_covariance_m2(base, channel)
    scatter = np.cov(np.array(found).T)
    # The ratio of a variance of 120 draws has a deviation of 13 %.
    ratio = np.linalg.eigvals(np.linalg.solve(expected, scatter)).real
    assert ratio.min() > 0.6 and ratio.max() < 1.5


@pytest.mark.parametrize(("method", "most"), [("joint", 3.2), ("line", 3.6)])
def test_normalised_error_is_near_two(method, most):
    """Mean of e' S^-1 e over 40 channels: 2 if S is right, deviation 0.32; most are inside 95 %.

    The fitted covariance is taken for the true one, which makes S a little too small.
    """
    normalised = []
    for seed in range(40):
        fit = fit_channel_and_station(
            simulated(CHANNEL, seed, 80, 200.0), height_m=10.0, station_method=method
        )
        error = np.subtract(fit.parameters.station.position_m, CHANNEL.station.position_m)
        normalised.append(error @ np.linalg.solve(fit.station_covariance_m2, error))
    assert 1.0 < np.mean(normalised) < most
    assert np.mean(np.array(normalised) < 5.991) >= 0.85


def test_theta_follows_the_position():
    """Without residuals, the derivative is that of the profiled theta by the position."""
    base = simulated(CHANNEL, 2, 60, 200.0)
    power = regressors(base.positions_m, CHANNEL.station) @ [-40.0, 3.0]
    exact = dataclasses.replace(base, power_dbm=power)
    surface = station_surface(exact, CHANNEL, has_prior=False)
    centre, step = np.array(CHANNEL.station.position_m), 1e-3 * np.eye(2)
    rise = losses(surface, centre + step).theta - losses(surface, centre - step).theta
    np.testing.assert_allclose(theta_by_position(exact, CHANNEL), rise.T / 2e-3, rtol=1e-4)


def test_turning_the_scene_turns_the_ellipse():
    """S becomes R S R' under a quarter turn R, for both ways."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    base = simulated(CHANNEL, 5, 70, 200.0)
    there = dataclasses.replace(base, positions_m=base.positions_m @ turn.T)
    place = tuple(turn @ CHANNEL.station.position_m)
    channel = dataclasses.replace(CHANNEL, station=Station(place, 10.0))
    for covariance_m2 in (line_covariance_m2, joint_covariance_m2):
        expected = turn @ covariance_m2(base, CHANNEL) @ turn.T
        np.testing.assert_allclose(covariance_m2(there, channel), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("method", ["line", "joint"])
def test_a_station_at_the_edge_of_the_search_is_not_bounded(method):
    """Where the climb was stopped there is no optimum to have moments."""
    base = simulated(CHANNEL, 6, 40, 200.0)
    low, high = base.positions_m.min(axis=0), base.positions_m.max(axis=0)
    edge = low - 2.0 * math.hypot(*(high - low))
    channel = dataclasses.replace(CHANNEL, station=Station((edge[0], 100.0), 10.0))
    assert position_covariance_m2(base, channel, method) is None


def test_a_position_that_no_derivative_tells_is_not_determined():
    """All measurements at one height over the station: its distance is held, nothing moves."""
    positions = np.random.default_rng(0).uniform(-0.01, 0.01, (12, 2))
    measurements = Measurements(positions, np.linspace(-60.0, -50.0, 12), np.zeros(12, bool))
    near = dataclasses.replace(CHANNEL, station=Station((0.0, 0.0)))
    assert line_covariance_m2(measurements, near) is None
