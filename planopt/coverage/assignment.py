"""Assignment of agents to events: demands, flag propagation, and distributed matching.

A demand is a function from the number of agents n to the number that an event requires. The P
agents nearest to one event form a connected part of the Voronoi neighbour graph, so that lists of
the nearest agents, passed between neighbours, reach every agent concerned. Several events share
agents by deferred acceptance: events propose to the agents nearest to them, and an agent keeps the
nearest event. The result is stable: no agent and event would both prefer each other. It need not
be the assignment of least total distance, which :func:`optimal_assignment` finds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.localisation import EventSensor, best_distance_m, sensitivity
from planopt.coverage.network import Loss, Network, gets_through
from planopt.coverage.region import positive
from planopt.errors import InputError

Demand = Callable[[int], int]

HEXAGON = 5.0 / (18.0 * math.sqrt(3.0))
"""Second moment of a regular hexagon of area 1 about its centre."""

LEAST_ON_RING = 2
"""One agent alone measures a distance and no position."""


def demanded(demand: Demand, agents: int) -> int:
    """Return how many of `agents` agents an event asks for."""
    wanted = demand(agents)
    if wanted != int(wanted) or not 0 <= wanted <= agents:
        raise InputError(
            f"a demand of {wanted!r} among {agents} agents",
            key="demand",
            remedy="demands are whole numbers from 0 to the number of agents",
        )
    return int(wanted)


def table_demand(steps: Mapping[int, int]) -> Demand:
    """Return a demand that is looked up: the entry of the largest number not above n."""
    if not steps:
        raise InputError("the table is empty", key="demand")
    for number, wanted in steps.items():
        if not 0 <= wanted <= number:
            raise InputError(f"{wanted} of {number} agents", key=f"demand[{number}]")
    entries = sorted(steps.items(), reverse=True)

    def demand(agents: int) -> int:
        return next((wanted for number, wanted in entries if number <= agents), 0)

    return demand


def capped_demand(share: float, most: int, remaining: int) -> Demand:
    """Return a share of the agents, at most a number, and so that enough remain for coverage."""
    if not 0.0 <= share <= 1.0:
        raise InputError(f"{share!r} is not a share", key="demand.share")
    for key, value in (("most", most), ("remaining", remaining)):
        if value < 0:
            raise InputError(f"{value} is negative", key=f"demand.{key}")

    def demand(agents: int) -> int:
        # A share of 0.3 of 10 agents is 3, not the 4 that rounding up its last bit would give.
        asked = math.ceil(round(share * agents, 9))
        return max(min(agents - remaining, most, asked), 0)

    return demand


def accuracy_demand(
    sensor: EventSensor, accuracy_m: float, measurements: int = 1, radius_m: float | None = None
) -> Demand:
    """Return the least number of agents that locate an event well enough.

    Agents stand at equal angles on a ring (two of them 90 degrees apart), where the Cramer-Rao
    bound on the mean squared error is ``4 sigma^2 / (P m g^2)`` with g the sensor's slope there.
    """
    positive(accuracy_m, "demand.accuracy_m")
    if measurements < 1:
        raise InputError(f"{measurements} measurements", key="demand.measurements")
    radius = best_distance_m(sensor) if radius_m is None else positive(radius_m, "demand.radius_m")
    slope = sensitivity(sensor, radius)
    if not slope > 0.0:
        raise InputError(
            f"the signal does not change with distance at {radius:g} m", key="demand.radius_m"
        )
    exact = 4.0 * sensor.noise_std**2 / (measurements * slope**2 * accuracy_m**2)
    least = max(math.ceil(exact - 1e-9), LEAST_ON_RING)

    def demand(agents: int) -> int:
        return min(least, agents)

    return demand


def trade_off_demand(
    area_m2: float, localisation_m2: float, coverage_weight: float, localisation_weight: float
) -> Demand:
    """Return the number of agents that balances coverage against localisation.

    It minimises ``w_c c |A|^2 / (n - P) + w_s kappa / P`` over P, with c the second moment of a
    hexagon of area 1, by trying both whole numbers beside the minimum over the reals.
    """
    ahead = HEXAGON * positive(area_m2, "demand.area_m2") ** 2
    coverage = ahead * positive(coverage_weight, "demand.coverage_weight")
    localisation = positive(localisation_m2, "demand.localisation_m2") * positive(
        localisation_weight, "demand.localisation_weight"
    )

    def demand(agents: int) -> int:
        if agents < 2:
            return 0
        exact = agents / (1.0 + math.sqrt(coverage / localisation))
        low = min(max(math.floor(exact), 1), agents - 1)
        high = min(low + 1, agents - 1)
        return min(low, high, key=lambda p: coverage / (agents - p) + localisation / p)

    return demand


@dataclass(frozen=True, eq=False)
class FlagLists:
    """The lists of agents near an event, as each agent knows them: a table of entries."""

    # (k,) the agent that has the entry, and the agent that the entry is about
    holder: NDArray[np.intp]
    member: NDArray[np.intp]
    distance_m: NDArray[np.float64]  # (k,) the member's distance to the event, as it said
    age: NDArray[np.intp]  # (k,) over how many links the entry has come


@dataclass(frozen=True, eq=False)
class Flags:
    """The outcome of flag propagation."""

    flagged: NDArray[np.bool_]  # (n,) whether the agent responds to the event
    rounds: int  # Rounds until nothing changed, or the required number
    messages: int  # Transmissions over single links
    entries: int  # Pairs (distance, agent) in them
    history: NDArray[np.bool_]  # (rounds + 1, n) flags before the first round and after each


def start_lists(distances_m: NDArray[np.float64]) -> FlagLists:
    """Return lists in which every agent knows of itself only."""
    # Shapes: distances_m (n,).
    agents = np.arange(len(distances_m))
    return FlagLists(agents, agents, distances_m, np.zeros(len(agents), dtype=np.intp))


def flag_round(
    lists: FlagLists,
    network: Network,
    distances_m: NDArray[np.float64],  # (n,)
    wanted: NDArray[np.intp],  # (n,) how many should respond, as each agent reckons
    *,
    lifetime: int | None = None,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> FlagLists:
    """Let every agent send its list to its neighbours once, and keep the nearest of what it knows.

    Repeating this is self-stabilising: an agent that fails stops renewing its entry, which then
    dies of age everywhere.
    """
    n = network.count
    sender, receiver = network.directed
    heard = gets_through(len(sender), loss, generator)
    sender, receiver = sender[heard], receiver[heard]
    alive = np.isfinite(distances_m)
    # Entries by holder, so that a link's message is a slice of them.
    order = np.argsort(lists.holder, kind="stable")
    sizes = np.bincount(lists.holder, minlength=n)
    begin = np.cumsum(sizes) - sizes
    link = np.repeat(np.arange(len(sender)), sizes[sender])
    within = np.arange(len(link)) - np.repeat(
        np.cumsum(sizes[sender]) - sizes[sender], sizes[sender]
    )
    sent = order[begin[sender[link]] + within]
    own = np.arange(n)
    holder = np.concatenate((own, lists.holder, receiver[link]))
    member = np.concatenate((own, lists.member, lists.member[sent]))
    distance = np.concatenate((distances_m, lists.distance_m, lists.distance_m[sent]))
    # What an agent already has ages while it waits to hear it again.
    age = np.concatenate((np.zeros(n, dtype=np.intp), lists.age + 1, lists.age[sent] + 1))
    kept = alive[holder] & ((member != holder) | (age == 0))
    if lifetime is not None:
        kept &= age <= lifetime
    kept &= np.isfinite(distance)
    holder, member, distance, age = holder[kept], member[kept], distance[kept], age[kept]
    # The freshest entry about each member, and of those the nearest.
    order = np.lexsort((age, member, holder))
    newest = np.ones(len(order), dtype=np.bool_)
    newest[1:] = (np.diff(holder[order]) != 0) | (np.diff(member[order]) != 0)
    order = order[newest]
    order = order[np.lexsort((member[order], distance[order], holder[order]))]
    sizes = np.bincount(holder[order], minlength=n)
    place = np.arange(len(order)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    order = order[place < wanted[holder[order]]]
    return FlagLists(holder[order], member[order], distance[order], age[order])


def flags_of(lists: FlagLists, count: int) -> NDArray[np.bool_]:
    """Return which of `count` agents find themselves in their own list; (n,)."""
    flagged = np.zeros(count, dtype=np.bool_)
    flagged[lists.holder[lists.holder == lists.member]] = True
    return flagged


def propagate_flags(
    network: Network,
    distances_m: NDArray[np.float64],  # (n,)
    wanted: int | NDArray[np.intp],
    *,
    rounds: int | None = None,
    loss: Loss = 0.0,
    generator: np.random.Generator | None = None,
) -> Flags:
    """Find the agents nearest to an event by lists that all agents send at once.

    Without losses an agent sends only when its list has changed, and all lists are right after at
    most as many rounds as the network's diameter. An agent that is among the nearest is flagged
    from the start; others may be flagged for some rounds.
    """
    n = network.count
    asked = np.broadcast_to(np.asarray(wanted, dtype=np.intp), (n,))
    if distances_m.shape != (n,) or (asked < 0).any():
        raise InputError(f"{len(distances_m)} distances for {n} agents", key="distances_m")
    lossy = bool(np.any(loss))
    if lossy and rounds is None:
        raise InputError(f"a loss of {loss!r}", key="loss", remedy="give `rounds` as well")
    lists = start_lists(distances_m)
    lists = _kept(lists, asked[lists.holder] > 0)
    sent = np.ones(n, dtype=np.bool_)
    messages = entries = 0
    history = [flags_of(lists, n)]
    while rounds is None or len(history) <= rounds:
        every = lossy or rounds is not None
        talking = np.ones(n, dtype=np.bool_) if every else sent
        sizes = np.bincount(lists.holder, minlength=n)
        messages += int(network.degrees[talking & (sizes > 0)].sum())
        entries += int((network.degrees * sizes)[talking].sum())
        after = flag_round(lists, network, distances_m, asked, loss=loss, generator=generator)
        sent = _changed(lists, after, n)
        lists = after
        if rounds is None and not sent.any():
            break
        history.append(flags_of(lists, n))
    return Flags(history[-1], len(history) - 1, messages, entries, np.array(history))


def _kept(lists: FlagLists, kept: NDArray[np.bool_]) -> FlagLists:
    """Some of the entries."""
    return FlagLists(
        lists.holder[kept], lists.member[kept], lists.distance_m[kept], lists.age[kept]
    )


def _changed(before: FlagLists, after: FlagLists, count: int) -> NDArray[np.bool_]:
    """Return which agents' lists name other members than before; (n,)."""
    old = before.holder * count + before.member
    new = after.holder * count + after.member
    changed = np.zeros(count, dtype=np.bool_)
    changed[np.setxor1d(old, new) // count] = True
    return changed


NONE = -1
"""The event of an agent that has none."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """The assignment of agents to events."""

    event_of: NDArray[np.intp]  # (n,) number of each agent's event; `NONE` for an agent that covers
    total_m: float  # Sum of the distances between agents and their events
    largest_m: float  # The largest of them; 0 if nobody responds
    # Rounds of asking; 0 for assignments that are computed with all distances known
    rounds: int = 0
    asked: int = 0  # How many times an event asked an agent
    released: int = 0  # How many times an agent declined or left an event for a nearer one


def fair_shares(demands: NDArray[np.intp], agents: int) -> NDArray[np.intp]:
    """Return how many agents each event gets if there are too few for all.

    Agents are given one by one to the event with the least share of its demand, which maximises
    the smallest share, then the second smallest, and so on. Ties go to the smaller demand, then to
    the smaller number.
    """
    # Shapes: demands (k,).
    if agents < 0 or (demands < 0).any():
        raise InputError("demands and numbers of agents are at least 0", key="demands")
    given = np.zeros(len(demands), dtype=np.intp)
    for _ in range(min(agents, int(demands.sum()))):
        open_ = np.flatnonzero(given < demands)
        order = np.lexsort((open_, demands[open_], given[open_] / demands[open_]))
        given[open_[order[0]]] += 1
    return given


def deferred_acceptance(distances_m: NDArray[np.float64], demands: NDArray[np.intp]) -> Assignment:
    """Assign agents to events by asking and releasing, as the agents themselves can do it.

    In each round every event asks as many agents as it lacks, nearest first, none of them twice.
    Every agent keeps the nearest event that it has or that asks it, and releases the others. Ties
    go to the smaller numbers. The events only need lists of the agents near them, which flag
    propagation gives.
    """
    # Shapes: distances_m (n, k); demands (k,).
    _check(distances_m, demands)
    agents, events = distances_m.shape
    order = np.argsort(distances_m, axis=0, kind="stable")
    # The agent's own preference: distances, then the event's number.
    asked_to = np.zeros(events, dtype=np.intp)
    event_of = np.full(agents, NONE, dtype=np.intp)
    rounds = asked = released = 0
    while True:
        lacking = demands - np.bincount(event_of[event_of != NONE], minlength=events)
        proposals: list[tuple[int, int]] = []
        for event in np.flatnonzero(lacking > 0).tolist():
            names = order[asked_to[event] : asked_to[event] + lacking[event], event].tolist()
            proposals.extend((agent, event) for agent in names)
            asked_to[event] += len(names)
        if not proposals:
            return _scored(event_of, distances_m, rounds, asked, released)
        rounds += 1
        asked += len(proposals)
        for agent, event in proposals:
            held = int(event_of[agent])
            if held == NONE:
                event_of[agent] = event
                continue
            released += 1
            if (distances_m[agent, event], event) < (distances_m[agent, held], held):
                event_of[agent] = event


def optimal_assignment(distances_m: NDArray[np.float64], demands: NDArray[np.intp]) -> Assignment:
    """Assign agents to events with the least sum of distances.

    The linear programme ``min sum c x, sum_k x_ik <= 1, sum_i x_ik = P_k, x >= 0`` has a totally
    unimodular matrix, so that this assignment is its optimum.
    """
    _check(distances_m, demands)
    seats = np.repeat(np.arange(len(demands)), demands)
    rows, columns = cast(
        "tuple[NDArray[np.intp], NDArray[np.intp]]", linear_sum_assignment(distances_m[:, seats])
    )
    event_of = np.full(len(distances_m), NONE, dtype=np.intp)
    event_of[rows] = seats[columns]
    return _scored(event_of, distances_m)


def _scored(
    event_of: NDArray[np.intp],
    distances_m: NDArray[np.float64],
    rounds: int = 0,
    asked: int = 0,
    released: int = 0,
) -> Assignment:
    """The assignment with its distances."""
    sent = np.flatnonzero(event_of != NONE)
    own = distances_m[sent, event_of[sent]]
    largest = float(own.max()) if len(own) else 0.0
    return Assignment(event_of, float(own.sum()), largest, rounds, asked, released)


def _check(distances_m: NDArray[np.float64], demands: NDArray[np.intp]) -> None:
    """Raise for distances and demands that do not fit."""
    if distances_m.ndim != 2 or demands.shape != distances_m.shape[1:]:
        raise InputError(
            f"distances of shape {distances_m.shape} for {len(demands)} events", key="distances_m"
        )
    if not (np.isfinite(distances_m) & (distances_m >= 0.0)).all():
        raise InputError("a distance is negative or not finite", key="distances_m")
    if (demands < 0).any() or demands.sum() > len(distances_m):
        raise InputError(
            f"{int(demands.sum())} agents are asked for, there are {len(distances_m)}",
            key="demands",
            remedy="share them out with fair_shares",
        )
