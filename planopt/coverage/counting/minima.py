"""Counting by minima: every agent draws numbers, and all learn the smallest of each.

The minimum of n exponential variables is n times smaller than one of them. No leader, no
identities; lost and repeated messages do no harm. The estimate is random, with an exact confidence
interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.counting.consensus import Count
from planopt.coverage.network import Loss, Network, gets_through
from planopt.errors import InputError

LEAST_DRAWS = 3
"""With fewer numbers the estimate has no finite variance."""


@dataclass(frozen=True, eq=False)
class Minima:
    """The smallest numbers that each agent has heard of.

    Attributes
    ----------
    values
        ``(n, m)`` one for each of m numbers.
    """

    values: NDArray[np.float64]


def draw_minima(agents: int, draws: int, generator: np.random.Generator) -> Minima:
    """Draw each agent's numbers from the exponential distribution of mean 1.

    Parameters
    ----------
    agents
        How many agents draw.
    draws
        How many numbers each of them draws; the estimate's relative standard deviation is
        ``1 / sqrt(draws - 2)``.
    generator
        Source of the numbers.

    Raises
    ------
    InputError
        There are too few draws.
    """
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
    """Let every agent send its numbers to its neighbours once and keep the smallest.

    Parameters
    ----------
    minima
        What agents know.
    network
        Who talks to whom.
    loss
        Probability that a message over a link is lost, in each direction by itself.
    generator
        Draws the losses.
    """
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
    """Count agents by the minima of exponential numbers.

    Parameters
    ----------
    network
        Who talks to whom.
    draws
        Numbers that each agent draws.
    rounds
        As many as the network's diameter suffice without losses.
    generator
        Draws numbers and losses.
    loss
        Probability that a message over a link is lost, in each direction by itself.

    Raises
    ------
    InputError
        A number is out of range.
    """
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

    Parameters
    ----------
    estimates
        ``(n,)`` from :func:`minima_estimates`.
    draws
        Numbers m that were drawn.
    confidence
        Probability that the interval holds the number of agents.

    Returns
    -------
    low, high
        ``(n,)`` each.

    Raises
    ------
    InputError
        The confidence is not between 0 and 1.
    """
    if not 0.0 < confidence < 1.0:
        raise InputError(f"{confidence!r} is no probability", key="confidence")
    tail = 0.5 * (1.0 - confidence)
    low, high = (float(gammaincinv(draws, p)) / (draws - 1) for p in (tail, 1.0 - tail))
    return estimates * low, estimates * high
