"""Kriging weights of many powers at once against one system at a time."""

import numpy as np

from planopt.channel.estimation.vecchia import regress_on_neighbours
from planopt.channel.measurement_covariance import Origins, shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters, Station

PARAMETERS = ChannelParameters(-40.0, 3.0, 6.0, 30.0, 2.0, Station((5.0, -10.0), 12.0))


def test_against_one_system_at_a_time():
    """Weights and variance by a dense solve without those that are missing."""
    generator = np.random.default_rng(0)
    own = generator.uniform(0.0, 50.0, (6, 1, 2))
    beside = generator.uniform(0.0, 50.0, (6, 9, 2))
    noise = generator.uniform(1.0, 5.0, (6, 9))
    missing = generator.random((6, 9)) < 0.3
    missing[0] = True
    found = regress_on_neighbours(PARAMETERS, Origins(own), Origins(beside), noise, missing)
    assert found.variance_db2[0] == 36.0
    for k in range(6):
        there = ~missing[k]
        covariance = shadow_covariance_db2(beside[k, there], beside[k, there], PARAMETERS)
        covariance += np.diag(noise[k, there])
        across = shadow_covariance_db2(beside[k, there], own[k], PARAMETERS)[:, 0]
        weights = np.linalg.solve(covariance, across)
        np.testing.assert_allclose(found.weights[k, there], weights, rtol=1e-10)
        assert (found.weights[k, missing[k]] == 0.0).all()
        np.testing.assert_allclose(found.variance_db2[k], 36.0 - across @ weights, rtol=1e-10)


def test_beside_an_exact_neighbour_the_variance_is_not_negative():
    """A neighbour at the same place without noise leaves nothing, not less."""
    place = Origins(np.full((1, 1, 2), 3.0))
    found = regress_on_neighbours(
        PARAMETERS, place, place, np.full((1, 1), 1e-15), np.zeros((1, 1), dtype=bool)
    )
    assert 0.0 <= found.variance_db2[0] < 1e-12
