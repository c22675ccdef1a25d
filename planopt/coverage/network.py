"""Communication of agents: links, losses of messages, and counting over them.

Agents estimate their own number in some rounds of messages in every step.

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

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.errors import InputError
from planopt.keys import SMALLEST, Part

Floats = NDArray[np.float64]

Loss = float | NDArray[np.float64]
"""Probability that a message is lost: the same for all links, or ``(e,)`` one for each link."""


@dataclass(frozen=True, eq=False)
class Network:
    """Agents and the links between them."""

    count: int  # Number of agents
    links: NDArray[np.intp]  # (e, 2) pairs of agents that are linked, each pair once

    @property
    def directed(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return sender and receiver of every link in both directions; (2 e,) each."""
        first, second = self.links[:, 0], self.links[:, 1]
        return np.concatenate((first, second)), np.concatenate((second, first))

    @property
    def degrees(self) -> NDArray[np.intp]:
        """Return the number of neighbours of each agent; (n,)."""
        return np.bincount(self.links.ravel(), minlength=self.count)


def gets_through(
    messages: int, loss: Loss, generator: np.random.Generator | None
) -> NDArray[np.bool_]:
    """Draw which messages get through; (messages,)."""
    if not np.any(loss):
        return np.ones(messages, dtype=np.bool_)
    assert generator is not None  # Losses are drawn
    losses = np.asarray(loss, dtype=np.float64)
    each = np.tile(losses, messages // len(losses)) if losses.ndim else losses
    return generator.random(messages) >= each


@dataclass(frozen=True)
class LinkModel(Part):
    """Loss of messages between agents by path loss and log-normal fading."""

    at = "links"

    k_pl_db: Annotated[float, Field(ge=-300, le=300)]
    """Received power at 1 m in dBm."""
    n_pl: Annotated[float, Field(ge=0.1, le=10)]
    """Path loss exponent."""
    fading_std_db: Annotated[float, Field(ge=SMALLEST, le=100)]
    """Standard deviation of the power of a message about its mean, in dB."""
    threshold_dbm: Annotated[float, Field(ge=-500, le=300)]
    """Weaker messages are lost."""

    def loss(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability that a message over distances is lost; of the same shape."""
        mean_dbm = self.k_pl_db - 10.0 * self.n_pl * np.log10(np.maximum(distance_m, 1.0))
        return np.asarray(ndtr((self.threshold_dbm - mean_dbm) / self.fading_std_db))


Method = Literal["known", "leader", "minima", "running"]
"""Agents know their number, or count by averaging from a leader, by minima, or running."""


@dataclass(frozen=True)
class Counting(Part):
    """The settings by which a network counts itself."""

    at = "counting"

    method: Method = "known"
    """known, leader (average consensus), minima (of random numbers) or running."""
    rounds: Annotated[int, Field(ge=1, le=10**5)] = 30
    """Rounds in a step."""
    epoch_rounds: Annotated[int, Field(ge=1, le=10**6)] = 600
    """Rounds of an epoch, and of the running count before the first step."""
    draws: Annotated[int, Field(ge=3, le=10**5)] = 400
    """For minima: numbers that each agent draws."""
    innovation: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Of the running count: with less, counts end nearer to the number, and follow slower."""


def elect_leader(network: Network, identities: NDArray[np.intp]) -> tuple[int, int]:
    """Return the agent with the largest identity ``(n,)``, found by messages, and their number.

    An agent sends when it has heard of a larger identity.
    """
    best, leader = identities, int(identities.argmax())
    sender, receiver = network.directed
    talking, messages = np.ones(network.count, dtype=np.bool_), 0
    while talking.any():
        sent = talking[sender]
        messages += int(sent.sum())
        after = best.copy()
        np.maximum.at(after, receiver[sent], best[sender[sent]])
        talking, best = after > best, after
    if (best != best[leader]).any():
        raise InputError("the network is not connected", key="links")
    return leader, messages


def link_weights(network: Network) -> Floats:
    """Return the Metropolis weight of each link, ``1 / (1 + max(deg_i, deg_j))``; (e,)."""
    return 1.0 / (1.0 + network.degrees[network.links].max(axis=1, initial=0))


def average_round(
    values: Floats,  # (n,) or (n, k) values that agents hold
    network: Network,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Floats:
    """Let every agent average with its neighbours once.

    A link that loses a message is left out in both directions, as agents find out by acknowledging
    each other's messages: then the sum of all values stays the same.
    """
    kept = gets_through(len(network.links), loss, generator)
    first, second = network.links[kept].T
    flow = (link_weights(network)[kept] * (values[second] - values[first]).T).T
    after = values.copy()
    np.add.at(after, first, flow)
    np.add.at(after, second, -flow)
    return after


def inverted(values: Floats) -> Floats:
    """Return counts from values near 1 / n; infinite where a value is not positive; (n,)."""
    counts = np.full(values.shape, np.inf)
    heard = values > 0.0
    counts[heard] = 1.0 / values[heard]
    return counts


def running_round(
    values: Floats,  # (n,) or (n, 1)
    network: Network,
    leader: int,
    innovation: float,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Floats:
    """Let every agent update its running count once."""
    after = average_round(values, network, loss, generator) + innovation
    after[leader] -= innovation * values[leader]
    return after


def minima_round(
    values: Floats,  # (n, m) smallest numbers that each agent has heard of
    network: Network,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Floats:
    """Let every agent send its numbers to its neighbours once and keep the smallest."""
    sender, receiver = network.directed
    heard = gets_through(len(sender), loss, generator)
    after = values.copy()
    np.minimum.at(after, receiver[heard], values[sender[heard]])
    return after


def minima_estimates(values: Floats) -> Floats:
    """Return each agent's unbiased estimate ``(m - 1) / sum of minima`` from (n, m); (n,)."""
    return (values.shape[1] - 1) / values.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Tally:
    """The state of agents while they count."""

    members: NDArray[np.bool_]  # (n,) who took part in the last step
    values: Floats  # (n, m) values that agents hold
    estimates: Floats  # (n,) each member's estimate of their number; NaN for others
    leader: int = -1  # Number of the leading agent; -1 for none
    done: int = 0  # Rounds of the present epoch
    messages: int = 0  # Transmissions over single links in the last step, lost ones included


def tally_step(
    tally: Tally | None,  # None before the first step, which counts once
    counting: Counting,
    network: Network,
    members: NDArray[np.bool_],  # (n,) who takes part
    generator: np.random.Generator,
    loss: Loss = 0.0,
) -> Tally:
    """Let members count for the rounds of one step."""
    rounds, method = counting.rounds, counting.method
    if tally is None:
        rounds, width = counting.epoch_rounds, counting.draws if method == "minima" else 1
        nobody = np.full(len(members), np.nan)
        tally = Tally(members, np.zeros((len(members), width)), nobody)
    who = np.flatnonzero(members)
    estimates = np.full(len(members), np.nan)
    if method == "known":
        estimates[who] = len(who)
        return Tally(members, tally.values, estimates)
    stayed = tally.members & members
    kept = stayed & np.isfinite(tally.estimates)
    estimates[who] = np.median(tally.estimates[kept]) if kept.any() else np.nan
    estimates[kept] = tally.estimates[kept]
    values, messages, leader, done = tally.values.copy(), 0, tally.leader, tally.done
    values[~stayed] = 0.0
    begins = method != "running" and done == 0
    if method != "minima" and (begins or leader < 0 or not members[leader]):
        found, messages = elect_leader(network, who)
        leader = int(who[found])
        if begins:
            values[who] = 0.0
            values[leader] = 1.0
    held = values[who]
    if method == "minima":
        # Agents that join draw, too; in a new epoch all do.
        fresh = begins | (held == 0.0).all(axis=1)
        held[fresh] = generator.standard_exponential((int(fresh.sum()), counting.draws))
    own = int(np.searchsorted(who, leader))
    for _ in range(rounds):
        if method == "minima":
            held = minima_round(held, network, loss, generator)
        elif method == "leader":
            held = average_round(held, network, loss, generator)
        else:
            held = running_round(held, network, own, counting.innovation, loss, generator)
    messages += 2 * rounds * len(network.links)
    values[who], done = held, done + rounds
    if method == "running":
        estimates[who] = held[:, 0]
    elif done >= counting.epoch_rounds:
        counted = minima_estimates(held) if method == "minima" else inverted(held[:, 0])
        estimates[who] = np.where(np.isfinite(counted), counted, estimates[who])
        done = 0
    return Tally(members, values, estimates, leader, done, messages)
