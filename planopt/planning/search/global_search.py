"""Initial guess of a plan to a goal: the cheapest lattice path at the outage price.

For a connectivity rule over several steps, searches with guides propose paths. The cheapest one
that satisfies the rule is returned, unless its progress is less than half of the cheapest path's: a
robot that satisfies the rule by waiting would never arrive.
"""

from dataclasses import dataclass, replace

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.kriging import bound_margin_db, connection_probability
from planopt.planning.plan import History, Pivot
from planopt.planning.scene import Scene, first_moves
from planopt.planning.search.lattice_search import first_steps_apart, move_table, search_cheapest
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.search.timed_search import (
    TimedCosts,
    TimedPath,
    search_room,
    search_timed,
    timed_places,
)
from planopt.planning.tolerances import MARGIN_PAD_DB, STANDSTILL_M, STEP_PAD_M
from planopt.planning.values.context import StepContext
from planopt.planning.values.objective_value import Guide, find_guided, rule_missing, step_rows
from planopt.problems.problem import Problem, charged_length_m, rate_s_m, steps_cost_s
from planopt.world.clearance import is_clear, swept_clearance_m
from planopt.world.lattice import CostToGo, lattice_paths, node_at, route_from
from planopt.world.motion import MovingDiscs

FORBIDDEN = 1e6  # Cost of a metre that violates a hard constraint; it exceeds the cost of any path
STAGNANT_STEPS = 0.75
"""Minimum distance from the robot, in longest steps, for a path to count as progress."""
LEAST_PROGRESS = 0.5
"""Minimum progress of a path that satisfies a rule, relative to the cheapest path."""
OUT_OF_BOUND_STEP_S = 1e5
"""Penalty in seconds of a step below a guide's level; it exceeds any time that can be saved."""
MISSING_DB_S = 1e3
"""Penalty in seconds per missing dB, which ranks paths with equally many steps below the level."""
BACK_STEPS = 10  # Number of longest steps by which a plan may usually increase the cost-to-go
CORRECTION_ROUNDS = 8
"""Maximum number of searches, each with corrected predictions along the last path."""


@dataclass(frozen=True)
class GlobalStart:
    """Initial guess of a plan to a goal, with its route and costs."""

    nodes: Indices  # (N,) lattice nodes
    path_m: Floats  # (N, 2) positions of the nodes
    margin_db: Floats  # (N,) connectivity margins of the nodes
    route_m: Floats  # (r, 2) route from its end to the goal
    beyond_m: Floats  # (b, 2) first part of the route: connected and reachable in N steps
    cost_to_go: CostToGo  # Cost-to-go of all nodes, in metres; infinite where it was not computed
    metre_cost: Floats  # (n,) cost per metre at every node
    is_blocked: bool  # Whether path or route violates a hard constraint
    is_direct: bool = False  # True if the path is released unrefined because the run has wandered
    # True if the path is released unrefined because it avoids other robots' paths
    gives_way: bool = False


