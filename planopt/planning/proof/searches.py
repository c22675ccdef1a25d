"""Searches of the verifier for reachable connected positions and for cheaper paths to the goal.

The searched positions are a superset of the reachable ones: a disc restricted to the connected free
space, where positions with a positive margin must also have a short enough path around obstacles.
Costs are compared with feasible paths on the verifier's own grid (equation 6.9).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from planopt.arrays import Floats, Indices, Mask
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems.problem import MayReach, Problem, charged_length_m
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear, segment_clearance_m
from planopt.world.shortest_paths import (
    ShortestPaths,
    is_near_joined,
    path_lengths_m,
    shortest_paths,
)


def grid_of(
    bounds_m: tuple[float, float, float, float],
    anchor_m: Floats,
    spacing_m: float,
    radius_m: float = np.inf,
) -> Floats:
    """Return the nodes (rows, columns, 2) of a grid around an anchor, which is a node itself."""
    low = np.maximum(np.array(bounds_m[:2]) - anchor_m, -radius_m)
    high = np.minimum(np.array(bounds_m[2:]) - anchor_m, radius_m)
    columns = _steps_within(float(low[0]), float(high[0]), spacing_m)
    rows = _steps_within(float(low[1]), float(high[1]), spacing_m)
    grid = np.empty((len(rows), len(columns), 2))
    grid[..., 0] = anchor_m[0] + columns
    grid[..., 1] = anchor_m[1] + rows[:, None]
    return grid


def _steps_within(low: float, high: float, spacing: float) -> Floats:
    """Return the multiples of `spacing` between `low` and `high`."""
    first, last = int(np.ceil(low / spacing)), int(np.floor(high / spacing))
    return spacing * np.arange(first, last + 1, dtype=np.float64)


def parts_of(passable: Mask) -> NDArray[np.int32]:
    """Return the label of each grid node's connected component; 0 for blocked nodes."""
    numbered = cast(
        "tuple[object, int]", label(passable, structure=np.ones((3, 3), dtype=np.int32))
    )
    return np.asarray(numbered[0], dtype=np.int32)


MarginAt = Callable[[Floats], Floats]
"""Function that maps positions (n, 2) to connectivity margins (n,) in dB."""
Places = tuple[Floats, Floats]
"""Positions (n, 2) and their connectivity margins (n,) in dB."""
FIRST_PATHS = 64
"""Number of best positions in the first round of path lengths; it grows fourfold per round."""
SPLIT_NODES = 100
"""Maximum number of good nodes that are too close to obstacles and replaced by free positions."""


def best_by_paths(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: MarginAt,
    start_m: Floats,
    clearance: float,
    reach_m: Floats,  # (k,) reachable path lengths, ascending
    looked: list[Places],
    spacing_m: float,
) -> tuple[float, ...]:
    """Return, for each path length in `reach_m` (k,), the best margin in dB within this length."""
    # Negative margins are compared by straight distance, so a negative result is an upper bound.
    paths = shortest_paths(index, bounds_m, start_m, clearance, float(reach_m[-1]), inner=True)
    places = np.concatenate([at for at, _ in looked])
    margins = np.concatenate([values for _, values in looked])
    # A node too close to an obstacle is replaced by clear positions around it.
    near = is_near_joined(paths, places, spacing_m)
    places, margins = places[near], margins[near]
    clear = is_clear(clearance_m(index, places), clearance) | (places == start_m).all(axis=1)
    short = margins < 0.0
    away = np.linalg.norm(places[short] - start_m, axis=1)
    bound = np.array([margins[short][away <= reach].max(initial=-np.inf) for reach in reach_m])
    split = np.flatnonzero(~clear & ~short)
    split = split[np.argsort(-margins[split])[:SPLIT_NODES]]
    about = _about(index, bounds_m, places[split], clearance, spacing_m)
    at_about = margin_db(about) if len(about) else np.zeros(0)
    good = np.concatenate([places[clear & ~short], about[at_about >= 0.0]])
    values = np.concatenate([margins[clear & ~short], at_about[at_about >= 0.0]])
    order = np.argsort(-values)
    return _best_reached(paths, reach_m, good[order], values[order], bound)


def _about(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    nodes_m: Floats,
    clearance: float,
    spacing_m: float,
) -> Floats:
    """Return collision-free positions (m, 2) within half a spacing of nodes along both axes."""
    fractions = np.linspace(-0.5, 0.5, 9)
    around = np.stack(np.meshgrid(fractions, fractions), axis=-1).reshape(1, -1, 2)
    places = (nodes_m[:, None] + spacing_m * around).reshape(-1, 2)
    inside = (places >= np.array(bounds_m[:2])) & (places <= np.array(bounds_m[2:]))
    places = places[inside.all(axis=1)]
    return places[is_clear(clearance_m(index, places), clearance)]


