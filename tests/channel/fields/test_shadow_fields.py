"""Shadowing fields on lattices, at positions and given measurements have the model's covariance."""

import numpy as np
import pytest
from refusals import refused

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    conditional_field,
    scattered_field_db,
    shadow_field_db,
)
from planopt.channel.shadow_fields import CLIPPED_SHARE_TOLERANCE, added_to_lattice_db


@pytest.mark.parametrize(("shape", "decorrelation"), [((10, 14), 3.0), ((7, 9), 12.0)])
def test_covariance_at_every_lag(shape, decorrelation):
    """All lags of the lattice, averaged over it, 4.5 errors."""
    generator = np.random.default_rng(9)
    means = []
    for _ in range(600):
        field = shadow_field_db(shape, 1.0, 2.0, decorrelation, generator).values_db
        lags = []
        for row in range(shape[0]):
            for column in range(shape[1]):
                moved = field[row:, column:]
                lags.append(np.mean(moved * field[: shape[0] - row, : shape[1] - column]))
        means.append(lags)
    means = np.array(means)
    rows, columns = np.indices(shape)
    expected = 4.0 * np.exp(-np.hypot(rows, columns) / decorrelation).ravel()
    error = means.std(axis=0) / np.sqrt(len(means))
    assert (np.abs(means.mean(axis=0) - expected) < 4.5 * error).all()


def test_seed_fixes_the_field_and_xi_scales_it():
    """Never standardised; padding grows with the decorrelation distance, and little is clipped."""
    short = shadow_field_db((10, 30), 1.0, 2.0, 1.0, np.random.default_rng(0))
    long = shadow_field_db((10, 30), 1.0, 2.0, 40.0, np.random.default_rng(0))
    assert short.values_db.shape == long.values_db.shape == (10, 30)
    assert min(short.padding) >= 10
    assert min(long.padding) > max(short.padding)
    assert 0.0 <= short.clipped_share <= CLIPPED_SHARE_TOLERANCE
    assert 0.0 <= long.clipped_share <= CLIPPED_SHARE_TOLERANCE
    one = shadow_field_db((8, 8), 1.0, 2.0, 3.0, np.random.default_rng(5)).values_db
    again = shadow_field_db((8, 8), 1.0, 2.0, 3.0, np.random.default_rng(5)).values_db
    double = shadow_field_db((8, 8), 1.0, 4.0, 3.0, np.random.default_rng(5)).values_db
    np.testing.assert_array_equal(one, again)
    np.testing.assert_allclose(double, 2.0 * one)


def test_fields_that_do_not_fit_are_refused(monkeypatch):
    """A clear error instead of a machine out of memory; repeated places do not count."""
    monkeypatch.setattr("planopt.channel.shadow_fields.MAX_TORUS_CELLS", 10_000)
    with refused():
        shadow_field_db((20, 20), 1.0, 2.0, 500.0, np.random.default_rng(0))
    monkeypatch.setattr("planopt.channel.shadow_fields.MAX_PLACES", 3)
    generator = np.random.default_rng(0)
    scattered_field_db(np.zeros((10, 2)), 1.0, 1.0, generator)
    with refused():
        scattered_field_db(np.eye(4, 2).cumsum(axis=0) + np.arange(4)[:, None], 1.0, 1.0, generator)


DRAWS = 1200


def within_errors(draws, expected):
    """Every sample covariance within 4.5 standard errors (zero mean, Gaussian)."""
    found = draws.T @ draws / len(draws)
    variance = np.diag(expected)
    error = np.sqrt((variance[:, None] * variance + expected**2) / len(draws))
    assert (np.abs(found - expected) < 4.5 * error).all()


def covariance(places, std, decorrelation):
    return std**2 * np.exp(-np.hypot(*(places[:, None] - places).T) / decorrelation)


