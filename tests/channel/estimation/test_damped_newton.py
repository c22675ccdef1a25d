"""The minimiser in a box on functions with known minima."""

import numpy as np
import pytest
from scipy.optimize import minimize

from planopt.channel.estimation.likelihood_climb import minimise_damped

TARGET = np.array([1.0, -2.0, 0.5])
CURVATURE = np.array([[4.0, 1.9, 0.0], [1.9, 1.0, 0.1], [0.0, 0.1, 9.0]])
WIDE = np.full(3, 10.0)


def quadratic(x):
    """Value, gradient, curvature."""
    offset = x - TARGET
    return 0.5 * offset @ CURVATURE @ offset, CURVATURE @ offset, CURVATURE


def counted(objective):
    """The objective and a list of the points it was evaluated at."""
    points = []

    def counting(x):
        points.append(x.copy())
        return objective(x)

    return counting, points


def test_free_minimum():
    """A quadratic with its own curvature is solved in a few evaluations, from outside the box."""
    objective, points = counted(quadratic)
    value, point = minimise_damped(objective, np.full(3, 20.0), -WIDE, WIDE, 1e-12)
    np.testing.assert_allclose(point, TARGET, atol=1e-5)
    assert value < 1e-11
    assert len(points) < 20
    assert all((np.abs(p) <= 10.0).all() for p in points)


@pytest.mark.parametrize("seed", range(8))
def test_minimum_on_the_boundary(seed):
    """In random boxes, corners and faces included, it ends where L-BFGS-B does."""
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-4.0, 1.0, 3)
    upper = lower + rng.uniform(0.1, 3.0, 3)
    expected = minimize(
        lambda x: quadratic(x)[:2],
        lower,
        jac=True,
        bounds=list(zip(lower, upper, strict=True)),
        options={"ftol": 1e-15, "gtol": 1e-10},
    )
    value, point = minimise_damped(quadratic, rng.uniform(lower, upper), lower, upper, 1e-12)
    assert value == pytest.approx(expected.fun, abs=1e-7)
    np.testing.assert_allclose(point, expected.x, atol=1e-3)
    assert ((lower <= point) & (point <= upper)).all()


def test_nothing_to_gain():
    """At a minimum, in a corner or where all is flat, one evaluation is enough."""
    for objective, start in (
        (quadratic, TARGET),
        (lambda x: (float(x.sum()), np.ones(3), np.eye(3)), -WIDE),
        (lambda x: (0.0, np.zeros(3), np.zeros((3, 3))), np.zeros(3)),
    ):
        counting, points = counted(objective)
        _, point = minimise_damped(counting, start, -WIDE, WIDE, 1e-9)
        np.testing.assert_array_equal(point, start)
        assert len(points) == 1
