"""Whether the connectivity bound can be met at all: the verifier's own searches.

Within reach: the places searched contain every place that the robot could reach by a step (a disc
about it, cut to the free part connected with it; where that has a good place, the ways round the
obstacles are measured too), so a negative best margin says that the bound cannot be met there. On
the way to the goal: a flood of the places that keep the bound either comes to the goal or shows
that no such way is left. Both are as good as their grids, which the functions name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label  # pyright: ignore[reportUnknownVariableType]
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]

from planopt.planning.proof.detours import Places, best_by_ways
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear

FINE_NODES, COARSE_NODES = 12, 4
"""Grid nodes a step of the search within reach: up to `FINE_STEPS` steps, and beyond."""
FINE_STEPS = 4
REFINED_STEPS = 12
"""How many steps are refined, the first ones; a later one is at least as good as these."""
REFINED_NODES = 24
"""How many of the best nodes each refinement looks around."""
REFINEMENTS = 2
"""How often the grid is refined, each time to a quarter of the spacing."""

FLOOD_SPACING_STEPS = 0.5
"""Grid spacing of the flood in longest steps."""

MayReach = Callable[[NDArray[np.float64], int, float], NDArray[np.bool_]]
"""Whether a robot may be at places (n, 2) after so many steps, or so many metres from there; never
False where it may."""


def connected_way_exists(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],
    goal_m: NDArray[np.float64],
    clearance: float,
    step_length_m: float,
    within_m: float,
) -> bool:
    """Whether a way to the goal keeps the connectivity bound, from a place near the start.

    Floods a grid of half a step's spacing over the workspace, corners included, so that what it
    finds is at least what there is, but for ways narrower than the grid.

    Parameters
    ----------
    index, bounds_m
        The obstacles and the workspace.
    margin_db
        Positions (n, 2) to margins (n,).
    start_m, goal_m
        ``(2,)`` each.
    clearance, step_length_m
        The clearance that the robot must keep and its longest step, in metres.
    within_m
        Ways may begin at any place that keeps the bound and is at most this far from the start.
        With 0 they begin at the start itself, whatever its margin.
    """
    spacing = FLOOD_SPACING_STEPS * step_length_m
    grid = _grid(bounds_m, start_m, spacing)
    x, y = grid[..., 0], grid[..., 1]
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(x.shape)
    # However coarse the grid is against the clearance, no way leads through an obstacle.
    open_ = (away > 0.0) & (away >= clearance - 0.5 * spacing)
    open_[open_] = margin_db(grid[open_]) >= 0.0
    from_start = np.hypot(x - start_m[0], y - start_m[1])
    if within_m == 0.0:
        open_[from_start < 0.5 * spacing] = True
    parts = _parts(open_)
    begins = parts[open_ & (from_start <= max(within_m, 0.5 * spacing))]
    at_goal = np.hypot(x - goal_m[0], y - goal_m[1]) <= spacing
    return bool(np.isin(parts[at_goal & open_], begins).any())


def _grid(
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


def _parts(passable: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Number the connected parts of a grid, corners connect; 0 where it is not passable."""
    numbered = cast(
        "tuple[object, int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    return np.asarray(numbered[0], dtype=np.int32)


def best_margins_by_step(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    start_m: NDArray[np.float64],
    step_length_m: float,
    steps: NDArray[np.intp],
    clearance: float,
    may_reach: MayReach | None = None,
) -> tuple[float, ...]:
    """Largest connectivity margin (dB) over the places within reach by each of some steps.

    One grid serves all steps, so that more time never gives a worse place, unless the robot cannot
    wait there.

    Parameters
    ----------
    index, bounds_m
        The obstacles and the workspace.
    margin_db
        Positions (n, 2) to margins (n,).
    start_m
        ``(2,)`` where the robot is.
    step_length_m
        How far it gets in a step.
    steps
        ``(k,)`` increasing, the first step being 1.
    clearance
        The clearance that it must keep, in metres.
    may_reach
        Where a robot may be that cannot turn or stop at will; None for any other.
    """
    radius = float(steps[-1]) * step_length_m
    spacing = step_length_m / (FINE_NODES if steps[-1] <= FINE_STEPS else COARSE_NODES)
    grid = _grid(bounds_m, start_m, spacing, radius)
    from_start = np.linalg.norm(grid - start_m, axis=-1)
    # A path may pass between nodes that are all a little too near to an obstacle, not through one.
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(from_start.shape)
    passable = (away > 0.0) & (away >= clearance - spacing)
    passable |= from_start == 0.0
    parts = _parts(passable)
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
    """Whether places (n, 2) are within reach."""

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


def least_outage_m(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    places_m: NDArray[np.float64],
    goal_m: NDArray[np.float64],
    clearance: float,
    step_length_m: float,
) -> NDArray[np.float64]:
    """Least length below the bound on a way from each place to the goal, in metres; (n,).

    By Dijkstra's algorithm on a grid of half a step's spacing, corners included; infinite where
    obstacles cut a place off. An edge counts as below the bound by the share of its ends that are.

    Parameters
    ----------
    places_m
        ``(n, 2)`` the first is a node of the grid; every other takes its nearest open node's value.
    index, bounds_m, margin_db, goal_m, clearance, step_length_m
        As for :func:`connected_way_exists`.
    """
    spacing = FLOOD_SPACING_STEPS * step_length_m
    grid = _grid(bounds_m, places_m[0], spacing)
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(grid.shape[:2])
    open_ = (away > 0.0) & (away >= clearance - 0.5 * spacing)
    number = np.full(open_.shape, -1)
    number[open_] = np.arange(int(open_.sum()))
    nodes = grid[open_]
    below = margin_db(nodes) < 0.0
    ends: list[NDArray[np.intp]] = []
    high, wide = len(grid), len(grid[0])
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = number[: high - down, max(0, -right) : wide - max(0, right)]
        other = number[down:, max(0, right) : wide + min(0, right)]
        both = (one >= 0) & (other >= 0)
        ends.append(np.stack([one[both], other[both]]))
    first, second = np.concatenate(ends, axis=1)
    length = np.linalg.norm(nodes[first] - nodes[second], axis=1)
    # An edge of no cost would be no edge to the solver; a millionth keeps ways short among equals.
    outage = length * (0.5 * (below[first].astype(float) + below[second]) + 1e-6)
    graph = csr_matrix((outage, (first, second)), shape=(len(nodes), len(nodes)))
    goal = int(np.argmin(np.linalg.norm(nodes - goal_m, axis=1)))
    from_goal = cast("NDArray[np.float64]", dijkstra(graph, directed=False, indices=goal))
    nearest = [int(np.argmin(np.linalg.norm(nodes - place, axis=1))) for place in places_m]
    return from_goal[nearest]
