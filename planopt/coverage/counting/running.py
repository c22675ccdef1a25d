"""Counting without a common start: the count follows agents that join and leave.

Every agent averages with its neighbours and adds a little in each round; the leader takes away as
much of its own value. ``x <- W x + eps (1 - x_leader e_leader)`` comes to rest only where the
leader holds n exactly, from wherever it starts, and all others hold a little more.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.counting.consensus import average_round, disagreement
from planopt.coverage.network import Loss, Network, is_connected
from planopt.errors import InputError


def running_round(
    values: NDArray[np.float64],
    network: Network,
    leader: int,
    innovation: float,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> NDArray[np.float64]:
    """Let every agent update its running count once.

    Parameters
    ----------
    values
        ``(n,)`` each agent's count, not rounded; an agent that joins may start with anything.
    network
        Who talks to whom now.
    leader
        Number of the agent that leads now.
    innovation
        eps, above 0 and at most 1: smaller ones leave all agents nearer to n, and take longer to
        follow: about n / eps rounds.
    loss, generator
        Links that fail, as in :func:`planopt.coverage.counting.consensus.average_round`.

    Raises
    ------
    InputError
        A number is out of range.
    """
    if not 0.0 < innovation <= 1.0:
        raise InputError(f"{innovation!r} is out of range", key="innovation")
    if not 0 <= leader < network.count:
        raise InputError(f"there is no agent {leader}", key="leader")
    after = average_round(values, network, loss=loss, generator=generator) + innovation
    after[leader] -= innovation * values[leader]
    return after


def running_limit(network: Network, leader: int, innovation: float) -> NDArray[np.float64]:
    """Return the counts ``(n,)`` at which updates without losses come to rest.

    The leader's is n, the others' are larger by at most innovation times a number of the network.

    Raises
    ------
    InputError
        The network is not connected.
    """
    every = np.arange(network.count)
    matrix = disagreement(network, np.where(every == leader, innovation, 0.0))
    return _solved(network, matrix, np.full(network.count, innovation))


def largest_innovation(network: Network, leader: int) -> float:
    """Return the innovation below which every agent's count at rest rounds to n.

    Raises
    ------
    InputError
        The network is not connected.
    """
    n = network.count
    if n == 1:
        return 1.0
    # At rest with innovation eps agent i holds n + eps y_i, with y_leader = 0.
    others = np.arange(n) != leader
    grounded = cast("csr_array", disagreement(network, np.zeros(n))[others][:, others])
    return min(0.5 / float(_solved(network, grounded, np.ones(n - 1)).max()), 1.0)


def _solved(network: Network, matrix: csr_array, right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solution of a sparse system that a connected network has."""
    if not is_connected(network):
        raise InputError("the network is not connected", key="links")
    return np.asarray(spsolve(matrix, right), dtype=np.float64)
