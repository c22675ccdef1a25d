"""Who can talk to whom: undirected graphs of agents."""

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

from planopt.errors import InputError


@dataclass(frozen=True, eq=False)
class Network:
    """Agents and the links between them.

    Attributes
    ----------
    count
        Number of agents.
    links
        ``(e, 2)`` pairs of agents that can talk to each other, each pair once.

    Raises
    ------
    InputError
        There is no agent, or a link names an agent that there is not, or one twice.
    """

    count: int
    links: NDArray[np.intp]

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
    """Return the largest number of links between any two agents.

    Raises
    ------
    InputError
        The network is not connected.
    """
    largest = float(hops(network).max())
    if not np.isfinite(largest):
        raise InputError("the network is not connected", key="links")
    return int(largest)