def test_covariance_of_places():
    """At near, far and collinear places, over many seeds."""
    generator = np.random.default_rng(1)
    places = np.array([[0, 0], [0.1, 0], [3, 0], [6, 0], [3e6, 1], [3e6, 5], [-4, 7]], dtype=float)
    draws = np.array([scattered_field_db(places, 3.0, 5.0, generator) for _ in range(DRAWS)])
    within_errors(draws, covariance(places, 3.0, 5.0))


def test_repeated_places_share_their_value():
    """Exactly, in any order; places that differ by rounding do not break the factor."""
    places = np.array([[1.0, 2.0], [5.0, 5.0], [1.0, 2.0], [1.0 + 1e-15, 2.0], [1.0, 2.0 + 1e-12]])
    values = scattered_field_db(places, 2.0, 5.0, np.random.default_rng(2))
    assert values[0] == values[2] != values[1]
    assert np.abs(values[3:] - values[0]).max() < 1e-3
    assert scattered_field_db(places[:0], 2.0, 5.0, np.random.default_rng(2)).shape == (0,)


def test_places_added_to_a_lattice():
    """Lattice and places together have the covariance of one field, inside and at the border."""
    generator = np.random.default_rng(3)
    x, y = np.arange(8.0), np.arange(6.0)
    places = np.array([[3.4, 2.2], [3.6, 2.2], [3.0, 2.0], [7.7, 5.3], [0.2, 3.9], [3.4, 2.9]])
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    shown = [0, 7, 19, 20, 28, 47]
    draws = []
    for _ in range(DRAWS):
        field = shadow_field_db((6, 8), 1.0, 2.0, 4.0, generator).values_db
        added = added_to_lattice_db(x, y, field, places, 2.0, 4.0, generator)
        draws.append(np.concatenate([field.ravel()[shown], added]))
    draws = np.array(draws)
    within_errors(draws, covariance(np.concatenate([nodes[shown], places]), 2.0, 4.0))
    # A place on a node takes the node's value.
    np.testing.assert_allclose(draws[:, 8], draws[:, 2], atol=0.01)


def test_a_lattice_of_two_cells():
    """Short axes have fewer nodes to draw from."""
    generator = np.random.default_rng(4)
    axis = np.array([0.0, 1.0])
    drawn = added_to_lattice_db(
        axis, axis, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0, 0.0]]), 2.0, 4.0, generator
    )
    assert drawn[0] == pytest.approx(2.0, abs=0.01)


STATION = Station((-20.0, 5.0), 3.0)
CHANNEL = ChannelParameters(-30.0, 2.5, 4.0, 8.0, 1.5, STATION)
NOISELESS = ChannelParameters(-30.0, 2.5, 4.0, 8.0, 0.0, STATION)
BOUNDS, CELL = (0.0, 0.0, 20.0, 16.0), 2.0
X, Y = np.arange(1.0, 20.0, 2.0), np.arange(1.0, 16.0, 2.0)
CENTRES = np.stack(np.meshgrid(X, Y), axis=-1).reshape(-1, 2)
DRAWN = 800


def measured(places, censored=()):
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


def posterior_moments(draws, mean, covariance):
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
    posterior = condition(CHANNEL, measured(PLACES, censored=[2]), theta=theta)
    generator = np.random.default_rng(1)
    draws = np.array(
        [conditional_field(posterior, BOUNDS, CELL, generator).values.ravel() for _ in range(DRAWN)]
    )
    mean, covariance = expected(posterior, CENTRES)
    np.testing.assert_allclose(posterior.predict(CENTRES).mean_db, mean, atol=1e-8)
    posterior_moments(draws, mean, covariance)


def test_fields_go_through_noiseless_measurements():
    """At measured nodes every draw has the measured value."""
    measurements = measured([[5.0, 5.0], [13.0, 9.0], [17.0, 1.0], [6.2, 5.7]])
    posterior = condition(NOISELESS, measurements)
    for seed in range(5):
        generator = np.random.default_rng(seed)
        field = conditional_field(posterior, BOUNDS, CELL, generator)
        at_nodes = field.values[[2, 4, 0], [2, 6, 8]]
        np.testing.assert_allclose(at_nodes, measurements.power_dbm[:3], atol=0.05)
