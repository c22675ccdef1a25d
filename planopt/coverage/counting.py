"""Counting: how the agents of a network estimate their own number, some rounds in every step.

By averaging from a leader, which holds 1 and all others 0, all values tend to 1 / n. By minima
every agent draws exponential numbers, and all learn the smallest of each: the minimum of n is n
times smaller than one of them. There is no leader, and lost or repeated messages do no harm. Both
restart in epochs, and an estimate holds until the next epoch has ended.

The running count never restarts and follows agents that join and leave: every agent averages with
its neighbours and adds a little in each round, and the leader subtracts as much of its own value.
``x <- W x + eps (1 - x_leader e_leader)`` rests only where the leader holds n exactly, and all
others a little more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.network import Loss, Network, gets_through
from planopt.errors import InputError


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


def inverted(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return counts from values near 1 / n; infinite where a value is not positive; (n,)."""
    counts = np.full(values.shape, np.inf)
    heard = values > 0.0
    counts[heard] = 1.0 / values[heard]
    return counts


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


def minima_estimates(minima: Minima) -> NDArray[np.float64]:
    """Return each agent's unbiased estimate ``(m - 1) / sum of minima``; (n,)."""
    return (minima.values.shape[1] - 1) / minima.values.sum(axis=1)


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
