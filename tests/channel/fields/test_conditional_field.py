"""Conditioned fields go through what was measured and have the posterior's mean and covariance."""

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station, condition, conditional_field

STATION = Station((-20.0, 5.0), 3.0)
PARAMETERS = ChannelParameters(-30.0, 2.5, 4.0, 8.0, 1.5, STATION)
NOISELESS = ChannelParameters(-30.0, 2.5, 4.0, 8.0, 0.0, STATION)
BOUNDS, CELL = (0.0, 0.0, 20.0, 16.0), 2.0
X, Y = np.arange(1.0, 20.0, 2.0), np.arange(1.0, 16.0, 2.0)
CENTRES = np.stack(np.meshgrid(X, Y), axis=-1).reshape(-1, 2)
DRAWS = 800


def measured(places, censored=()):
    """Powers about -65 dBm at `places`."""
    places = np.array(places, dtype=float)
    power = -65.0 + np.random.default_rng(9).normal(0.0, 4.0, len(places))
    return Measurements(places, power, np.isin(np.arange(len(places)), censored))


# Off the nodes, on one, two nearly together, a repeated one, one outside the lattice.
PLACES = [[4.3, 3.1], [5.0, 5.0], [12.1, 9.0], [12.2, 9.1], [17.0, 2.0], [17.0, 2.0], [22.0, 12.0]]


def expected(posterior, places):
    """Mean and covariance of path loss and shadowing by dense algebra (equation 1.12)."""
    p = posterior.parameters

    def kernel(a, b):
        return p.shadow_std_db**2 * np.exp(-np.hypot(*(a[:, None] - b).T).T / p.decorrelation_m)

    def trend(a):
        distance = np.sqrt(((a - STATION.position_m) ** 2).sum(axis=1) + STATION.height_m**2)
        return np.column_stack([np.ones(len(a)), -10.0 * np.log10(distance)])

    at = posterior.measurements.positions_m
    gain = np.linalg.solve(
        kernel(at, at) + np.diag(posterior.noise_variance_db2), kernel(at, places)
    )
    rest = trend(places) - gain.T @ trend(at)
    mean = trend(places) @ posterior.theta
    mean += gain.T @ (posterior.values_db - trend(at) @ posterior.theta)
    spread = kernel(places, places) - kernel(places, at) @ gain
    return mean, spread + rest @ posterior.theta_covariance @ rest.T


def within_errors(draws, mean, covariance):
    """Every mean and covariance within 4.8 standard errors."""
    variance = np.diag(covariance)
    tiny = 1e-9
    assert (np.abs(draws.mean(axis=0) - mean) < 4.8 * np.sqrt(variance / len(draws)) + tiny).all()
    off = draws - mean
    error = np.sqrt((variance[:, None] * variance + covariance**2) / len(draws))
    assert (np.abs(off.T @ off / len(draws) - covariance) < 4.8 * error + tiny).all()


@pytest.mark.parametrize("theta", ["estimated", "known"])
def test_lattice_has_the_posteriors_moments(theta):
    """Mean and covariance of all 80 nodes over many draws; sites of censored ones included."""
    posterior = condition(PARAMETERS, measured(PLACES, censored=[2]), theta=theta)
    generator = np.random.default_rng(1)
    draws = np.array(
        [conditional_field(posterior, BOUNDS, CELL, generator).values.ravel() for _ in range(DRAWS)]
    )
    mean, covariance = expected(posterior, CENTRES)
    np.testing.assert_allclose(posterior.predict(CENTRES).mean_db, mean, atol=1e-8)
    within_errors(draws, mean, covariance)


def test_fields_go_through_noiseless_measurements():
    """At measured nodes every draw has the measured value."""
    measurements = measured([[5.0, 5.0], [13.0, 9.0], [17.0, 1.0], [6.2, 5.7]])
    posterior = condition(NOISELESS, measurements)
    for seed in range(5):
        generator = np.random.default_rng(seed)
        field = conditional_field(posterior, BOUNDS, CELL, generator)
        at_nodes = field.values[[2, 4, 0], [2, 6, 8]]
        np.testing.assert_allclose(at_nodes, measurements.power_dbm[:3], atol=0.05)


def test_draws_differ_away_from_measurements():
    """The seed fixes a draw; another seed gives another one."""
    posterior = condition(PARAMETERS, measured(PLACES))
    one, same, other = (
        conditional_field(posterior, BOUNDS, CELL, np.random.default_rng(seed)).values
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1.0


def test_without_measurements():
    """The prior: path loss and shadowing."""
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    posterior = condition(PARAMETERS, nothing, theta="known")
    generator = np.random.default_rng(5)
    assert np.isfinite(conditional_field(posterior, BOUNDS, CELL, generator).values).all()
