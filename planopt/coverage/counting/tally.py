"""The count that a network keeps while it works: some rounds of a method in every step.

Methods with a common start are restarted in epochs, and an estimate holds until the next epoch has
ended; the running count never restarts.

By minima every agent draws numbers, and all learn the smallest of each: the minimum of n
exponential variables is n times smaller than one of them. No leader, no identities; lost and
repeated messages do no harm. The estimate is random, with an exact confidence interval.

The running count follows agents that join and leave. Every agent averages with its neighbours and
adds a little in each round; the leader takes away as much of its own value.
``x <- W x + eps (1 - x_leader e_leader)`` comes to rest only where the leader holds n exactly, from
wherever it starts, and all others hold a little more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve  # pyright: ignore[reportUnknownVariableType]
from scipy.special import gammaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.counting.consensus import (
    Count,
    average_round,
    disagreement,
    elect_leader,
    inverted,
)
from planopt.coverage.network import Loss, Network, gets_through, is_connected
from planopt.errors import InputError


def running_round(
    values: NDArray[np.float64],  # (n,)
    network: Network,
    leader: int,
    innovation: float,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> NDArray[np.float64]:
    """Let every agent update its running count once."""
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
    """
    every = np.arange(network.count)
    matrix = disagreement(network, np.where(every == leader, innovation, 0.0))
    return _solved(network, matrix, np.full(network.count, innovation))


def largest_innovation(network: Network, leader: int) -> float:
    """Return the innovation below which every agent's count at rest rounds to n."""
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


LEAST_DRAWS = 3
"""With fewer numbers the estimate has no finite variance."""


@dataclass(frozen=True, eq=False)
class Minima:
    """The smallest numbers that each agent has heard of."""

    values: NDArray[np.float64]  # (n, m) one for each of m numbers


def draw_minima(agents: int, draws: int, generator: np.random.Generator) -> Minima:
    """Draw each agent's numbers from the exponential distribution of mean 1."""
    if draws < LEAST_DRAWS:
        raise InputError(f"{draws} draws", key="draws", remedy=f"give {LEAST_DRAWS} or more")
    return Minima(generator.standard_exponential((agents, draws)))


