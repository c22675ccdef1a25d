"""Smoothed routes to a goal, and steps that follow them.

Points of a route suggested by a bound's mesh are moved out of the clearance of obstacles, and then
sideways: dynamic programming over a few offsets of each point finds the cheapest combination.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import shapely
from scipy.optimize import minimize

from planopt.arrays import Floats, Indices, Mask
from planopt.bounds.mesh import Corridor
from planopt.channel.kriging import connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.planning.certificate import holes_on
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict
from planopt.planning.proof.bounds import metre_cost_of
from planopt.planning.proof.rule import connectivity_law, search_prediction, verifier_context
from planopt.planning.proof.verify import verify
from planopt.planning.scene import stops_along
from planopt.planning.tolerances import CLEARANCE_PAD_M, CLEARANCE_TOLERANCE_M, STEP_PAD_M
from planopt.planning.values.objective_value import ReachCost
from planopt.problems.problem import Problem, integrated_cost_m, rate_s_m, step_cost_s
from planopt.world.clearance import (
    ObstacleIndex,
    index_obstacles,
    inside_bounds,
    segment_clearance_m,
    segments_clear,
)

MetreCost = Callable[[Floats], Floats]
"""Function that maps positions (n, 2) to the cost per metre there as an array (n,)."""
OFFSETS = np.array([-1.0, 0.0, 1.0])
"""Sideways displacements of a point in each pass, in units of the pass."""
WIDEST = 0.25  # First unit of smoothing, in lengths of the pieces
FINEST = 2.0  # Minimum length of a piece, in spacings of the cost raster
CLEARINGS, MOVES_OUT, CLEARING_M = 8, 20, 0.01
"""Maximum numbers of added points and of moves; distance in addition to the clearance."""
RASTER_SHARE = 3e-3
"""Spacing of the cost raster, as a share of the workspace diagonal; values are interpolated."""
RASTER_M = (0.2, 3.0)  # Minimum and maximum spacing of the cost raster


class Effort(NamedTuple):
    """Settings that determine the effort of route smoothing."""

    lookback: int  # Maximum number of consecutive corners replaced by one straight leg
    pieces: int  # Number of pieces into which the route is divided
    narrowest: float  # Last unit of smoothing, in lengths of the pieces
    passes: int  # Maximum number of passes with the same unit


QUICK, THOROUGH = Effort(6, 64, 0.02, 1), Effort(24, 128, 0.002, 4)
"""Effort for every first plan, and with a proof."""


def smooth_route(
    raster: CostRaster,
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    clearance_m: float,
    corners_m: Floats,  # (n, 2)
    effort: Effort = THOROUGH,
) -> Floats:
    """Return a smoothed route (m, 2) between the same end points."""
    total = float(np.linalg.norm(np.diff(corners_m, axis=0), axis=1).sum())
    longest = max(total / effort.pieces, FINEST * raster.spacing_m)
    route = stops_along(_taut(raster, index, clearance_m, corners_m, effort.lookback), longest)
    unit = WIDEST * longest
    while unit > effort.narrowest * longest:
        for _ in range(effort.passes):
            moved = _moved(raster, index, bounds_m, clearance_m, route, unit)
            is_same = np.array_equal(moved, route)
            route = moved
            if is_same:
                break
        unit *= 0.5
    return route


def cleared(
    index: ObstacleIndex, clearance_m: float, path_m: Floats, longest_m: float
) -> Floats | None:
    """Return a path (n, 2) whose points are moved out of the clearance; None if that fails."""
    # Its ends stay. Points are added between points whose connection is too close to an obstacle.
    path = stops_along(path_m, longest_m)
    for _ in range(CLEARINGS):
        blocked = ~segments_clear(index, path[:-1], path[1:], clearance_m)
        if not blocked.any():
            return path
        middles = 0.5 * (path[:-1] + path[1:])[blocked]
        path = np.insert(path, np.flatnonzero(blocked) + 1, middles, axis=0)
        path[1:-1] = _moved_out(index, clearance_m + CLEARING_M, path[1:-1])
    return None


def _moved_out(index: ObstacleIndex, distance_m: float, places_m: Floats) -> Floats:
    """Return positions (n, 2) moved to `distance_m` from their nearest obstacles."""
    places, rows = places_m.copy(), np.arange(len(places_m))
    for _ in range(MOVES_OUT):
        points = shapely.points(places[rows])
        near = index.polygons[index.tree.query_nearest(points, all_matches=False)[1]]
        lines: Any = shapely.shortest_line(shapely.boundary(near), points)  # pyright: ignore
        ends: Floats = shapely.get_coordinates(lines)[::2]
        outwards = np.where(shapely.contains(near, points), -1.0, 1.0)
        offset = outwards[:, None] * (places[rows] - ends)
        size = np.linalg.norm(offset, axis=1)
        short = outwards * size < distance_m
        if not short.any():
            break
        away = offset[short] / np.maximum(size[short], 1e-12)[:, None]
        places[rows[short]] = ends[short] + distance_m * away
        rows = rows[short]
    return places


class CostRaster:
    """Raster of costs per metre, computed on demand and interpolated."""

    def __init__(self, metre_cost: MetreCost, bounds_m: tuple[float, float, float, float]) -> None:
        self._metre_cost = metre_cost
        self._low = np.array(bounds_m[:2])
        size = np.array(bounds_m[2:]) - self._low
        self.spacing_m = float(np.clip(RASTER_SHARE * np.hypot(*size), *RASTER_M))
        columns, rows = (math.ceil(side / self.spacing_m) + 2 for side in size.tolist())
        self._shape = columns, rows
        self._values = np.full(columns * rows, np.nan)

    def __call__(self, places_m: Floats) -> Floats:
        """Return the interpolated costs per metre at positions (n, 2)."""
        at = (places_m - self._low) / self.spacing_m
        columns, rows = self._shape
        cell = np.clip(at.astype(np.intp), 0, np.array([columns, rows]) - 2)
        first = cell[:, 0] * rows + cell[:, 1]
        corners = first[:, None] + np.array([0, rows, 1, rows + 1])
        new = np.unique(corners[np.isnan(self._values[corners])])
        if len(new):
            nodes = np.column_stack([new // rows, new % rows])
            self._values[new] = self._metre_cost(self._low + self.spacing_m * nodes)
        x, y = (at - cell).T
        weights = np.column_stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])
        return np.asarray((self._values[corners] * weights).sum(axis=1))

    def legs_m(self, starts_m: Floats, ends_m: Floats) -> Floats:
        """Return the costs of straight legs to `ends_m` (n, 2), by the midpoint rule."""
        lengths = np.linalg.norm(ends_m - starts_m, axis=1)
        count = max(1, math.ceil(float(lengths.max(initial=0.0)) / self.spacing_m))
        share = (np.arange(count) + 0.5) / count
        places = starts_m[:, None] + share[None, :, None] * (ends_m - starts_m)[:, None]
        return lengths * self(places.reshape(-1, 2)).reshape(-1, count).mean(axis=1)


def _taut(
    raster: CostRaster, index: ObstacleIndex, clearance_m: float, corners_m: Floats, back: int
) -> Floats:
    """Return the cheapest route with straight legs between some of the corners (n, 2)."""
    count = len(corners_m)
    back = min(back, count - 1)
    legs = np.full((back, count), np.inf)
    for skipped in range(back):
        starts, ends = corners_m[: -1 - skipped], corners_m[1 + skipped :]
        clear = segments_clear(index, starts, ends, clearance_m) | (skipped == 0)
        values = np.full(len(starts), np.inf)
        values[clear] = raster.legs_m(starts[clear], ends[clear])
        legs[skipped, 1 + skipped :] = values
    cost, before = np.zeros(count), np.zeros(count, dtype=int)
    for k in range(1, count):
        first = np.arange(k - 1, max(-1, k - 1 - back), -1)
        through = cost[first] + legs[: len(first), k]
        before[k] = first[int(through.argmin())]
        cost[k] = through.min()
    chosen = [count - 1]
    while chosen[-1] > 0:
        chosen.append(int(before[chosen[-1]]))
    return corners_m[chosen[::-1]]


def _moved(
    raster: CostRaster,
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    clearance_m: float,
    route_m: Floats,
    unit_m: float,
) -> Floats:
    """Return the cheapest route after one pass of sideways moves with fixed end points."""
    along = np.zeros_like(route_m)
    along[1:-1] = route_m[2:] - route_m[:-2]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    places = route_m[:, None] + unit_m * OFFSETS[None, :, None] * normal[:, None]
    low, high = np.array(bounds_m[:2]), np.array(bounds_m[2:])
    inside = np.asarray(((places >= low) & (places <= high)).all(axis=2))
    count, choices = len(route_m), len(OFFSETS)
    starts = np.repeat(places[:-1], choices, axis=1).reshape(-1, 2)
    ends = np.tile(places[1:], (1, choices, 1)).reshape(-1, 2)
    legs = raster.legs_m(starts, ends)
    clear = segments_clear(index, starts, ends, clearance_m)
    legs = np.where(clear, legs, np.inf).reshape(count - 1, choices, choices)
    # The current route may violate the clearance with its pad.
    still = choices // 2
    present = raster.legs_m(route_m[:-1], route_m[1:])
    legs[:, still, still] = np.minimum(legs[:, still, still], present)
    legs = np.where(inside[1:, None, :], legs, np.inf)
    cost = np.zeros(choices)
    before = np.zeros((count, choices), dtype=int)
    for k in range(1, count):
        through = cost[:, None] + legs[k - 1]
        before[k] = through.argmin(axis=0)
        # Ties keep the current point, so that equal costs end the passes.
        tie = through[still] <= through.min(axis=0) + 1e-12
        before[k][tie] = still
        cost = np.take_along_axis(through, before[k][None], axis=0)[0]
    chosen = [still if cost[still] <= cost.min() else int(cost.argmin())]
    for k in range(count - 1, 0, -1):
        chosen.append(int(before[k][chosen[-1]]))
    return places[np.arange(count), chosen[::-1]]


ROUND = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
"""Displacements of a plan's position in each pass, in units of the pass; the middle one is zero."""
STEP_UNITS = 0.25 * 0.5 ** np.arange(7)
"""Units of the passes over a plan's positions, in longest steps."""
STEP_PASSES = 6  # Maximum number of passes with the same unit