def _best_reached(
    paths: ShortestPaths, reach_m: Floats, places_m: Floats, margins_db: Floats, bound_db: Floats
) -> tuple[float, ...]:
    """Return the best margin (k,) within each path length; `margins_db` is in descending order."""
    # If no position is within a path length, return the upper bound `bound_db` (k,) of all others.
    by_air = np.linalg.norm(places_m - paths.start_m, axis=1)
    length = np.full(len(places_m), np.nan)
    best: list[float] = []
    for k, reach in enumerate(reach_m):
        candidates = np.flatnonzero(by_air <= reach)
        here, begin, count = float(bound_db[k]), 0, FIRST_PATHS
        while begin < len(candidates):
            chunk = candidates[begin : begin + count]
            new = chunk[np.isnan(length[chunk])]
            length[new] = path_lengths_m(paths, places_m[new])
            reached = chunk[length[chunk] <= reach]
            if len(reached):
                here = float(margins_db[reached[0]])
                break
            begin, count = begin + count, 4 * count
        best.append(max(here, best[-1]) if best else here)
    return tuple(best)


FINE_NODES, COARSE_NODES = 12, 4
"""Number of grid nodes per step length, within `FINE_STEPS` steps and beyond."""
FINE_STEPS = 4
REFINED_STEPS = 12  # Number of initial steps with a refined grid
REFINED_NODES = 24  # Number of best nodes around which each refinement searches
REFINEMENTS = 2  # Number of refinements, each with a quarter of the previous spacing


def best_margins_by_step(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[Floats], Floats],
    start_m: Floats,  # (2,) position of the robot
    step_length_m: float,
    steps: Indices,  # (k,) ascending step numbers; 1 is the first
    clearance: float,
    may_reach: MayReach | None = None,
) -> tuple[float, ...]:
    """Return the largest connectivity margin (dB) over the positions reachable by each step."""
    # One grid serves all steps, so values never decrease unless the robot cannot wait.
    radius = float(steps[-1]) * step_length_m
    spacing = step_length_m / (FINE_NODES if steps[-1] <= FINE_STEPS else COARSE_NODES)
    grid = grid_of(bounds_m, start_m, spacing, radius)
    from_start = np.linalg.norm(grid - start_m, axis=-1)
    # A path may lead between nodes that are all slightly too close to an obstacle.
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
                # The reachable set includes points between the nodes.
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
    return best_by_paths(index, bounds_m, margin_db, start_m, clearance, reaches, looked, spacing)


def _reached(
    start_m: Floats, radius_m: float, step: int, may_reach: MayReach | None
) -> Callable[[Floats], Mask]:
    """Return a function that tests which positions (n, 2) a robot can reach by step `step`."""

    def reached(places_m: Floats) -> Mask:
        near = np.linalg.norm(places_m - start_m, axis=1) <= radius_m
        return near if may_reach is None else near & may_reach(places_m, step, 0.0)

    return reached


def _refined(
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    margin_db: Callable[[Floats], Floats],
    reached: Callable[[Floats], Mask],
    clearance: float,
    top_m: Floats,
    spacing_m: float,
) -> list[Places]:
    """Return positions on successively finer grids around the best nodes, with margins."""
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


SPACING_STEPS = 0.5  # Spacing of the goal grid, in longest steps
MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Row and column offsets to a node's neighbours, one of each opposite pair: sixteen headings."""
JOINING_SPACINGS = 1.5  # Distance in spacings within which an off-grid position is linked to nodes
COARSE = 2  # Stride of rows and columns with predictions; values in between are interpolated
ContactAt = Callable[[Floats], tuple[Floats, Floats]]
"""Function that maps positions (n, 2) to the fraction (n,) of a metre that costs the outage price
and the connectivity margin (n,) in dB."""


@dataclass(frozen=True, eq=False)
class GoalGrid:
    """Grid of nodes and moves that satisfy the clearance; one node is the goal."""

    spacing_m: float  # Grid spacing
    nodes_m: Floats  # (n, 2)
    ends: Indices  # (2, m) end nodes of each move
    goal: int  # Index of the goal's node
    coarse_m: Floats  # (c, 2) positions of the coarse grid
    # (n, 4) coarse positions whose weighted mean is the value of each node
    corners: Indices
    weights: Floats


@dataclass(frozen=True, eq=False)
class GoalCosts:
    """Costs of paths on the goal grid for one channel belief."""

    share: Floats  # (n,) fraction of a metre out of contact at each node
    to_goal_m: Floats  # (n,) cost of the cheapest path to the goal
    best_margin_db: float  # Largest connectivity margin in the workspace


@dataclass(frozen=True)
class PricedPath:
    """Cost of a path including cost-to-go, and cost of the cheapest path found."""

    cost_m: float  # Length in metres plus outage at its price
    best_m: float
    step_m: float  # Cost of the path's first step
    excess_m: float  # First step plus subsequent cost-to-go, minus `best_m`

    @property
    def is_compared(self) -> bool:
        """Return whether the grid has paths to the goal from both ends of the plan's path."""
        return max(self.cost_m, self.best_m) < np.inf


