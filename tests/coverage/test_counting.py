"""Counting against its bounds, its distribution and its limits."""

import math

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import gamma, kstest

from planopt.coverage import (
    Medium,
    Network,
    average_round,
    elect_leader,
    inverted,
    minima_estimates,
    minima_round,
    running_round,
)


def network_of(graph: nx.Graph) -> Network:
    """A network with the links of a graph on 0 .. n - 1."""
    links = np.array(list(graph.edges), dtype=np.intp).reshape(-1, 2)
    return Network(graph.number_of_nodes(), links)


def random_network(seed: int) -> Network:
    generator = np.random.default_rng(seed)
    n = int(generator.integers(2, 70))
    kind = seed % 5
    if kind == 0:
        graph = nx.path_graph(n)
    elif kind == 1:
        graph = nx.complete_bipartite_graph(max(n // 2, 1), n - max(n // 2, 1))
    elif kind == 2:
        graph = nx.random_labeled_tree(n, seed=seed)
    elif kind == 3:
        graph = nx.connected_watts_strogatz_graph(max(n, 5), 4, 0.3, seed=seed)
    else:
        graph = nx.barbell_graph(max(n // 3, 3), n // 3)
    return network_of(graph)


def metropolis_weights(network: Network) -> NDArray[np.float64]:
    joined = np.zeros((network.count, network.count))
    joined[network.directed] = 1.0
    larger = np.maximum.outer(network.degrees, network.degrees)
    weights = joined / (1.0 + larger)
    return weights + np.diag(1.0 - weights.sum(axis=1))


def test_exact_within_the_bound() -> None:
    """Counts are exact after ln(n (2 n + 1)) / ln(1 / modulus) rounds, not after a quarter."""
    early = []
    for seed in range(40):
        network = random_network(seed)
        n = network.count
        leader = n - 1  # The largest identity
        modulus = float(np.abs(np.linalg.eigvalsh(metropolis_weights(network) - 1.0 / n)).max())
        needed = math.floor(math.log(n * (2 * n + 1)) / -math.log(modulus)) + 1 if modulus else 1
        values = np.zeros(n)
        values[leader] = 1.0
        for number in range(needed):
            if number == needed // 4:
                early.append((np.rint(inverted(values)) == n).all())
            values = average_round(values, Medium(network))
        assert (np.rint(inverted(values)) == n).all()
    assert not all(early)


def test_averaging_and_election() -> None:
    """A round multiplies by the weights; the largest identity wins, by counted messages."""
    network = random_network(13)
    weights = metropolis_weights(network)
    values = np.random.default_rng(0).random((network.count, 3))
    assert average_round(values, Medium(network)) == pytest.approx(weights @ values)
    network = network_of(nx.path_graph(3))
    # All send; agents 0 and 1 learn of 9 or pass 4 on; agent 0 learns it last.
    assert elect_leader(network, np.array([3, 4, 9])) == (2, 4 + (1 + 2) + 1)


def test_averaging_with_losses() -> None:
    """Acknowledged losses keep the sum, so that the count still becomes exact."""
    network = random_network(8)
    values = np.random.default_rng(1).random(network.count)
    medium = Medium(network, 0.6, generator=np.random.default_rng(2))
    assert average_round(values, medium).sum() == pytest.approx(values.sum())
    held = np.append(1.0, np.zeros(network.count - 1))
    for _ in range(4000):
        held = average_round(held, medium)
    assert (np.rint(inverted(held)) == network.count).all()


def test_minima_distribution() -> None:
    """Unbiased, with variance n^2 / (m - 2): n times the sum of minima has a gamma law."""
    network, draws, runs = random_network(23), 40, 3000
    n = network.count
    generator = np.random.default_rng(3)
    # What all agents agree on is the minimum over all of them.
    drawn = generator.standard_exponential((runs, n, draws))
    sums = drawn.min(axis=1).sum(axis=1)
    estimates = (draws - 1) / sums
    error = estimates.std() / math.sqrt(runs)
    assert estimates.mean() == pytest.approx(n, abs=4.0 * error)
    assert estimates.std() == pytest.approx(n / math.sqrt(draws - 2), rel=0.06)
    assert kstest(n * sums, gamma(draws).cdf).pvalue > 1e-3


def test_minima_agree_after_the_diameter() -> None:
    """All agents hold the same minima after as many rounds as the diameter, and not before."""
    network = network_of(nx.path_graph(12))
    minima = np.random.default_rng(4).standard_exponential((12, 50))
    best = minima.min(axis=0)
    for _ in range(10):
        minima = minima_round(minima, Medium(network))
    assert (minima != best).any()
    assert (minima_round(minima, Medium(network)) == best).all()
    medium = Medium(network, 0.5, generator=np.random.default_rng(4))
    for _ in range(80):
        minima = minima_round(minima, medium)
    assert len(set(minima_estimates(minima).tolist())) == 1


@pytest.mark.parametrize("seed", [3, 7, 12, 21])
def test_running_count_comes_to_its_limit(seed: int) -> None:
    """From any initial value; the limit of the leader is n, and no agent holds less."""
    network = random_network(seed)
    n = network.count
    innovation = 0.001
    matrix = metropolis_weights(network)
    matrix[0, 0] -= innovation
    limit = np.linalg.solve(np.eye(n) - matrix, np.full(n, innovation))
    assert limit[0] == pytest.approx(n, rel=1e-9) and (limit >= n - 1e-9).all()
    start = np.random.default_rng(seed).uniform(-50.0, 300.0, n)
    one = running_round(start, Medium(network), 0, innovation)
    assert one == pytest.approx(matrix @ start + innovation)
    # All rounds at once: the distance from the limit shrinks by the matrix in each of them.
    rounds = int(40 * n / innovation)
    assert np.linalg.matrix_power(matrix, rounds) @ (start - limit) == pytest.approx(
        np.zeros(n), abs=1e-3
    )