def smooth_steps(
    leg_value: Callable[[Floats, Floats], Floats], places_m: Floats, longest_m: float
) -> Floats:
    """Return positions (k + 1, 2) moved to reduce the legs' cost, with fixed end points."""
    # `leg_value` maps starts and ends (n, k, 2) of legs to costs (n, k), some infinite.
    places = places_m.copy()
    choices, still = len(ROUND), len(ROUND) // 2
    for unit in (longest_m * STEP_UNITS).tolist():
        for _ in range(STEP_PASSES):
            moved = places[:, None] + unit * ROUND
            moved[0], moved[-1] = places[0], places[-1]
            starts = np.repeat(moved[:-1], choices, axis=1).swapaxes(0, 1)
            values = leg_value(starts, np.tile(moved[1:], (1, choices, 1)).swapaxes(0, 1))
            legs = values.T.reshape(-1, choices, choices)
            cost, before = legs[0][still], list[Indices]()
            for leg in legs[1:]:
                through = cost[:, None] + leg
                before.append(through.argmin(axis=0))
                cost = through.min(axis=0)
            chosen = [still]
            for back in before[::-1]:
                chosen.append(int(back[chosen[-1]]))
            found = moved[1:-1][np.arange(len(places) - 2), chosen[:0:-1]]
            if not np.isfinite(cost[still]) or np.array_equal(found, places[1:-1]):
                break
            places[1:-1] = found
    return places


