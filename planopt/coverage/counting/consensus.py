"""Counting by average consensus: a leader holds 1, all others 0, and everybody averages.

All values tend to 1 / n. The Metropolis weights need no number that an agent cannot know, and
their second largest eigenvalue modulus bounds how many rounds make the rounded count exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, eigsh  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.network import Loss, Network, gets_through, is_connected
from planopt.errors import InputError

DENSE = 400
"""Up to so many agents all eigenvalues are computed."""


@dataclass(frozen=True, eq=False)
class Count:
    """The agents' estimates of their own number."""

    # (n,) each agent's estimate, not rounded; infinite as long as an agent has heard nothing
    estimates: NDArray[np.float64]
    rounds: int  # Rounds in which all agents talked to their neighbours
    messages: int  # Transmissions over single links in one direction, lost ones included

    @property
    def rounded(self) -> NDArray[np.float64]:
        """Estimates to the nearest whole number; (n,)."""
        return np.rint(self.estimates)


@dataclass(frozen=True)
class Election:
    """The outcome of choosing a leader."""

    leader: int  # Number of the agent with the largest identity
    rounds: int  # Rounds until every agent knew it
    # Transmissions over single links; an agent sends when it has heard of a larger identity
    messages: int


def elect_leader(network: Network, identities: NDArray[np.intp] | None = None) -> Election:
    """Choose the agent with the largest identity, by passing on the largest one heard of."""
    # Shapes: identities (n,).
    n = network.count
    best = np.arange(n) if identities is None else np.asarray(identities)
    if best.shape != (n,) or len(np.unique(best)) != n:
        raise InputError("identities are distinct numbers, one for each agent", key="identities")
    leader = int(best.argmax())
    sender, receiver = network.directed
    talking, rounds, messages = np.ones(n, dtype=np.bool_), 0, 0
    while True:
        sent = talking[sender]
        messages += int(sent.sum())
        after = best.copy()
        np.maximum.at(after, receiver[sent], best[sender[sent]])
        talking = after > best
        if not talking.any():
            break
        best, rounds = after, rounds + 1
    if (best != best[leader]).any():
        raise InputError("the network is not connected", key="links")
    return Election(leader, rounds, messages)


def link_weights(network: Network) -> NDArray[np.float64]:
    """Return the Metropolis weight of each link, ``1 / (1 + max(deg_i, deg_j))``; (e,)."""
    return 1.0 / (1.0 + network.degrees[network.links].max(axis=1, initial=0))


def disagreement(network: Network, added: NDArray[np.float64]) -> csr_array:
    """Return what averaging takes away, ``I - W``, with numbers ``(n,)`` added to its diagonal."""
    weights, every = np.tile(link_weights(network), 2), np.arange(network.count)
    sender, receiver = network.directed
    own = np.bincount(sender, weights, minlength=network.count) + added
    return csr_array(
        (
            np.concatenate((-weights, own)),
            (np.concatenate((sender, every)), np.concatenate((receiver, every))),
        ),
        shape=(network.count, network.count),
    )


def second_modulus(network: Network) -> float:
    """Return the second largest eigenvalue modulus of the Metropolis weights.

    The modulus matters: on a graph that is nearly bipartite the most negative eigenvalue is the
    slow one.
    """
    n = network.count
    if not is_connected(network):
        raise InputError("the network is not connected", key="links")
    if n == 1:
        return 0.0
    if n <= DENSE:
        weights = average_round(np.eye(n), network)
        return float(np.abs(np.linalg.eigvalsh(weights - 1.0 / n)).max())

    def apply(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return average_round(x.ravel(), network) - x.mean()

    operator = LinearOperator((n, n), matvec=apply)  # pyright: ignore[reportCallIssue]
    # A start that is no eigenvector of any symmetric network, and always the same.
    start = np.random.default_rng(0).standard_normal(n)
    largest = cast(
        "NDArray[np.float64]",
        eigsh(operator, k=1, which="LM", v0=start, return_eigenvectors=False),
    )
    return float(np.abs(largest).max())


def rounds_until_exact(agents: int, modulus: float) -> int:
    """Return after how many rounds every rounded count is exact for certain.

    The error of an agent's value is at most ``modulus ** rounds``, and rounding ``1 / x`` is right
    once it is below ``1 / (n (2 n + 1))``.
    """
    if not 0.0 <= modulus < 1.0:
        raise InputError(f"a modulus of {modulus:g}", key="modulus", remedy="connect the network")
    if agents == 1:
        return 0
    if modulus == 0.0:
        return 1
    return math.floor(math.log(agents * (2 * agents + 1)) / -math.log(modulus)) + 1


def average_round(
    values: NDArray[np.float64],  # (n,) or (n, k) what agents hold
    network: Network,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> NDArray[np.float64]:
    """Let every agent average with its neighbours once.

    A link that loses a message is left out in both directions, as agents find out by acknowledging
    each other's messages: then the sum of all values stays the same.
    """
    links, weights = network.links, link_weights(network)
    if np.any(loss):
        kept = gets_through(len(links), loss, generator)
        links, weights = links[kept], weights[kept]
    first, second = links[:, 0], links[:, 1]
    flow = (values[second] - values[first]) * (weights if values.ndim == 1 else weights[:, None])
    after = values.copy()
    np.add.at(after, first, flow)
    np.add.at(after, second, -flow)
    return after


def count_by_averaging(
    network: Network,
    leader: int,
    rounds: int,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Count:
    """Count agents by average consensus from a leader."""
    if not 0 <= leader < network.count:
        raise InputError(f"there is no agent {leader}", key="leader")
    if rounds < 0:
        raise InputError(f"{rounds} rounds", key="rounds")
    values = np.zeros(network.count)
    values[leader] = 1.0
    for _ in range(rounds):
        values = average_round(values, network, loss=loss, generator=generator)
    return Count(inverted(values), rounds, 2 * rounds * len(network.links))


def inverted(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return counts from values near 1 / n; infinite where a value is not positive; (n,)."""
    counts = np.full(values.shape, np.inf)
    heard = values > 0.0
    counts[heard] = 1.0 / values[heard]
    return counts
