"""The count that a network keeps while it works: some rounds of a method in every step.

Methods with a common start are restarted in epochs, and an estimate holds until the next epoch has
ended; the running count never restarts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.counting.consensus import average_round, elect_leader, inverted
from planopt.coverage.counting.minima import Minima, draw_minima, minima_estimates, minima_round
from planopt.coverage.counting.running import running_round
from planopt.coverage.network import Loss, Network
from planopt.errors import InputError

Method = Literal["known", "leader", "minima", "running"]
"""Agents are told their number, or count by averaging from a leader, by minima, or running."""


@dataclass(frozen=True)
class Counting:
    """How a network counts itself.

    Attributes
    ----------
    method
        One of :data:`Method`.
    rounds
        Rounds in a step.
    epoch_rounds
        Rounds of an epoch, and of the running count before the first step.
    draws
        Numbers that each agent draws, for ``minima``.
    innovation
        Of the running count: smaller ones leave all agents nearer to the number, and follow slower
        (:func:`planopt.coverage.counting.running.largest_innovation`).

    Raises
    ------
    InputError
        A number of rounds is less than 1.
    """

    method: Method = "known"
    rounds: int = 30
    epoch_rounds: int = 600
    draws: int = 400
    innovation: float = 0.01

    def __post_init__(self) -> None:
        for key in ("rounds", "epoch_rounds"):
            if getattr(self, key) < 1:
                raise InputError(f"is {getattr(self, key)}", key=f"counting.{key}")


@dataclass(frozen=True, eq=False)
class Tally:
    """What agents hold and believe while counting.

    Attributes
    ----------
    members
        ``(n,)`` who took part in the last step.
    values
        ``(n, m)`` what they hold.
    estimates
        ``(n,)`` how many agents they believe there are; NaN for who does not take part.
    leader
        Number of the leading agent; -1 for none.
    done
        Rounds of the present epoch.
    messages
        Transmissions over single links in the last step, lost ones included.
    """

    members: NDArray[np.bool_]
    values: NDArray[np.float64]
    estimates: NDArray[np.float64]
    leader: int = -1
    done: int = 0
    messages: int = 0


def start_tally(
    counting: Counting,
    network: Network,
    members: NDArray[np.bool_],
    generator: np.random.Generator,
    loss: Loss = 0.0,
) -> Tally:
    """Count once before the first step.

    Parameters
    ----------
    counting
        How.
    network
        The members' links; they are numbered among themselves there.
    members
        ``(n,)`` who takes part.
    generator
        Draws numbers and losses.
    loss
        Probability that a message is lost.

    Raises
    ------
    InputError
        The members are not connected, or a number is out of range.
    """
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
    """Let members count for the rounds of one step.

    Parameters
    ----------
    tally
        What they held. Who has joined since takes over a member's estimate.
    counting, network, members, generator, loss
        As for :func:`start_tally`.

    Raises
    ------
    InputError
        As there.
    """
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
