"""Search for a lattice path to a goal in space and time, among other robots.

Based on the cost-to-go without other robots, the search prunes paths that exceed the lowest cost by
`DELAYS_STEPS` of waiting. It ends as soon as the shortest route from a promising node is free.
"""

from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.neighbours import PlaceTree
from planopt.planning.search.lattice_search import steps_apart
from planopt.planning.tolerances import CLEARANCE_PAD_M, STANDSTILL_M
from planopt.problems.problem import step_cost_s
from planopt.world.lattice import CostToGo, RoadMap, lattice_paths, route_from
from planopt.world.motion import MovingDiscs, closest_approach_m

DELAYS_STEPS = (16, 64, 200)  # Allowed delays in waiting steps, tried in this order
MOST_PLACES = 12_000  # Maximum number of nodes per stage, lowest cost first
ROUTES_TESTED = 4  # Number of routes tested in each stage, from the nodes of lowest cost


@dataclass(frozen=True, eq=False)
class TimedCosts:
    """Lattice with a goal, and costs of motion on the lattice."""

    road_map: RoadMap  # Lattice, its cost-to-go without other robots, goal
    cost_to_go: CostToGo
    goal_node: int
    step_s: float  # Duration and maximum length of a step, effort weight
    step_m: float
    effort_s2_m2: float
    rate_s_m: float  # Cost per metre of the cost-to-go
    surcharge_s_m: Floats  # (n + 1,) additional cost per metre at each node and, last, at the robot


def timed_places(places_m: Floats, route_m: Floats, step_m: float, steps: int) -> Floats:
    """Return positions by step: along a path, then along a route at full speed, then waiting."""
    # Shapes: places_m (k + 1, 2); route_m (r, 2).
    route = np.vstack([places_m[-1:], route_m])
    driven = np.concatenate([[0.0], np.linalg.norm(np.diff(route, axis=0), axis=1).cumsum()])
    stops = step_m * np.arange(1, steps + 2 - len(places_m))
    # np.interp stays at the last position beyond the end of the route.
    on = np.stack([np.interp(stops, driven, route[:, axis]) for axis in (0, 1)], axis=1)
    return np.vstack([places_m, on])[: steps + 1]


def is_apart(discs: MovingDiscs, places_m: Floats, first: int = 0) -> bool:
    """Return whether a timed path avoids all moving discs; its first step may leave a disc."""
    # Shapes: places_m (T - first + 1, 2).
    if not len(discs):
        return True
    centres, least = discs.centres_m[:, first:], discs.apart_m[:, first:]
    gaps = closest_approach_m(places_m[:-1], places_m[1:], centres[:, :-1], centres[:, 1:]) - least
    wanted = np.full(gaps.shape, CLEARANCE_PAD_M)
    if first == 0:
        here = np.linalg.norm(places_m[0] - centres[:, 0], axis=1) - least[:, 0]
        wanted[:, 0] = np.minimum(CLEARANCE_PAD_M, here)
    return bool((gaps >= wanted).all())


@dataclass(frozen=True, eq=False)
class TimedPath:
    """Timed path to a goal or a refuge that avoids other robots."""

    nodes: Indices  # (k,) after each step
    # (r,) nodes of the route to the goal at full speed; empty if the path does not arrive
    route: Indices
    cost_s: float  # Total cost in seconds
    arrives: bool = True  # Whether the path ends at the goal, not at a refuge


