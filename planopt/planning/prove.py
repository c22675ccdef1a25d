"""Smoothed routes of plans, and a proven bound on every plan's cost.

Routes of a lattice with sixteen headings are up to 2.7 % too long and zigzag around coverage.
Smoothing moves their points sideways: dynamic programming over a few offsets of each point finds
the cheapest combination, first with few points and large offsets, then with more points and smaller
offsets.

For a goal, :mod:`planopt.bounds.route` supplies the bound. It is compared with the time and effort
of the plan's steps, the cost rate of the route (equation 4.16), and the outage integrated along
both (equation 6.13).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import monotonic

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.bounds.bound import Bound, Tilts
from planopt.bounds.multipliers import local_optimum, tilts_near
from planopt.bounds.reach import rate_s_m, route_problem, why_unbounded
from planopt.bounds.route import route_bounds
from planopt.bounds.tube import tube_bounds
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.objectives.reach import integrated_cost_m, step_cost_s
from planopt.planning.candidates import Scorer
from planopt.planning.certificate import holes_on
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict
from planopt.planning.proof.bounds import bound_of, bound_of_sum, metre_cost_of, stages_of
from planopt.planning.proof.context import connectivity_law, search_prediction, verifier_context
from planopt.planning.proof.verify import verify
from planopt.planning.scene import stops_along
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.planning.values.context import Aim, StepContext, step_context
from planopt.planning.values.exploration import workspace_region
from planopt.planning.values.objective_value import ObjectiveValue, ReachCost
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import ObstacleIndex, index_obstacles, segments_clear

MetreCost = Callable[[Floats], Floats]
"""Function that maps positions (n, 2) to the cost per metre there; (n,)."""

PIECES = (8, 16, 32, 64, 128, 256)
"""Number of pieces into which each level of smoothing divides a route."""

OFFSETS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
"""Sideways displacements of a point in each pass, in units of the pass."""

WIDEST, NARROWEST = 0.25, 0.002
"""First and last unit of a smoothing level, in lengths of its pieces."""

FINEST = 2.0
"""Minimum length of a piece, in spacings of the cost raster."""

PASSES = 4
"""Maximum number of passes with the same unit."""

RASTER_SHARE = 3e-3
"""Spacing of the cost raster, as a share of the workspace diagonal; values are interpolated."""

RASTER_M = (0.2, 3.0)
"""Minimum and maximum spacing of the cost raster."""


def smooth_route(
    metre_cost: MetreCost,
    index: ObstacleIndex,
    bounds_m: tuple[float, float, float, float],
    clearance_m: float,
    corners_m: Floats,  # (n, 2)
) -> Floats:
    """Return a smoothed route (m, 2) between the same ends, which costs no more."""
    raster = CostRaster(metre_cost, bounds_m)
    total = float(np.linalg.norm(np.diff(corners_m, axis=0), axis=1).sum())
    route = corners_m
    for pieces in PIECES:
        longest = total / pieces
        if longest < FINEST * raster.spacing_m:
            break
        route = stops_along(_taut(raster, index, clearance_m, route), longest)
        unit = WIDEST * longest
        while unit > NARROWEST * longest:
            for _ in range(PASSES):
                moved = _moved(raster, index, bounds_m, clearance_m, route, unit)
                is_same = np.array_equal(moved, route)
                route = moved
                if is_same:
                    break
            unit *= 0.5
    costs_m = [integrated_cost_m(metre_cost, each) for each in (corners_m, route)]
    return route if costs_m[1] < costs_m[0] else corners_m


class CostRaster:
    """Raster of costs per metre, computed where needed and interpolated."""

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
        """Return the costs of straight legs (n, 2), by the midpoint rule."""
        lengths = np.linalg.norm(ends_m - starts_m, axis=1)
        count = max(1, math.ceil(float(lengths.max()) / self.spacing_m))
        share = (np.arange(count) + 0.5) / count
        places = starts_m[:, None] + share[None, :, None] * (ends_m - starts_m)[:, None]
        return lengths * self(places.reshape(-1, 2)).reshape(-1, count).mean(axis=1)


def _taut(
    raster: CostRaster, index: ObstacleIndex, clearance_m: float, corners_m: Floats
) -> Floats:
    """Return the cheapest route with straight legs between some of the corners (n, 2)."""
    count = len(corners_m)
    cost, before = np.full(count, np.inf), np.zeros(count, dtype=int)
    cost[0] = 0.0
    for k in range(1, count):
        first = np.arange(max(0, k - 40), k)
        ends = np.broadcast_to(corners_m[k], (len(first), 2))
        legs = raster.legs_m(corners_m[first], ends)
        clear = segments_clear(index, corners_m[first], ends, clearance_m)
        clear[-1] = True
        through = np.where(clear, cost[first] + legs, np.inf)
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
    """Return the cheapest route after one pass of sideways moves; its ends stay."""
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

STEP_PASSES = 6
"""Maximum number of passes with the same unit."""


def smooth_steps(
    leg_value: Callable[[Floats, Floats], Floats], places_m: Floats, longest_m: float
) -> Floats:
    """Return positions (k + 1, 2) moved to reduce the cost of the legs; first and last stay.

    `leg_value` maps starts and ends (n, k, 2) of the k legs to costs (n, k), infinite if a leg is
    not allowed.
    """
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


STEP_SHARES = np.linspace(1.0, 0.0, 21)
"""Lengths of a step to try in this order, in longest steps."""

ROUNDS, LEAST_GAIN = 3, 1e-4
"""Maximum number of alternations of smoothing steps and route, and minimum relative gain of one."""

LEAST_SHARE = 0.3
"""Minimum share of the time that is reserved for the bound."""

SURPLUS = 2e-5
"""Surplus of the probability of connection over the bound's p_min in an improved plan."""

