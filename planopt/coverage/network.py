"""Communication between agents: links, message losses, flooding and distributed counting.

Agents estimate the size of the network by several rounds of messages in every step. `leader` is
average consensus from 1 at the leader and 0 elsewhere; with `minima` the network finds minima of
exponential random numbers. Both restart in epochs. `running` never restarts: at the fixed point of
``x <- W x + eps (1 - x_leader e_leader)`` the leader holds n exactly, and all others hold slightly
more.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.special import ndtr

from planopt.arrays import Floats, Indices, Mask
from planopt.errors import InputError
from planopt.keys import SMALLEST, Part

Loss = float | Floats
"""Probability of losing a message: one value for all links, or ``(e,)`` values by link."""


@dataclass(frozen=True, eq=False)
class Network:
    """Communication graph: agents and the links between them."""

    count: int  # Number of agents
    links: Indices  # (e, 2) pairs of linked agents, each pair once

    @property
    def directed(self) -> tuple[Indices, Indices]:
        """Return senders (2 e,) and receivers (2 e,) of all links in both directions."""
        first, second = self.links[:, 0], self.links[:, 1]
        return np.concatenate((first, second)), np.concatenate((second, first))

    @property
    def degrees(self) -> Indices:
        """Return the number (n,) of neighbours of each agent."""
        return np.bincount(self.links.ravel(), minlength=self.count)


Merge = Callable[[Indices, Indices], Mask]
"""Function that delivers the content of senders (m,) to receivers (m,), all in one round; it
returns the agents (n,) whose content changed."""


@dataclass(frozen=True, eq=False)
class Medium:
    """Links between agents in one step, over which messages may be lost."""

    network: Network
    loss: Loss = 0.0
    rounds: int | None = None  # Largest number of rounds of a flood; None without losses
    generator: np.random.Generator | None = None  # None without losses

    def arrives(self, links: Indices) -> Mask:
        """Draw a mask (m,) of the messages over links (m,) that arrive."""
        losses = np.broadcast_to(self.loss, len(self.network.links))[links]
        if not losses.any():
            return np.ones(len(links), dtype=np.bool_)
        assert self.generator is not None  # Losses are random
        return self.generator.random(len(links)) >= losses

    def flood(self, begins: Mask, merge: Merge, ends: Mask | None = None) -> int:
        """Flood content from agents `begins` (n,); return the number of sent messages.

        Only links with an end in the mask `ends` (n,) are used.
        """
        # An agent sends to a neighbour until the neighbour has acknowledged its present content.
        sender, receiver = self.network.directed
        link = np.tile(np.arange(len(self.network.links)), 2)
        if ends is not None:
            used = ends[sender] | ends[receiver]
            sender, receiver, link = sender[used], receiver[used], link[used]
        pending, messages, done = begins[sender], 0, 0
        while pending.any() and done != self.rounds:
            sent = np.flatnonzero(pending)
            messages += len(sent)
            done += 1
            arrived = sent[self.arrives(link[sent])]
            pending[arrived] = False
            pending |= merge(sender[arrived], receiver[arrived])[sender]
        return messages


@dataclass(frozen=True)
class LinkModel(Part):
    """Model of message loss between agents: path loss and log-normal fading."""

    at = "links"

    k_pl_db: Annotated[float, Field(ge=-300, le=300)]
    """Received power at 1 m in dBm."""
    n_pl: Annotated[float, Field(ge=0.1, le=10)]
    """Path loss exponent."""
    fading_std_db: Annotated[float, Field(ge=SMALLEST, le=100)]
    """Standard deviation of the received power about its mean, in dB."""
    threshold_dbm: Annotated[float, Field(ge=-500, le=300)]
    """Received power in dBm below which a message is lost."""

    def loss(self, distance_m: Floats) -> Floats:
        """Return the probability of losing a message at each distance, in the same shape."""
        mean_dbm = self.k_pl_db - 10.0 * self.n_pl * np.log10(np.maximum(distance_m, 1.0))
        return np.asarray(ndtr((self.threshold_dbm - mean_dbm) / self.fading_std_db))


Method = Literal["known", "leader", "minima", "running"]
"""Counting method: known size, average consensus from a leader, minima, or running count."""


@dataclass(frozen=True)
class Counting(Part):
    """Settings of distributed counting."""

    at = "counting"

    method: Method = "known"
    """Counting method: known, leader (average consensus), minima (of random numbers) or running."""
    rounds: Annotated[int, Field(ge=1, le=10**5)] = 30
    """Rounds of messages in a step."""
    epoch_rounds: Annotated[int, Field(ge=1, le=10**6)] = 600
    """Rounds of messages in an epoch, and of the running count before the first step."""
    draws: Annotated[int, Field(ge=3, le=10**5)] = 400
    """For minima: count of random numbers drawn by each agent."""
    innovation: Annotated[float, Field(gt=0, le=1)] = 0.01
    """Gain eps of the running count: a smaller value is more accurate but tracks changes slower."""


def elect_leader(network: Network, identities: Indices) -> tuple[int, int]:
    """Elect the agent with the largest of `identities`; return its index and the message count."""
    # An agent sends after it has received a larger identity.
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
        raise InputError("do not connect all agents: the network is disconnected", key="links")
    return leader, messages


def average_round(values: Floats, medium: Medium) -> Floats:
    """Return the agents' values (n,) or (n, k) after one round of consensus averaging."""
    links = medium.network.links
    # Metropolis weights 1 / (1 + max(deg_i, deg_j)) of the links (i, j).
    weights = 1.0 / (1.0 + medium.network.degrees[links].max(axis=1, initial=0))
    # A lossy link is omitted in both directions (acknowledgements), so the sum is preserved.
    kept = medium.arrives(np.arange(len(links)))
    first, second = links[kept].T
    flow = (weights[kept] * (values[second] - values[first]).T).T
    after = values.copy()
    np.add.at(after, first, flow)
    np.add.at(after, second, -flow)
    return after


