"""Global search over N steps: dynamic programming on the lattice, then better timing.

The search is exact for an additive cost on the lattice. The first move goes from the robot's own
position to any node in reach; every later move is one of the lattice's.

A lattice path moves at the speeds that its moves happen to have. The separating lines of a polish
belong to segments, so a path that passes a corner a step late keeps the polished one late too.
Sampled anew at cruising speed (:func:`retime`) it passes the corner in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import step_cost_s
from planopt.planning.search.moving_moves import MovingMoves, steps_apart
from planopt.world.lattice import REACH_TOLERANCE_M
from planopt.world.moving_obstacle import NOTHING_MOVES, MovingDiscs
from planopt.world.road_map import RoadMap


@dataclass(frozen=True)
class LatticePath:
    """The cheapest path found."""

    nodes: NDArray[np.intp]  # (N,) node after each step
    cost_s: float  # Its cost, penalties and cost to go included


def search_lattice(
    road_map: RoadMap,
    first_nodes: NDArray[np.intp],
    first_length_m: NDArray[np.float64],
    horizon: int,
    step_s: float,
    effort_weight_s2_m2: float,
    goal_node: int,
    node_penalty_s: NDArray[np.float64],  # (n,)
    terminal_cost_s: NDArray[np.float64],  # (n,) added for the last node
    surcharge_s_m: NDArray[np.float64] | None = None,  # (n + 1,)
    moving: MovingDiscs = NOTHING_MOVES,
    first_step: int = 0,
) -> LatticePath | None:
    """Find the cheapest path of `horizon` steps, or None if no node can be reached at all."""
    if first_nodes.size == 0:
        return None
    count = len(road_map.nodes_m)
    penalty_s = np.broadcast_to(node_penalty_s, (horizon, count))
    half = np.zeros(count + 1) if surcharge_s_m is None else 0.5 * surcharge_s_m
    # A step is at most the longest move, so stage k cannot leave this disc about the first nodes.
    reach = float(road_map.lengths_m.max()) + REACH_TOLERANCE_M
    away = road_map.nodes_m - road_map.nodes_m[first_nodes[0]]
    away *= away
    distance = np.sqrt(away[:, 0] + away[:, 1])
    near = np.nonzero(distance <= reach * (horizon + 1))[0]
    near = near[np.argsort(distance[near], kind="stable")]
    radius = distance[near]
    move_cost = step_cost_s(road_map.lengths_m, step_s, effort_weight_s2_m2)
    stay = int(np.argmin(road_map.lengths_m))

    cost = np.full(count + 1, np.inf)
    cost[first_nodes] = (
        step_cost_s(first_length_m, step_s, effort_weight_s2_m2)
        + first_length_m * (half[first_nodes] + half[-1])
        + penalty_s[0, first_nodes]
    )
    # A stage's nodes are the first of `near`: what belongs to their moves is looked up once.
    sources = road_map.sources[near]
    # A closed move comes from node n, which costs infinity whatever its surcharge.
    surcharge = road_map.lengths_m * (half[sources] + half[near, None])
    came_by: list[NDArray[np.intp]] = []
    stages: list[NDArray[np.intp]] = []
    for k in range(1, horizon):
        stage = near[: np.searchsorted(radius, reach * (k + 2), side="right")]
        arriving = cost[sources[: len(stage)]]
        arriving += move_cost
        if surcharge_s_m is not None:
            arriving += surcharge[: len(stage)]
        rests = _without_blocked(road_map, moving, first_step + k, stage, arriving, goal_node)
        move = arriving.argmin(axis=1)
        best = arriving[np.arange(len(stage)), move] + penalty_s[k, stage]
        at_goal = np.nonzero(stage == goal_node)[0]
        rest = cost[goal_node] + penalty_s[k, goal_node]
        if rests and at_goal.size and rest <= best[at_goal[0]]:
            best[at_goal[0]] = rest
            move[at_goal[0]] = stay
        cost = np.full(count + 1, np.inf)
        cost[stage] = best
        came_by.append(move)
        stages.append(stage)

    total = cost[:count] + terminal_cost_s
    end = int(np.argmin(total))
    if not np.isfinite(total[end]):
        return None
    nodes = np.empty(horizon, dtype=np.intp)
    nodes[-1] = end
    for k in range(horizon - 2, -1, -1):
        row = int(np.nonzero(stages[k] == nodes[k + 1])[0][0])
        nodes[k] = road_map.sources[nodes[k + 1], came_by[k][row]]
    return LatticePath(nodes=nodes, cost_s=float(total[end]))


def _without_blocked(
    road_map: RoadMap,
    moving: MovingDiscs,
    step: int,
    stage: NDArray[np.intp],
    arriving: NDArray[np.float64],
    goal_node: int,
) -> bool:
    """Close the moves to the nodes of a stage that come too near to what moves, in one step.

    Returns whether the robot may rest at the goal during the step.
    """
    if not len(moving):
        return True
    place = road_map.lattice
    window = slice(0, place.shape[0]), slice(0, place.shape[1])
    rows, columns, blocked = MovingMoves(place, moving).hindered(step, *window)
    nodes = road_map.number[rows, columns]
    at = np.full(len(road_map.nodes_m) + 1, -1, dtype=np.intp)
    at[stage] = np.arange(len(stage))
    # A node that is not free has the number -1, which is the last place.
    row = at[nodes]
    arriving[row[row >= 0]] = np.where(blocked.T[row >= 0], np.inf, arriving[row[row >= 0]])
    nodes_m = road_map.nodes_m
    goal = nodes_m[[goal_node]]
    return bool(steps_apart(moving, step, goal, goal)[0])


def retime(
    start_m: NDArray[np.float64],  # (2,) where the robot is
    path_m: NDArray[np.float64],  # (N, 2) its path; where it stands still at its end it has arrived
    beyond_m: NDArray[np.float64],  # (b, 2)
    step_m: float,
) -> NDArray[np.float64]:
    """Sample the way of a path anew, N places `step_m` apart."""
    # Shapes: returns (N, 2).
    horizon = len(path_m)
    arrived = horizon > 1 and bool((path_m[-1] == path_m[-2]).all())
    way = np.vstack([start_m, path_m] if arrived else [start_m, path_m, beyond_m])
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    way = way[np.concatenate([[True], lengths > 0.0])]
    travelled = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
    total = float(travelled[-1])
    if total == 0.0:
        return path_m
    # A lattice path of n longest moves is n steps long but for rounding, and takes n steps.
    steps = max(int(np.ceil((total - REACH_TOLERANCE_M) / step_m)), 1)
    if steps <= horizon:
        step_m = total / steps
    stops = np.minimum(step_m * np.arange(1, horizon + 1), total)
    return np.stack(
        [np.interp(stops, travelled, way[:, 0]), np.interp(stops, travelled, way[:, 1])], axis=1
    )