INSIDE_GOAL = 0.999
"""Distance of a smoothed route's end from the goal, as a share of the goal's radius."""


def proven_plans(
    problem: Problem, belief: Belief, plans: Sequence[Plan], aims: Sequence[Aim], seconds: float
) -> tuple[Plan, ...]:
    """Return the plans with proven bounds, and with smoothed routes if these are cheaper.

    Each robot gets the same share of the time.
    """
    found: list[Plan] = []
    for number, (plan, aim) in enumerate(zip(plans, aims, strict=True)):
        own = problem_of_robot(problem, number)
        share = seconds / len(plans)
        if problem.task != "reach":
            found.append(with_sum_bound(own, belief, plan, aim, share, len(plans)))
            continue
        reason = why_unbounded(own, belief.posteriors)
        if reason:
            found.append(replace(plan, bound=Bound(None, plan.objective, reason=reason)))
            continue
        begun = monotonic()
        plan = with_smooth_route(own, belief.posteriors, plan, len(plans) == 1)
        left = max(LEAST_SHARE * share, share - (monotonic() - begun))
        # Bounds never get worse.
        best = list(route_bounds(route_problem(own, belief.posteriors), left))[-1]
        bound = bound_of(own, belief.posteriors, plan, best.value_m, best.potential, len(plans))
        found.append(replace(plan, bound=replace(bound, wall_s=best.seconds)))
    return tuple(found)


def with_sum_bound(
    problem: Problem, belief: Belief, plan: Plan, aim: Aim, seconds: float, robots: int
) -> Plan:
    """Return the first robot's plan or a better one near it, with a bound on its sum of terms."""
    begun, index = monotonic(), index_obstacles(problem.workspace)
    start = plan.positions_m[0] if plan.drive is None else plan.drive.states[0]
    base = verifier_context(problem, index, belief.posteriors, start)
    at = step_context(base, workspace_region(problem), aim)
    stages = stages_of(problem, at, plan)
    if isinstance(stages, str):
        return replace(plan, bound=Bound(None, plan.objective, reason=stages))
    optimum = local_optimum(stages, plan.positions_m[1:], SURPLUS)
    if robots == 1 or problem.constraints.separation_m == 0.0:
        plan = better_of(at, plan, optimum)
    kinks = np.vstack([each.measurements.positions_m for each in belief.posteriors])
    tilts = tilts_near(stages, [plan.positions_m[1:], optimum], kinks)
    left = max(LEAST_SHARE * seconds, seconds - (monotonic() - begun))
    *_, best = tube_bounds(stages, plan.objective, tilts, left)
    of_steps, of_p_min = (np.array(each) for each in zip(*tilts, strict=True))
    tilted = Tilts(of_steps, of_p_min, best.levels, best.value)
    bound = bound_of_sum(problem, plan, tilted, robots)
    return replace(plan, bound=replace(bound, wall_s=monotonic() - begun))


