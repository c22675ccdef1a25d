"""The bivariate normal distribution against SciPy's and closed forms."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from planopt.channel.path_connectivity import bivariate_normal_cdf

SCORES = st.floats(-6.0, 6.0)
CORRELATIONS = st.floats(-1.0, 1.0)


def cdf(h, k, rho):
    """One pair."""
    return float(bivariate_normal_cdf(np.array(h), np.array(k), np.array(rho)))


def by_quadrature(h, k, rho):
    """Phi(h) Phi(k) plus the integral of the density over the correlation (Plackett)."""

    def slope(angle):
        return np.exp(-(h * h + k * k - 2.0 * h * k * np.sin(angle)) / (2.0 * np.cos(angle) ** 2))

    added = quad(slope, 0.0, np.arcsin(rho), epsabs=1e-14)[0] / (2.0 * np.pi)
    return norm.cdf(h) * norm.cdf(k) + added


@pytest.mark.parametrize("rho", [-0.999, -0.5, 0.0, 0.3, 0.95])
@pytest.mark.parametrize(("h", "k"), [(-1.0, 2.0), (0.0, -0.7), (0.0, 0.0), (1.3, 1.3), (-4, -3)])
def test_against_quadrature(h, k, rho):
    """To 1e-13."""
    assert cdf(h, k, rho) == pytest.approx(by_quadrature(h, k, rho), abs=1e-13)


@given(SCORES, SCORES, CORRELATIONS)
@example(5e-324, 5e-324, 0.875)
@example(0.0, 5e-324, 0.875)
def test_identities(h, k, rho):
    """Symmetry, the complement, and the Fréchet bounds."""
    value = cdf(h, k, rho)
    assert value == pytest.approx(cdf(k, h, rho), abs=1e-14)
    assert value + cdf(h, -k, -rho) == pytest.approx(norm.cdf(h), abs=1e-13)
    assert max(0.0, norm.cdf(h) + norm.cdf(k) - 1.0) - 1e-15 <= value
    assert value <= min(norm.cdf(h), norm.cdf(k)) + 1e-15


@pytest.mark.parametrize("rho", [-1.0, 1.0])
def test_one_variable_in_two(rho):
    """Correlation 1 and -1."""
    expected = norm.cdf(0.2) if rho > 0.0 else norm.cdf(0.7) - norm.cdf(-0.2)
    assert cdf(0.2, 0.7, rho) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("rho", [-1.0, -0.3, 0.0, 0.6, 1.0])
def test_infinite_scores(rho):
    """Certain events drop out."""
    assert cdf(np.inf, 0.4, rho) == pytest.approx(norm.cdf(0.4), abs=1e-15)
    assert cdf(-np.inf, 0.4, rho) == 0.0
    assert cdf(np.inf, np.inf, rho) == 1.0
