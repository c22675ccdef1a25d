"""The station's position: its likelihood, the search, joint fits and their uncertainty."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import log_ndtr
from simulated_channel import simulated

from planopt import InputError
from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    fit_channel,
    fit_channel_and_station,
)
from planopt.channel.estimation.station_fit import (
    gauss_newton,
    joint_covariance_m2,
    line_covariance_m2,
    locate,
    losses,
    station_surface,
    theta_by_position,
)
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 3.0, 20.0, 1.0, Station((130.0, 70.0), 10.0))
NEAR_CHANNEL = ChannelParameters(-40.0, 3.0, 4.0, 25.0, 1.5, Station((130.0, 70.0), 10.0))
MEASUREMENTS = simulated(NEAR_CHANNEL, 1, 50, 200.0)
PLACES = np.array([[120.0, 80.0], [150.0, 40.0], [100.0, 60.0]])


def by_hand(place, prior):
    """Profiled loss and theta by generalised least squares with dense algebra."""
    positions = MEASUREMENTS.positions_m
    covariance = shadow_covariance_db2(positions, positions, NEAR_CHANNEL) + 1.5**2 * np.eye(50)
    weights = np.linalg.inv(covariance)
    gamma = regressors(positions, Station(tuple(place), 10.0))
    precision = np.diag([0.0, 1.0]) if prior else np.zeros((2, 2))
    right = gamma.T @ weights @ MEASUREMENTS.power_dbm + precision @ [0.0, 3.0]
    theta = np.linalg.solve(gamma.T @ weights @ gamma + precision, right)
    residual = MEASUREMENTS.power_dbm - gamma @ theta
    surprise = theta - [0.0, 3.0]
    return 0.5 * (residual @ weights @ residual + surprise @ precision @ surprise), theta


@pytest.mark.parametrize("prior", [False, True])
def test_losses_are_those_of_generalised_least_squares(prior):
    """Value and theta at several places, with n_PL's prior of 3 +- 1 and without."""
    found = losses(station_surface(MEASUREMENTS, NEAR_CHANNEL, has_prior=prior), PLACES)
    for place, loss, theta in zip(PLACES, *found, strict=True):
        expected_loss, expected_theta = by_hand(place, prior)
        assert loss == pytest.approx(expected_loss, rel=1e-10)
        np.testing.assert_allclose(theta, expected_theta, rtol=1e-9)


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("censored_share", [0.0, 0.2])
def test_gradient_is_that_of_the_losses(prior, censored_share):
    measurements = simulated(NEAR_CHANNEL, 2, 60, 200.0, censored_share)
    surface = station_surface(measurements, NEAR_CHANNEL, has_prior=prior)
    step = 1e-3 * np.eye(2)
    for place in PLACES:
        _, gradient, _ = gauss_newton(surface, place)
        rise = losses(surface, place + step)[0] - losses(surface, place - step)[0]
        np.testing.assert_allclose(gradient, rise / 2e-3, rtol=1e-5, atol=1e-7)


METHODS = ["line", "joint"]


def found(measurements, method, height_m=10.0):
    return np.array(locate(measurements, method, height_m, np.inf).position_m)


@pytest.mark.parametrize("method", METHODS)
def test_exact_path_loss_gives_the_exact_place(method):
    """Without any fading the position comes out to a millimetre."""
    positions = np.random.default_rng(0).uniform(0.0, 200.0, (60, 2))
    power = regressors(positions, CHANNEL.station) @ [-40.0, 3.0]
    measurements = Measurements(positions, power, np.zeros(60, bool))
    np.testing.assert_allclose(found(measurements, method), (130.0, 70.0), atol=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.35])
def test_the_line_is_tobit_regression(share):
    """Likelihood of independent errors with limits, maximised by SciPy over all five unknowns."""
    measurements = simulated(CHANNEL, 3, 80, 200.0, share)
    cut, power = measurements.censored, measurements.power_dbm

    def loss(unknown):
        k_pl, n_pl, log_deviation, x, y = unknown
        mean = regressors(measurements.positions_m, Station((x, y), 10.0)) @ [k_pl, n_pl]
        z = (power - mean) / np.exp(log_deviation)
        return 0.5 * (z[~cut] ** 2).sum() + (~cut).sum() * log_deviation - log_ndtr(z[cut]).sum()

    options = {"maxiter": 20000, "maxfev": 20000, "xatol": 1e-5, "fatol": 1e-9}
    start = [-40.0, 3.0, 1.0, 130.0, 70.0]
    best = minimize(loss, start, method="Nelder-Mead", options=options).x[3:]
    np.testing.assert_allclose(found(measurements, "line"), best, atol=0.3)