def better_of(at: StepContext, plan: Plan, path_m: Floats) -> Plan:
    """Return the plan of a path (N, 2), its steps shortened, if it is verified and better."""
    if plan.drive is not None:
        return plan
    path, here = path_m.copy(), plan.positions_m[0]
    longest = at.step_length_m - STEP_PAD_M
    for k, place in enumerate(path_m):
        move = place - here
        here = here + move * min(1.0, longest / max(float(np.hypot(*move)), longest))
        path[k] = here
    scorer = Scorer(at, ObjectiveValue(at))
    found = scorer.assessed(scorer.candidate(path, plan.rung, Termination.LATTICE_ONLY))
    if found.verdict is not Verdict.VERIFIED or not found.objective > plan.objective:
        return plan
    return scorer.plan_from(found, plan.wall_s)


def with_smooth_route(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan, alone: bool
) -> Plan:
    """Return the plan with a smoothed route, whose integrated cost is the new cost-to-go.

    If the robot is `alone`, its steps are smoothed as well, if the verifier accepts them and they
    are cheaper. Plans of robots with dynamics, and plans without a route, are returned unchanged.
    """
    if plan.drive is not None or plan.pivot is None or not len(plan.route_m):
        return plan
    smoothing = _Smoothing(problem, posteriors)
    found = smoothing.with_route(plan, smoothing.route(plan.positions_m[-1:], plan.route_m))
    if not alone or problem.workspace.moving or problem.workspace.timed:
        return found
    whole = smoothing.route(found.positions_m, found.route_m)
    for begin in (found, smoothing.cruising(found, whole)):
        best = begin
        for _ in range(ROUNDS):
            other = smoothing.driven(best)
            if other is None or other.objective >= best.objective * (1.0 - LEAST_GAIN):
                break
            best = other
            if best.objective < found.objective:
                found = best
    return found