def search_timed(
    costs: TimedCosts,
    position_m: Floats,  # (2,) position of the robot
    first_nodes: Indices,
    first_length_m: Floats,
    discs: MovingDiscs,
    least_stages: int,
) -> TimedPath | None:
    """Return a cheap path to the goal that avoids all discs, also after arrival, or None."""
    kept = steps_apart(
        discs,
        0,
        np.broadcast_to(position_m, (len(first_nodes), 2)),
        costs.road_map.nodes_m[first_nodes],
    )
    nodes, lengths = first_nodes[kept], first_length_m[kept]
    half = 0.5 * costs.surcharge_s_m
    cost = step_cost_s(lengths, costs.step_s, costs.effort_s2_m2) + lengths * (
        half[nodes] + half[-1]
    )
    to_go = costs.rate_s_m * costs.cost_to_go.cost_m
    least = float((cost + to_go[nodes]).min(initial=np.inf))
    aside: TimedPath | None = None
    for delay in DELAYS_STEPS:
        limit = least + delay * costs.step_s
        found = _search_within(costs, nodes, cost, discs, least_stages, limit)
        if found is not None and found.arrives:
            return found
        aside = aside or found
    return aside


def search_room(
    road_map: RoadMap,
    first_nodes: Indices,
    first_length_m: Floats,
    others_m: Floats,  # (k, 2) positions on the others' paths, at any time
    least_m: float,
    least_stages: int,
) -> TimedPath | None:
    """Return the shortest path to a refuge away from the other robots' paths, or None."""
    if not len(first_nodes):
        return None
    here = int(first_nodes[np.argmin(first_length_m)])
    cost_to_go = lattice_paths(road_map, here)
    away = PlaceTree(others_m).nearest(road_map.nodes_m, 1)[1][:, 0]
    longest = float(road_map.lengths_m.max())
    cost = np.where(away >= np.hypot(least_m + CLEARANCE_PAD_M, longest), cost_to_go.cost_m, np.inf)
    room = int(np.argmin(cost))
    if not np.isfinite(cost[room]):
        return None
    nodes = route_from(road_map, cost_to_go, room, np.inf)[::-1]
    # A robot already at a node would postpone its departure forever.
    nodes = nodes[1:] if len(nodes) > 1 and first_length_m.min() <= STANDSTILL_M else nodes
    waits = np.repeat(nodes[-1:], max(least_stages - len(nodes), 0))
    return TimedPath(np.concatenate([nodes, waits]), nodes[:0], float(cost[room]), False)


def _search_within(
    costs: TimedCosts,
    nodes: Indices,
    cost: Floats,
    discs: MovingDiscs,
    least_stages: int,
    limit_s: float,
) -> TimedPath | None:
    """Return the best path from `nodes` (m,) with a cost of at most `limit_s`, or None."""
    # Once all other robots have stopped, a static search completes the search in space and time.
    to_go = costs.rate_s_m * costs.cost_to_go.cost_m
    stages: list[tuple[Indices, Indices]] = [(nodes, np.zeros(len(nodes), dtype=np.intp))]
    moved = (np.abs(np.diff(discs.centres_m, axis=1)) > 0.0).any(axis=(0, 2))
    last = max(least_stages, int(np.flatnonzero(moved).max(initial=0)) + 1)
    aside: TimedPath | None = None
    for k in range(1, last + 1):
        if not len(nodes):
            return aside
        if k >= least_stages:
            for row in np.argsort(cost + to_go[nodes], kind="stable")[:ROUTES_TESTED]:
                route = route_from(costs.road_map, costs.cost_to_go, int(nodes[row]), np.inf)
                if _is_free(costs, discs, k, route):
                    total = float(cost[row] + to_go[nodes[row]])
                    return TimedPath(_nodes_to(stages, int(row)), route[1:], total)
                if aside is None and _is_free(costs, discs, k, route[:1]):
                    waiting = float(cost[row] + to_go[nodes[row]])
                    aside = TimedPath(_nodes_to(stages, int(row)), route[:0], waiting, False)
        if k < last:
            nodes, cost, came = _next_stage(costs, nodes, cost, discs, k, limit_s)
            stages.append((nodes, came))
    cost_to_go = _cost_to_go_past_standing(costs, discs)
    total = cost + costs.rate_s_m * cost_to_go.cost_m[nodes]
    row = int(np.argmin(total))
    if not np.isfinite(total[row]):
        return aside
    route = route_from(costs.road_map, cost_to_go, int(nodes[row]), np.inf)
    if not _is_free(costs, discs, last, route):
        return aside
    return TimedPath(_nodes_to(stages, row), route[1:], float(total[row]))


