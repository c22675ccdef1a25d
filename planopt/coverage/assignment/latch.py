"""Hysteresis of an assignment: when it is made anew, and how little of it is then changed.

An assignment that follows every step of the agents may flip: a coverage agent on its way to its
centroid overtakes a slow sensing agent. So it is latched. It is made again when the number of
agents, the events or their estimated places have changed, and then agents are exchanged only if
that brings one nearer by more than a hysteresis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.region import positive
from planopt.errors import InputError


@dataclass(frozen=True)
class Circumstance:
    """The events, counts and agents that an assignment was made for."""

    agents: frozenset[int]  # Names of the agents that take part
    # Estimated place (x, y) in metres of each event, by its name
    events: dict[str, tuple[float, float]]


def is_due(last: Circumstance | None, now: Circumstance, moved_m: float) -> bool:
    """Return whether an assignment has to be made again."""
    positive(moved_m, "moved_m", zero=True)
    if last is None or last.agents != now.agents or last.events.keys() != now.events.keys():
        return True
    return any(
        np.hypot(x - last.events[name][0], y - last.events[name][1]) > moved_m
        for name, (x, y) in now.events.items()
    )


def relatch(
    held: NDArray[np.bool_], distances_m: NDArray[np.float64], wanted: int, hysteresis_m: float
) -> NDArray[np.bool_]:
    """Change an assignment of agents to one event as little as the hysteresis allows.

    Missing agents are added and surplus ones released in order of distance. Then the farthest of
    those who respond and the nearest of those who do not are exchanged, as long as the second is
    nearer by more than the hysteresis.
    """
    # Shapes: held (n,); distances_m (n,).
    n = len(distances_m)
    positive(hysteresis_m, "hysteresis_m", zero=True)
    if not 0 <= wanted <= n:
        raise InputError(f"{wanted} of {n} agents", key="wanted")
    order = np.lexsort((np.arange(n), distances_m))
    inside = order[held[order]].tolist()
    outside = order[~held[order]].tolist()
    if len(inside) > wanted:
        outside = sorted(outside + inside[wanted:], key=order.tolist().index)
        inside = inside[:wanted]
    missing = wanted - len(inside)
    inside = sorted(inside + outside[:missing], key=order.tolist().index)
    outside = outside[missing:]
    exchanged = 0
    for farthest, nearest in zip(reversed(inside), outside, strict=False):
        if not distances_m[farthest] > distances_m[nearest] + hysteresis_m:
            break
        exchanged += 1
    kept = inside[: len(inside) - exchanged] + outside[:exchanged]
    flags = np.zeros(n, dtype=np.bool_)
    flags[kept] = True
    return flags
