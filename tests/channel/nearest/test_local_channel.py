"""The local channel model against the exact posterior, and which measurements it takes."""

from itertools import pairwise

import numpy as np
import pytest

from planopt.channel import ChannelParameters, Measurements, Station, condition, kriging
from planopt.channel.kriging import (
    GROUP,
    GROUP_SHARE,
    LocalChannel,
    LocalGrid,
    nearby_terms,
    predict_nearby,
)

PARAMETERS = ChannelParameters(-40.0, 3.0, 4.0, 20.0, 1.13, Station((5.0, -10.0), 12.0))
CENTRES = np.random.default_rng(8).uniform(0.0, 100.0, (25, 2))
PATH = np.array([40.0, 30.0]) + np.arange(6)[:, None] * [3.0, 2.0]


def measured(count, seed=0, **columns):
    generator = np.random.default_rng(seed)
    positions = generator.uniform(0.0, 100.0, (count, 2))
    power = -80.0 + 4.0 * np.sin(positions[:, 0] / 15.0) + generator.standard_normal(count)
    return Measurements(positions, power, np.zeros(count, dtype=bool), **columns)


def assert_close(found, expected, mean_db, deviation_db):
    np.testing.assert_allclose(found.mean_db, expected.mean_db, atol=mean_db, rtol=0.0)
    np.testing.assert_allclose(found.deviation_db, expected.deviation_db, atol=deviation_db)


def from_numbers(channel, places):
    """Predict from precision, weights and trend, as the class states it."""
    parameters = channel.parameters
    squared = ((channel.positions_m[:, None] - places) ** 2).sum(axis=2) + channel.added_m2[:, None]
    phi = parameters.shadow_std_db**2 * np.exp(-np.sqrt(squared) / parameters.decorrelation_m)
    away = np.sqrt(((places - parameters.station.position_m) ** 2).sum(axis=1) + 144.0)
    gamma = np.column_stack([np.ones(len(places)), -10.0 * np.log10(away)])
    mean = gamma @ channel.theta + phi.T @ (channel.weights - channel.trend @ channel.theta)
    b = gamma - phi.T @ channel.trend
    variance = 4.0**2 + 1.13**2 - (phi * (channel.precision @ phi)).sum(axis=0)
    return mean, np.sqrt(variance + ((b @ channel.theta_covariance) * b).sum(axis=1))


@pytest.mark.parametrize("available", [0, 1, 20, 60])
def test_all_measurements_give_the_exact_posterior(available):
    """One set for all places, a set for each, groups, and the numbers that solvers use."""
    posterior = condition(PARAMETERS, measured(available))
    exact = posterior.predict(CENTRES)
    each = LocalChannel.around_each(posterior, CENTRES, 60).predict(CENTRES[:, None])
    np.testing.assert_allclose(each.mean_db[:, 0], exact.mean_db, atol=1e-9)
    np.testing.assert_allclose(each.deviation_db[:, 0], exact.deviation_db, atol=1e-9)
    shared = LocalChannel.around(posterior, CENTRES, 60)
    assert shared.precision.shape == (available, available)
    assert_close(shared.predict(CENTRES), exact, 1e-9, 1e-9)
    assert_close(predict_nearby(posterior, CENTRES, 60), exact, 1e-9, 1e-9)
    mean, deviation = from_numbers(shared, CENTRES)
    np.testing.assert_allclose(mean, exact.mean_db, atol=1e-9)
    np.testing.assert_allclose(deviation, exact.deviation_db, atol=1e-9)


def test_errors_of_places_are_counted():
    data = measured(60)
    std_m = np.full(len(PATH), 2.0)
    found = nearby_terms(condition(PARAMETERS, data, theta="known"), PATH, 60, std_m)
    exact = condition(PARAMETERS, data, theta="known").predict(PATH)
    assert (np.sqrt(found.variance_db2) > exact.deviation_db).all()


def test_accuracy_of_48_of_1000():
    """4 m away from the centres the mean is off by 0.1 dB rms at most, the deviation by 0.01."""
    posterior = condition(PARAMETERS, measured(1000))
    places = CENTRES + 4.0 / np.sqrt(2.0)
    found = LocalChannel.around_each(posterior, CENTRES, 48).predict(places[:, None])
    exact = posterior.predict(places)
    assert np.sqrt(np.mean((found.mean_db[:, 0] - exact.mean_db) ** 2)) < 0.1
    assert np.abs(found.deviation_db[:, 0] - exact.deviation_db).max() < 0.01


