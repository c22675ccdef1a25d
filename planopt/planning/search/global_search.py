"""The global start of a plan to a goal: the cheapest lattice path at the outage price.

The cost-to-go is the length of the cheapest path to the goal, a metre counting
``1 + outage_price (1 - P)`` metres; the path of N steps is found by dynamic programming with the
same charges, so that both agree about every metre. A rule of connectivity over several steps is
searched for under guides (:class:`planopt.planning.values.rule_rows.Guide`); of the paths that
keep it the cheapest is taken, unless it comes less than half as near to the goal as the cheapest
path of all: a robot that keeps its rule by standing still would never arrive.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import bound_margin_db, connection_probability
from planopt.objectives.reach import charged_length_m, cost_rate_s_m, path_cost_s
from planopt.planning.free_space import node_at
from planopt.planning.history import History
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
from planopt.planning.values.objective_value import rule_missing
from planopt.planning.values.rule_rows import Guide, find_guided, step_rows
from planopt.problems.problem import Problem
from planopt.world.lattice import CostToGo, lattice_paths, route_from
from planopt.world.moving_discs import MovingDiscs

FORBIDDEN = 1e6
"""A metre below the bound costs this many where it must not be driven: more than any path."""
STAGNANT_STEPS = 0.75
"""A path that stays within this many longest steps of the robot gets nowhere; a lattice path can
only end on a node, so that even one that wants to stay moves a little."""
LEAST_PROGRESS = 0.5
"""A path that keeps a rule must come at least this share as near to the goal as the cheapest."""
OUT_OF_BOUND_STEP_S = 1e5
"""Penalty of a step below the level that a guide asks for: no saving of time is worth one."""
MISSING_DB_S = 1e3
"""Penalty of a missing dB: among as many steps below the level, the least missing dB wins."""
BACK_STEPS = 10
"""No plan ends where the way on costs more than from here by this many longest steps, unless others
or a rule make it. Nodes farther off than that need no cost-to-go."""
CORRECTION_ROUNDS = 8
"""How often the search is repeated with exact margins along its path."""


@dataclass(frozen=True)
class GlobalStart:
    """The initial guess of the refinement."""

    nodes: NDArray[np.intp]  # (N,) lattice nodes
    path_m: NDArray[np.float64]  # (N, 2) their places
    margin_db: NDArray[np.float64]  # (N,) connectivity margins there, of what is asked of each step
    route_m: NDArray[np.float64]  # (r, 2) the path beyond its end, to the goal
    # (b, 2) its beginning, as far as it keeps the bound and may be come to in N steps
    beyond_m: NDArray[np.float64]
    # Cost-to-go of the nodes, in metres; infinite at those that it was not looked for at
    ways: CostToGo
    metre_cost: NDArray[np.float64]  # (n,) what a metre costs at every node
    is_blocked: bool  # Whether path or route lead where driving is forbidden
    is_direct: bool = False  # Whether the robot is to drive this very path, having wandered enough
    # Whether it is to drive this very path, which keeps from those of other robots
    gives_way: bool = False


class GlobalSearch:
    """Finds start paths; keeps its map of the channel."""

    def __init__(self, problem: Problem, scene: Scene, others: int = 0) -> None:
        self._problem = problem
        self._scene = scene
        constraints = problem.constraints
        threshold = problem.stations[0].threshold_dbm
        everywhere = problem.reach.charges_everywhere
        self.margins = NodeMargins(scene.road_map, threshold, constraints.p_min, everywhere)
        self._rate = cost_rate_s_m(
            problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
        )
        rule = constraints.rule
        start = np.asarray(problem.robots[0].start_m, dtype=np.float64)
        nodes, lengths = first_moves(scene.ground, problem, start)
        self._direct_m = float((lengths + scene.ways.cost_m[nodes]).min(initial=np.inf))
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
        """Search from where the robot is; None if no node is in reach."""
        problem, scene = self._problem, self._scene
        self.margins.refresh(context.law, context.power)
        ways = scene.ways
        if self._has_wandered(context.history):
            nodes = self._shortest(context, ways)
            return None if nodes is None else self._start(context, ways, nodes, direct=True)
        if problem.reach.cost_to_go == "connected":
            ways = self._ways_from(context.position_m)
        nodes = self._cheapest(context, ways, None, priced=True)
        if nodes is None:
            return None
        if self._gets_nowhere(context, nodes):
            # The fastest path round the obstacles knows of no price, and leads on all the same.
            nodes = self._cheapest(context, ways, None, priced=self._forbids, effort_s2_m2=0.0)
            if nodes is None:
                return None
        if not problem.constraints.rule.every_step:
            nodes = self._within_rule(context, ways, nodes)
        return self._start(context, ways, nodes)

    def beside(
        self, position_m: NDArray[np.float64], start: GlobalStart, discs: MovingDiscs
    ) -> tuple[GlobalStart, NDArray[np.float64], TimedPath] | None:
        """Search a path to the goal that keeps from discs all the way; None if there is none."""
        # Shapes: position_m (2,).
        problem, scene = self._problem, self._scene
        nodes, lengths = first_moves(scene.ground, problem, position_m)
        _, here = self.margins.at(position_m[None])
        price = 0.0 if start.is_direct else problem.reach.outage_price
        metre_cost = np.append(start.metre_cost, 1.0 + price * float(here[0]))
        costs = TimedCosts(
            scene.road_map,
            start.ways,
            scene.goal_node,
            problem.planner.step_s,
            problem.step_length_m - STEP_PAD_M,
            problem.reach.effort_weight_s2_m2,
            self._rate,
            self._rate * (metre_cost - 1.0),
        )
        found = search_timed(costs, position_m, nodes, lengths, discs, problem.planner.horizon)
        return None if found is None else self._given(position_m, start, found, discs.steps)

    def aside(
        self,
        position_m: NDArray[np.float64],
        start: GlobalStart,
        others_m: NDArray[np.float64],
        steps: int,
    ) -> tuple[GlobalStart, NDArray[np.float64], TimedPath] | None:
        """Search a path off all places (k, 2) that others drive through; as :meth:`beside`."""
        problem, scene = self._problem, self._scene
        found = search_room(
            scene.road_map,
            *first_moves(scene.ground, problem, position_m),
            others_m,
            problem.constraints.separation_m,
            problem.planner.horizon,
        )
        return None if found is None else self._given(position_m, start, found, steps)

    def _given(
        self, position_m: NDArray[np.float64], start: GlobalStart, found: TimedPath, steps: int
    ) -> tuple[GlobalStart, NDArray[np.float64], TimedPath]:
        """Return the first steps of a path beside others, and where it leads over all `steps`."""
        problem, places = self._problem, self._scene.road_map.nodes_m
        horizon = problem.planner.horizon
        first = found.nodes[:horizon]
        self.margins.correct(first)
        way = np.vstack([position_m, places[found.nodes]])
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
        return given, timed_places(way, places[found.route], step_m, steps), found

    def _has_wandered(self, history: History) -> bool:
        """Return whether a run has gone in circles, or on for longer than the dearest direct path.

        The shortest path out of contact all the way costs ``1 + outage_price`` times its length. A
        robot that has driven for as long as that takes drives the shortest path from then on, and
        arrives: its run is at most ``3 + 2 outage_price`` times as long as the shortest path.
        """
        if self._forbids:
            return False
        allowed = (1.0 + self._problem.reach.outage_price) * self._direct_m
        return history.has_circled or history.steps * self._problem.step_length_m > allowed

    def _ways_from(self, position_m: NDArray[np.float64]) -> CostToGo:
        """Cheapest paths to the goal from where the robot is and from where it may plan to be.

        How far to look is guessed from the cost-to-go a step ago. Where that was too little, all
        paths are found.
        """
        scene, metre_cost = self._scene, self._metre_cost()
        node = node_at(scene.road_map, position_m)
        back_m = BACK_STEPS * self._problem.step_length_m
        limit_m = self._here_m + 2.0 * back_m
        ways = lattice_paths(scene.road_map, scene.goal_node, metre_cost, limit_m=limit_m)
        here_m = float(ways.cost_m[node]) if node >= 0 else np.inf
        if here_m + back_m > limit_m:
            ways = lattice_paths(scene.road_map, scene.goal_node, metre_cost)
            here_m = float(ways.cost_m[node]) if node >= 0 else np.inf
        self._here_m = here_m if self._is_alone else np.inf
        return ways

    def _metre_cost(self) -> NDArray[np.float64]:
        """Return the cost of a metre at every node, in metres."""
        charged = 1.0 + self._problem.reach.outage_price * self.margins.outage_share
        return np.where(self.margins.outside, FORBIDDEN, charged) if self._forbids else charged

    def _within_rule(
        self, context: StepContext, ways: CostToGo, cheapest: NDArray[np.intp]
    ) -> NDArray[np.intp]:
        """The cheapest path that keeps the rule and comes near enough to the goal; else nearer.

        Where slack is bounded, keeping the rule comes before coming near.
        """
        found: dict[bytes, NDArray[np.intp]] = {}
        places = self._scene.road_map.nodes_m

        def search(guide: Guide) -> list[NDArray[np.float64]]:
            nodes = self._cheapest(context, ways, guide, priced=True)
            if nodes is None:
                return []
            path = places[nodes]
            found[path.tobytes()] = nodes
            return [path]

        found[places[cheapest].tobytes()] = cheapest
        find_guided(context, search, lambda path: rule_missing(context, path) == 0.0)
        all_nodes = list(found.values())
        missing = [round(rule_missing(context, places[nodes]), 2) for nodes in all_nodes]
        costs = [self._cost_s(context, ways, nodes) for nodes in all_nodes]
        order = sorted(range(len(costs)), key=lambda k: (missing[k], costs[k]))
        if self._problem.constraints.rule.slack_max_db is not None:
            return all_nodes[order[0]]
        begin = self._nearest_cost_m(context, ways)
        least = LEAST_PROGRESS * (begin - ways.cost_m[cheapest[-1]])
        for k in order:
            if begin - ways.cost_m[all_nodes[k][-1]] >= least:
                return all_nodes[k]
        return cheapest

    def _nearest_cost_m(self, context: StepContext, ways: CostToGo) -> float:
        """Cost-to-go from where the robot is."""
        nodes, lengths = first_moves(self._scene.ground, self._problem, context.position_m)
        return float((lengths + ways.cost_m[nodes]).min())

    def _cost_s(self, context: StepContext, ways: CostToGo, nodes: NDArray[np.intp]) -> float:
        """Cost of a path and of the way on from its end."""
        problem, road_map = self._problem, self._scene.road_map
        places = np.vstack([context.position_m, road_map.nodes_m[nodes]])
        cost = path_cost_s(
            places,
            np.asarray(problem.goal_m),
            problem.constraints.goal_radius_m,
            problem.planner.step_s,
            problem.reach.effort_weight_s2_m2,
        )
        _, here = self.margins.at(context.position_m[None])
        share = np.concatenate([here, self.margins.outage_share[nodes]])
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        charged = problem.reach.outage_price * charged_length_m(lengths, share)
        return cost + self._rate * (charged + float(ways.cost_m[nodes[-1]]))

    def _shortest(self, context: StepContext, ways: CostToGo) -> NDArray[np.intp] | None:
        """Nodes (N,) of a shortest path: of the fastest one, if no path is shorter than it."""
        places, position = self._scene.road_map.nodes_m, context.position_m
        fastest = self._cheapest(context, ways, None, priced=False, effort_s2_m2=0.0)
        if fastest is None:
            return None
        joined, lengths = first_moves(self._scene.ground, self._problem, position)
        ahead = lengths + ways.cost_m[joined]
        legs = np.linalg.norm(np.diff(np.vstack([position, places[fastest]]), axis=0), axis=1)
        if float(legs.sum() + ways.cost_m[fastest[-1]]) <= float(ahead.min()) + STANDSTILL_M:
            return fastest
        first = int(np.argmin(ahead))
        nodes = route_from(self._scene.road_map, ways, int(joined[first]), np.inf)
        if lengths[first] <= STANDSTILL_M and len(nodes) > 1:
            nodes = nodes[1:]
        horizon = self._problem.planner.horizon
        return np.append(nodes, np.full(horizon, nodes[-1]))[:horizon]

    def _gets_nowhere(self, context: StepContext, nodes: NDArray[np.intp]) -> bool:
        """Return whether a path stays where the robot is, short of the goal."""
        places = self._scene.road_map.nodes_m[nodes]
        farthest = np.linalg.norm(places - context.position_m, axis=1).max()
        at_goal = int(nodes[-1]) == self._scene.goal_node
        return not at_goal and bool(farthest <= STAGNANT_STEPS * self._problem.step_length_m)

    def _cheapest(
        self,
        context: StepContext,
        ways: CostToGo,
        guide: Guide | None,
        *,
        priced: bool,
        effort_s2_m2: float | None = None,
    ) -> NDArray[np.intp] | None:
        """Nodes (N,) of the cheapest path, with exact margins wherever it rests on them.

        With another weight of effort than the problem's, if one is given.
        """
        if effort_s2_m2 is None:
            effort_s2_m2 = self._problem.reach.effort_weight_s2_m2
        problem, scene, margins = self._problem, self._scene, self.margins
        moving: MovingDiscs = context.moving
        places = scene.road_map.nodes_m
        first_nodes, first_lengths = first_moves(scene.ground, problem, context.position_m)
        kept = first_steps_apart(moving, context.position_m, places[first_nodes])
        first_nodes, first_lengths = first_nodes[kept], first_lengths[kept]
        margin_here, share_here = margins.at(context.position_m[None])
        here = problem.reach.outage_price * share_here
        if self._forbids:
            here = np.where(margin_here < 0.0, FORBIDDEN, here)
        nodes: NDArray[np.intp] | None = None
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
                self._rate * ways.cost_m,
                surcharge if priced else None,
                moving,
            )
            if nodes is None:
                return None
            if not margins.correct(nodes):
                break
        return nodes

    def _penalty_s(self, guide: Guide) -> NDArray[np.float64]:
        """Penalty of ending each step at each node, ``(N, n)``; negative where it is credited."""
        margins, threshold = self.margins, self._problem.stations[0].threshold_dbm
        penalty = np.zeros((len(guide.asked), len(margins.mean_db)))
        if guide.asked.any():
            margin = bound_margin_db(margins.mean_db, margins.deviation_db, threshold, guide.level)
            missing = np.maximum(MARGIN_PAD_DB - margin, 0.0)
            below = np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing
            penalty[guide.asked] = below
        if guide.credit.any():
            chance = connection_probability(margins.mean_db, margins.deviation_db, threshold)
            step_s = self._rate * self._problem.step_length_m
            penalty -= step_s * guide.credit[:, None] * chance
        return penalty

    def _start(
        self,
        context: StepContext,
        ways: CostToGo,
        nodes: NDArray[np.intp],
        *,
        direct: bool = False,
    ) -> GlobalStart:
        """Return the initial guess of a path."""
        problem, road_map = self._problem, self._scene.road_map
        route = route_from(road_map, ways, int(nodes[-1]), np.inf)
        soon = route_from(
            road_map, ways, int(nodes[-1]), problem.planner.horizon * problem.step_length_m
        )
        margin = self.margins.margin_db[nodes]
        outside = self.margins.outside
        if problem.constraints.rule.is_plain:
            below = np.nonzero(outside[soon])[0]
            soon = soon[1 : below[0]] if below.size else soon[1:]
        else:
            path = road_map.nodes_m[nodes]
            margin = step_rows(context, path).margins_db(context.power(path))
            soon = soon[1:]
        return GlobalStart(
            nodes=nodes,
            path_m=road_map.nodes_m[nodes],
            margin_db=margin,
            route_m=road_map.nodes_m[route[1:]],
            beyond_m=road_map.nodes_m[soon],
            ways=ways,
            metre_cost=np.ones(len(outside)) if ways is self._scene.ways else self._metre_cost(),
            is_blocked=self._forbids and bool(outside[nodes].any() or outside[route].any()),
            is_direct=direct,
        )
