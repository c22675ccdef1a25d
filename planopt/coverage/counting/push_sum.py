"""Counting over links that lose messages in one direction without anybody noticing.

Every agent sends the sum of all that it ever gave a neighbour. Whoever hears it again after a loss
finds what was missing in the difference, so that nothing is lost for good.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.counting.consensus import Count, inverted
from planopt.coverage.network import Loss, Network, gets_through
from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class PushSum:
    """The sums that agents and links hold."""

    held: NDArray[np.float64]  # (n, 2) value and weight of each agent
    given: NDArray[np.float64]  # (n, 2) sums of what each agent ever gave to one neighbour
    # (2 e, 2) the sums that were last heard over each link in each direction
    taken: NDArray[np.float64]


def start_push_sum(network: Network, leader: int) -> PushSum:
    """Return the state in which the leader has the value 1 and every agent the weight 1."""
    if not 0 <= leader < network.count:
        raise InputError(f"there is no agent {leader}", key="leader")
    held = np.stack((np.zeros(network.count), np.ones(network.count)), axis=1)
    held[leader, 0] = 1.0
    return PushSum(held, np.zeros((network.count, 2)), np.zeros((2 * len(network.links), 2)))


def push_sum_round(
    state: PushSum,
    network: Network,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> PushSum:
    """Let every agent share what it holds with its neighbours once."""
    sender, receiver = network.directed
    heard = gets_through(len(sender), loss, generator)
    share = state.held / (1.0 + network.degrees)[:, None]
    given = state.given + share
    held = share.copy()
    news = given[sender] - state.taken
    np.add.at(held, receiver[heard], news[heard])
    taken = np.where(heard[:, None], given[sender], state.taken)
    return PushSum(held, given, taken)


def count_by_push_sum(
    network: Network,
    leader: int,
    rounds: int,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Count:
    """Count agents by push-sum with running sums."""
    if rounds < 0:
        raise InputError(f"{rounds} rounds", key="rounds")
    state = start_push_sum(network, leader)
    for _ in range(rounds):
        state = push_sum_round(state, network, loss=loss, generator=generator)
    estimates = inverted(state.held[:, 0] / state.held[:, 1])
    return Count(estimates, rounds, 2 * rounds * len(network.links))
