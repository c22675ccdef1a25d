"""Steering of a robot beyond its horizon: to high variance, to a connection, or to its goal.

To learn the channel, a robot is steered to the workspace cell q* that maximises
J_CH = max{0, sigma^2 - sigma_TH^2} psi(d), with d the length of the shortest path to the cell.
"""

import math
from dataclasses import replace

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.channel_map import TileMap
from planopt.channel.kriging import connection_probability
from planopt.channel.neighbours import PlaceTree
from planopt.objectives.measuring import OPEN_SPACINGS
from planopt.objectives.terms.measured import MappingTerm
from planopt.objectives.terms.term import SteeringPath, Term
from planopt.objectives.terms.until_connected import UntilConnectedTerm
from planopt.planning.proof.rule import search_power
from planopt.planning.scene import Ground, PathsFrom, first_moves, taut_turns
from planopt.planning.search.global_search import FORBIDDEN
from planopt.planning.search.node_margins import LatticeMap, NodeMargins
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.planning.values.context import StepContext, steering_path, workspace_region
from planopt.problems.problem import Problem
from planopt.world.clearance import segments_clear
from planopt.world.lattice import lattice_paths, route_from

TILE = 1  # Tile size in cells; cells are far apart, so each has its own neighbours
NEIGHBOURS = 48  # Number of measurements for the prediction of each cell


class Steering:
    """Search for a workspace cell of high variance to steer to; it caches the channel map."""

    def __init__(self, problem: Problem, ground: Ground, term: MappingTerm) -> None:
        self._problem, self._ground, self._term = problem, ground, term
        places = workspace_region(problem).grid_m
        x, column = np.unique(places[:, 0], return_inverse=True)
        y, row = np.unique(places[:, 1], return_inverse=True)
        needed = np.zeros((len(y), len(x)), dtype=bool)
        needed[row, column] = True
        self._places_m = places
        self._at = row, column
        self._map = TileMap(x, y, needed, TILE, NEIGHBOURS)
        nodes = ground.road_map.nodes_m
        self._nearest = PlaceTree(nodes).nearest(places, 1)[0][:, 0]
        next_to = nodes[self._nearest]
        # A cell too close to an obstacle is not reachable.
        wanted = problem.constraints.clearance_m + CLEARANCE_PAD_M
        clear = segments_clear(ground.index, next_to, places, wanted)
        away: Floats = np.linalg.norm(next_to - places, axis=1)
        self._away_m = np.where(clear, away, np.inf)

    def find_path(self, context: StepContext) -> SteeringPath | None:
        """Return the steering path; None if no reachable cell exceeds the variance threshold."""
        (own,), (posterior,) = context.law.posteriors, context.anticipated
        if posterior is own:
            self._map.refresh(own)
            variance = self._map.deviation_db[self._at] ** 2
        else:
            # A cached map cannot include others' planned measurements, which change at every step.
            variance = search_power(posterior, self._places_m).deviation_db ** 2
        above = variance - self._term.variance_threshold_db2
        is_open = context.measuring.is_open(self._places_m)
        counted = np.where(is_open, np.maximum(above, 0.0), 0.0)
        return self.path_to_best(counted, context.position_m)

    def path_to_best(self, above_db2: Floats, position_m: Floats) -> SteeringPath | None:
        """Return the path to the cell of largest excess variance times closeness; None if zero."""
        paths = PathsFrom(self._problem, self._ground, position_m)
        distance = paths.length_m[self._nearest] + self._away_m
        reachable = np.isfinite(distance)
        straight = np.linalg.norm(self._places_m - position_m, axis=1)
        distance = np.where(paths.straight(self._places_m), straight, distance)
        score = np.zeros_like(above_db2)
        nearness = np.exp(-self._term.closeness_per_m * distance[reachable])
        score[reachable] = above_db2[reachable] * nearness
        best = int(score.argmax())
        if score[best] == 0.0:
            return None
        road_map, node = self._ground.road_map, int(self._nearest[best])
        lengths = lattice_paths(road_map, node).cost_m + self._away_m[best]
        # Unreachable nodes get a finite distance, as no search visits them.
        farthest = float(lengths[np.isfinite(lengths)].max())
        lattice = np.full(road_map.lattice.shape, farthest)
        lattice[road_map.rows, road_map.columns] = np.minimum(lengths, farthest)
        turns = paths.turns_m(node, self._places_m[best])
        return steering_path(self._problem, self._ground.index, turns, lattice)


FIRST_RADIUS_STEPS, WIDER = 16.0, 2.0
"""Initial search radius in longest steps, and its growth factor."""


