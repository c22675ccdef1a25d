"""The verifier's own search for places within reach that meet the connectivity bound.

The places searched contain every place that the robot could reach by a step (a disc about it, cut
to the free part connected with it; where that has a good place, the ways round the obstacles are
measured too), so a negative best margin says that the bound cannot be met there. The search is as
good as its grid. A robot that cannot turn or stop at will has a disc of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label  # pyright: ignore[reportUnknownVariableType]

from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear
from planopt.world.shortest_paths import (
    ShortestPaths,
    is_near_joined,
    path_lengths_m,
    shortest_paths,
)


def grid_of(
    bounds_m: tuple[float, float, float, float],
    anchor_m: NDArray[np.float64],
    spacing_m: float,
    radius_m: float = np.inf,
) -> NDArray[np.float64]:
    """Places of a grid over the workspace, one of them the anchor, none far beyond the radius."""
    low = np.maximum(np.array(bounds_m[:2]) - anchor_m, -radius_m)
    high = np.minimum(np.array(bounds_m[2:]) - anchor_m, radius_m)
    columns = _steps_within(float(low[0]), float(high[0]), spacing_m)
    rows = _steps_within(float(low[1]), float(high[1]), spacing_m)
    grid = np.empty((len(rows), len(columns), 2))
    grid[..., 0] = anchor_m[0] + columns
    grid[..., 1] = anchor_m[1] + rows[:, None]
    return grid


def _steps_within(low: float, high: float, spacing: float) -> NDArray[np.float64]:
    """Multiples of the spacing between two offsets."""
    first, last = int(np.ceil(low / spacing)), int(np.floor(high / spacing))
    return spacing * np.arange(first, last + 1, dtype=np.float64)


def parts_of(passable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Number the connected parts of a grid, corners connect; 0 where it is not passable."""
    numbered = cast(
        "tuple[object, int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    return np.asarray(numbered[0], dtype=np.int32)


def may_reach_from(problem: Problem, state: NDArray[np.float64]) -> MayReach | None:
    """Return where the first robot may be some steps after `state`; None if anywhere near."""
    if problem.robots[0].moves_freely:
        return None
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s

    def may_reach(places_m: NDArray[np.float64], step: int, slack_m: float) -> NDArray[np.bool_]:
        return dynamics.may_reach(state, places_m, step * step_s, slack_m)

    return may_reach


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
    reach_m: NDArray[np.float64],  # (k,) how far the robot gets, ascending
    looked: list[Places],
    spacing_m: float,
) -> tuple[float, ...]:
    """Best margin (dB) by each of k reaches, if good places count only where a way leads to them.

    A negative one is a bound above: ways are only measured to places that keep the bound.
    """
    ways = shortest_paths(index, bounds_m, start_m, clearance, float(reach_m[-1]), inner=True)
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
    ways: ShortestPaths,
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
            length[new] = path_lengths_m(ways, places_m[new])
            reached = chunk[length[chunk] <= reach]
            if len(reached):
                here = float(margins_db[reached[0]])
                break
            begin, count = begin + count, 4 * count
        best.append(max(here, best[-1]) if best else here)
    return tuple(best)


FINE_NODES, COARSE_NODES = 12, 4
"""Grid nodes a step of the search within reach: up to `FINE_STEPS` steps, and beyond."""
FINE_STEPS = 4
REFINED_STEPS = 12
"""How many steps are refined, the first ones; a later one is at least as good as these."""
REFINED_NODES = 24
"""How many of the best nodes each refinement looks around."""
REFINEMENTS = 2
"""How often the grid is refined, each time to a quarter of the spacing."""

MayReach = Callable[[NDArray[np.float64], int, float], NDArray[np.bool_]]
"""Whether a robot may be at places (n, 2) after so many steps, or so many metres from there; never
False where it may."""


def best_margins_by_step(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],  # (2,) where the robot is
    step_length_m: float,
    steps: NDArray[np.intp],  # (k,) increasing, the first step being 1
    clearance: float,
    may_reach: MayReach | None = None,
) -> tuple[float, ...]:
    """Largest connectivity margin (dB) over the places within reach by each of some steps.

    One grid serves all steps, so that more time never gives a worse place, unless the robot cannot
    wait there.
    """
    radius = float(steps[-1]) * step_length_m
    spacing = step_length_m / (FINE_NODES if steps[-1] <= FINE_STEPS else COARSE_NODES)
    grid = grid_of(bounds_m, start_m, spacing, radius)
    from_start = np.linalg.norm(grid - start_m, axis=-1)
    # A path may pass between nodes that are all a little too near to an obstacle, not through one.
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(from_start.shape)
    passable = (away > 0.0) & (away >= clearance - spacing)
    passable |= from_start == 0.0
    parts = parts_of(passable)
    reachable = (parts == parts[from_start == 0.0]) & (from_start <= radius)
    order = np.argsort(from_start[reachable])
    places, distance = grid[reachable][order], from_start[reachable][order]
    margins = margin_db(places)
    best: list[float] = []
    looked: list[Places] = [(places, margins)]
    for k, step in enumerate(steps):
        reach = float(step) * step_length_m
        reached = _reached(start_m, reach, int(step), may_reach)
        within = slice(0, int(np.searchsorted(distance, reach, side="right")))
        if may_reach is not None:
            within = reached(places)
            if not within.any():
                # What it may reach lies between the nodes.
                within = (distance <= reach) & may_reach(places, int(step), spacing)
        here = float(np.max(margins[within], initial=-np.inf))
        if here < 0.0 and k < REFINED_STEPS:
            top = places[within][np.argsort(-margins[within])[:REFINED_NODES]]
            found = _refined(index, bounds_m, margin_db, reached, clearance, top, spacing)
            looked.extend(found)
            here = max([here, *(float(values.max()) for _, values in found)])
        best.append(max(here, best[-1]) if best and may_reach is None else here)
    if best[-1] < 0.0 or may_reach is not None or not index.obstacles:
        return tuple(best)
    reaches = step_length_m * steps.astype(np.float64)
    return best_by_ways(index, bounds_m, margin_db, start_m, clearance, reaches, looked, spacing)


def _reached(
    start_m: NDArray[np.float64], radius_m: float, step: int, may_reach: MayReach | None
) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]]:
    """Return whether places (n, 2) are within reach."""

    def reached(places_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        near = np.linalg.norm(places_m - start_m, axis=1) <= radius_m
        return near if may_reach is None else near & may_reach(places_m, step, 0.0)

    return reached


def _refined(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    reached: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
    clearance: float,
    top_m: NDArray[np.float64],
    spacing_m: float,
) -> list[Places]:
    """Places near the best nodes, on grids that grow finer."""
    found: list[Places] = []
    fractions = np.array([-0.5, -0.25, 0.0, 0.25, 0.5])
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    lower, upper = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    for _ in range(REFINEMENTS):
        places = (top_m[:, None] + spacing_m * around).reshape(-1, 2)
        places = places[reached(places)]
        places = places[((places >= lower) & (places <= upper)).all(axis=1)]
        places = places[is_clear(clearance_m(index, places), clearance)]
        if len(places) == 0:
            break
        margins = margin_db(places)
        found.append((places, margins))
        top_m = places[np.argsort(-margins)[:REFINED_NODES]]
        spacing_m /= 4.0
    return found
