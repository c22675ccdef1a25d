"""Bivariate and multivariate normal probabilities, joint connectivity and first passage."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm
from simulated_channel import simulated

from planopt.channel import (
    ChannelParameters,
    JointPrediction,
    Measurements,
    Station,
    condition,
    first_passage,
    joint_connectivity,
    sample_power,
)
from planopt.channel.parameters import regressors
from planopt.channel.path_connectivity import (
    bivariate_normal_cdf,
    prefix_probabilities,
    spanning_tree_weight,
)

SCORES = st.floats(-6.0, 6.0)
CORRELATIONS = st.floats(-1.0, 1.0)


def cdf(h, k, rho):
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
    assert cdf(h, k, rho) == pytest.approx(by_quadrature(h, k, rho), abs=1e-13)


@given(SCORES, SCORES, CORRELATIONS)
@example(5e-324, 5e-324, 0.875)
@example(0.0, 5e-324, 0.875)
def test_identities(h, k, rho):
    value = cdf(h, k, rho)
    assert value == pytest.approx(cdf(k, h, rho), abs=1e-14)
    assert value + cdf(h, -k, -rho) == pytest.approx(norm.cdf(h), abs=1e-13)
    assert max(0.0, norm.cdf(h) + norm.cdf(k) - 1.0) - 1e-15 <= value
    assert value <= min(norm.cdf(h), norm.cdf(k)) + 1e-15


@pytest.mark.parametrize("rho", [-1.0, 1.0])
def test_one_variable_in_two(rho):
    expected = norm.cdf(0.2) if rho > 0.0 else norm.cdf(0.7) - norm.cdf(-0.2)
    assert cdf(0.2, 0.7, rho) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("rho", [-1.0, -0.3, 0.0, 0.6, 1.0])
def test_infinite_scores(rho):
    assert cdf(np.inf, 0.4, rho) == pytest.approx(norm.cdf(0.4), abs=1e-15)
    assert cdf(-np.inf, 0.4, rho) == 0.0
    assert cdf(np.inf, np.inf, rho) == 1.0


def rng():
    return np.random.default_rng(5)


def test_every_prefix_against_scipy():
    """A random covariance of 8; each prefix within the stated error and SciPy's 1e-5."""
    root = np.random.default_rng(0).standard_normal((8, 8))
    covariance, bound = root @ root.T + np.eye(8), np.linspace(-1.0, 4.0, 8)
    found = prefix_probabilities(bound, covariance, rng())
    for k in range(1, 9):
        expected = multivariate_normal.cdf(bound[:k], cov=covariance[:k, :k])
        assert abs(found.probability[k - 1] - expected) <= 2.0 * found.error[k - 1] + 2e-5
    assert found.error.max() <= 1e-4