def test_fewer_measurements_never_lower_the_deviation():
    """With theta known, kriging from a subset is a posterior of less data."""
    posterior = condition(PARAMETERS, measured(300), theta="known")
    full = posterior.predict(CENTRES).deviation_db
    for predicted in (
        lambda count: (
            LocalChannel.around_each(posterior, CENTRES, count)
            .predict(CENTRES[:, None])
            .deviation_db[:, 0]
        ),
        lambda count: LocalChannel.around(posterior, CENTRES, count).predict(CENTRES).deviation_db,
        lambda count: predict_nearby(posterior, CENTRES, count).deviation_db,
    ):
        deviations = [predicted(count) for count in (4, 16, 48, 300)]
        for fewer, more in pairwise(deviations):
            assert (fewer >= more - 1e-12).all()
        np.testing.assert_allclose(deviations[-1], full, atol=1e-9)


def test_places_far_apart_do_not_share(monkeypatch):
    """Factors stay small where places are spread out; each place has its nearest all the same."""
    sizes = []
    whitened_by = kriging.whitened_by

    def recorded(covariance, columns):
        sizes.append(len(covariance))
        return whitened_by(covariance, columns)

    monkeypatch.setattr(kriging, "whitened_by", recorded)
    posterior = condition(PARAMETERS, measured(400), theta="known")
    axes = np.meshgrid([0.0, 35.0, 65.0, 100.0], [0.0, 50.0, 100.0])
    spread = np.stack(axes, axis=-1).reshape(-1, 2)
    together = predict_nearby(posterior, spread, 20).deviation_db
    assert 20 <= min(sizes) and max(sizes) <= GROUP_SHARE * 20 and len(sizes) >= 4
    # What else the group has can only lower the variance.
    alone = [predict_nearby(posterior, place[None], 20).deviation_db[0] for place in spread]
    assert (together <= np.array(alone) + 1e-9).all()


def test_many_places_in_any_order():
    """More places than a group holds, scattered, and none at all: near the full posterior."""
    posterior = condition(PARAMETERS, measured(400))
    many = np.random.default_rng(0).uniform(0.0, 100.0, (5 * GROUP, 2))
    found, full = predict_nearby(posterior, many, 128), posterior.predict(many)
    assert np.abs(found.mean_db - full.mean_db).max() < 0.02
    np.testing.assert_allclose(found.deviation_db, full.deviation_db, rtol=1e-3)
    assert predict_nearby(posterior, many[:0], 128).mean_db.shape == (0,)


def test_no_place_of_a_path_is_left_out():
    """A cluster at one end does not take the others' share: each place has its three nearest."""
    cluster = PATH[0] + 0.1 * np.random.default_rng(0).standard_normal((100, 2))
    positions = np.vstack([cluster, measured(200).positions_m])
    whole = Measurements(positions, np.zeros(300), np.zeros(300, dtype=bool))
    found = LocalChannel.around(condition(PARAMETERS, whole), PATH, 20).positions_m
    assert len(found) == 20
    chosen = {tuple(each) for each in found}
    for place in PATH:
        away = np.linalg.norm(positions - place, axis=1)
        assert {tuple(each) for each in positions[np.argsort(away)[:3]]} <= chosen


def test_grid():
    """U^-1 Phi and the trend of places, and roots of weights."""
    grid = np.array([[5.0, 5.0], [30.0, 20.0]])
    channel = LocalChannel.around(condition(PARAMETERS, measured(200)), PATH, 50)
    found = LocalGrid.of(channel, grid, np.array([4.0, 0.25]))
    np.testing.assert_array_equal(found.root_weight, [2.0, 0.5])
    terms = channel.terms(grid)
    np.testing.assert_allclose(found.trend, terms.trend, atol=1e-9)
    phi = channel.rows_db2(grid)
    explained = np.vecdot(phi, found.solved.T)
    np.testing.assert_allclose(4.0**2 + 1.13**2 - explained, terms.variance_db2)