def build_goal_grid(problem: Problem, index: ObstacleIndex) -> GoalGrid:
    """Return the verifier's grid for a whole run; it contains the goal."""
    spacing = SPACING_STEPS * problem.step_length_m
    goal = np.asarray(problem.goal_m)
    grid = grid_of(problem.workspace.bounds_m, goal, spacing)
    high, wide = len(grid), len(grid[0])
    away = clearance_m(index, grid.reshape(-1, 2)).reshape(high, wide)
    clearance = problem.constraints.clearance_m
    is_open = is_clear(away.ravel(), clearance).reshape(high, wide)
    number = np.full((high, wide), -1)
    number[is_open] = np.arange(int(is_open.sum()))
    nodes = grid[is_open]
    ends: list[Indices] = []
    for down, right in MOVES:
        left = max(0, -right)
        one = number[: high - down, left : wide - max(0, right)]
        other = number[down:, left + right : wide + min(0, right)]
        both = (one >= 0) & (other >= 0)
        ends.append(np.stack([one[both], other[both]]))
    joined = np.concatenate(ends, axis=1)
    # Lower bound of the clearance along a move between two nodes.
    length = np.linalg.norm(nodes[joined[0]] - nodes[joined[1]], axis=1)
    least = 0.5 * (away[is_open][joined].sum(axis=0) - length)
    doubtful = np.flatnonzero(least < clearance + CLEARANCE_TOLERANCE_M)
    swept = segment_clearance_m(index, nodes[joined[0, doubtful]], nodes[joined[1, doubtful]])
    kept = np.ones(joined.shape[1], dtype=bool)
    kept[doubtful] = is_clear(swept, clearance)
    at_goal = int(np.argmin(np.linalg.norm(nodes - goal, axis=1)))
    coarse, corners, weights = _coarser(grid, is_open)
    return GoalGrid(spacing, nodes, joined[:, kept], at_goal, coarse, corners, weights)


def _coarser(grid: Floats, is_open: Mask) -> tuple[Floats, Indices, Floats]:
    """Return a coarse grid around open nodes, with indices and weights for interpolation."""
    rows, columns = np.nonzero(is_open)
    last = (np.array(is_open.shape) - 1) // COARSE
    corners: list[Indices] = []
    weights: list[Floats] = []
    for down in (0, 1):
        for right in (0, 1):
            row, column = rows // COARSE + down, columns // COARSE + right
            # Beyond the last coarse row, the extrapolation is constant.
            corners.append(np.minimum(row, last[0]) * (last[1] + 1) + np.minimum(column, last[1]))
            share_y, share_x = rows % COARSE / COARSE, columns % COARSE / COARSE
            by_y = share_y if down else 1.0 - share_y
            weights.append(by_y * (share_x if right else 1.0 - share_x))
    corner, weight = np.stack(corners, axis=1), np.stack(weights, axis=1)
    used, numbered = np.unique(corner, return_inverse=True)
    places = grid[::COARSE, ::COARSE].reshape(-1, 2)[used]
    return places, numbered.reshape(corner.shape), weight


def goal_costs(grid: GoalGrid, contact_at: ContactAt, price: float) -> GoalCosts:
    """Return each node's outage fraction and least cost to the goal."""
    coarse, margin = contact_at(grid.coarse_m)
    share = (coarse[grid.corners] * grid.weights).sum(axis=1)
    one, other = grid.ends
    length = np.linalg.norm(grid.nodes_m[one] - grid.nodes_m[other], axis=1)
    cost = length * (1.0 + 0.5 * price * (share[one] + share[other]))
    count = len(grid.nodes_m)
    graph = csr_matrix((cost, (one, other)), shape=(count, count))
    to_goal: Floats = cast("Any", dijkstra)(graph, directed=False, indices=grid.goal)
    best = float(margin.max())
    if best < 0.0:
        best = max(best, float(contact_at(grid.nodes_m)[1].max()))
    return GoalCosts(share, to_goal, best)


def price_path(
    grid: GoalGrid,
    index: ObstacleIndex,
    costs: GoalCosts,
    price: float,
    positions_m: Floats,
    share: Floats,
) -> PricedPath:
    """Return the cost of a path (N + 1, 2), and of the cheapest path from its start."""

    def rest_m(k: int) -> float:
        """Return the cost of the cheapest path to the goal from the k-th position."""
        away = np.linalg.norm(grid.nodes_m - positions_m[k], axis=1)
        near = np.flatnonzero(away <= JOINING_SPACINGS * grid.spacing_m)
        here = np.broadcast_to(positions_m[k], (len(near), 2))
        near = near[segment_clearance_m(index, here, grid.nodes_m[near]) > 0.0]
        joining = away[near] * (1.0 + 0.5 * price * (costs.share[near] + share[k]))
        return float((joining + costs.to_goal_m[near]).min(initial=np.inf))

    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    driven = float(lengths.sum()) + price * charged_length_m(lengths, share)
    best = rest_m(0)
    step = float(lengths[:1].sum()) + price * charged_length_m(lengths[:1], share[:2])
    after = rest_m(min(1, len(lengths)))
    # Without a path on the grid, the excess is undefined.
    excess = step + after - best if max(best, after) < np.inf else 0.0
    return PricedPath(driven + rest_m(len(positions_m) - 1), best, step, excess)