def _is_free(costs: TimedCosts, discs: MovingDiscs, step: int, route: Indices) -> bool:
    """Return whether driving along `route` (r,) after `step` steps avoids all discs."""
    route_m = costs.road_map.nodes_m[route]
    on = timed_places(route_m[:1], route_m[1:], costs.step_m, discs.steps - step)
    return is_apart(discs, on, step)


def _cost_to_go_past_standing(costs: TimedCosts, discs: MovingDiscs) -> CostToGo:
    """Return the cost-to-go on paths that avoid the final positions of the other robots."""
    # Nodes near a disc are blocked, so that no move between other nodes violates the separation.
    road_map = costs.road_map
    factor = 1.0 + costs.surcharge_s_m[:-1] / costs.rate_s_m
    if len(discs):
        longest = float(road_map.lengths_m.max())
        least = np.hypot(np.maximum(discs.apart_m[:, -1], 0.0) + CLEARANCE_PAD_M, 0.5 * longest)
        away = np.linalg.norm(road_map.nodes_m - discs.centres_m[:, -1:], axis=2)
        factor = np.where((away < least[:, None]).any(axis=0), np.inf, factor)
    return lattice_paths(road_map, costs.goal_node, factor)


def _next_stage(
    costs: TimedCosts, nodes: Indices, cost: Floats, discs: MovingDiscs, step: int, limit_s: float
) -> tuple[Indices, Floats, Indices]:
    """Return the nodes reachable from nodes (m,) in one step, their costs and predecessors."""
    # A node's successors equal its predecessors, since lattice moves are symmetric.
    road_map, count = costs.road_map, len(costs.road_map.nodes_m)
    half, to_go = 0.5 * costs.surcharge_s_m, costs.rate_s_m * costs.cost_to_go.cost_m
    targets = road_map.sources[nodes]
    lengths = road_map.lengths_m
    arriving = cost[:, None] + step_cost_s(lengths, costs.step_s, costs.effort_s2_m2)
    arriving = np.where(
        (nodes == costs.goal_node)[:, None] & (targets == costs.goal_node), cost[:, None], arriving
    )
    open_moves = targets < count
    ends = np.where(open_moves, targets, 0)
    arriving = arriving + lengths * (half[nodes][:, None] + half[ends])
    row, move = np.nonzero(open_moves & (arriving + to_go[ends] <= limit_s))
    end, value = ends[row, move], arriving[row, move]
    places = road_map.nodes_m
    if len(discs):
        # Only nodes near a disc need the exact test.
        away = np.linalg.norm(places[nodes][None] - discs.centres_m[:, step, None], axis=2)
        driven = np.linalg.norm(discs.centres_m[:, step + 1] - discs.centres_m[:, step], axis=1)
        reach = discs.apart_m[:, step] + driven + costs.step_m + CLEARANCE_PAD_M
        near = (away <= reach[:, None]).any(axis=0)[row]
        kept = np.ones(len(row), dtype=np.bool_)
        kept[near] = steps_apart(discs, step, places[nodes[row[near]]], places[end[near]])
        row, end, value = row[kept], end[kept], value[kept]
    order = np.lexsort((value, end))
    row, end, value = row[order], end[order], value[order]
    first = np.append(True, end[1:] != end[:-1])[: len(end)]
    row, end, value = row[first], end[first], value[first]
    if len(end) > MOST_PLACES:
        best = np.argpartition(value + to_go[end], MOST_PLACES)[:MOST_PLACES]
        row, end, value = row[best], end[best], value[best]
    return end, value, row


def _nodes_to(stages: list[tuple[Indices, Indices]], row: int) -> Indices:
    """Return the nodes of a path, traced back from a row of the last stage."""
    path: list[int] = []
    for nodes, came in reversed(stages):
        path.append(int(nodes[row]))
        row = int(came[row])
    return np.asarray(path[::-1], dtype=np.intp)
