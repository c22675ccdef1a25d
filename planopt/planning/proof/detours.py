"""Which of the good places within reach by air are within reach round the obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear
from planopt.world.shortest_ways import (
    ShortestWays,
    is_near_joined,
    shortest_ways,
    way_lengths_m,
)

MarginAt = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Places = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Positions (n, 2) and their margins (n,) in dB."""

FIRST_WAYS = 64
"""Ways to so many of the best places are measured first, then to four times as many, and so on."""
SPLIT_NODES = 100
"""Good nodes too near to obstacles about which the clear places are looked for: the best ones."""


def best_by_ways(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: MarginAt,
    start_m: NDArray[np.float64],
    clearance: float,
    reach_m: NDArray[np.float64],
    looked: list[Places],
    spacing_m: float,
) -> tuple[float, ...]:
    """Best margin (dB) by each of k reaches, if good places count only where a way leads to them.

    A negative one is a bound above: ways are only measured to places that keep the bound.

    Parameters
    ----------
    index, bounds_m, margin_db, start_m, clearance
        As for :func:`planopt.planning.proof.reachability.best_margins_by_step`.
    reach_m
        ``(k,)`` how far the robot gets, ascending.
    looked
        What was found by air: the nodes of a grid first, then places about the best of them.
    spacing_m
        Of the grid.
    """
    ways = shortest_ways(index, bounds_m, start_m, clearance, float(reach_m[-1]), inner=True)
    places = np.concatenate([at for at, _ in looked])
    margins = np.concatenate([values for _, values in looked])
    # A node too near to an obstacle stands for the clear places about it.
    near = is_near_joined(ways, places, spacing_m)
    places, margins = places[near], margins[near]
    clear = is_clear(clearance_m(index, places), clearance) | (places == start_m).all(axis=1)
    short = margins < 0.0
    bound = _bound_below(start_m, reach_m, places[short], margins[short])
    split = np.flatnonzero(~clear & ~short)
    split = split[np.argsort(-margins[split])[:SPLIT_NODES]]
    about = _about(index, bounds_m, places[split], clearance, spacing_m)
    at_about = margin_db(about) if len(about) else np.zeros(0)
    good = np.concatenate([places[clear & ~short], about[at_about >= 0.0]])
    values = np.concatenate([margins[clear & ~short], at_about[at_about >= 0.0]])
    order = np.argsort(-values)
    return _best_reached(ways, reach_m, good[order], values[order], bound)


def _bound_below(
    start_m: NDArray[np.float64],
    reach_m: NDArray[np.float64],
    places_m: NDArray[np.float64],
    margins_db: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Best margin of places (n, 2) by each reach by air; (k,)."""
    away = np.linalg.norm(places_m - start_m, axis=1)
    return np.array([margins_db[away <= reach].max(initial=-np.inf) for reach in reach_m])


def _about(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    nodes_m: NDArray[np.float64],
    clearance: float,
    spacing_m: float,
) -> NDArray[np.float64]:
    """Clear places (m, 2) within half a spacing of nodes (n, 2)."""
    fractions = np.linspace(-0.5, 0.5, 9)
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    places = (nodes_m[:, None] + spacing_m * around).reshape(-1, 2)
    inside = (places >= np.array(bounds_m[:2])) & (places <= np.array(bounds_m[2:]))
    places = places[inside.all(axis=1)]
    return places[is_clear(clearance_m(index, places), clearance)]


def _best_reached(
    ways: ShortestWays,
    reach_m: NDArray[np.float64],
    places_m: NDArray[np.float64],
    margins_db: NDArray[np.float64],
    bound_db: NDArray[np.float64],
) -> tuple[float, ...]:
    """Margin of the first of the places (n, 2) that a way as long as each reach leads to.

    Places come best first; where none is within reach, what is known of others, `bound_db` (k,).
    """
    by_air = np.linalg.norm(places_m - ways.start_m, axis=1)
    length = np.full(len(places_m), np.nan)
    best: list[float] = []
    for k, reach in enumerate(reach_m):
        candidates = np.flatnonzero(by_air <= reach)
        here, begin, count = float(bound_db[k]), 0, FIRST_WAYS
        while begin < len(candidates):
            chunk = candidates[begin : begin + count]
            new = chunk[np.isnan(length[chunk])]
            length[new] = way_lengths_m(ways, places_m[new])
            reached = chunk[length[chunk] <= reach]
            if len(reached):
                here = float(margins_db[reached[0]])
                break
            begin, count = begin + count, 4 * count
        best.append(max(here, best[-1]) if best else here)
    return tuple(best)
