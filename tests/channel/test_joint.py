"""Joint prediction and conditional samples against dense formulas, predict and conditioning."""

import numpy as np
import pytest
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    Measurements,
    Station,
    condition,
    joint_prediction,
    sample_power,
)

CHANNEL = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))
DATA = simulated(CHANNEL, 0, 60, 200.0)
PATH = np.column_stack([np.linspace(20.0, 150.0, 14), 60.0 + 30.0 * np.sin(np.arange(14.0))])


@pytest.mark.parametrize("theta", ["estimated", "known"])
def test_factor_is_sequential_conditioning(theta):
    """The factor's diagonal is the deviation after measuring the earlier places (equation 1.11)."""
    posterior = condition(CHANNEL, DATA, theta=theta)
    diagonal = np.diag(np.linalg.cholesky(joint_prediction(posterior, PATH).covariance_db2))
    for place, expected in zip(PATH, diagonal, strict=True):
        assert posterior.predict(place[None]).deviation_db[0] == pytest.approx(expected, rel=1e-9)
        posterior = posterior.extend(
            Measurements(place[None], np.array([-80.0]), np.zeros(1, dtype=bool))
        )


def test_latent_differs_by_multipath_alone():
    """Without multipath the diagonal is smaller by omega^2 and nothing else changes."""
    posterior = condition(CHANNEL, DATA)
    whole, latent = (joint_prediction(posterior, PATH, latent=flag) for flag in (False, True))
    np.testing.assert_array_equal(whole.mean_db, latent.mean_db)
    np.testing.assert_allclose(
        whole.covariance_db2 - latent.covariance_db2, 4.0 * np.eye(len(PATH)), atol=1e-12
    )


def test_samples_have_the_predicted_moments():
    """Sample mean and covariance within 5 standard errors; the random seed decides the draws."""
    posterior, count = condition(CHANNEL, DATA), 40_000
    power = sample_power(posterior, PATH, count, np.random.default_rng(1))
    again = sample_power(posterior, PATH, count, np.random.default_rng(1))
    np.testing.assert_array_equal(power, again)
    expected = joint_prediction(posterior, PATH)
    spread = expected.deviation_db / np.sqrt(count)
    assert (np.abs(power.mean(axis=0) - expected.mean_db) < 5.0 * spread).all()
    variance = np.diag(expected.covariance_db2)
    error = np.sqrt((np.outer(variance, variance) + expected.covariance_db2**2) / count)
    assert (np.abs(np.cov(power.T) - expected.covariance_db2) < 5.0 * error).all()


def test_repeated_places():
    """A place visited twice has one latent value, and two powers when multipath is drawn."""
    posterior = condition(CHANNEL, DATA)
    twice = np.vstack([PATH[:3], PATH[:3]])
    latent = sample_power(posterior, twice, 50, np.random.default_rng(2), latent=True)
    np.testing.assert_allclose(latent[:, :3], latent[:, 3:], atol=1e-3)
    power = sample_power(posterior, twice, 50, np.random.default_rng(2))
    assert np.abs(power[:, :3] - power[:, 3:]).min() > 0.0
