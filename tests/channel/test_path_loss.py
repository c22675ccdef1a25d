"""Path loss regressors in closed form."""

import numpy as np

from planopt.channel import Station
from planopt.channel.parameters import MIN_DISTANCE_M, regressors, station_distance_m


def test_distance_is_three_dimensional():
    """A 3-4-12 box has the diagonal 13."""
    station = Station((100.0, 50.0), 12.0)
    assert station_distance_m(np.array([[103.0, 54.0]]), station)[0] == 13.0


def test_ten_times_the_distance_costs_ten_n_db():
    """Rows are [1, -10 log10 d]."""
    rows = regressors(np.array([[1.0, 0.0], [10.0, 0.0], [0.0, -100.0]]), Station((0.0, 0.0)))
    np.testing.assert_allclose(rows, [[1.0, 0.0], [1.0, -10.0], [1.0, -20.0]], atol=1e-12)


def test_at_the_station_the_logarithm_stays_finite():
    """Distances do not fall below the least one."""
    rows = regressors(np.array([[7.0, 7.0]]), Station((7.0, 7.0)))
    assert rows[0, 1] == -10.0 * np.log10(MIN_DISTANCE_M)
