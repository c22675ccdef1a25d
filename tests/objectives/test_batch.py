"""S, B and mu of a batch against dense formulas, and its cross covariance."""

import dataclasses

import numpy as np
import pytest
from path_scene import CHANNEL, NOTHING, PATH, drawn

from planopt.channel.joint import joint_prediction
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.parameters import regressors
from planopt.channel.posterior import condition
from planopt.errors import InputError
from planopt.objectives.batch import batch_factor, batch_of, cross_covariance_db2, known_places

DATA = drawn(25)
GRID = np.random.default_rng(1).uniform(0.0, 60.0, (7, 2))


def test_terms_are_the_boxed_formulas():
    """Equation 1.11 by dense inverses; covariance() adds B M B'."""
    inverse = np.linalg.inv(
        shadow_covariance_db2(DATA.positions_m, DATA.positions_m, CHANNEL) + 4.0 * np.eye(25)
    )
    phi = shadow_covariance_db2(DATA.positions_m, PATH, CHANNEL)
    gamma = regressors(DATA.positions_m, CHANNEL.station)
    spread = np.linalg.inv(gamma.T @ inverse @ gamma)
    batch = batch_of(condition(CHANNEL, DATA), PATH)
    s = shadow_covariance_db2(PATH, PATH, CHANNEL) + 4.0 * np.eye(5) - phi.T @ inverse @ phi
    b = regressors(PATH, CHANNEL.station) - phi.T @ inverse @ gamma
    theta = spread @ gamma.T @ inverse @ DATA.power_dbm
    np.testing.assert_allclose(batch.covariance(False), s, atol=1e-10)
    np.testing.assert_allclose(batch.trend, b, atol=1e-10)
    np.testing.assert_allclose(batch.covariance(True), s + b @ spread @ b.T, atol=1e-9)
    np.testing.assert_allclose(
        batch.mean_db, b @ theta + phi.T @ inverse @ DATA.power_dbm, atol=1e-8
    )


@pytest.mark.parametrize("universal", [False, True])
def test_cross_covariance_is_a_block_of_the_joint_one(universal):
    """Path and grid predicted together; as if theta were known without `universal`."""
    posterior = condition(CHANNEL, DATA)
    joint = dataclasses.replace(
        posterior,
        theta_covariance=posterior.theta_covariance if universal else np.zeros((2, 2)),
    )
    whole = joint_prediction(joint, np.vstack([PATH, GRID])).covariance_db2
    found = cross_covariance_db2(posterior, PATH, known_places(posterior, GRID), universal)
    np.testing.assert_allclose(found, whole[:5, 5:], atol=1e-10)


def test_without_measurements():
    """The prior: S = K + omega^2 I and B = Gamma."""
    batch = batch_of(condition(CHANNEL, NOTHING, theta="known"), PATH)
    prior = shadow_covariance_db2(PATH, PATH, CHANNEL) + 4.0 * np.eye(5)
    np.testing.assert_allclose(batch.covariance(True), prior)
    np.testing.assert_allclose(batch.trend, regressors(PATH, CHANNEL.station))


def test_a_singular_batch_is_explained():
    """Twice to one place without multipath."""
    dry = dataclasses.replace(CHANNEL, multipath_std_db=0.0)
    batch = batch_of(condition(dry, NOTHING, theta="known"), np.array([[1.0, 2.0], [1.0, 2.0]]))
    with pytest.raises(InputError, match="twice"):
        batch_factor(batch.covariance_db2)
