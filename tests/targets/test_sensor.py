"""The sensor with a sweet spot: closed forms, noise by simulation, derivatives by differences."""

import numpy as np
import pytest

from planopt import InputError
from planopt.targets.information_filter import (
    CUSP_SHARE,
    Sensor,
    noise_covariance_m2,
    sense,
    sensing_derivatives,
    sensing_information,
)

SENSOR = Sensor(0.008, 0.08, 1.0)
TARGET = np.array([3.0, -2.0])
PLACES = TARGET + np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 6.0], [-3.0, 4.0]])


def test_closed_forms():
    """1 / nu at the sweet spot; 1 / (varpi (r - r_s)^2 + nu) elsewhere, at the target too."""
    np.testing.assert_allclose(
        sensing_information(SENSOR, PLACES, TARGET),
        [12.5, 1.0 / 0.088, 1.0 / 0.28, 1.0 / (0.008 * 16.0 + 0.08)],
    )


def test_the_trace_of_the_inverse_covariance_is_the_information():
    """Tr Lambda^-1 = 1 / g, alike in both directions."""
    covariance = noise_covariance_m2(SENSOR, PLACES, TARGET)
    np.testing.assert_allclose(
        np.trace(np.linalg.inv(covariance), axis1=1, axis2=2),
        sensing_information(SENSOR, PLACES, TARGET),
    )
    np.testing.assert_array_equal(covariance[:, 0, 0], covariance[:, 1, 1])
    np.testing.assert_array_equal(covariance[:, 0, 1], 0.0)


def test_measurements_have_that_covariance():
    """40,000 measurements from one place, within 5 standard errors."""
    places = np.repeat(PLACES[2:3], 40_000, axis=0)
    error = sense(SENSOR, places, TARGET, np.random.default_rng(0)) - TARGET
    expected = noise_covariance_m2(SENSOR, PLACES[2], TARGET)
    bound = 5.0 * expected[0, 0] * np.sqrt(2.0 / 40_000)
    assert np.abs(np.cov(error.T) - expected).max() < bound
    assert np.abs(error.mean(axis=0)).max() < 5.0 * np.sqrt(expected[0, 0] / 40_000)


@pytest.mark.parametrize("sweet_spot", [1.0, 0.0, 4.0])
def test_derivatives_are_those_of_differences(sweet_spot):
    sensor, h = Sensor(0.03, 0.08, sweet_spot), 1e-5
    places = np.concatenate([PLACES, TARGET + np.array([[0.03, 0.05], [0.2, -0.1]])])
    found = sensing_derivatives(sensor, places, TARGET)
    for axis, columns in ((0, [0, 1]), (1, [1, 2])):
        step = h * np.eye(2)[axis]
        more = sensing_derivatives(sensor, places + step, TARGET)
        less = sensing_derivatives(sensor, places - step, TARGET)
        np.testing.assert_allclose(
            found.gradient[:, axis], (more.value - less.value) / (2 * h), atol=1e-7
        )
        np.testing.assert_allclose(
            found.hessian[:, columns], (more.gradient - less.gradient) / (2 * h), atol=2e-3
        )


def test_rounding_is_only_at_the_target_and_as_large_as_said():
    """Exact from a tenth of the sweet spot on; g smaller by at most 3/4 of that share inside."""
    radii = np.linspace(0.0, 3.0, 301)
    places = TARGET + radii[:, None] * np.array([0.6, 0.8])
    g = 1.0 / sensing_derivatives(SENSOR, places, TARGET).value
    exact = 1.0 / sensing_information(SENSOR, places, TARGET)
    less = exact - g
    far = radii >= CUSP_SHARE
    np.testing.assert_allclose(less[far], 0.0, atol=1e-15)
    assert less[~far].min() > 0.0
    assert less[0] == pytest.approx(0.75 * CUSP_SHARE * 0.008)


@pytest.mark.parametrize(
    "numbers",
    [(0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, -0.1), (np.nan, 1.0, 1.0), (1.0, np.inf, 1.0)],
)
def test_numbers_out_of_range(numbers):
    with pytest.raises(InputError):
        Sensor(*numbers)