def minima_round(
    minima: Minima,
    network: Network,
    *,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Minima:
    """Let every agent send its numbers to its neighbours once and keep the smallest."""
    sender, receiver = network.directed
    heard = gets_through(len(sender), loss, generator)
    sender, receiver = sender[heard], receiver[heard]
    after = minima.values.copy()
    np.minimum.at(after, receiver, minima.values[sender])
    return Minima(after)


def count_by_minima(
    network: Network,
    draws: int,
    rounds: int,
    generator: np.random.Generator,
    *,
    loss: Loss = 0.0,
) -> Count:
    """Count agents by the minima of exponential numbers."""
    if rounds < 0:
        raise InputError(f"{rounds} rounds", key="rounds")
    minima = draw_minima(network.count, draws, generator)
    for _ in range(rounds):
        minima = minima_round(minima, network, loss=loss, generator=generator)
    return Count(minima_estimates(minima), rounds, 2 * rounds * len(network.links))


def minima_estimates(minima: Minima) -> NDArray[np.float64]:
    """Return each agent's unbiased estimate ``(m - 1) / sum of minima``; (n,)."""
    return (minima.values.shape[1] - 1) / minima.values.sum(axis=1)


def count_interval(
    estimates: NDArray[np.float64], draws: int, confidence: float = 0.95
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the exact confidence interval of counts.

    n times the sum of m minima has the gamma distribution of shape m.
    """
    # Shapes: estimates (n,); returns (n,).
    if not 0.0 < confidence < 1.0:
        raise InputError(f"{confidence!r} is no probability", key="confidence")
    tail = 0.5 * (1.0 - confidence)
    low, high = (float(gammaincinv(draws, p)) / (draws - 1) for p in (tail, 1.0 - tail))
    return estimates * low, estimates * high


Method = Literal["known", "leader", "minima", "running"]
"""Agents are told their number, or count by averaging from a leader, by minima, or running."""


@dataclass(frozen=True)
class Counting:
    """The settings by which a network counts itself."""

    method: Method = "known"  # One of :data:`Method`
    rounds: int = 30  # Rounds in a step
    epoch_rounds: int = 600  # Rounds of an epoch, and of the running count before the first step
    draws: int = 400  # Numbers that each agent draws, for minima
    # Of the running count: smaller ones leave all agents nearer to the number, and follow slower
    # (:func:`planopt.coverage.counting.tally.largest_innovation`)
    innovation: float = 0.01

    def __post_init__(self) -> None:
        for key in ("rounds", "epoch_rounds"):
            if getattr(self, key) < 1:
                raise InputError(f"is {getattr(self, key)}", key=f"counting.{key}")


@dataclass(frozen=True, eq=False)
class Tally:
    """The state of agents while they count."""

    members: NDArray[np.bool_]  # (n,) who took part in the last step
    values: NDArray[np.float64]  # (n, m) what they hold
    # (n,) how many agents they believe there are; NaN for who does not take part
    estimates: NDArray[np.float64]
    leader: int = -1  # Number of the leading agent; -1 for none
    done: int = 0  # Rounds of the present epoch
    messages: int = 0  # Transmissions over single links in the last step, lost ones included


def start_tally(
    counting: Counting,
    network: Network,
    members: NDArray[np.bool_],  # (n,) who takes part
    generator: np.random.Generator,
    loss: Loss = 0.0,
) -> Tally:
    """Count once before the first step."""
    width = counting.draws if counting.method == "minima" else 1
    count = len(members)
    tally = Tally(members, np.zeros((count, width)), np.full(count, np.nan))
    whole = replace(counting, rounds=counting.epoch_rounds)
    return tally_step(tally, whole, network, members, generator, loss)


def tally_step(
    tally: Tally,
    counting: Counting,
    network: Network,
    members: NDArray[np.bool_],
    generator: np.random.Generator,
    loss: Loss = 0.0,
) -> Tally:
    """Let members count for the rounds of one step."""
    who = np.flatnonzero(members)
    estimates = np.full(len(members), np.nan)
    if counting.method == "known":
        estimates[who] = len(who)
        return Tally(members, tally.values, estimates)
    joined = who[~(tally.members & np.isfinite(tally.estimates))[who]]
    estimates[who] = tally.estimates[who]
    old = estimates[who][np.isfinite(estimates[who])]
    estimates[joined] = np.median(old) if len(old) else np.nan
    values, messages, leader, done = tally.values.copy(), 0, tally.leader, tally.done
    values[~(tally.members & members)] = 0.0
    begins = counting.method != "running" and done == 0
    if counting.method != "minima" and (begins or leader < 0 or not members[leader]):
        found = elect_leader(network, who)
        leader, messages = int(who[found.leader]), found.messages
        if begins:
            values[who] = 0.0
            values[leader] = 1.0
    held = values[who]
    if counting.method == "minima":
        # Who joins draws, too; in a new epoch everybody.
        fresh = np.ones(len(who), dtype=np.bool_) if begins else (held == 0.0).all(axis=1)
        if fresh.any():
            held[fresh] = draw_minima(int(fresh.sum()), counting.draws, generator).values
    own = int(np.searchsorted(who, leader))
    for _ in range(counting.rounds):
        if counting.method == "minima":
            held = minima_round(Minima(held), network, loss=loss, generator=generator).values
        elif counting.method == "leader":
            held = average_round(held, network, loss=loss, generator=generator)
        else:
            column = running_round(
                held[:, 0], network, own, counting.innovation, loss=loss, generator=generator
            )
            held = column[:, None]
    messages += 2 * counting.rounds * len(network.links)
    values[who], done = held, done + counting.rounds
    if counting.method == "running":
        estimates[who] = held[:, 0]
    elif done >= counting.epoch_rounds:
        counted = minima_estimates(Minima(held)) if held.shape[1] > 1 else inverted(held[:, 0])
        estimates[who] = np.where(np.isfinite(counted), counted, estimates[who])
        done = 0
    return Tally(members, values, estimates, leader, done, messages)
