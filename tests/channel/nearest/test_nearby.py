"""Prediction from nearby measurements against the full posterior."""

from __future__ import annotations

import numpy as np
import pytest

from planopt.channel.cholesky import whitened_by
from planopt.channel.kriging import predict
from planopt.channel.measurements import Measurements
from planopt.channel.nearest import nearby
from planopt.channel.nearest.nearby import GROUP, GROUP_SHARE, predict_nearby
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import ChannelPosterior, condition


@pytest.fixture(scope="module")
def posterior() -> ChannelPosterior:
    """400 measurements on a square of 200 m."""
    generator = np.random.default_rng(3)
    parameters = ChannelParameters(-20.0, 3.0, 8.0, 40.0, 2.0, Station((20.0, 30.0), 10.0))
    places = generator.uniform(0.0, 200.0, (400, 2))
    power = -70.0 + 8.0 * generator.standard_normal(400)
    return condition(parameters, Measurements(places, power, np.zeros(400, dtype=bool)))


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """More places than one group holds, along a path."""
    along = np.linspace(0.0, 1.0, 2 * GROUP + 5)[:, None]
    return np.array([10.0, 20.0]) + along * np.array([150.0, 90.0])


def test_all_measurements_are_the_full_posterior(posterior, places):
    """With every measurement in use nothing is left out."""
    nearby, full = predict_nearby(posterior, places, 400), predict(posterior, places)
    np.testing.assert_allclose(nearby.mean_db, full.mean_db, atol=1e-9)
    np.testing.assert_allclose(nearby.deviation_db, full.deviation_db, atol=1e-9)


def test_error_falls_with_the_number_of_neighbours(posterior, places):
    """More neighbours come nearer to the full posterior, and 128 come within 0.01 dB."""
    full = predict(posterior, places).mean_db
    errors = [
        np.abs(predict_nearby(posterior, places, m).mean_db - full).max() for m in (8, 32, 128)
    ]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.01


def test_deviation_is_never_below_the_full_one(posterior, places):
    """Less data leaves more variance, at every place, where theta is known."""
    known = condition(posterior.parameters, posterior.measurements, theta="known")
    nearby, full = predict_nearby(known, places, 64), predict(known, places)
    assert (nearby.deviation_db >= full.deviation_db - 1e-9).all()
    assert (nearby.deviation_db > full.deviation_db).any()


def test_places_far_apart_do_not_share(posterior, monkeypatch):
    """Factors stay small where places are spread out; each place has its nearest all the same."""
    sizes = []

    def recorded(covariance, columns):
        sizes.append(len(covariance))
        return whitened_by(covariance, columns)

    monkeypatch.setattr(nearby, "whitened_by", recorded)
    known = condition(posterior.parameters, posterior.measurements, theta="known")
    axes = np.meshgrid([0.0, 70.0, 130.0, 200.0], [0.0, 100.0, 200.0])
    spread = np.stack(axes, axis=-1).reshape(-1, 2)
    together = predict_nearby(known, spread, 20).deviation_db
    assert 20 <= min(sizes) and max(sizes) <= GROUP_SHARE * 20 and len(sizes) >= 4
    # What else the group has can only make it surer.
    alone = [predict_nearby(known, place[None], 20).deviation_db[0] for place in spread]
    assert (together <= np.array(alone) + 1e-9).all()


def test_many_places_in_any_order(posterior):
    """More places than a group holds, scattered, and none at all: near the full posterior."""
    many = np.random.default_rng(0).uniform(0.0, 200.0, (5 * GROUP, 2))
    found, full = predict_nearby(posterior, many, 128), predict(posterior, many)
    assert np.abs(found.mean_db - full.mean_db).max() < 0.02
    np.testing.assert_allclose(found.deviation_db, full.deviation_db, rtol=1e-3)
    assert predict_nearby(posterior, many[:0], 128).mean_db.shape == (0,)
