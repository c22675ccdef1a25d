"""Communication networks: undirected graphs of agents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import (
    breadth_first_order,  # pyright: ignore[reportUnknownVariableType]
    shortest_path,  # pyright: ignore[reportUnknownVariableType]
)
from scipy.special import ndtr  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.region import positive
from planopt.errors import InputError

Loss = float | NDArray[np.float64]
"""Probability that a message is lost: the same for all links, or ``(e,)`` one for each link."""


@dataclass(frozen=True, eq=False)
class Network:
    """Agents and the links between them."""

    count: int  # Number of agents
    links: NDArray[np.intp]  # (e, 2) pairs of agents that can talk to each other, each pair once

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"a network of {self.count} agents", key="agents")
        links = self.links
        if links.ndim != 2 or links.shape[1] != 2:
            raise InputError(f"links of shape {links.shape}", key="links")
        wrong = (links < 0) | (links >= self.count)
        if wrong.any() or (links[:, 0] == links[:, 1]).any():
            raise InputError("a link does not join two agents of the network", key="links")

    @property
    def directed(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Sender and receiver of every link in both directions; (2 e,) each."""
        first, second = self.links[:, 0], self.links[:, 1]
        return np.concatenate((first, second)), np.concatenate((second, first))

    @property
    def degrees(self) -> NDArray[np.intp]:
        """Number of neighbours of each agent; (n,)."""
        return np.bincount(self.links.ravel(), minlength=self.count)


def adjacency(network: Network) -> csr_array:
    """Return the sparse ``(n, n)`` matrix that is 1 where two agents are linked."""
    sender, receiver = network.directed
    ones = np.ones(len(sender))
    return csr_array((ones, (sender, receiver)), shape=(network.count, network.count))


def is_connected(network: Network) -> bool:
    """Return whether every agent can reach every other over links."""
    order = cast(
        "NDArray[np.int32]",
        breadth_first_order(adjacency(network), 0, return_predecessors=False),
    )
    return len(order) == network.count


def hops(network: Network) -> NDArray[np.float64]:
    """Return the least number of links between any two agents; (n, n), infinite without a path."""
    return cast(
        "NDArray[np.float64]", shortest_path(adjacency(network), method="D", unweighted=True)
    )


def diameter(network: Network) -> int:
    """Return the largest number of links between any two agents."""
    largest = float(hops(network).max())
    if not np.isfinite(largest):
        raise InputError("the network is not connected", key="links")
    return int(largest)


def gets_through(
    messages: int, loss: Loss, generator: np.random.Generator | None
) -> NDArray[np.bool_]:
    """Draw which messages get through; (messages,)."""
    if not np.any(loss):
        return np.ones(messages, dtype=np.bool_)
    losses = np.asarray(loss, dtype=np.float64)
    if not ((losses >= 0.0) & (losses <= 1.0)).all() or (not losses.ndim and loss == 1.0):
        raise InputError(f"a loss of {loss!r}", key="loss", remedy="give 0 or more, less than 1")
    if generator is None:
        raise InputError("losses are drawn from a generator", key="generator")
    each = np.tile(losses, messages // len(losses)) if losses.ndim else losses
    return generator.random(messages) >= each


@dataclass(frozen=True)
class LinkModel:
    """Loss of messages between agents by path loss and log-normal fading."""

    k_pl_db: float  # Received power at 1 m, in dBm
    n_pl: float  # Path loss exponent
    fading_std_db: float  # Standard deviation of the power of a message about its mean, more than 0
    threshold_dbm: float  # A message with less power is lost

    def __post_init__(self) -> None:
        positive(self.n_pl, "links.n_pl")
        positive(self.fading_std_db, "links.fading_std_db")

    def loss(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the probability that a message over distances is lost; of the same shape."""
        mean_dbm = self.k_pl_db - 10.0 * self.n_pl * np.log10(np.maximum(distance_m, 1.0))
        return np.asarray(ndtr((self.threshold_dbm - mean_dbm) / self.fading_std_db))