def test_prefixes_in_extreme_cases():
    """Far tails keep their digits, one variable is exact, and covariances may be singular."""
    found = prefix_probabilities(np.full(3, -20.0), np.eye(3), rng())
    np.testing.assert_allclose(found.probability, norm.cdf(-20.0) ** np.arange(1.0, 4.0), rtol=1e-9)
    found = prefix_probabilities(np.array([2.0]), np.array([[4.0]]), rng())
    assert found.probability[0] == pytest.approx(norm.cdf(1.0), rel=1e-14)
    assert found.error[0] == 0.0
    covariance = np.array([[1.0, 1.0, 0.5], [1.0, 1.0, 0.5], [0.5, 0.5, 1.0]])
    found = prefix_probabilities(np.array([0.3, 0.3, 0.1]), covariance, rng())
    expected = multivariate_normal.cdf([0.3, 0.1], cov=[[1.0, 0.5], [0.5, 1.0]])
    assert found.probability[1] == pytest.approx(norm.cdf(0.3), abs=1e-12)
    assert found.probability[2] == pytest.approx(expected, abs=2e-4)
    constant = np.diag([0.0, 1.0, 0.0])
    inside = prefix_probabilities(np.array([0.1, 0.0, 0.0]), constant, rng())
    np.testing.assert_allclose(inside.probability, [1.0, 0.5, 0.5], atol=1e-12)
    outside = prefix_probabilities(np.array([0.1, 0.0, -0.1]), constant, rng())
    np.testing.assert_allclose(outside.probability, [1.0, 0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("far", [1e3, 1e12, 1e160])
def test_bounds_out_of_all_proportion(far):
    covariance = 0.5 + 0.5 * np.eye(3)
    bound = np.array([far, -far, far])
    found = prefix_probabilities(bound, covariance, rng())
    np.testing.assert_allclose(found.probability, [1.0, 0.0, 0.0], atol=1e-12)


def test_error_estimate_covers():
    """The stated error holds the truth in at least 18 of 20 seeds, at a coarse tolerance."""
    covariance = 0.5 + 0.5 * np.eye(10)
    held = 0
    for seed in range(20):
        found = prefix_probabilities(np.zeros(10), covariance, np.random.default_rng(seed), 1e-2)
        held += abs(found.probability[-1] - 1.0 / 11.0) <= found.error[-1]
    assert held >= 18


def line(shadow_std_db, multipath_std_db, decorrelation_m, marginal, count=20):
    """The prior field at places 1 m apart, each connected with probability `marginal` at 0 dBm."""
    index = np.arange(count)
    covariance = shadow_std_db**2 * np.exp(-np.abs(index[:, None] - index) / decorrelation_m)
    covariance += multipath_std_db**2 * np.eye(count)
    return JointPrediction(norm.ppf(marginal) * np.sqrt(np.diag(covariance)), covariance)


@pytest.mark.parametrize(
    ("channel", "hunter", "exact"),
    [((3.2, 3.02, 3.09), 0.171, 0.461), ((4.0, 1.13, 20.0), 0.575, 0.773)],
)
def test_checked_values_of_the_theory(channel, hunter, exact):
    """An indoor and an outdoor channel, 20 places at 0.95, to three digits.

    The product is 0.95^20 = 0.3585, which the theory prints as .359.
    """
    found = joint_connectivity(line(*channel, 0.95), 0.0, np.random.default_rng(0))
    assert found.boole.value == pytest.approx(0.0, abs=1e-12)
    assert found.hunter.value == pytest.approx(hunter, abs=5e-4)
    assert found.product.value == pytest.approx(0.95**20, rel=1e-12)
    assert found.exact.value == pytest.approx(exact, abs=5e-4 + found.exact.error)
    assert found.exact.error < 1e-3
    assert found.upper.value == pytest.approx(0.95)
    assert found.lower == max(found.hunter.value, found.product.value)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 7), st.integers(1, 9))
def test_order_of_the_bounds(seed, count, rank):
    """Boole <= Hunter <= exact <= min p; the product below it wherever it is called valid."""
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((count, rank)) + 0.5
    covariance = root @ root.T + np.diag(generator.uniform(0.01, 1.0, count))
    mean = generator.uniform(-1.0, 4.0, count)
    found = joint_connectivity(JointPrediction(mean, covariance), 0.0, generator, 1e-3)
    slack = 2.0 * found.exact.error + 1e-12
    assert found.boole.value <= found.hunter.value
    assert found.hunter.value <= found.exact.value + slack
    assert found.lower <= found.exact.value + slack
    assert found.exact.value <= found.upper.value + slack
    assert found.product.proven == (covariance.min() >= 0.0)
    assert found.corrected_product.value <= found.exact.value + slack
    if found.product.proven:
        assert found.corrected_product.value == found.product.value


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.integers(2, 7), st.floats(0.0, 0.9))
def test_corrected_product_under_negative_correlation(seed, count, strength):
    """Below the exact value for signs of every kind; exact for two places."""
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((count, count))
    covariance = strength * root @ root.T / count + (1.0 - strength) * np.eye(count)
    mean = generator.uniform(0.0, 3.0, count)
    found = joint_connectivity(JointPrediction(mean, covariance), 0.0, generator, 1e-4)
    slack = 2.0 * found.exact.error + 1e-12
    assert found.corrected_product.value <= found.exact.value + slack
    if count == 2 and covariance[0, 1] < 0.0:
        assert found.corrected_product.value == pytest.approx(found.exact.value, abs=slack)


def test_certain_and_negatively_correlated_places():
    """Known powers are in or out; without a product bound Hunter's is the lower bound."""
    covariance = np.array([[1.0, -0.2, 0.1], [-0.2, 1.0, 0.3], [0.1, 0.3, 1.0]])
    found = joint_connectivity(JointPrediction(np.full(3, 1.5), covariance), 0.0)
    assert found.exact is None
    assert found.product.value is None
    assert not found.product.proven
    assert "1 pairs" in found.product.reason
    assert "-0.2" in found.product.reason
    assert found.corrected_product.value < found.at_each.prod()
    assert found.lower == found.hunter.value
    certain = JointPrediction(np.array([1.0, 2.0]), np.zeros((2, 2)))
    inside = joint_connectivity(certain, 0.0, np.random.default_rng(0))
    assert inside.exact.value == inside.lower == inside.upper.value == 1.0
    outside = joint_connectivity(certain, 1.5, np.random.default_rng(0))
    assert outside.exact.value == outside.lower == outside.upper.value == 0.0


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_spanning_tree_by_enumeration(seed, count):
    """The best of all trees, found by trying every set of h - 1 edges."""
    weight = np.random.default_rng(seed).uniform(0.0, 1.0, (count, count))
    weight = weight + weight.T
    edges = list(itertools.combinations(range(count), 2))
    best = max(
        sum(weight[edge] for edge in chosen)
        for chosen in itertools.combinations(edges, count - 1)
        if connects(chosen, count)
    )
    assert spanning_tree_weight(weight) == pytest.approx(best)


