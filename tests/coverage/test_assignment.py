"""Assignment of agents: demands, flags and matching against sorting, enumeration and programmes."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
from numpy.typing import NDArray
from scattered import scattered

from planopt.coverage import (
    NONE,
    ConvexRegion,
    Demand,
    EventSensor,
    Medium,
    Network,
    accuracy_demand,
    agent_neighbours,
    capped_demand,
    deferred_acceptance,
    demanded,
    fair_shares,
    propagate_flags,
    table_demand,
    trade_off_demand,
    voronoi_cells,
)


@pytest.mark.parametrize(
    "demand",
    [
        table_demand({3: 1, 8: 4, 20: 5}),
        capped_demand(0.3, 6, 4),
        accuracy_demand(EventSensor(0.1, 1.0), 0.1),
        trade_off_demand(100.0, 2.0, 1.0, 3.0),
    ],
)
def test_never_more_than_there_are(demand: Demand) -> None:
    """Every kind stays between 0 and n, and never falls as n grows."""
    wanted = [demanded(demand, n) for n in range(1, 200)]
    assert all(0 <= p <= n for n, p in enumerate(wanted, start=1))
    assert wanted == sorted(wanted)


def test_demands() -> None:
    """The smallest of share, cap and what coverage leaves; functions of the user's own."""
    demand = capped_demand(0.3, 6, 4)
    assert [demand(n) for n in (1, 4, 5, 10, 11, 19, 50)] == [0, 0, 1, 3, 4, 6, 6]
    assert demanded(lambda n: n // 2, 9) == 4


def test_accuracy_meets_its_bound() -> None:
    """The number is the least whose Cramer-Rao bound on an equal-angle ring is small enough."""
    noise, strength, wanted = 0.05, 2.0, 0.04
    demand = accuracy_demand(EventSensor(noise, strength), wanted)
    slope = 9.0 * strength / (8.0 * math.sqrt(3.0))

    def error_m2(agents: int) -> float:
        turn = np.arange(agents) * (0.5 * np.pi if agents == 2 else 2.0 * np.pi / agents)
        away = np.stack((np.cos(turn), np.sin(turn)), axis=1)
        return float(np.trace(np.linalg.inv(slope**2 / noise**2 * away.T @ away)))

    least = next(p for p in range(2, 100) if error_m2(p) <= wanted**2)
    assert demand(1000) == least == 4
    assert demand(3) == 3
    assert accuracy_demand(EventSensor(noise, strength), wanted, measurements=4)(1000) == 2
    # Two agents leave three unknowns undetermined.
    unknown = accuracy_demand(EventSensor(noise, strength), wanted, 4, strength_known=False)
    assert unknown(1000) == 3 and unknown(2) == 2


def test_trade_off_is_the_minimum() -> None:
    for area, kappa, w_c, w_s in (
        (100.0, 2.0, 1.0, 3.0),
        (5.0, 9.0, 0.1, 2.0),
        (1.0, 1.0, 1.0, 1e-4),
    ):
        demand = trade_off_demand(area, kappa, w_c, w_s)
        for n in range(2, 60):
            costs = [
                w_c * 5.0 / (18.0 * math.sqrt(3.0)) * area**2 / (n - p) + w_s * kappa / p
                for p in range(1, n)
            ]
            assert costs[demand(n) - 1] == pytest.approx(min(costs), rel=1e-12)


def scene(region: ConvexRegion, seed: int, count: int) -> tuple[Network, NDArray[np.float64]]:
    """Agents' Voronoi neighbours and their distances to an event."""
    places = scattered(region, count + 1, np.random.default_rng(seed))
    network = Network(count, agent_neighbours(voronoi_cells(region, places[:-1])))
    return network, np.linalg.norm(places[:-1] - places[-1], axis=1)


def nearest(distances: NDArray[np.float64], wanted: int) -> NDArray[np.bool_]:
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
    lists = propagate_flags(Medium(network), distances, wanted)
    assert (lists.flagged == right).all()
    assert len(lists.history) - 1 <= nx.diameter(nx.Graph(network.links.tolist()))
    assert lists.history[:, right].all()
    assert (lists.history[-1] == right).all()


def test_every_agent_has_a_nearer_neighbour(square: ConvexRegion) -> None:
    """The nearest agents are connected, and the next one is their neighbour (both lemmas)."""
    for seed in range(30):
        network, distances = scene(square, 300 + seed, 25)
        order = np.argsort(distances)
        rank = np.argsort(order)
        joined = np.sort(rank[network.links], axis=1)
        assert set(range(1, 25)) <= set(joined[:, 1].tolist())


def test_messages_by_hand() -> None:
    """A chain of three: who sends what is counted over single links."""
    chain = Network(3, np.array([[0, 1], [1, 2]]))
    found = propagate_flags(Medium(chain), np.array([1.0, 2.0, 3.0]), 1)
    # All send their one entry; agents 1 and 2 change; they send again; agent 2 changes and sends.
    assert found.messages == 4 + 3 + 1
    assert found.history.tolist() == [[True] * 3, [True, False, False], [True, False, False]]


def test_repeated_and_lost_messages(square: ConvexRegion) -> None:
    """Half of the messages may be lost: after more rounds the flags are right all the same."""
    network, distances = scene(square, 7, 40)
    media = (Medium(network, 0.5, 60, np.random.default_rng(0)) for _ in range(2))
    lossy, again = (propagate_flags(medium, distances, 6) for medium in media)
    assert (lossy.flagged == nearest(distances, 6)).all()
    assert (again.history == lossy.history).all()
    assert lossy.history[:, nearest(distances, 6)].all()


def test_agents_with_their_own_count(square: ConvexRegion) -> None:
    """Agents that assume a larger demand keep longer lists; no required agent is missed."""
    network, distances = scene(square, 8, 30)
    wanted = np.where(np.arange(30) % 2 == 0, 4, 5)
    found = propagate_flags(Medium(network), distances, wanted)
    assert found.flagged[nearest(distances, 4)].all()
    assert found.flagged.sum() <= 5


def drawn(seed: int, agents: int, demands: NDArray[np.intp]) -> NDArray[np.float64]:
    generator = np.random.default_rng(seed)
    places = generator.random((agents, 2)), generator.random((len(demands), 2))
    return np.linalg.norm(places[0][:, None] - places[1], axis=2)


def test_shares_by_enumeration() -> None:
    """Shares are the best in the order of the smallest, the second smallest, and so on."""
    for demands in itertools.product(range(1, 5), repeat=3):
        for agents in range(sum(demands) + 2):
            used = min(agents, sum(demands))
            best = max(
                sorted(g / d for g, d in zip(given, demands, strict=True))
                for given in itertools.product(*(range(d + 1) for d in demands))
                if sum(given) == used
            )
            found = fair_shares(np.array(demands), agents)
            assert found.sum() == used and (found <= demands).all()
            assert sorted(found / np.array(demands)) == best
    assert fair_shares(np.array([0, 3]), 2).tolist() == [0, 2]
    assert fair_shares(np.array([], dtype=np.intp), 5).tolist() == []


@pytest.mark.parametrize("seed", range(15))
def test_matching_is_stable(seed: int) -> None:
    """Demands are met, and no agent and event would both rather have each other."""
    generator = np.random.default_rng(seed)
    demands = generator.integers(0, 6, size=int(generator.integers(1, 5)))
    agents = int(demands.sum() + generator.integers(1, 10))
    distances = drawn(100 + seed, agents, demands)
    event_of = deferred_acceptance(distances, demands)
    assert [(event_of == event).sum() for event in range(len(demands))] == demands.tolist()
    own = np.where(event_of == NONE, np.inf, 0.0)
    sent = event_of != NONE
    own[sent] = distances[sent, event_of[sent]]
    for event in range(len(demands)):
        team = distances[event_of == event, event]
        worst = team.max() if len(team) else -np.inf
        blocking = (distances[:, event] < own) & (distances[:, event] < worst)
        assert not blocking.any()


def test_matching_is_what_lists_give() -> None:
    """Flag lists for each event, with agents leaving the farther ones, end in the same matching."""
    demands = np.array([4, 3, 5])
    for seed in range(10):
        distances = drawn(seed, 20, demands)
        complete = Medium(Network(20, np.array(list(itertools.combinations(range(20), 2)))))
        open_ = distances.copy()
        while True:
            flags = np.stack(
                [propagate_flags(complete, open_[:, k], int(demands[k])).flagged for k in range(3)],
                axis=1,
            )
            twice = flags.sum(axis=1) > 1
            if not twice.any():
                break
            for agent in np.flatnonzero(twice):
                best = np.where(flags[agent], distances[agent], np.inf).argmin()
                leave = flags[agent] & (np.arange(3) != best)
                open_[agent, leave] = 1e9
        event_of = np.where(flags.any(axis=1), flags.argmax(axis=1), NONE)
        assert (deferred_acceptance(distances, demands) == event_of).all()


def test_no_events() -> None:
    nothing = np.array([], dtype=np.intp)
    assert (deferred_acceptance(np.zeros((3, 0)), nothing) == NONE).all()
    assert (deferred_acceptance(np.ones((3, 1)), np.array([0])) == NONE).all()
