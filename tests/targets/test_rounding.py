"""Rounded lengths and thresholds: exact beyond the width, smooth across it, close within."""

import numpy as np
import pytest

from planopt.arrays import rounded_length, rounded_positive_part

WIDTH = 0.3


def test_exact_beyond_the_width():
    """Value, unit vector and curvature of the Euclidean length."""
    offset = np.array([[0.3, 0.0], [3.0, -4.0], [-0.2, 0.5]])
    found = rounded_length(offset, WIDTH)
    r = np.linalg.norm(offset, axis=1)
    np.testing.assert_allclose(found.value, r, rtol=1e-15)
    np.testing.assert_allclose(found.gradient, offset / r[:, None], rtol=1e-14)
    across = np.eye(2)[None] - offset[:, :, None] * offset[:, None] / r[:, None, None] ** 2
    np.testing.assert_allclose(
        found.hessian, (across / r[:, None, None])[:, [0, 0, 1], [0, 1, 1]], atol=1e-14
    )


def test_within_the_width_it_is_larger_by_at_most_three_eighths():
    """The most at zero; nowhere below the length."""
    offset = np.column_stack([np.linspace(0.0, WIDTH, 50), np.zeros(50)])
    more = rounded_length(offset, WIDTH).value - offset[:, 0]
    assert more[0] == pytest.approx(0.375 * WIDTH)
    assert (np.diff(more) <= 1e-15).all()
    assert more[-1] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.299999, 0.300001, 1.0])
def test_derivatives_are_those_of_differences(radius):
    """At zero, inside, on both sides of the seam, and outside."""
    place, h = radius * np.array([0.6, -0.8]), 1e-6
    found = rounded_length(place, WIDTH)
    for axis, columns in ((0, [0, 1]), (1, [1, 2])):
        step = h * np.eye(2)[axis]
        more, less = rounded_length(place + step, WIDTH), rounded_length(place - step, WIDTH)
        assert found.gradient[axis] == pytest.approx((more.value - less.value) / (2 * h), abs=1e-8)
        np.testing.assert_allclose(
            found.hessian[columns], (more.gradient - less.gradient) / (2 * h), atol=2e-4
        )


def test_positive_part():
    """Exact outside, within 3/16 of the width inside, twice differentiable."""
    x = np.array([-2.0, -0.3, -0.1, 0.0, 0.2, 0.3, 5.0])
    value, first, second = rounded_positive_part(x, WIDTH)
    more = value - np.maximum(x, 0.0)
    assert (more >= -1e-15).all() and more.max() == pytest.approx(3.0 / 16.0 * WIDTH)
    np.testing.assert_allclose(value[[0, 1, 5, 6]], [0.0, 0.0, 0.3, 5.0], atol=1e-15)
    h = 1e-5
    above, below = rounded_positive_part(x + h, WIDTH), rounded_positive_part(x - h, WIDTH)
    np.testing.assert_allclose(first, (above[0] - below[0]) / (2 * h), atol=1e-8)
    np.testing.assert_allclose(second, (above[1] - below[1]) / (2 * h), atol=2e-4)
