"""The truncated normal against quadrature on scaled integrands, closed forms and limits."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import log_ndtr
from scipy.stats import norm

from planopt.channel.gaussian_sites import LEAST_CLOSED_FORM, truncated_normal


def one(upper, width):
    """Log probability, mean and variance of one interval, never by the closed form."""
    found = truncated_normal(np.array([upper, 0.0]), np.array([width, 1.0]))
    return found.log_probability[0], found.mean[0], found.variance[0]


def by_quadrature(upper, width):
    """The same by adaptive integration of the density scaled to 1 at its highest point."""
    lower = upper - width
    highest = min(max(lower, 0.0), upper)
    scale = min(1.0, 1.0 / (1.0 + abs(highest)))
    ends = max(lower, highest - 40.0 * scale), min(upper, highest + 40.0 * scale)

    def moment(power, about=0.0):
        def integrand(x):
            excess = (x - highest) * (x + highest)
            return ((x - about) / scale) ** power * np.exp(-0.5 * excess)

        middle = [highest] if ends[0] < highest < ends[1] else None
        absolute = 1e-13 * (ends[1] - ends[0])
        return quad(integrand, *ends, epsabs=absolute, epsrel=1e-11, limit=400, points=middle)[0]

    mass = moment(0)
    offset = moment(1, highest) / mass
    mean = highest + scale * offset
    variance = scale**2 * moment(2, mean) / mass
    return np.log(mass) - 0.5 * highest**2 - 0.5 * np.log(2.0 * np.pi), mean, variance


@pytest.mark.parametrize("upper", [-300.0, -30.0, -6.0, -1.0, 0.0, 0.4, 3.0, 9.0, 35.0, 300.0])
@pytest.mark.parametrize("width", [1e-3, 0.1, 1.0, 4.0, 30.0, 1e4])
def test_agrees_with_quadrature(upper, width):
    """Probability, mean and variance, in the body and deep in both tails."""
    log_probability, mean, variance = one(upper, width)
    expected = by_quadrature(upper, width)
    assert log_probability == pytest.approx(expected[0], rel=1e-11, abs=1e-11)
    assert mean == pytest.approx(expected[1], rel=1e-11, abs=1e-11)
    assert variance == pytest.approx(expected[2], rel=1e-8)


@pytest.mark.parametrize("z", [-19.0, -5.0, 0.0, 2.0, 8.0, 50.0])
def test_half_lines_by_both_methods(z):
    """The closed form for half lines agrees with the quadrature and with SciPy."""
    assert z > LEAST_CLOSED_FORM
    closed = truncated_normal(np.array([z]), np.array([np.inf]))
    log_probability, mean, variance = one(z, np.inf)
    assert closed.log_probability[0] == pytest.approx(float(log_ndtr(z)), abs=1e-13, rel=1e-13)
    assert closed.log_probability[0] == pytest.approx(log_probability, abs=1e-12, rel=1e-12)
    assert closed.mean[0] == pytest.approx(mean, abs=1e-12, rel=1e-12)
    assert closed.variance[0] == pytest.approx(variance, rel=1e-9)


def test_narrow_intervals_are_uniform():
    """Variance d^2 / 12 and probability d phi(z), however narrow, in the tail as in the middle."""
    for width in (1e-2, 1e-6, 1e-12):
        for z in (0.0, -3.0, 12.0):
            log_probability, mean, variance = one(z + 0.5 * width, width)
            assert variance == pytest.approx(width**2 / 12.0, rel=width**2 * (1 + z**2) + 1e-12)
            assert mean == pytest.approx(z, abs=width**2 * (1 + abs(z)) + 1e-14)
            expected = norm.logpdf(z) + np.log(width)
            assert log_probability == pytest.approx(expected, abs=width**2 * (1 + z**2) + 1e-11)