def inverted(values: Floats) -> Floats:
    """Return the reciprocals (n,) of values near 1 / n; infinite for non-positive values."""
    counts = np.full(values.shape, np.inf)
    heard = values > 0.0
    counts[heard] = 1.0 / values[heard]
    return counts


def running_round(values: Floats, medium: Medium, leader: int, innovation: float) -> Floats:
    """Return the agents' values (n,) or (n, 1) after a round of the counting method `running`."""
    after = average_round(values, medium) + innovation
    after[leader] -= innovation * values[leader]
    return after


def minima_round(values: Floats, medium: Medium) -> Floats:
    """Return the smallest numbers (n, m) that agents know after an exchange with neighbours."""
    sender, receiver = medium.network.directed
    heard = medium.arrives(np.tile(np.arange(len(medium.network.links)), 2))
    after = values.copy()
    np.minimum.at(after, receiver[heard], values[sender[heard]])
    return after


def minima_estimates(values: Floats) -> Floats:
    """Return the unbiased estimates (n,) of the number of agents from minima (n, m)."""
    return (values.shape[1] - 1) / values.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Tally:
    """State of distributed counting."""

    members: Mask  # (n,) mask of the members in the last step
    values: Floats  # (n, m) values of the agents
    estimates: Floats  # (n,) each member's estimate of their number; NaN for others
    leader: int = -1  # Index of the leading agent; -1 for none
    done: int = 0  # Completed rounds of the present epoch
    messages: int = 0  # Transmissions over single links in the last step, including lost ones


def tally_step(
    tally: Tally | None,  # None before the first step
    counting: Counting,
    medium: Medium,  # Links between the members, numbered consecutively
    members: Mask,  # (n,) mask of the members
    generator: np.random.Generator,
) -> Tally:
    """Return the counting state after the message rounds of one step."""
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
        found, messages = elect_leader(medium.network, who)
        leader = int(who[found])
        if begins:
            values[who] = 0.0
            values[leader] = 1.0
    held = values[who]
    if method == "minima":
        # Agents draw numbers when they join, and all agents draw in a new epoch.
        fresh = begins | (held == 0.0).all(axis=1)
        held[fresh] = generator.standard_exponential((int(fresh.sum()), counting.draws))
    own = int(np.searchsorted(who, leader))
    for _ in range(rounds):
        if method == "minima":
            held = minima_round(held, medium)
        elif method == "leader":
            held = average_round(held, medium)
        else:
            held = running_round(held, medium, own, counting.innovation)
    messages += 2 * rounds * len(medium.network.links)
    values[who], done = held, done + rounds
    if method == "running":
        estimates[who] = held[:, 0]
    elif done >= counting.epoch_rounds:
        counted = minima_estimates(held) if method == "minima" else inverted(held[:, 0])
        estimates[who] = np.where(np.isfinite(counted), counted, estimates[who])
        done = 0
    return Tally(members, values, estimates, leader, done, messages)
