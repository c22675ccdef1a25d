"""The verifier's own search for cheaper paths to the goal at the outage price.

A plan may leave contact where that is cheaper than going round. Whether it is, is not the planner's
to say: Dijkstra's algorithm runs here on a grid of the verifier's own, over the whole workspace.
What it finds can be driven: nodes and moves keep the clearance, while a path that fits between the
nodes may stay unseen. Its cost is sampled, too: probabilities are exact at every other node and
interpolated between, and a move is charged by its ends, so that holes narrower than a step may cost
too little. The leeway of :mod:`planopt.planning.proof.single_steps` is for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra  # pyright: ignore[reportUnknownVariableType]

from planopt.objectives.reach import charged_length_m
from planopt.planning.proof.reachability import grid_of
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex, clearance_m, is_clear, segment_clearance_m

SPACING_STEPS = 0.5
"""Grid spacing in longest steps."""
MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Rows and columns to a node's neighbours, one of each pair: sixteen headings."""
JOINING_SPACINGS = 1.5
"""A place off the grid is joined to the nodes within this many spacings."""

COARSE = 2
"""Predictions are made at every so many-th row and column, and interpolated between."""

ContactAt = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]
"""From places (n, 2) to the share (n,) of a metre there that the outage price is charged on, and to
the connectivity margin (n,) in dB."""


@dataclass(frozen=True, eq=False)
class GoalGrid:
    """Places where a robot may be, and the moves between them; the goal is one of them."""

    spacing_m: float  # Of the grid
    nodes_m: NDArray[np.float64]  # (n, 2)
    ends: NDArray[np.intp]  # (2, m) nodes that each move joins
    goal: int  # Number of the goal's node
    coarse_m: NDArray[np.float64]  # (c, 2) places of a coarser grid about them
    # (n, 4) of which coarse places each node's value is the mean, and how weighted
    corners: NDArray[np.intp]
    weights: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GoalCosts:
    """The costs of a grid by one belief."""

    share: NDArray[np.float64]  # (n,) of a metre at each node that the price is charged on
    to_goal_m: NDArray[np.float64]  # (n,) cost of the cheapest path to the goal
    best_margin_db: float  # The largest connectivity margin found anywhere


@dataclass(frozen=True)
class PricedPath:
    """The cost of a path with the rest of the way, and that of the cheapest found."""

    cost_m: float  # Metres, those out of contact counted at the outage price
    best_m: float
    # The cost of its first step, and that with the cheapest path from there less `best_m`
    step_m: float
    excess_m: float

    @property
    def is_compared(self) -> bool:
        """Return whether the grid has paths from where the path begins and from where it ends."""
        return max(self.cost_m, self.best_m) < np.inf


def build_goal_grid(problem: Problem, index: ObstacleIndex) -> GoalGrid:
    """Lay the grid through the goal; it stays the same for a whole run."""
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
    ends: list[NDArray[np.intp]] = []
    for down, right in MOVES:
        left = max(0, -right)
        one = number[: high - down, left : wide - max(0, right)]
        other = number[down:, left + right : wide + min(0, right)]
        both = (one >= 0) & (other >= 0)
        ends.append(np.stack([one[both], other[both]]))
    joined = np.concatenate(ends, axis=1)
    # Midway between two places nothing is nearer than this.
    length = np.linalg.norm(nodes[joined[0]] - nodes[joined[1]], axis=1)
    least = 0.5 * (away[is_open][joined].sum(axis=0) - length)
    doubtful = np.flatnonzero(least < clearance + CLEARANCE_TOLERANCE_M)
    swept = segment_clearance_m(index, nodes[joined[0, doubtful]], nodes[joined[1, doubtful]])
    kept = np.ones(joined.shape[1], dtype=bool)
    kept[doubtful] = is_clear(swept, clearance)
    at_goal = int(np.argmin(np.linalg.norm(nodes - goal, axis=1)))
    coarse, corners, weights = _coarser(grid, is_open)
    return GoalGrid(spacing, nodes, joined[:, kept], at_goal, coarse, corners, weights)


def _coarser(
    grid: NDArray[np.float64], is_open: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]]:
    """Places of the coarser grid about open nodes, and how nodes interpolate between them."""
    rows, columns = np.nonzero(is_open)
    last = (np.array(is_open.shape) - 1) // COARSE
    corners: list[NDArray[np.intp]] = []
    weights: list[NDArray[np.float64]] = []
    for down in (0, 1):
        for right in (0, 1):
            row, column = rows // COARSE + down, columns // COARSE + right
            # Beyond the last coarse row its value holds.
            corners.append(np.minimum(row, last[0]) * (last[1] + 1) + np.minimum(column, last[1]))
            share_y, share_x = rows % COARSE / COARSE, columns % COARSE / COARSE
            by_y = share_y if down else 1.0 - share_y
            weights.append(by_y * (share_x if right else 1.0 - share_x))
    corner, weight = np.stack(corners, axis=1), np.stack(weights, axis=1)
    used, numbered = np.unique(corner, return_inverse=True)
    places = grid[::COARSE, ::COARSE].reshape(-1, 2)[used]
    return places, numbered.reshape(corner.shape), weight


def goal_costs(grid: GoalGrid, contact_at: ContactAt, price: float) -> GoalCosts:
    """Cost of the cheapest path to the goal from every node of the grid."""
    coarse, margin = contact_at(grid.coarse_m)
    share = (coarse[grid.corners] * grid.weights).sum(axis=1)
    one, other = grid.ends
    length = np.linalg.norm(grid.nodes_m[one] - grid.nodes_m[other], axis=1)
    cost = length * (1.0 + 0.5 * price * (share[one] + share[other]))
    count = len(grid.nodes_m)
    graph = csr_matrix((cost, (one, other)), shape=(count, count))
    to_goal = cast("NDArray[np.float64]", dijkstra(graph, directed=False, indices=grid.goal))
    best = float(margin.max())
    if best < 0.0:
        best = max(best, float(contact_at(grid.nodes_m)[1].max()))
    return GoalCosts(share, to_goal, best)


def price_path(
    grid: GoalGrid,
    index: ObstacleIndex,
    costs: GoalCosts,
    price: float,
    positions_m: NDArray[np.float64],
    share: NDArray[np.float64],
) -> PricedPath:
    """Compare a path (N + 1, 2), its first place included, with the cheapest one from there."""

    def rest_m(k: int) -> float:
        """Cost of the cheapest path from the k-th place on."""
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
    # Where the grid has no path, there is nothing to exceed.
    excess = step + after - best if max(best, after) < np.inf else 0.0
    return PricedPath(driven + rest_m(len(positions_m) - 1), best, step, excess)
