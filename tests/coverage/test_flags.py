"""Flag propagation against the list of the nearest agents."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered

from planopt.coverage.assignment import propagate_flags
from planopt.coverage.network import Network
from planopt.coverage.voronoi import ConvexRegion, agent_neighbours, voronoi_cells
from planopt.errors import InputError


def scene(region: ConvexRegion, seed: int, count: int) -> tuple[Network, NDArray[np.float64]]:
    """Agents' Voronoi neighbours and their distances to an event."""
    places = scattered(region, count + 1, np.random.default_rng(seed))
    network = Network(count, agent_neighbours(voronoi_cells(region, places[:-1])))
    return network, np.linalg.norm(places[:-1] - places[-1], axis=1)


def nearest(distances: NDArray[np.float64], wanted: int) -> NDArray[np.bool_]:
    """Flags of the nearest agents, by sorting."""
    flags = np.zeros(len(distances), dtype=bool)
    flags[np.argsort(distances, kind="stable")[:wanted]] = True
    return flags


@pytest.mark.parametrize("seed", range(20))
def test_lists_find_the_nearest(hexagon: ConvexRegion, seed: int) -> None:
    """Lists give the P nearest within the diameter, and never miss one."""
    generator = np.random.default_rng(1000 + seed)
    count = int(generator.integers(2, 60))
    network, distances = scene(hexagon, seed, count)
    wanted = int(generator.integers(0, count + 1))
    right = nearest(distances, wanted)
    lists = propagate_flags(network, distances, wanted)
    assert (lists.flagged == right).all()
    assert len(lists.history) - 1 <= nx.diameter(nx.Graph(network.links.tolist()))
    assert lists.history[:, right].all()
    assert (lists.history[-1] == right).all()


def test_every_agent_has_a_nearer_neighbour(square: ConvexRegion) -> None:
    """The nearest agents are connected, and the next one is beside them: the lemmas behind it."""
    for seed in range(30):
        network, distances = scene(square, 300 + seed, 25)
        order = np.argsort(distances)
        rank = np.argsort(order)
        joined = np.sort(rank[network.links], axis=1)
        assert set(range(1, 25)) <= set(joined[:, 1].tolist())


def test_messages_by_hand() -> None:
    """A chain of three: who sends what is counted over single links."""
    chain = Network(3, np.array([[0, 1], [1, 2]]))
    found = propagate_flags(chain, np.array([1.0, 2.0, 3.0]), 1)
    # All send their one entry; agents 1 and 2 change; they send again; agent 2 changes and sends.
    assert found.messages == 4 + 3 + 1
    assert found.history.tolist() == [[True] * 3, [True, False, False], [True, False, False]]


def test_repeated_and_lost_messages(square: ConvexRegion) -> None:
    """Half of the messages may be lost: after more rounds the flags are right all the same."""
    network, distances = scene(square, 7, 40)
    lossy = propagate_flags(
        network, distances, 6, rounds=60, loss=0.5, generator=np.random.default_rng(0)
    )
    assert (lossy.flagged == nearest(distances, 6)).all()
    again = propagate_flags(
        network, distances, 6, rounds=60, loss=0.5, generator=np.random.default_rng(0)
    )
    assert (again.history == lossy.history).all()
    assert lossy.history[:, nearest(distances, 6)].all()


def test_agents_with_their_own_count(square: ConvexRegion) -> None:
    """Agents that reckon with a larger demand keep longer lists; nobody wanted is missed."""
    network, distances = scene(square, 8, 30)
    wanted = np.where(np.arange(30) % 2 == 0, 4, 5)
    found = propagate_flags(network, distances, wanted)
    assert found.flagged[nearest(distances, 4)].all()
    assert found.flagged.sum() <= 5


def test_bad_input() -> None:
    """Wrong shapes and numbers, and losses without a number of rounds."""
    chain = Network(3, np.array([[0, 1], [1, 2]]))
    distances = np.array([1.0, 2.0, 3.0])
    for attempt in (
        lambda: propagate_flags(chain, distances[:2], 1),
        lambda: propagate_flags(chain, distances, -1),
        lambda: propagate_flags(chain, distances, 1, loss=0.5),
    ):
        with pytest.raises(InputError):
            attempt()