class ConnectionSteering:
    """Search for the position to probe for a connection; it caches the predicted channel map."""

    def __init__(self, problem: Problem, ground: Ground, term: UntilConnectedTerm) -> None:
        self._problem, self._ground, self._term = problem, ground, term
        self._map = LatticeMap(ground.road_map.lattice)
        self._radius_m = FIRST_RADIUS_STEPS * problem.step_length_m

    def find_path(self, context: StepContext) -> SteeringPath | None:
        """Return the path to the best position to probe; None if there is none."""
        road_map, here = self._ground.road_map, context.position_m
        widest = context.workspace_diagonal_m
        rule = context.probing
        rule = replace(rule, spacing_m=OPEN_SPACINGS * rule.spacing_m)
        while True:
            radius = self._radius_m
            last = radius >= widest
            paths = PathsFrom(self._problem, self._ground, here, math.inf if last else radius)
            near = np.flatnonzero(np.isfinite(paths.length_m))
            near = near[rule.is_open(road_map.nodes_m[near])]
            if len(near):
                chance = self._chance(context, near, radius)
                length = self._term.search_length_m(context, paths.length_m[near], chance)
                best = int(length.argmin())
                if last or length[best] <= radius:
                    node = int(near[best])
                    turns = paths.turns_m(node, road_map.nodes_m[node])
                    return steering_path(self._problem, self._ground.index, turns)
            elif last:
                return None
            self._radius_m *= WIDER

    def _chance(self, context: StepContext, nodes: Indices, radius_m: float) -> Floats:
        """Return the probabilities of connection at `nodes`, all within `radius_m` of the robot."""
        low, high = context.position_m - radius_m, context.position_m + radius_m
        window = float(low[0]), float(low[1]), float(high[0]), float(high[1])
        self._map.refresh(context.law, window)
        at = self._ground.road_map.rows[nodes], self._ground.road_map.columns[nodes]
        threshold = self._problem.stations[0].threshold_dbm
        mean, deviation = self._map.mean_db[at], self._map.deviation_db[at]
        return connection_probability(mean, deviation, threshold)


TAUT_SHARE = 1.02
"""Largest cost of a straight leg relative to the path along the nodes that it replaces."""


class GoalSteering:
    """Search for the cheapest path to the goal; it caches the predicted channel map."""

    def __init__(self, problem: Problem, ground: Ground, _term: Term) -> None:
        self._problem, self._ground = problem, ground
        self._goal_m = np.asarray(problem.goal_m)
        self._wanted_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
        self._bounded = p_min > 0.0
        self._margins = NodeMargins(ground.road_map, threshold, p_min)
        nodes, lengths = first_moves(ground, problem, self._goal_m)
        self._goal_node = int(nodes[lengths.argmin()]) if len(nodes) else None

    def find_path(self, context: StepContext) -> SteeringPath | None:
        """Return the cheapest path by the current belief; None if obstacles enclose the goal."""
        road_map, here = self._ground.road_map, context.position_m
        nodes, lengths = first_moves(self._ground, self._problem, here)
        if self._goal_node is None or not len(nodes):
            return None
        self._margins.refresh(context.law)
        metre_cost = np.where(self._margins.outside & self._bounded, FORBIDDEN, 1.0)
        paths = lattice_paths(road_map, self._goal_node, metre_cost)
        cost = lengths * metre_cost[nodes] + paths.cost_m[nodes]
        first = int(nodes[cost.argmin()])
        if not np.isfinite(paths.cost_m[first]):
            return None
        along = route_from(road_map, paths, first, math.inf)
        corners = np.vstack([here, road_map.nodes_m[along], self._goal_m])
        # Robot and goal get the cost of their nearest nodes.
        at_corner = metre_cost[np.concatenate([[first], along, [self._goal_node]])]
        farthest = float(paths.cost_m[np.isfinite(paths.cost_m)].max())
        lattice = np.full(road_map.lattice.shape, farthest)
        lattice[road_map.rows, road_map.columns] = np.minimum(paths.cost_m, farthest)
        legs = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        spent = np.append(0.0, np.cumsum(legs * 0.5 * (at_corner[1:] + at_corner[:-1])))

        def is_cheap(corner: int) -> Mask:
            allowed = TAUT_SHARE * (spent[corner + 1 :] - spent[corner])
            ahead = corners[corner + 1 :]
            return self._leg_costs_m(corners[corner], ahead, metre_cost) <= allowed

        turns = taut_turns(self._ground, self._wanted_m, corners, is_cheap)
        return steering_path(self._problem, self._ground.index, turns, lattice)

    def _leg_costs_m(self, start_m: Floats, ends_m: Floats, metre_cost: Floats) -> Floats:
        """Return the costs of straight legs to `ends_m` (n, 2), sampled at the nearest nodes."""
        road_map = self._ground.road_map
        lattice = road_map.lattice
        lengths = np.linalg.norm(ends_m - start_m, axis=1)
        count = math.ceil(float(lengths.max()) / lattice.spacing_m) + 1
        share = (np.arange(count) + 0.5) / count
        places = start_m + share[None, :, None] * (ends_m - start_m)[:, None]
        cell = np.rint((places - np.asarray(lattice.origin_m)) / lattice.spacing_m).astype(int)
        ny, nx = lattice.shape
        column, row = np.clip(cell[..., 0], 0, nx - 1), np.clip(cell[..., 1], 0, ny - 1)
        number = road_map.number[row, column]
        # Positions next to an obstacle may have no free node.
        return lengths * np.where(number >= 0, metre_cost[number], 1.0).mean(axis=1)
