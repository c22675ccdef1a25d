"""Several events at once: fair shares, distributed matching, and the best assignment there is.

Each event asks for a number of agents. The distributed method is deferred acceptance: events ask
the agents nearest to them, an agent that several events ask keeps the nearest event. The result is
stable: no agent and event would both rather have each other. It need not be the assignment of least
total distance, which :func:`optimal_assignment` finds with all distances known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # pyright: ignore[reportUnknownVariableType]
from scipy.sparse import csr_array
from scipy.sparse.csgraph import (
    maximum_bipartite_matching,  # pyright: ignore[reportUnknownVariableType]
)

from planopt.errors import InputError

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


def bottleneck_assignment(
    distances_m: NDArray[np.float64], demands: NDArray[np.intp]
) -> Assignment:
    """Assign agents to events so that the largest distance is least."""
    _check(distances_m, demands)
    seats = np.repeat(np.arange(len(demands)), demands)
    limits = np.unique(distances_m)
    low, high = 0, len(limits) - 1
    best = np.full(len(distances_m), NONE, dtype=np.intp)
    while low <= high and len(seats):
        middle = (low + high) // 2
        allowed = csr_array((distances_m[:, seats] <= limits[middle]).T)
        agent = cast("NDArray[np.int32]", maximum_bipartite_matching(allowed, perm_type="column"))
        if (agent >= 0).all():
            best[:] = NONE
            best[agent] = seats
            high = middle - 1
        else:
            low = middle + 1
    return _scored(best, distances_m)


def relative_gap(found: Assignment, best: Assignment) -> float:
    """Return by what share an assignment's total distance exceeds the least possible."""
    if best.total_m == 0.0:
        return 0.0 if found.total_m == 0.0 else float("inf")
    return found.total_m / best.total_m - 1.0


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
