"""Connectivity of positions against SciPy's normal distribution, and refused arguments."""

import numpy as np
import pytest
from scipy.stats import norm

from planopt.channel.kriging import bound_margin_db, connection_probability

MEAN = np.array([-90.0, -83.0, -70.0, -83.0])
DEVIATION = np.array([4.0, 2.0, 9.0, 0.5])


def test_probability_is_the_normal_tail():
    expected = norm.sf(-82.0, loc=MEAN, scale=DEVIATION)
    np.testing.assert_allclose(connection_probability(MEAN, DEVIATION, -82.0), expected)


@pytest.mark.parametrize("p_min", [0.5, 0.8, 0.99])
def test_margin_is_zero_where_the_probability_is_p_min(p_min):
    """Lowering the mean by the margin makes the probability exactly p_min."""
    margin = bound_margin_db(MEAN, DEVIATION, -82.0, p_min)
    np.testing.assert_allclose(
        connection_probability(MEAN - margin, DEVIATION, -82.0), p_min, rtol=1e-12
    )


def test_powers_that_are_certain_or_not_predicted():
    """Deviation zero decides, and NaN stays NaN, on rasters too."""
    found = connection_probability(np.array([-82.0, -82.1]), np.zeros(2), -82.0)
    np.testing.assert_array_equal(found, [1.0, 0.0])
    mean = np.array([[np.nan, -80.0]])
    found = connection_probability(mean, np.array([[np.nan, 1.0]]), -82.0)
    assert np.isnan(found[0, 0])
    assert found[0, 1] > 0.97
    assert np.isnan(bound_margin_db(mean, mean, -82.0, 0.8)[0, 0])
