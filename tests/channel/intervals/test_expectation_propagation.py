"""Sites of intervals against quadrature, lattice sums and the limits of the interval's width."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import multivariate_normal

from planopt.channel.gaussian_sites import Intervals, LatentPrior, interval_sites

PLACES = np.array([0.0, 1.0, 3.0])
COVARIANCE = 16.0 * np.exp(-np.abs(np.subtract.outer(PLACES, PLACES)) / 2.0)
THREE = LatentPrior.known_mean(np.array([-80.0, -82.0, -79.0]), COVARIANCE)


def limits(upper):
    return Intervals(np.asarray(upper), np.full(len(upper), np.inf))


def likelihood(f, upper, width, omega):
    """Probability that f + noise is in the interval, without loss of digits in the tails."""
    high, low = (upper - f) / omega, (upper - width - f) / omega
    # By the tail that is the smaller one.
    return np.where(low > 0.0, ndtr(-low) - ndtr(-high), ndtr(high) - ndtr(low))


@pytest.mark.parametrize("upper", [-60.0, -79.0, -84.0, -100.0])
@pytest.mark.parametrize("width", [0.01, 1.0, 6.0, 40.0, np.inf])
@pytest.mark.parametrize("omega2", [4.0, 0.01])
def test_one_interval_matches_the_exact_tilted_moments(upper, width, omega2):
    """With one site EP is exact: mean, variance and evidence agree with quadrature."""
    mean, deviation = -80.0, 5.0
    prior = LatentPrior.known_mean(np.array([mean]), np.array([[deviation**2]]))
    known = Intervals(np.array([upper]), np.array([width]))
    found = interval_sites(prior, known, omega2)
    omega = np.sqrt(omega2)
    lower = max(upper - width, -250.0)
    ends = max(lower - 12.0 * omega, mean - 45.0), min(upper + 12.0 * omega, mean + 45.0)
    nearest = np.clip(mean, ends[0], ends[1])

    def moment(power, about=0.0):
        def integrand(f):
            density = np.exp(0.5 * ((nearest - mean) ** 2 - (f - mean) ** 2) / deviation**2)
            return (f - about) ** power * density * likelihood(f, upper, width, omega)

        points = np.clip([lower, nearest, upper], *ends)
        return quad(integrand, *ends, points=points, limit=500, epsrel=1e-11, epsabs=1e-300)[0]

    mass = moment(0)
    exact_mean = moment(1) / mass
    exact_variance = moment(2, exact_mean) / mass
    log_mass = np.log(mass) - 0.5 * ((nearest - mean) / deviation) ** 2
    log_mass -= np.log(deviation) + 0.5 * np.log(2.0 * np.pi)
    total = deviation**-2 + found.precision[0]
    assert mean + found.shift[0] / total == pytest.approx(exact_mean, abs=2e-6)
    assert 1.0 / total == pytest.approx(exact_variance, rel=2e-6)
    assert found.log_evidence == pytest.approx(log_mass, abs=1e-6)


@pytest.mark.parametrize("omega", [0.3, 1.0, 3.0])
def test_two_intervals_against_numerical_integration(omega):
    """Moments and evidence of two correlated values, each in its interval, one half-open."""
    mean = np.array([-80.0, -79.0])
    covariance = np.array([[16.0, 12.0], [12.0, 16.0]])
    known = Intervals(np.array([-82.5, -78.0]), np.array([3.0, np.inf]))
    found = interval_sites(LatentPrior.known_mean(mean, covariance), known, omega**2)
    posterior = np.linalg.inv(np.linalg.inv(covariance) + np.diag(found.precision))
    axis = np.linspace(-22.0, 22.0, 1101)
    grid = np.stack(np.meshgrid(mean[0] + axis, mean[1] + axis, indexing="ij"), axis=-1)
    weight = multivariate_normal(mean, covariance).pdf(grid)
    for i in (0, 1):
        weight *= likelihood(grid[..., i], known.upper_db[i], known.width_db[i], omega)
    mass = weight.sum()
    exact = np.einsum("ij,ijk->k", weight, grid) / mass
    centred = grid - exact
    spread = np.einsum("ij,ijk,ijl->kl", weight, centred, centred) / mass
    np.testing.assert_allclose(mean + posterior @ found.shift, exact, atol=0.03)
    np.testing.assert_allclose(posterior, spread, atol=0.05)
    log_mass = np.log(mass * (axis[1] - axis[0]) ** 2)
    assert found.log_evidence == pytest.approx(log_mass, abs=0.01)


@pytest.mark.parametrize("width", [np.inf, 3.0, 0.1])
def test_slope_is_the_derivative_of_the_evidence_by_omega(width):
    """At the fixed point the evidence moves with omega^2 through the likelihood alone."""
    known = Intervals(np.array([-83.0, -81.0, -84.0]), np.full(3, width))
    up, down = (interval_sites(THREE, known, 2.0 + d).log_evidence for d in (1e-4, -1e-4))
    slope = interval_sites(THREE, known, 2.0).evidence_slope
    assert slope == pytest.approx((up - down) / 2e-4, rel=1e-4)


def test_score_and_information_of_the_mean_are_a_measurement_of_it():
    """A prior of delta by natural parameters equals a normal one through the mean and covariance.

    Their constants differ: the integral of the former is not one.
    """
    columns = np.ones((3, 1))
    known = Intervals(np.array([-78.0, -80.0, -82.0]), np.array([1.0, 4.0, np.inf]))
    linear = dataclasses.replace(
        THREE, columns=columns, information=np.array([[0.2]]), score=np.array([0.3])
    )
    found = interval_sites(linear, known, 1.0)
    plain = LatentPrior.known_mean(THREE.mean_db + 1.5, COVARIANCE + 5.0)
    expected = interval_sites(plain, known, 1.0)
    np.testing.assert_allclose(found.precision, expected.precision, rtol=1e-6)
    np.testing.assert_allclose(
        found.as_measurements().values_db, expected.as_measurements().values_db, rtol=1e-6
    )
    constant = 0.5 * np.log(2.0 * np.pi / 0.2) + 0.5 * 0.3**2 / 0.2
    assert found.log_evidence == pytest.approx(expected.log_evidence + constant, abs=1e-7)
    integrated, log_integral = linear.integrated()
    assert log_integral == pytest.approx(constant)
    np.testing.assert_allclose(integrated.mean_db, plain.mean_db, rtol=1e-14)
    np.testing.assert_allclose(integrated.covariance_db2, plain.covariance_db2, rtol=1e-14)
