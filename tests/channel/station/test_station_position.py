"""Where the station is found, by the line and by the joint likelihood."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import log_ndtr
from simulated_channel import simulated

from planopt.channel import ChannelParameters, Measurements, Station
from planopt.channel.estimation.station_fit import locate, losses, station_surface
from planopt.channel.parameters import regressors

CHANNEL = ChannelParameters(-40.0, 3.0, 3.0, 20.0, 1.0, Station((130.0, 70.0), 10.0))
METHODS = ["line", "joint"]


def found(measurements, method, height_m=10.0):
    """The position as an array."""
    return np.array(locate(measurements, method, height_m, np.inf).position_m)


@pytest.mark.parametrize("method", METHODS)
def test_exact_path_loss_gives_the_exact_place(method):
    """Without any fading the position comes out to a millimetre."""
    positions = np.random.default_rng(0).uniform(0.0, 200.0, (60, 2))
    power = regressors(positions, CHANNEL.station) @ [-40.0, 3.0]
    measurements = Measurements(positions, power, np.zeros(60, bool))
    np.testing.assert_allclose(found(measurements, method), (130.0, 70.0), atol=1e-3)


def squared_residual(measurements, position):
    """Sum of squares that the best line to a station there leaves."""
    gamma = regressors(measurements.positions_m, Station(tuple(position), 10.0))
    line = np.linalg.lstsq(gamma, measurements.power_dbm, rcond=None)[0]
    return float(((measurements.power_dbm - gamma @ line) ** 2).sum())


def test_the_line_is_the_one_of_least_squares():
    """No position near or far leaves a smaller sum of squares: against SciPy from many starts."""
    measurements = simulated(CHANNEL, 3, 60, 200.0)
    least = min(
        minimize(lambda q: squared_residual(measurements, q), (x, y), method="Nelder-Mead").fun
        for x in (0.0, 70.0, 130.0, 200.0)
        for y in (0.0, 70.0, 130.0, 200.0)
    )
    reached = squared_residual(measurements, found(measurements, "line"))
    assert reached == pytest.approx(least, rel=1e-6)


def test_the_line_with_censored_powers_is_tobit_regression():
    """Likelihood of independent errors with limits, maximised by SciPy over all five unknowns."""
    measurements = simulated(CHANNEL, 3, 80, 200.0, 0.35)
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
    best = losses(surface, lattice).loss.min()
    assert losses(surface, position[None]).loss[0] < best + 0.2


def test_the_joint_estimate_is_the_better_one_where_shadowing_is_strong():
    """Correlated errors pull the line: over channels with slow shadowing joint errs less."""
    channel = dataclasses.replace(CHANNEL, shadow_std_db=6.0, decorrelation_m=60.0)
    errors = {method: [] for method in METHODS}
    for seed in range(10):
        measurements = simulated(channel, seed, 60, 200.0)
        for method in METHODS:
            errors[method].append(np.hypot(*(found(measurements, method) - (130.0, 70.0))))
    assert np.median(errors["joint"]) < np.median(errors["line"])


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