class GlobalSearch:
    """Search for initial guesses of plans to a goal; it caches the predicted channel map."""

    def __init__(self, problem: Problem, scene: Scene, others: int = 0) -> None:
        self._problem = problem
        self._scene = scene
        constraints = problem.constraints
        threshold = problem.stations[0].threshold_dbm
        everywhere = problem.reach.charges_everywhere
        self.margins = NodeMargins(scene.road_map, threshold, constraints.p_min, everywhere)
        self._rate = rate_s_m(problem)
        rule = constraints.rule
        start = np.asarray(problem.robots[0].start_m, dtype=np.float64)
        nodes, lengths = first_moves(scene, problem, start)
        self._direct_m = float((lengths + scene.cost_to_go.cost_m[nodes]).min(initial=np.inf))
        self._forbids = rule.every_step and rule.slack_max_db is not None
        self._is_alone = (
            rule.is_plain
            and not others
            and problem.robots[0].moves_freely
            and not problem.workspace.moving
        )
        self._here_m = np.inf
        self._table = move_table(scene.road_map.lattice)

    def find_start(self, context: StepContext) -> GlobalStart | None:
        """Return the initial guess from the robot's position; None if no node is reachable."""
        problem, scene = self._problem, self._scene
        self.margins.refresh(context.law, context.power)
        cost_to_go = scene.cost_to_go
        if self._has_wandered(context.history):
            nodes = self._shortest(context, cost_to_go)
            return None if nodes is None else self._start(context, cost_to_go, nodes, direct=True)
        if problem.reach.cost_to_go == "connected":
            cost_to_go = self._cost_to_go_from(context.position_m)
        nodes = self._cheapest(context, cost_to_go, None, priced=True)
        if nodes is None:
            return None
        if self._gets_nowhere(context, nodes):
            # The fastest path around obstacles ignores the outage price.
            nodes = self._cheapest(
                context, cost_to_go, None, priced=self._forbids, effort_s2_m2=0.0
            )
            if nodes is None:
                return None
        if not problem.constraints.rule.every_step:
            nodes = self._within_rule(context, cost_to_go, nodes)
        return self._start(context, cost_to_go, nodes)

    def clear_course(
        self, position_m: Floats, start: GlobalStart, discs: MovingDiscs
    ) -> tuple[GlobalStart, Floats, TimedPath] | None:
        """Return a timed path to the goal that avoids moving discs; None if there is none."""
        # Shapes: position_m (2,).
        problem, scene = self._problem, self._scene
        nodes, lengths = first_moves(scene, problem, position_m)
        _, here = self.margins.at(position_m[None])
        price = 0.0 if start.is_direct else problem.reach.outage_price
        metre_cost = np.append(start.metre_cost, 1.0 + price * float(here[0]))
        costs = TimedCosts(
            scene.road_map,
            start.cost_to_go,
            scene.goal_node,
            problem.planner.step_s,
            problem.step_length_m - STEP_PAD_M,
            problem.reach.effort_weight_s2_m2,
            self._rate,
            self._rate * (metre_cost - 1.0),
        )
        found = search_timed(costs, position_m, nodes, lengths, discs, problem.planner.horizon)
        return None if found is None else self._given(position_m, start, found, discs.steps)

    def refuge_course(
        self, position_m: Floats, start: GlobalStart, others_m: Floats, steps: int
    ) -> tuple[GlobalStart, Floats, TimedPath] | None:
        """Return a timed path to a refuge away from `others_m` (k, 2); None if there is none."""
        problem, scene = self._problem, self._scene
        found = search_room(
            scene.road_map,
            *first_moves(scene, problem, position_m),
            others_m,
            problem.constraints.separation_m,
            problem.planner.horizon,
        )
        return None if found is None else self._given(position_m, start, found, steps)

    def _given(
        self, position_m: Floats, start: GlobalStart, found: TimedPath, steps: int
    ) -> tuple[GlobalStart, Floats, TimedPath]:
        """Return the initial guess along a timed path, the path's positions, and the path."""
        problem, places = self._problem, self._scene.road_map.nodes_m
        horizon = problem.planner.horizon
        first = found.nodes[:horizon]
        self.margins.correct(first)
        path = np.vstack([position_m, places[found.nodes]])
        given = replace(
            start,
            nodes=first,
            path_m=places[first],
            margin_db=self.margins.margin_db[first],
            route_m=places[np.concatenate([found.nodes[horizon:], found.route])],
            beyond_m=np.zeros((0, 2)),
            gives_way=True,
        )
        step_m = problem.step_length_m - STEP_PAD_M
        return given, timed_places(path, places[found.route], step_m, steps), found

    def _has_wandered(self, history: History) -> bool:
        """Return whether the robot has circled or driven too far to keep searching for contact."""
        # Out of contact throughout, the shortest path costs `1 + outage_price` times its length. A
        # robot that has driven this far takes the shortest path, so that its run is at most `3 + 2
        # outage_price` times as long as that path.
        if self._forbids:
            return False
        allowed = (1.0 + self._problem.reach.outage_price) * self._direct_m
        return history.has_circled or history.steps * self._problem.step_length_m > allowed

    def _cost_to_go_from(self, position_m: Floats) -> CostToGo:
        """Return the cost-to-go of nodes up to a limit above the cost-to-go at the robot."""
        # The radius follows from the cost-to-go one step ago; if too small, all nodes count.
        scene, metre_cost = self._scene, self._metre_cost()
        node = node_at(scene.road_map, position_m)
        back_m = BACK_STEPS * self._problem.step_length_m
        limit_m = self._here_m + 2.0 * back_m
        cost_to_go = lattice_paths(scene.road_map, scene.goal_node, metre_cost, limit_m=limit_m)
        here_m = float(cost_to_go.cost_m[node]) if node >= 0 else np.inf
        if here_m + back_m > limit_m:
            cost_to_go = lattice_paths(scene.road_map, scene.goal_node, metre_cost)
            here_m = float(cost_to_go.cost_m[node]) if node >= 0 else np.inf
        self._here_m = here_m if self._is_alone else np.inf
        return cost_to_go

    def _metre_cost(self) -> Floats:
        """Return the cost per metre at every lattice node, including outage."""
        charged = 1.0 + self._problem.reach.outage_price * self.margins.outage_share
        return np.where(self.margins.outside, FORBIDDEN, charged) if self._forbids else charged

    def _within_rule(
        self, context: StepContext, cost_to_go: CostToGo, cheapest: Indices
    ) -> Indices:
        """Return the nodes (N,) of the cheapest path with enough progress that meets the rule."""
        # Without one, return `cheapest`. With a slack limit, the rule has priority over progress.
        found: dict[bytes, Indices] = {}
        places = self._scene.road_map.nodes_m

        def search(guide: Guide) -> list[Floats]:
            nodes = self._cheapest(context, cost_to_go, guide, priced=True)
            if nodes is None:
                return []
            path = places[nodes]
            found[path.tobytes()] = nodes
            return [path]

        found[places[cheapest].tobytes()] = cheapest
        find_guided(context, search, lambda path: rule_missing(context, path) == 0.0)
        all_nodes = list(found.values())
        missing = [round(rule_missing(context, places[nodes]), 2) for nodes in all_nodes]
        costs = [self._cost_s(context, cost_to_go, nodes) for nodes in all_nodes]
        order = sorted(range(len(costs)), key=lambda k: (missing[k], costs[k]))
        if self._problem.constraints.rule.slack_max_db is not None:
            return all_nodes[order[0]]
        joined, lengths = first_moves(self._scene, self._problem, context.position_m)
        begin = float((lengths + cost_to_go.cost_m[joined]).min())
        least = LEAST_PROGRESS * (begin - cost_to_go.cost_m[cheapest[-1]])
        for k in order:
            if begin - cost_to_go.cost_m[all_nodes[k][-1]] >= least:
                return all_nodes[k]
        return cheapest

    def _cost_s(self, context: StepContext, cost_to_go: CostToGo, nodes: Indices) -> float:
        """Return the cost in seconds of a path and of the route from its end."""
        problem, road_map = self._problem, self._scene.road_map
        places = np.vstack([context.position_m, road_map.nodes_m[nodes]])
        cost = steps_cost_s(problem, places)
        _, here = self.margins.at(context.position_m[None])
        share = np.concatenate([here, self.margins.outage_share[nodes]])
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        charged = problem.reach.outage_price * charged_length_m(lengths, share)
        return cost + self._rate * (charged + float(cost_to_go.cost_m[nodes[-1]]))

    def _shortest(self, context: StepContext, cost_to_go: CostToGo) -> Indices | None:
        """Return the nodes (N,) of the shortest path to the goal; None if there is no path."""
        places, position = self._scene.road_map.nodes_m, context.position_m
        fastest = self._cheapest(context, cost_to_go, None, priced=False, effort_s2_m2=0.0)
        if fastest is None:
            return None
        joined, lengths = first_moves(self._scene, self._problem, position)
        ahead = lengths + cost_to_go.cost_m[joined]
        legs = np.linalg.norm(np.diff(np.vstack([position, places[fastest]]), axis=0), axis=1)
        if float(legs.sum() + cost_to_go.cost_m[fastest[-1]]) <= float(ahead.min()) + STANDSTILL_M:
            return fastest
        first = int(np.argmin(ahead))
        nodes = route_from(self._scene.road_map, cost_to_go, int(joined[first]), np.inf)
        if lengths[first] <= STANDSTILL_M and len(nodes) > 1:
            nodes = nodes[1:]
        horizon = self._problem.planner.horizon
        return np.append(nodes, np.full(horizon, nodes[-1]))[:horizon]

    def _gets_nowhere(self, context: StepContext, nodes: Indices) -> bool:
        """Return whether a path neither reaches the goal nor leaves the robot's neighbourhood."""
        places = self._scene.road_map.nodes_m[nodes]
        farthest = np.linalg.norm(places - context.position_m, axis=1).max()
        at_goal = int(nodes[-1]) == self._scene.goal_node
        return not at_goal and bool(farthest <= STAGNANT_STEPS * self._problem.step_length_m)

    def _cheapest(
        self,
        context: StepContext,
        cost_to_go: CostToGo,
        guide: Guide | None,
        *,
        priced: bool,
        effort_s2_m2: float | None = None,
    ) -> Indices | None:
        """Return the nodes (N,) of the path that is cheapest by corrected predictions, or None."""
        # `effort_s2_m2` replaces the problem's effort weight.
        if effort_s2_m2 is None:
            effort_s2_m2 = self._problem.reach.effort_weight_s2_m2
        problem, scene, margins = self._problem, self._scene, self.margins
        moving: MovingDiscs = context.moving
        places = scene.road_map.nodes_m
        first_nodes, first_lengths = first_moves(scene, problem, context.position_m)
        kept = first_steps_apart(moving, context.position_m, places[first_nodes])
        first_nodes, first_lengths = first_nodes[kept], first_lengths[kept]
        margin_here, share_here = margins.at(context.position_m[None])
        here = problem.reach.outage_price * share_here
        if self._forbids:
            here = np.where(margin_here < 0.0, FORBIDDEN, here)
        nodes: Indices | None = None
        for _ in range(CORRECTION_ROUNDS):
            surcharge = self._rate * np.concatenate([self._metre_cost() - 1.0, here])
            nodes = search_cheapest(
                scene.road_map,
                self._table,
                first_nodes,
                first_lengths,
                problem.planner.horizon,
                problem.planner.step_s,
                effort_s2_m2,
                scene.goal_node,
                np.zeros(len(places)) if guide is None else self._penalty_s(guide),
                self._rate * cost_to_go.cost_m,
                surcharge if priced else None,
                moving,
            )
            if nodes is None:
                return None
            if not margins.correct(nodes):
                break
        return nodes

    def _penalty_s(self, guide: Guide) -> Floats:
        """Return a guide's penalties (N, n) in seconds for ending each step at each node."""
        margins, threshold = self.margins, self._problem.stations[0].threshold_dbm
        penalty = np.zeros((len(guide.bounded), len(margins.mean_db)))
        if guide.bounded.any():
            margin = bound_margin_db(margins.mean_db, margins.deviation_db, threshold, guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            below = np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing
            penalty[guide.bounded] = below
        if guide.credit.any():
            chance = connection_probability(margins.mean_db, margins.deviation_db, threshold)
            step_s = self._rate * self._problem.step_length_m
            penalty -= step_s * guide.credit[:, None] * chance
        return penalty

    def _start(
        self, context: StepContext, cost_to_go: CostToGo, nodes: Indices, *, direct: bool = False
    ) -> GlobalStart:
        """Return the initial guess along lattice nodes, with its route and margins."""
        problem, road_map = self._problem, self._scene.road_map
        route = route_from(road_map, cost_to_go, int(nodes[-1]), np.inf)
        soon = route_from(
            road_map, cost_to_go, int(nodes[-1]), problem.planner.horizon * problem.step_length_m
        )
        margin = self.margins.margin_db[nodes]
        outside = self.margins.outside
        if problem.constraints.rule.is_plain:
            below = np.nonzero(outside[soon])[0]
            soon = soon[1 : below[0]] if below.size else soon[1:]
        else:
            path = road_map.nodes_m[nodes]
            margin = step_rows(context, path).margins_db(context.predicted(path))
            soon = soon[1:]
        return GlobalStart(
            nodes=nodes,
            path_m=road_map.nodes_m[nodes],
            margin_db=margin,
            route_m=road_map.nodes_m[route[1:]],
            beyond_m=road_map.nodes_m[soon],
            cost_to_go=cost_to_go,
            metre_cost=np.ones(len(outside))
            if cost_to_go is self._scene.cost_to_go
            else self._metre_cost(),
            is_blocked=self._forbids and bool(outside[nodes].any() or outside[route].any()),
            is_direct=direct,
        )


LOOKAHEAD_STEPS = 5.0  # Length of the route that is searched for a pivot, in longest steps
LATTICE_DETOUR = 0.03  # Largest relative detour of a lattice path (16 headings: 2.7 %)


class Ahead:
    """Route beyond a path's end, represented by a terminal waypoint (pivot)."""

    def __init__(
        self, problem: Problem, scene: Scene, start: GlobalStart, node_margin_db: Floats | None
    ) -> None:
        self._problem = problem
        self._scene = scene
        self._start = start
        self._is_complete = False
        self._node_margin_db = node_margin_db
        self.pivot = self._seen_from(int(start.nodes[-1]), None)
        # The ends of lattice, refined and released path are evaluated repeatedly.
        self._joins: dict[bytes, tuple[int, float, float] | None] = {}
        self._pivots: dict[bytes, Pivot] = {}

    def __call__(self, end_m: Floats) -> Pivot:
        """Return the pivot if it is visible from `end_m` (2,) and cheapest, else a nearby node."""
        key = end_m.tobytes()
        if key not in self._pivots:
            self._pivots[key] = self._cheaper(end_m)
        return self._pivots[key]

    def _cheaper(self, end_m: Floats) -> Pivot:
        problem, pivot = self._problem, self.pivot
        joined = self._joined(end_m)
        if joined is None:
            return pivot
        node, cost_m, metre = joined
        to_pivot = float(np.linalg.norm(pivot.position_m - end_m))
        from_end = float(np.linalg.norm(self._start.path_m[-1] - end_m))
        seen = swept_clearance_m(self._scene.index, np.stack([end_m, pivot.position_m]))
        is_seen = to_pivot == 0.0 or (
            from_end <= problem.step_length_m
            and bool(is_clear(seen, problem.constraints.clearance_m)[0])
        )
        if is_seen and to_pivot * pivot.metre_cost + pivot.cost_m <= cost_m:
            return pivot
        place = self._scene.road_map.nodes_m[node]
        return Pivot(place, float(self._start.cost_to_go.cost_m[node]), metre)

    def leading(self, end_m: Floats) -> Pivot:
        """Return, for the route from `end_m` (2,), a pivot that is out of reach within N steps."""
        # With a reachable pivot, a solver could postpone the departure.
        joined = self._joined(end_m)
        return self.pivot if joined is None else self._seen_from(joined[0], end_m)

    def route_m(self, end_m: Floats) -> Floats:
        """Return the cheapest route (r, 2) over the lattice from `end_m` (2,) to the goal."""
        joined, road_map = self._joined(end_m), self._scene.road_map
        if joined is None:
            return self._start.route_m
        route = road_map.nodes_m[route_from(road_map, self._start.cost_to_go, joined[0], np.inf)]
        return route[1:] if np.array_equal(route[0], end_m) else route

    def _joined(self, end_m: Floats) -> tuple[int, float, float] | None:
        """Return the cheapest node within a step of `end_m`, its total and metre cost, or None."""
        key = end_m.tobytes()
        if key not in self._joins:
            self._joins[key] = self._join(end_m)
        return self._joins[key]

    def _join(self, end_m: Floats) -> tuple[int, float, float] | None:
        start = self._start
        nodes, lengths = first_moves(self._scene, self._problem, end_m)
        if not len(nodes):
            return None
        metre = start.metre_cost[nodes]
        metre = 0.5 * (metre + metre[np.argmin(lengths)])
        total = lengths * metre + start.cost_to_go.cost_m[nodes]
        best = int(np.argmin(total))
        if not np.isfinite(total[best]) and not self._is_complete:
            # The search did not expand these nodes.
            cost_to_go = lattice_paths(
                self._scene.road_map, self._scene.goal_node, start.metre_cost
            )
            self._start, self._is_complete = replace(start, cost_to_go=cost_to_go), True
            return self._join(end_m)
        return int(nodes[best]), float(total[best]), float(metre[best])

    def _seen_from(self, node: int, origin_m: Floats | None) -> Pivot:
        problem = self._problem
        return find_pivot(
            self._scene,
            replace(self._start, nodes=np.append(self._start.nodes[:-1], node)),
            self._node_margin_db,
            problem.step_length_m,
            problem.constraints.clearance_m,
            origin_m,
        )


def find_pivot(
    scene: Scene,
    start: GlobalStart,
    node_margin_db: Floats | None,
    step_length_m: float,
    clearance: float,
    origin_m: Floats | None = None,  # (2,)
) -> Pivot:
    """Return the farthest visible route point or, if reachable by the path, a point beyond it."""
    end = int(start.nodes[-1])
    route = route_from(scene.road_map, start.cost_to_go, end, LOOKAHEAD_STEPS * step_length_m)
    places = scene.road_map.nodes_m[route]
    origin = places[0] if origin_m is None else origin_m
    chosen = 0
    if len(route) > 1:
        # Segments from one origin as one path: origin, p1, origin, p2, ...
        fan = np.empty((2 * (len(route) - 1) + 1, 2))
        fan[0::2] = origin
        fan[1::2] = places[1:]
        seen = is_clear(swept_clearance_m(scene.index, fan)[0::2], clearance)
        farthest_seen = int(np.argmin(seen)) if not seen.all() else len(seen)
        if node_margin_db is not None:
            within = node_margin_db[route] >= MARGIN_PAD_DB
            changed = np.nonzero(within != within[0])[0]
            farthest_seen = min(farthest_seen, int(changed[0]) - 1 if changed.size else len(route))
        ahead = np.linalg.norm(places - origin, axis=1)
        room = LATTICE_DETOUR * len(start.nodes) * step_length_m
        enough = int(np.argmax(ahead >= room)) if ahead.max() >= room else len(ahead) - 1
        chosen = max(farthest_seen, enough)
    cost_m = start.cost_to_go.cost_m
    straight = float(np.linalg.norm(places[chosen] - origin))
    # At the guess's end, the cost via the pivot equals the cost via the lattice.
    joining = float(np.linalg.norm(places[0] - origin)) * float(start.metre_cost[end])
    saved = joining + float(cost_m[end] - cost_m[route[chosen]])
    metre_cost = saved / straight if straight else float(start.metre_cost[end])
    return Pivot(places[chosen], float(cost_m[route[chosen]]), max(metre_cost, 1.0))