class _Smoothing:
    """Smoothing of routes in one problem with one belief."""

    def __init__(self, problem: Problem, posteriors: Sequence[ChannelPosterior]) -> None:
        self._problem, self._posteriors = problem, posteriors
        self._law = connectivity_law(problem, posteriors)
        self._index = index_obstacles(problem.workspace)
        self._raster = CostRaster(metre_cost_of(problem, posteriors), problem.workspace.bounds_m)
        self._metre_cost: MetreCost = lambda places_m: np.ones(len(places_m))
        if problem.reach.cost_to_go == "connected":
            self._metre_cost = metre_cost_of(problem, posteriors)

    def route(self, first_m: Floats, rest_m: Floats) -> Floats:
        """Return a smoothed route (n, 2) that ends inside the goal."""
        constraints, goal = self._problem.constraints, np.asarray(self._problem.goal_m)
        corners = np.vstack([first_m, rest_m])
        last = corners[-2] - goal
        away = float(np.linalg.norm(last))
        if constraints.goal_radius_m < away:
            corners[-1] = goal + INSIDE_GOAL * constraints.goal_radius_m / away * last
        return smooth_route(
            self._metre_cost,
            self._index,
            self._problem.workspace.bounds_m,
            constraints.clearance_m + CLEARANCE_PAD_M,
            corners,
        )

    def _thinned(self, route_m: Floats, longest_m: float) -> Floats:
        """Return vertices of a route (n, 2) about `longest_m` apart, with collision-free legs."""
        clearance_m = self._problem.constraints.clearance_m + CLEARANCE_PAD_M
        lengths = np.linalg.norm(np.diff(route_m, axis=0), axis=1)
        along = np.concatenate([[0.0], lengths.cumsum()])
        kept = [0]
        while kept[-1] < len(route_m) - 1:
            last = kept[-1]
            ahead = np.flatnonzero(along - along[last] <= longest_m)
            ahead = ahead[ahead > last]
            starts = np.broadcast_to(route_m[last], (len(ahead), 2))
            clear = ahead[segments_clear(self._index, starts, route_m[ahead], clearance_m)]
            kept.append(int(clear[-1]) if len(clear) else last + 1)
        return route_m[kept]

    def with_route(self, plan: Plan, route_m: Floats) -> Plan:
        """Return the plan with another route (n, 2) from its last position, and its new cost."""
        problem = self._problem
        ahead = Pivot(plan.positions_m[-1], integrated_cost_m(self._metre_cost, route_m))
        cost = ReachCost(problem, plan.positions_m[0], self._law.power, lambda _: ahead)
        places = np.vstack([plan.positions_m, route_m[1:]])
        holes = holes_on(problem, search_prediction(self._law, places), places)
        objective = cost(plan.positions_m[1:])
        return replace(plan, route_m=route_m[1:], pivot=ahead, objective=objective, holes=holes)

    def cruising(self, plan: Plan, route_m: Floats) -> Plan:
        """Return an unverified plan with full steps along a route (n, 2), as an initial guess."""
        problem = self._problem
        clearance_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        lengths = np.linalg.norm(np.diff(route_m, axis=0), axis=1)
        line = route_m[np.concatenate([[True], lengths > 0.0])]
        along = np.concatenate([[0.0], lengths[lengths > 0.0].cumsum()])
        places, reached = [route_m[0]], 0.0
        for _ in range(problem.planner.horizon):
            step_m = (problem.step_length_m - STEP_PAD_M) * STEP_SHARES
            stops = np.minimum(reached + step_m, along[-1])
            ends = np.column_stack([np.interp(stops, along, line[:, k]) for k in (0, 1)])
            starts = np.broadcast_to(places[-1], ends.shape)
            clear = segments_clear(self._index, starts, ends, clearance_m)
            chosen = int(clear.argmax()) if clear.any() else len(stops) - 1
            places.append(ends[chosen])
            reached = float(stops[chosen])
        guess = replace(plan, positions_m=np.array(places), objective=np.inf)
        return replace(guess, route_m=line[along > reached])

    def driven(self, plan: Plan) -> Plan | None:
        """Return a plan with smoothed steps and route; None if the verifier rejects it."""
        problem, route = self._problem, plan.route_m
        if not len(route):
            return None
        planner, reach = problem.planner, problem.reach
        longest, rate = problem.step_length_m - STEP_PAD_M, rate_s_m(problem)
        clearance_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        low, high = np.reshape(problem.workspace.bounds_m, (2, 2))

        def leg_value(starts_m: Floats, ends_m: Floats) -> Floats:
            shape = starts_m.shape[:2]
            starts, ends = starts_m.reshape(-1, 2), ends_m.reshape(-1, 2)
            lengths = np.linalg.norm(ends - starts, axis=1)
            cost = rate * self._raster.legs_m(starts, ends)
            steps_s = step_cost_s(lengths, planner.step_s, reach.effort_weight_s2_m2)
            is_step = np.ones(shape, dtype=bool)
            is_step[:, horizon:] = False
            is_step = is_step.ravel()
            cost += np.where(is_step, steps_s - rate * lengths, 0.0)
            allowed = segments_clear(self._index, starts, ends, clearance_m)
            allowed &= ~is_step | (lengths <= longest)
            allowed &= ((ends >= low) & (ends <= high)).all(axis=1)
            return np.where(allowed, cost, np.inf).reshape(shape)

        horizon = planner.horizon
        coarse = self._thinned(np.vstack([plan.positions_m[-1:], route]), longest)
        places = smooth_steps(leg_value, np.vstack([plan.positions_m, coarse[1:]]), longest)
        positions = places[: horizon + 1]
        rest = self.route(positions[-1:], places[horizon + 1 :])
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
        return self.with_route(found, rest)