def test_the_joint_position_is_the_most_likely_one():
    """On a fine lattice over the whole square no place is more likely under the true covariance."""
    measurements = simulated(CHANNEL, 4, 150, 200.0)
    position = found(measurements, "joint")
    surface = station_surface(measurements, CHANNEL, has_prior=True)
    axis = np.linspace(0.0, 200.0, 101)
    lattice = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    # The covariance was fitted, not given: it may differ by little.
    best = losses(surface, lattice)[0].min()
    assert losses(surface, position[None])[0][0] < best + 0.2


MOTIONS = {
    "moved": (np.eye(2), np.array([3e5, -4e5])),
    "turned": (np.array([[0.6, -0.8], [0.8, 0.6]]), np.zeros(2)),
    "mirrored": (np.diag([-1.0, 1.0]), np.zeros(2)),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_moving_the_scene_moves_the_station(method, motion):
    """Rigid motions of all positions are those of the estimate."""
    turn, shift = MOTIONS[motion]
    measurements = simulated(CHANNEL, 5, 70, 200.0, 0.1)
    there = dataclasses.replace(measurements, positions_m=measurements.positions_m @ turn.T + shift)
    expected = turn @ found(measurements, method) + shift
    # Rounds end when the position stands still within a tenth of its deviation, 4 m.
    np.testing.assert_allclose(found(there, method), expected, atol=0.4)


def distance(fit, station):
    return np.hypot(*np.subtract(fit.parameters.station.position_m, station))


@pytest.mark.parametrize(("place", "error_m"), [((130.0, 70.0), 10.0), ((-60.0, 250.0), 80.0)])
def test_finds_a_station_inside_and_outside(place, error_m):
    """With censoring, a station is found well within the measured square, less well beyond it."""
    channel = dataclasses.replace(CHANNEL, station=Station(place, 10.0))
    measurements = simulated(channel, 3, 150, 200.0, 0.15)
    fit = fit_channel_and_station(measurements, height_m=10.0)
    assert distance(fit, place) < error_m
    assert fit.parameters.n_pl == pytest.approx(3.0, abs=0.8)
    assert "is estimated, not given" in fit.warnings[0]
    is_outside = place[0] < 0.0
    assert ("outside the extent of the measurements" in " ".join(fit.warnings)) == is_outside
    assert fit.status == ("weak" if is_outside else "ok")
    if is_outside:
        assert "exponent n_PL is poorly determined" in " ".join(fit.warnings)


def test_the_method_is_that_of_the_final_fit():
    """At the estimated station the result is the ordinary fit's, with the warning in front."""
    measurements = simulated(CHANNEL, 4, 80, 200.0)
    found = fit_channel_and_station(measurements, "capped", 10.0)
    plain = fit_channel(measurements, found.parameters.station, "capped")
    assert found.parameters == plain.parameters
    assert found.warnings[1:] == plain.warnings
    assert plain.station_covariance_m2 is None


def steadily_rising():
    """Powers that rise to one side alone: the line's station goes as far as it may."""
    positions = np.random.default_rng(3).uniform(0.0, 100.0, (60, 2))
    noise = np.random.default_rng(4).normal(0.0, 2.0, 60)
    return Measurements(positions, -80.0 + 0.05 * positions[:, 0] + noise, np.zeros(60, bool))


def mostly_shadowing():
    """Powers that slow shadowing explains as well as any station does."""
    weak = dataclasses.replace(CHANNEL, n_pl=0.3, shadow_std_db=8.0, decorrelation_m=80.0)
    return simulated(weak, 7, 40, 200.0)


CASES = {"line": steadily_rising, "joint": mostly_shadowing}


@pytest.mark.parametrize("station_method", CASES)
def test_what_is_not_bounded_is_infinite_and_said(station_method):
    """No number stands for a position that may be anywhere."""
    found = fit_channel_and_station(CASES[station_method](), station_method=station_method)
    assert found.status == "degenerate"
    assert "is not bounded" in found.warnings[0]
    np.testing.assert_array_equal(found.station_covariance_m2, np.diag([np.inf, np.inf]))
    assert found.standard_errors["n_pl"] == np.inf
    assert np.isfinite(found.theta_covariance).all()


def test_random_small_cases_are_fits_or_input_errors():
    """Few, clustered, nearly collinear, repeated, censored, by either method of location."""
    rng = np.random.default_rng(0)
    fitted = 0
    for case in range(40):
        count = int(rng.integers(2, 16))
        positions = rng.uniform(0.0, 100.0, (count, 2))
        positions[:, 1] *= rng.choice([1.0, 1e-2, 0.0])
        positions = positions[rng.integers(0, count, count)] if case % 3 == 0 else positions
        power = rng.normal(-70.0, 5.0, count)
        measurements = Measurements(positions, power, rng.random(count) < 0.15)
        method = "line" if case % 2 else "joint"
        try:
            found = fit_channel_and_station(measurements, station_method=method)
        except InputError:
            continue
        fitted += 1
        assert np.isfinite(found.parameters.station.position_m).all()
        assert not np.isnan(found.station_covariance_m2).any()
    assert fitted > 5


def test_a_station_on_a_measurement_is_moved_off_it():
    """When the best position is that of a measurement, log of zero is avoided."""
    axis = np.arange(-4.0, 5.0)
    lattice = 10.0 * np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    power = -40.0 - 30.0 * np.log10(np.maximum(np.hypot(*lattice.T), 0.1))
    measurements = Measurements(lattice, power, np.zeros(81, bool))
    assert distance(fit_channel_and_station(measurements), (0.0, 0.0)) < 0.5


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


def test_both_methods_agree_with_the_closed_form():
    """The sandwich exactly, the likelihood's moments but for what is cut off, 1 %."""
    expected = ring_variance_m2() * np.eye(2)
    line = line_covariance_m2(rings(0), WHITE)
    np.testing.assert_allclose(line, expected, rtol=1e-6, atol=1e-8)
    noisy = dataclasses.replace(WHITE, n_pl=3.0)
    joint = joint_covariance_m2(rings(), noisy)
    # Student's t with 48 measurements is 5 % wider than the normal.
    np.testing.assert_allclose(joint, expected, rtol=0.1, atol=0.1 * expected[0, 0])


@pytest.mark.parametrize(
    ("method", "height_m", "most"),
    [("joint", 10.0, 3.2), ("line", 10.0, 3.6), ("joint", None, 3.2)],
)
def test_normalised_error_is_near_two(method, height_m, most):
    """Mean of e' S^-1 e over 40 channels: 2 if S is right, deviation 0.32; most are inside 95 %.

    The fitted covariance is taken for the true one, which makes S a little too small.
    """
    normalised = []
    for seed in range(40):
        fit = fit_channel_and_station(
            simulated(CHANNEL, seed, 80, 200.0), height_m=height_m, station_method=method
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
    rise = losses(surface, centre + step)[1] - losses(surface, centre - step)[1]
    np.testing.assert_allclose(theta_by_position(exact, CHANNEL), rise.T / 2e-3, rtol=1e-4)


def test_turning_the_scene_turns_the_ellipse():
    """S becomes R S R' under a quarter turn R, for both methods."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    base = simulated(CHANNEL, 5, 70, 200.0)
    there = dataclasses.replace(base, positions_m=base.positions_m @ turn.T)
    place = tuple(turn @ CHANNEL.station.position_m)
    channel = dataclasses.replace(CHANNEL, station=Station(place, 10.0))
    for covariance_m2 in (line_covariance_m2, joint_covariance_m2):
        expected = turn @ covariance_m2(base, CHANNEL) @ turn.T
        np.testing.assert_allclose(covariance_m2(there, channel), expected, rtol=1e-6, atol=1e-6)


def test_position_without_derivatives_is_undetermined():
    """All measurements at one height over the station: its distance is held, nothing moves."""
    positions = np.random.default_rng(0).uniform(-0.01, 0.01, (12, 2))
    measurements = Measurements(positions, np.linspace(-60.0, -50.0, 12), np.zeros(12, bool))
    near = dataclasses.replace(CHANNEL, station=Station((0.0, 0.0)))
    assert line_covariance_m2(measurements, near) is None