def connects(edges, count):
    group = list(range(count))
    for one, other in edges:
        group = [group[one] if label == group[other] else label for label in group]
    return len(set(group)) == 1


CHANNEL = ChannelParameters(-30.0, 3.0, 5.0, 15.0, 1.5, Station((0.0, 0.0)))
NOTHING = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
PRIOR = condition(CHANNEL, NOTHING, theta="known")
LINE = np.column_stack([np.full(12, 30.0), 40.0 - np.linspace(0.0, 30.0, 12) ** 1.05])
CURVE = np.column_stack([np.linspace(60.0, 30.0, 9), 50.0 + 10.0 * np.cos(np.arange(9.0))])
THRESHOLD = -76.0


def missed_on_a_line(path, disconnected_now):
    """pi_k before any measurement by the recursion of equation 3.9, on a grid of shadowing."""
    places = path if disconnected_now else path[1:]
    grid, step = np.linspace(-45.0, 45.0, 1801, retstep=True)
    mean = regressors(places, CHANNEL.station) @ [CHANNEL.k_pl_db, CHANNEL.n_pl]
    misses = norm.cdf((THRESHOLD - mean[:, None] - grid) / CHANNEL.multipath_std_db)
    mass = norm.pdf(grid, 0.0, CHANNEL.shadow_std_db) * misses[0]
    found = [step * mass.sum()]
    for leg, miss in zip(np.hypot(*np.diff(places, axis=0).T), misses[1:], strict=True):
        rho = np.exp(-leg / CHANNEL.decorrelation_m)
        spread = CHANNEL.shadow_std_db * np.sqrt(1.0 - rho**2)
        mass = step * (norm.pdf(grid[:, None], rho * grid, spread) @ mass) * miss
        found.append(step * mass.sum())
    return np.array(found) / found[0] if disconnected_now else np.append(1.0, found)


@pytest.mark.parametrize("disconnected_now", [False, True])
def test_prior_on_a_line(disconnected_now):
    """The multivariate normal integral equals the recursion within its stated error."""
    found = first_passage(
        PRIOR, LINE, THRESHOLD, np.random.default_rng(0), disconnected_now=disconnected_now
    )
    line = missed_on_a_line(LINE, disconnected_now)
    off = np.abs(found.not_connected - line)
    assert (off <= 2.0 * found.not_connected_error + 1e-6).all()
    np.testing.assert_allclose(found.travelled_m[-1], 40.0 - LINE[-1, 1])
    # Taking places as independent promises too much (equation 3.10).
    missed = 1.0 - PRIOR.connectivity(LINE[1:], THRESHOLD)
    assert np.prod(missed) < 0.5 * found.not_connected[-1]


@pytest.mark.parametrize("disconnected_now", [False, True])
def test_posterior_on_a_curve_by_simulation(disconnected_now):
    """Distribution and expected distance against driving through sampled fields."""
    posterior = condition(CHANNEL, simulated(CHANNEL, 1, 15, 70.0))
    found = first_passage(
        posterior, CURVE, THRESHOLD, np.random.default_rng(0), disconnected_now=disconnected_now
    )
    power = sample_power(posterior, CURVE, 60_000, np.random.default_rng(2))
    connected = power >= THRESHOLD
    if disconnected_now:
        connected = connected[~connected[:, 0]]
    count = len(connected)
    legs = np.hypot(*np.diff(CURVE, axis=0).T)
    driven = np.zeros(count)
    searching = np.ones(count, dtype=bool)
    for leg, now, expected in zip(legs, connected[:, 1:].T, found.not_connected[1:], strict=True):
        driven += leg * searching
        searching &= ~now
        error = np.sqrt(expected * (1.0 - expected) / count)
        assert abs(searching.mean() - expected) < 4.0 * error + 2e-4
    assert abs(driven.mean() - found.expected_distance_m) < 4.0 * driven.std() / np.sqrt(count)
