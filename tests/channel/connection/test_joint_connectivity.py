"""Joint connectivity: the theory's checked values, the order of the bounds, validity."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from planopt.channel import (
    ChannelParameters,
    JointPrediction,
    Measurements,
    Station,
    condition,
    joint_connectivity,
    joint_prediction,
)
from planopt.channel.path_connectivity import spanning_tree_weight


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


def test_hunter_is_exact_for_two_places():
    """Inclusion and exclusion, for correlations of either sign."""
    for covariance in ([[1.0, 0.6], [0.6, 1.0]], [[1.0, -0.6], [-0.6, 1.0]]):
        prediction = JointPrediction(np.array([0.4, 0.9]), np.array(covariance))
        found = joint_connectivity(prediction, 0.0, np.random.default_rng(0), 1e-6)
        assert found.hunter.value == pytest.approx(found.exact.value, abs=2e-6)


def test_negative_correlation_is_said():
    """No product bound, and why; Hunter's is the lower bound."""
    covariance = np.array([[1.0, -0.2, 0.1], [-0.2, 1.0, 0.3], [0.1, 0.3, 1.0]])
    found = joint_connectivity(JointPrediction(np.full(3, 1.5), covariance), 0.0)
    assert found.exact is None
    assert found.product.value is None
    assert not found.product.proven
    assert "1 pairs" in found.product.reason
    assert "-0.2" in found.product.reason
    assert found.corrected_product.value < found.at_each.prod()
    assert found.lower == found.hunter.value


def test_certain_places():
    """Powers that are known count as in or out."""
    certain = JointPrediction(np.array([1.0, 2.0]), np.zeros((2, 2)))
    inside = joint_connectivity(certain, 0.0, np.random.default_rng(0))
    assert inside.exact.value == inside.lower == inside.upper.value == 1.0
    outside = joint_connectivity(certain, 1.5, np.random.default_rng(0))
    assert outside.exact.value == outside.lower == outside.upper.value == 0.0


def test_from_a_posterior():
    """Measurements above the threshold raise the joint probability."""
    channel = ChannelParameters(-30.0, 3.0, 6.0, 40.0, 2.0, Station((0.0, 0.0)))
    path = np.column_stack([np.full(10, 50.0), np.linspace(0.0, 20.0, 10)])
    strong = Measurements(path[::3], np.full(4, -70.0), np.zeros(4, dtype=bool))
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    prior, given_data = (
        joint_connectivity(
            joint_prediction(condition(channel, data, theta="known"), path),
            -83.0,
            np.random.default_rng(1),
        )
        for data in (nothing, strong)
    )
    assert given_data.exact.value > prior.exact.value + 0.1
    assert prior.product.proven


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
    """Whether the edges join all nodes."""
    group = list(range(count))
    for one, other in edges:
        group = [group[one] if label == group[other] else label for label in group]
    return len(set(group)) == 1
