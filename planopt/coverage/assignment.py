"""Assignment of agents to events: demands, flag propagation and distributed matching."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.coverage.localisation import EventSensor
from planopt.coverage.network import Medium
from planopt.errors import InputError

Demand = Callable[[int], int]
"""Function that maps the number of agents to the number that an event requires."""
HEXAGON = 5.0 / (18.0 * math.sqrt(3.0))
"""Second moment of a regular hexagon of area 1 about its centre."""
LEAST_ON_RING = 2  # Minimum number of agents on a ring; a single one measures the distance only
NONE = -1  # Event number that marks a covering agent


def demanded(demand: Demand, agents: int) -> int:
    """Evaluate `demand` for a network of `agents` agents; raise `InputError` if it is invalid."""
    wanted = demand(agents)
    if wanted != int(wanted) or not 0 <= wanted <= agents:
        raise InputError(
            f"is {wanted!r} for {agents} agents",
            key="demand",
            remedy="give a whole number from 0 to the number of agents",
        )
    return int(wanted)


def table_demand(steps: Mapping[int, int]) -> Demand:
    """Return a step function of the number n of agents: `steps` at its largest key up to n."""
    entries = sorted(steps.items(), reverse=True)
    return lambda agents: next((wanted for number, wanted in entries if number <= agents), 0)


def capped_demand(share: float, most: int, remaining: int) -> Demand:
    """Return a demand for a share of n agents: at most `most`, and at most n - `remaining`."""
    # Rounding first keeps 0.3 of 10 agents at 3; the ceiling of the float product may be 4.
    return lambda n: max(min(n - remaining, most, math.ceil(round(share * n, 9))), 0)


def accuracy_demand(
    sensor: EventSensor, accuracy_m: float, measurements: int = 1, strength_known: bool = True
) -> Demand:
    """Return the demand for the smallest team that locates an event with the required accuracy."""
    # Agents are at equal angles (two agents 90 degrees apart) on the most informative ring. The
    # Cramer-Rao bound on the mean squared error is ``4 sigma^2 / (P m g^2)`` with g the slope of
    # the signal on the ring.
    slope = sensor.strength * float(sensor.slope(np.array(sensor.best_distance_m)))
    exact = 4.0 * sensor.noise_std**2 / (measurements * slope**2 * accuracy_m**2)
    # From three agents on, equal angles make the estimates of position and strength independent.
    least = max(math.ceil(exact - 1e-9), LEAST_ON_RING if strength_known else LEAST_ON_RING + 1)
    return lambda agents: min(least, agents)


def trade_off_demand(
    area_m2: float, localisation_m2: float, coverage_weight: float, localisation_weight: float
) -> Demand:
    """Return the demand that minimises weighted coverage cost plus localisation error."""
    # The demand minimises ``w_c c |A|^2 / (n - P) + w_s kappa / P`` over integers P, c the second
    # moment of a hexagon of area 1.
    coverage = HEXAGON * area_m2**2 * coverage_weight
    localisation = localisation_m2 * localisation_weight

    def demand(agents: int) -> int:
        if agents < 2:
            return 0
        exact = agents / (1.0 + math.sqrt(coverage / localisation))
        low = min(max(math.floor(exact), 1), agents - 1)
        high = min(low + 1, agents - 1)
        return min(low, high, key=lambda p: coverage / (agents - p) + localisation / p)

    return demand


@dataclass(frozen=True, eq=False)
class Flags:
    """Agents flagged to respond to an event, with the number of messages."""

    flagged: Mask  # (n,) whether the agent responds to the event
    messages: int  # Number of transmissions over single links
    history: Mask  # (changes + 1, n) initial flags, and those after each round that changes a list
    lists: tuple[Indices, ...]  # n lists of agent indices, each list nearest first


def propagate_flags(
    medium: Medium,
    distances_m: Floats,  # (n,); infinite for agents that do not know the event
    wanted: int | Indices,  # Required number of agents; (n,) if agents disagree on it
) -> Flags:
    """Find the agents nearest to an event by exchanging lists of the nearest known agents."""
    # Without losses all lists are correct after at most as many rounds as the network's diameter.
    # With losses there are at most `medium.rounds` rounds. The nearest agents are flagged from the
    # start; other agents may be flagged temporarily.
    n = medium.network.count
    most = np.broadcast_to(np.asarray(wanted, dtype=np.intp), (n,))
    if distances_m.shape != (n,) or (most < 0).any():
        raise InputError(
            f"has {len(distances_m)} distances, should have one for each of {n} agents",
            key="distances_m",
        )
    if np.any(medium.loss) and medium.rounds is None:
        raise InputError(
            f"is {medium.loss!r}, but the number of rounds is missing",
            key="loss",
            remedy="give rounds if messages can be lost",
        )
    order = np.argsort(distances_m, kind="stable")
    rank = np.empty(n, dtype=np.intp)
    rank[order] = np.arange(n)
    # An entry is n * holder + rank, so sorted entries are lists by holder, nearest first.
    own = np.arange(n) * n + rank
    lists = own[(most > 0) & np.isfinite(distances_m)]
    history = [np.isin(own, lists)]

    def merge(sender: Indices, receiver: Indices) -> Mask:
        """Merge the senders' lists into the receivers' lists; keep at most `most` (n,) entries."""
        nonlocal lists
        sizes = np.bincount(lists // n, minlength=n)
        begin, length = np.cumsum(sizes) - sizes, sizes[sender]
        offset = np.repeat(begin[sender] - (np.cumsum(length) - length), length)
        sent = lists[offset + np.arange(len(offset))] % n
        known = np.unique(np.concatenate((lists, np.repeat(receiver * n, length) + sent)))
        holder = known // n
        sizes = np.bincount(holder, minlength=n)
        place = np.arange(len(known)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        before, lists = lists, known[place < most[holder]]
        changed = np.zeros(n, dtype=np.bool_)
        changed[np.setxor1d(before, lists, assume_unique=True) // n] = True
        if changed.any():
            history.append(np.isin(own, lists, assume_unique=True))
        return changed

    messages = medium.flood(history[0], merge)
    ends = np.cumsum(np.bincount(lists // n, minlength=n))[:-1]
    return Flags(history[-1], messages, np.array(history), tuple(np.split(order[lists % n], ends)))


def fair_shares(demands: Indices, agents: int) -> Indices:
    """Return the number of agents per event: its demand, reduced if the sum exceeds `agents`."""
    # Agents go one by one to the event with the smallest fulfilled share of its demand (max-min
    # fairness in lexicographic order). Ties go to the smaller demand, then to the smaller event
    # number.
    shares = np.zeros(len(demands), dtype=np.intp)
    for _ in range(min(agents, int(demands.sum()))):
        open_ = np.flatnonzero(shares < demands)
        order = np.lexsort((open_, demands[open_], shares[open_] / demands[open_]))
        shares[open_[order[0]]] += 1
    return shares


def deferred_acceptance(distances_m: Floats, demands: Indices) -> Indices:
    """Return the index of each agent's event, or `NONE`, in a stable assignment."""
    # Shapes: distances_m (n, k), infinite for agents that are not requested; demands (k,).
    # In each round every event requests as many agents as it lacks, nearest first and none twice.
    # Every agent keeps the nearest event among its requests and rejects the others. Ties go to the
    # smaller numbers. An event that runs out of agents stays short.
    agents, events = distances_m.shape
    order = np.argsort(distances_m, axis=0, kind="stable")
    within = np.isfinite(distances_m).sum(axis=0)
    requested = np.zeros(events, dtype=np.intp)
    event_of = np.full(agents, NONE, dtype=np.intp)
    while True:
        lacking = demands - np.bincount(event_of[event_of != NONE], minlength=events)
        requests: list[tuple[int, int]] = []
        for event in np.flatnonzero(lacking > 0).tolist():
            first = requested[event]
            names = order[first : min(first + lacking[event], within[event]), event].tolist()
            requests.extend((agent, event) for agent in names)
            requested[event] += len(names)
        if not requests:
            return event_of
        for agent, event in requests:
            held = int(event_of[agent])
            nearer = (distances_m[agent, event], event) < (distances_m[agent, held], held)
            if held == NONE or nearer:
                event_of[agent] = event
