"""Flag propagation: each agent decides by itself whether it is among the P nearest to an event.

The P agents nearest to an event form a connected part of the Voronoi neighbour graph, so that lists
of the nearest agents, passed between neighbours, reach every agent concerned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.network import Loss, Network, gets_through
from planopt.errors import InputError


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
