"""The typed minimisers on functions with known minima."""

import numpy as np

from planopt.channel.minimise import minimise_from_simplex, minimise_in_box

TARGET = np.array([1.0, -2.0])


def test_box_holds_the_minimum_in():
    """A quadratic whose minimum is outside the box ends on its face, from a start outside."""
    value, point = minimise_in_box(
        lambda x: (float(((x - TARGET) ** 2).sum()), 2.0 * (x - TARGET)),
        np.array([9.0, 9.0]),
        np.array([-1.0, -1.0]),
        np.array([5.0, 5.0]),
    )
    np.testing.assert_allclose(point, [1.0, -1.0], atol=1e-5)
    assert abs(value - 1.0) < 1e-6


def test_simplex_finds_the_minimum():
    """A kinked function without gradient is minimised to the tolerance."""
    simplex = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    value, point = minimise_from_simplex(lambda x: float(np.abs(x - TARGET).sum()), simplex, 1e-4)
    np.testing.assert_allclose(point, TARGET, atol=1e-3)
    assert value < 2e-3
