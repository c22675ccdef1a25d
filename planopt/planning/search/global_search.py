"""The global start of a plan: a lattice path whose connectivity is exact where it matters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import cost_rate_s_m
from planopt.planning.ground import first_moves
from planopt.planning.scene import Scene
from planopt.planning.search.frontier import OUT_OF_BOUND_FACTOR, Frontier
from planopt.planning.search.lattice_search import search_lattice
from planopt.planning.search.moving_moves import steps_apart
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.search.road_map import Ways, shortest_ways, way_from
from planopt.planning.tolerances import MARGIN_PAD_DB, STEP_PAD_M
from planopt.problems.problem import Problem
from planopt.world.clearance import inside_bounds, is_clear, swept_clearance_m
from planopt.world.moving_discs import NOTHING_MOVES, MovingDiscs

STAGNANT_STEPS = 0.75
"""A path that stays within this many longest steps of the robot gets nowhere; a lattice path can
only end on a node, so that even one that wants to stay moves a little."""
MAX_CLOSINGS = 50
"""How many gaps may be given up in one step."""
FINE_PLACES = 6
"""Places along the radius of a first step that is looked for between the nodes."""
FINE_TRIALS = 4
"""How many of them are tried, those nearest to the path first."""
CROSSING_SHARE = 0.5
"""What a step through a gap is charged when it must be crossed, as a share of what the cost to go
charges for a longest step there: less, or crossing would never pay within the horizon."""
OUT_OF_BOUND_STEP_S = 1e5
"""Penalty of a step below the bound: no saving of time is worth one."""
MISSING_DB_S = 1e3
"""Penalty of a missing dB: among as many steps below the bound, the least missing dB wins."""
CORRECTION_ROUNDS = 8
"""How often the search is repeated with exact margins along its path."""


@dataclass(frozen=True)
class GlobalStart:
    """Where the polish starts.

    Attributes
    ----------
    nodes
        ``(N,)`` lattice nodes.
    path_m
        ``(N, 2)`` their places.
    margin_db
        ``(N,)`` exact connectivity margins there.
    beyond_m
        ``(b, 2)`` the way beyond its end, as far as it keeps the bound.
    ways
        Cost to go of every node.
    crossing
        Whether it crosses a gap on purpose, because no way to the goal keeps the bound.
    """

    nodes: NDArray[np.intp]
    path_m: NDArray[np.float64]
    margin_db: NDArray[np.float64]
    beyond_m: NDArray[np.float64]
    ways: Ways
    crossing: bool


class GlobalSearch:
    """Finds start paths; remembers what it has tried before gaps in connectivity.

    Parameters
    ----------
    problem, scene
        What is planned, and where.
    margins
        Connectivity margins of the nodes, kept up to date by the caller.
    """

    def __init__(self, problem: Problem, scene: Scene, margins: NodeMargins) -> None:
        self._problem = problem
        self._scene = scene
        self._margins = margins
        self._frontier = Frontier(scene.road_map, problem.step_length_m)
        self._moving = NOTHING_MOVES
        self._rate = cost_rate_s_m(
            problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s
        )

    def find_start(
        self,
        position_m: NDArray[np.float64],
        measured_m: NDArray[np.float64],
        moving: MovingDiscs = NOTHING_MOVES,
    ) -> GlobalStart | None:
        """Search from `position_m`; None if no node is in reach.

        A step below the bound is taken only where every lattice path has one.

        Parameters
        ----------
        position_m
            ``(2,)`` where the robot is.
        measured_m
            ``(m, 2)`` where power has been measured.
        moving
            What moves during the steps.
        """
        self._moving = moving
        if self._problem.reach.cost_to_go == "geodesic":
            start = self._search(position_m, self._scene.goal_node, self._scene.ways)
            return self._with_fine_first_step(position_m, start)
        if self._frontier.crossing:
            self._frontier.follow(bool(self._margins.at(position_m[None])[0] < 0.0))
        return self._with_fine_first_step(position_m, self._past_gaps(position_m, measured_m))

    def _past_gaps(
        self, position_m: NDArray[np.float64], measured_m: NDArray[np.float64]
    ) -> GlobalStart | None:
        """Search towards the goal, and decide what to do at a gap that is in the way."""
        start = self._towards_goal(position_m)
        for _ in range(MAX_CLOSINGS):
            if start is None or self._frontier.crossing:
                break
            end, outside = int(start.nodes[-1]), self._outside()
            if not self._frontier.probing:
                if not self._stagnant(position_m, start):
                    break
                if not self._frontier.stand_before_gap(start.ways, end, outside):
                    break
            if not self._frontier.still_there(start.ways, end, outside):
                self._frontier.leave()
                break
            factor = self._frontier.node_factor(outside)
            from_here = shortest_ways(self._scene.road_map, int(start.nodes[0]), factor)
            probe = self._frontier.probe(from_here, measured_m, outside)
            if probe is not None:
                ways = shortest_ways(self._scene.road_map, probe, factor)
                return self._search(position_m, probe, ways)
            if not self._frontier.close(outside):
                self._frontier.cross()
            start = self._towards_goal(position_m)
        return start

    def _towards_goal(self, position_m: NDArray[np.float64]) -> GlobalStart | None:
        """Search with the `connected` cost to go."""
        factor = self._frontier.node_factor(self._outside())
        ways = shortest_ways(self._scene.road_map, self._scene.goal_node, factor)
        return self._search(position_m, self._scene.goal_node, ways)

    def _outside(self) -> NDArray[np.bool_]:
        return self._margins.margin_db < MARGIN_PAD_DB

    def _stagnant(self, position_m: NDArray[np.float64], start: GlobalStart) -> bool:
        """Whether a path gets nowhere, short of the goal."""
        farthest = np.linalg.norm(start.path_m - position_m, axis=1).max()
        at_goal = int(start.nodes[-1]) == self._scene.goal_node
        return not at_goal and bool(farthest <= STAGNANT_STEPS * self._problem.step_length_m)

    def _with_fine_first_step(
        self, position_m: NDArray[np.float64], start: GlobalStart | None
    ) -> GlobalStart | None:
        """Look between the nodes for a first step that keeps the bound, where no node does."""
        if start is None or start.margin_db[0] >= 0.0:
            return start
        problem, horizon = self._problem, len(start.nodes)
        length = problem.step_length_m - STEP_PAD_M
        offsets = length * np.linspace(-1.0, 1.0, 2 * FINE_PLACES + 1)
        grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        places = position_m + grid[np.linalg.norm(grid, axis=1) <= length]
        fan = np.repeat(position_m[None], 2 * len(places) + 1, axis=0)
        fan[1::2] = places
        swept = swept_clearance_m(self._scene.index, fan)[0::2]
        clear = is_clear(swept, problem.constraints.clearance_m)
        clear &= steps_apart(self._moving, 0, np.broadcast_to(position_m, places.shape), places)
        places = places[clear & inside_bounds(problem.workspace, places)]
        margin = self._margins.at(places)
        places, margin = places[margin >= MARGIN_PAD_DB], margin[margin >= MARGIN_PAD_DB]
        ahead = start.path_m[min(1, horizon - 1)]
        for k in np.argsort(np.linalg.norm(places - ahead, axis=1))[:FINE_TRIALS]:
            first = replace(
                start,
                nodes=np.array([self._nearest(places[k])]),
                path_m=places[k : k + 1],
                margin_db=margin[k : k + 1],
            )
            fine = first if horizon == 1 else self._continued(first, start.ways, horizon - 1)
            # A gap is not left on the side that it was entered from.
            behind = start.ways.cost_m[start.nodes[-1]] + problem.step_length_m
            if fine is not None and not (
                start.crossing and start.ways.cost_m[fine.nodes[-1]] > behind
            ):
                return fine
        return start

    def _continued(self, first: GlobalStart, ways: Ways, horizon: int) -> GlobalStart | None:
        """Search on from a first step; None if the rest does not keep the bound throughout."""
        rest = self._search(first.path_m[0], self._scene.goal_node, ways, horizon)
        if rest is None or (rest.margin_db < 0.0).any():
            return None
        return replace(
            rest,
            nodes=np.concatenate([first.nodes, rest.nodes]),
            path_m=np.vstack([first.path_m, rest.path_m]),
            margin_db=np.concatenate([first.margin_db, rest.margin_db]),
        )

    def _nearest(self, place_m: NDArray[np.float64]) -> int:
        return int(np.argmin(np.linalg.norm(self._scene.road_map.nodes_m - place_m, axis=1)))

    def _search(
        self,
        position_m: NDArray[np.float64],
        target: int,
        ways: Ways,
        horizon: int | None = None,
    ) -> GlobalStart | None:
        """Search once, with exact margins wherever the path rests on them."""
        settings, scene, margins = self._problem.planner, self._scene, self._margins
        first_nodes, first_lengths = first_moves(scene.ground, self._problem, position_m)
        steps = settings.horizon if horizon is None else horizon
        first_step = settings.horizon - steps
        ends = scene.road_map.nodes_m[first_nodes]
        begins = np.broadcast_to(position_m, ends.shape)
        kept = steps_apart(self._moving, first_step, begins, ends)
        first_nodes, first_lengths = first_nodes[kept], first_lengths[kept]
        if first_nodes.size == 0:
            return None
        nodes: NDArray[np.intp] | None = None
        for _ in range(CORRECTION_ROUNDS):
            found = search_lattice(
                scene.road_map,
                first_nodes,
                first_lengths,
                steps,
                settings.step_s,
                self._problem.reach.effort_weight_s2_m2,
                target,
                self._penalty_s(),
                self._rate * ways.cost_m,
                self._moving,
                first_step,
            )
            if found is None:
                return None
            nodes = found.nodes
            # Below the bound already at the first step: make sure of every place in reach.
            doubtful = margins.margin_db[nodes[0]] < MARGIN_PAD_DB
            if not margins.correct(np.concatenate([nodes, first_nodes]) if doubtful else nodes):
                break
        if nodes is None:
            raise AssertionError("at least one round is searched")
        places = scene.road_map.nodes_m
        beyond = self._beyond(ways, int(nodes[-1]))
        return GlobalStart(
            nodes=nodes,
            path_m=places[nodes],
            margin_db=margins.margin_db[nodes],
            beyond_m=places[beyond],
            ways=ways,
            crossing=self._frontier.crossing,
        )

    def _penalty_s(self) -> NDArray[np.float64]:
        """Penalty of a step that ends at each node."""
        missing = np.maximum(MARGIN_PAD_DB - self._margins.margin_db, 0.0)
        if self._frontier.crossing:
            longest = self._rate * OUT_OF_BOUND_FACTOR * self._problem.step_length_m
            return np.where(missing > 0.0, CROSSING_SHARE * longest, 0.0)
        return np.where(missing > 0.0, OUT_OF_BOUND_STEP_S, 0.0) + MISSING_DB_S * missing

    def _beyond(self, ways: Ways, end: int) -> NDArray[np.intp]:
        """Nodes beyond a path's end that a faster path could come to within the horizon."""
        horizon, length = self._problem.planner.horizon, self._problem.step_length_m
        way = way_from(self._scene.road_map, ways, end, horizon * length)
        outside = np.nonzero(self._margins.margin_db[way] < MARGIN_PAD_DB)[0]
        return way[1 : outside[0]] if outside.size else way[1:]