POLISHES, POLISH_M = 80, 1e-6
"""Maximum number of iterations of the local search; its margin from limits, in metres."""
STEP_PARTS = 8  # Number of stops on a route within the longest step
ASIDE = np.array([-0.42, -0.25, -0.12, -0.04, 0.0, 0.04, 0.12, 0.25, 0.42])
"""Distances of positions from the route, in longest steps."""
WINDOW = 4  # Number of legs of the route that are moved together with the steps
LEAST_GAIN = 2e-3
"""Minimum relative gain of a suggested route over the current one before it is smoothed."""
INSIDE_GOAL = 0.999
"""Distance of a smoothed route's end from the goal, as a share of the goal's radius."""


def _may_change(plan: Plan) -> bool:
    """Return whether a plan has a route that may be replaced."""
    is_timed = plan.rung in (Rung.DIRECT, Rung.GIVE_WAY)
    return plan.drive is None and len(plan.route_m) > 0 and not is_timed


class RouteSmoothing:
    """Smoothing of a robot's routes with one belief."""

    def __init__(
        self, problem: Problem, posteriors: Sequence[ChannelPosterior], alone: bool
    ) -> None:
        self._problem, self._posteriors = problem, posteriors
        self._law = connectivity_law(problem, posteriors)
        self._index = index_obstacles(problem.workspace)
        self._metre_cost: MetreCost = lambda places_m: np.ones(len(places_m))
        if problem.reach.cost_to_go == "connected":
            self._metre_cost = metre_cost_of(problem, posteriors)
        self._raster = CostRaster(self._metre_cost, problem.workspace.bounds_m)
        self._clearance_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        self._longest_m = problem.step_length_m - STEP_PAD_M
        self._moves_steps = alone and not problem.workspace.moving and not problem.workspace.timed
        self._seen: Corridor | None = None
        self._cost_m = np.inf

    def smoothed(self, plan: Plan) -> Plan:
        """Return the plan with a smoothed route, if it is cheaper; its steps stay the same."""
        if not _may_change(plan):
            return plan
        begun, bounds_m = perf_counter(), self._problem.workspace.bounds_m
        found = self._inside_goal(np.vstack([plan.positions_m[-1:], plan.route_m]))
        route = smooth_route(self._raster, self._index, bounds_m, self._clearance_m, found, QUICK)
        chosen = self._cheaper(plan, self.with_route(plan, route))
        return replace(chosen, wall_s=plan.wall_s + perf_counter() - begun)

    def improved(self, plan: Plan, corridor: Corridor) -> Plan:
        """Return the plan with the cheapest route through a corridor, if it is cheaper."""
        if corridor is self._seen or not _may_change(plan):
            return plan
        self._seen = corridor
        places = plan.positions_m if self._moves_steps else plan.positions_m[-1:]
        path = np.vstack([places[:1], corridor.path_m(places[0])[1:-1], self._problem.goal_m])
        spacing_m = FINEST * self._raster.spacing_m
        found = cleared(self._index, self._clearance_m, self._inside_goal(path), spacing_m)
        if found is None:
            if np.isfinite(self._cost_m):
                return plan
            found = self._inside_goal(np.vstack([places, plan.route_m]))
        if self._cost_of(found) > self._cost_m * (1.0 - LEAST_GAIN):
            return plan
        bounds_m = self._problem.workspace.bounds_m
        route = smooth_route(self._raster, self._index, bounds_m, self._clearance_m, found)
        self._cost_m = min(self._cost_m, self._cost_of(route))
        other = self.driven(plan, route) if self._moves_steps else self.with_route(plan, route)
        return self._cheaper(plan, other)

    def _cheaper(self, plan: Plan, other: Plan | None) -> Plan:
        """Return `other` if it is clear, costs less and crosses no forbidden hole, else `plan`."""
        if other is None or other.objective >= plan.objective:
            return plan
        least_m = self._problem.constraints.clearance_m - CLEARANCE_TOLERANCE_M
        ahead = np.vstack([other.positions_m[-1:], other.route_m])
        if not segments_clear(self._index, ahead[:-1], ahead[1:], least_m).all():
            return plan
        is_hard = self._problem.constraints.rule.slack_max_db is not None
        return plan if is_hard and other.holes else other

    def _cost_of(self, route_m: Floats) -> float:
        return float(self._raster.legs_m(route_m[:-1], route_m[1:]).sum())

    def _inside_goal(self, route_m: Floats) -> Floats:
        """Return a route (n, 2) to the goal that ends just inside the goal's disc."""
        goal = np.asarray(self._problem.goal_m)
        radius_m = INSIDE_GOAL * self._problem.constraints.goal_radius_m
        away = np.linalg.norm(route_m - goal, axis=1)
        last = max(1, int((away <= radius_m).argmax()))
        if radius_m <= 0.0 or away[last - 1] <= radius_m:
            return route_m
        towards = (route_m[last - 1] - goal) / away[last - 1]
        return np.vstack([route_m[:last], goal + radius_m * towards])

    def driven(self, plan: Plan, route_m: Floats) -> Plan | None:
        """Return a plan whose steps follow a route (n, 2); None if the verifier rejects it."""
        problem, horizon = self._problem, self._problem.planner.horizon
        stepped = self._stepped(route_m)
        if stepped is None:
            return None
        steps, rest = stepped

        def leg_value(starts_m: Floats, ends_m: Floats) -> Floats:
            is_step = [step < horizon for step in range(starts_m.shape[1])]
            starts, ends = starts_m.reshape(-1, 2), ends_m.reshape(-1, 2)
            costs = self._legs_s(starts, ends, np.array(is_step * len(starts_m)))
            return costs.reshape(starts_m.shape[:2])

        ahead = self._thinned(np.vstack([steps[-1:], rest]))
        places = smooth_steps(leg_value, np.vstack([steps, rest[ahead]]), self._longest_m)
        places = self._polished(leg_value, places)
        positions = places[: horizon + 1]
        whole = np.vstack([places[horizon:], rest[ahead[-1] + 1 :]])
        context = verifier_context(
            problem, self._index, self._posteriors, problem.robots[0].start_state
        )
        judgement = verify(context, positions)
        power = judgement.power
        if judgement.verdict is not Verdict.VERIFIED or power is None:
            return None
        threshold = problem.stations[0].threshold_dbm
        found = replace(
            plan,
            positions_m=positions,
            mean_dbm=power.mean_db,
            deviation_db=power.deviation_db,
            connectivity=connection_probability(power.mean_db, power.deviation_db, threshold),
            termination=Termination.LATTICE_ONLY,
            verdict=judgement.verdict,
            rung=Rung.PLAN,
            certificate=judgement.certificate,
            multipliers={},
            message="",
        )
        return self.with_route(found, whole)

    def _polished(self, leg_value: Callable[[Floats, Floats], Floats], places_m: Floats) -> Floats:
        """Return positions (k + 1, 2) of steps and route after a local search; the ends stay."""
        # Coordinate moves get stuck where several steps have full length.
        horizon = self._problem.planner.horizon
        longest_m, clearance_m = self._longest_m - POLISH_M, self._clearance_m + POLISH_M

        start = places_m[1:-1].ravel()

        def path(inner: Floats) -> Floats:
            # The search may try positions far away.
            near = np.clip(np.nan_to_num(inner), start - longest_m, start + longest_m)
            return np.vstack([places_m[:1], near.reshape(-1, 2), places_m[-1:]])

        def cost(inner: Floats) -> float:
            places = path(inner)
            return float(
                self._costs_s(places[:-1], places[1:], np.arange(len(places) - 1) < horizon).sum()
            )

        def room(inner: Floats) -> Floats:
            places = path(inner)
            lengths = np.linalg.norm(np.diff(places[: horizon + 1], axis=0), axis=1)
            away = segment_clearance_m(self._index, places[:-1], places[1:])
            return np.concatenate([longest_m - lengths, np.minimum(away, 1e3) - clearance_m])

        limits: Any = {"type": "ineq", "fun": room}
        options: Any = {"maxiter": POLISHES, "ftol": 1e-7}
        found: Any = minimize(cost, start, method="SLSQP", constraints=limits, options=options)
        polished = path(found.x)
        values = [
            float(leg_value(each[None, :-1], each[None, 1:]).sum()) for each in (places_m, polished)
        ]
        return polished if values[1] < values[0] else places_m

    def _costs_s(self, starts_m: Floats, ends_m: Floats, is_step: Mask | bool) -> Floats:
        """Return the costs (n,) of steps or route legs."""
        planner, rate = self._problem.planner, rate_s_m(self._problem)
        lengths = np.linalg.norm(ends_m - starts_m, axis=1)
        weight = self._problem.reach.effort_weight_s2_m2
        own = step_cost_s(lengths, planner.step_s, weight) - rate * lengths
        return rate * self._raster.legs_m(starts_m, ends_m) + np.where(is_step, own, 0.0)

    def _legs_s(self, starts_m: Floats, ends_m: Floats, is_step: Mask | bool) -> Floats:
        """Return the costs (n,) of steps or route legs; infinite for a leg that is not allowed."""
        cost = self._costs_s(starts_m, ends_m, is_step)
        lengths = np.linalg.norm(ends_m - starts_m, axis=1)
        allowed = ~np.asarray(is_step) | (lengths <= self._longest_m)
        allowed &= inside_bounds(self._problem.workspace, ends_m)
        allowed[allowed] = segments_clear(
            self._index, starts_m[allowed], ends_m[allowed], self._clearance_m
        )
        return np.where(allowed, cost, np.inf)

    def _stepped(self, route_m: Floats) -> tuple[Floats, Floats] | None:
        """Return the cheapest positions (N + 1, 2) near a route (n, 2), and the remaining route."""
        horizon, parts, longest_m = self._problem.planner.horizon, STEP_PARTS, self._longest_m
        lengths = np.linalg.norm(np.diff(route_m, axis=0), axis=1)
        along = np.concatenate([[0.0], lengths.cumsum()])
        stops = np.arange(horizon * parts + 1) * (longest_m / parts)
        stops = stops[stops < along[-1]]
        if len(stops) <= parts:
            return None
        at = np.column_stack([np.interp(stops, along, route_m[:, k]) for k in (0, 1)])
        ahead = np.gradient(at, axis=0)
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1e-12)[:, None]
        sideways = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        places = at[:, None] + longest_m * ASIDE[:, None] * sideways[:, None]
        count, choices = len(stops), len(ASIDE)
        legs = np.full((parts + 1, count, choices, choices), np.inf)
        for part in range(1, parts + 1):
            starts = np.repeat(places[:-part], choices, axis=1).reshape(-1, 2)
            ends = np.tile(places[part:], (1, choices, 1)).reshape(-1, 2)
            legs[part, part:] = self._legs_s(starts, ends, True).reshape(-1, choices, choices)
        cost, before = np.full((count, choices), np.inf), list[Indices]()
        cost[0, choices // 2] = 0.0
        for _ in range(horizon):
            through = np.full((parts + 1, choices, count, choices), np.inf)
            for part in range(1, parts + 1):
                through[part, :, part:] = np.moveaxis(
                    cost[:-part, :, None] + legs[part, part:], 0, 1
                )
            flat = through.reshape(-1, count, choices)
            before.append(flat.argmin(axis=0))
            cost = flat.min(axis=0)
        rest = [np.vstack([at[j : j + 1], route_m[along > stops[j]]]) for j in range(count)]
        whole = cost[:, choices // 2] + rate_s_m(self._problem) * np.array(
            [self._cost_of(each) for each in rest]
        )
        number, choice = int(whole.argmin()), choices // 2
        if not np.isfinite(whole[number]):
            return None
        found, chosen = [places[number, choice]], number
        for back in before[::-1]:
            part, choice = divmod(int(back[chosen, choice]), choices)
            chosen -= part
            found.append(places[chosen, choice])
        return np.array(found[::-1]), rest[number][1:]

    def _thinned(self, route_m: Floats) -> list[int]:
        """Return indices of vertices about one step apart, connected by collision-free legs."""
        # The numbers count from the vertex after the first. There are at most `WINDOW`.
        lengths = np.linalg.norm(np.diff(route_m, axis=0), axis=1)
        along = np.concatenate([[0.0], lengths.cumsum()])
        kept = [0]
        while kept[-1] < len(route_m) - 1 and len(kept) <= WINDOW:
            last = kept[-1]
            ahead = np.flatnonzero(along - along[last] <= self._longest_m)
            ahead = ahead[ahead > last]
            starts = np.broadcast_to(route_m[last], (len(ahead), 2))
            clear = ahead[segments_clear(self._index, starts, route_m[ahead], self._clearance_m)]
            kept.append(int(clear[-1]) if len(clear) else last + 1)
        return [number - 1 for number in kept[1:]]

    def with_route(self, plan: Plan, route_m: Floats) -> Plan:
        """Return the plan with `route_m` (n, 2) as its route, and with the cost of that route."""
        problem = self._problem
        ahead = Pivot(plan.positions_m[-1], integrated_cost_m(self._metre_cost, route_m))
        cost = ReachCost(problem, plan.positions_m[0], self._law.power, lambda _: ahead)
        places = np.vstack([plan.positions_m, route_m[1:]])
        holes = holes_on(problem, search_prediction(self._law, places), places)
        objective = cost(plan.positions_m[1:])
        return replace(plan, route_m=route_m[1:], pivot=ahead, objective=objective, holes=holes)
