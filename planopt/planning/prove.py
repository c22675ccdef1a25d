"""Proof of a plan's quality: a smoothed route, its cost, and a bound on every plan's cost.

For a goal the bound is that of :mod:`planopt.bounds.route`. The cost that is compared with it has
the time and effort of the plan's steps, the rate (4.16) for the route, and the outage integrated
along both (equation 6.13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from planopt.bounds.bound import Bound
from planopt.bounds.reach import rate_s_m, route_problem, why_unbounded
from planopt.bounds.route import route_bounds
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.objectives.reach import integrated_cost_m, step_cost_s
from planopt.planning.certificate import holes_on
from planopt.planning.plan import Pivot, Plan, Rung, Termination, Verdict
from planopt.planning.proof.bounds import bound_of, metre_cost_of
from planopt.planning.proof.context import (
    connectivity_law,
    search_prediction,
    verifier_context,
)
from planopt.planning.proof.verify import verify
from planopt.planning.search.route_smoothing import CostRaster, smooth_route, smooth_steps
from planopt.planning.tolerances import CLEARANCE_PAD_M, STEP_PAD_M
from planopt.planning.values.objective_value import ReachCost
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import index_obstacles, segments_clear

STEP_SHARES = np.linspace(1.0, 0.0, 21)
"""Lengths of a step that are tried in this order, in longest steps."""

ROUNDS, LEAST_GAIN = 3, 1e-4
"""Maximum number of alternations between steps and route, and the least relative gain of one."""

LEAST_SHARE = 0.3
"""Least share of the time for the bound, however long smoothing takes."""

INSIDE_GOAL = 0.999
"""Share of the goal's radius at which a smoothed route ends."""


def proven_plans(
    problem: Problem, belief: Belief, plans: Sequence[Plan], seconds: float
) -> tuple[Plan, ...]:
    """Return plans with bounds, and with smoothed routes where these are cheaper.

    The time is shared evenly by the robots.
    """
    found: list[Plan] = []
    for number, plan in enumerate(plans):
        own = problem_of_robot(problem, number)
        share = seconds / len(plans)
        reason = why_unbounded(own, belief.posteriors)
        if reason:
            found.append(replace(plan, bound=Bound(None, plan.objective, reason=reason)))
            continue
        begun = monotonic()
        plan = with_smooth_route(own, belief.posteriors, plan, len(plans) == 1)
        left = max(LEAST_SHARE * share, share - (monotonic() - begun))
        # Each bound is at least as good as the one before.
        best = list(route_bounds(route_problem(own, belief.posteriors), left))[-1]
        bound = bound_of(own, belief.posteriors, plan, best.value_m, best.potential, len(plans))
        found.append(replace(plan, bound=replace(bound, wall_s=best.seconds)))
    return tuple(found)


def with_smooth_route(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan, alone: bool
) -> Plan:
    """Return the plan with a smoothed route, whose integrated cost is the new cost-to-go.

    A robot that is `alone` drives the first steps of the smoothed route itself, if the verifier
    accepts them and they are cheaper. Plans of robots with dynamics, and those without a route, are
    unchanged.
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
        is_charged = problem.reach.cost_to_go == "connected"
        self._metre_cost = metre_cost_of(problem, posteriors) if is_charged else _ones

    def route(
        self, first_m: NDArray[np.float64], rest_m: NDArray[np.float64]
    ) -> NDArray[np.float64]:
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

    def _thinned(self, route_m: NDArray[np.float64], longest_m: float) -> NDArray[np.float64]:
        """Return vertices of a route (n, 2) about `longest_m` apart, with clear legs."""
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

    def with_route(self, plan: Plan, route_m: NDArray[np.float64]) -> Plan:
        """Return the plan with a route (n, 2) from its last position."""
        problem = self._problem
        ahead = Pivot(plan.positions_m[-1], integrated_cost_m(self._metre_cost, route_m))
        cost = ReachCost(problem, plan.positions_m[0], self._law.power, lambda _: ahead)
        places = np.vstack([plan.positions_m, route_m[1:]])
        holes = holes_on(problem, search_prediction(self._law, places), places)
        objective = cost(plan.positions_m[1:])
        return replace(plan, route_m=route_m[1:], pivot=ahead, objective=objective, holes=holes)

    def cruising(self, plan: Plan, route_m: NDArray[np.float64]) -> Plan:
        """Return a plan, to be verified, with full steps along a route (n, 2), as a guess."""
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
        """Return a plan with smoothed steps and route; None if it is not verified."""
        problem, route = self._problem, plan.route_m
        if not len(route):
            return None
        planner, reach = problem.planner, problem.reach
        longest, rate = problem.step_length_m - STEP_PAD_M, rate_s_m(problem)
        clearance_m = problem.constraints.clearance_m + CLEARANCE_PAD_M
        low, high = np.reshape(problem.workspace.bounds_m, (2, 2))

        def leg_value(
            starts_m: NDArray[np.float64], ends_m: NDArray[np.float64]
        ) -> NDArray[np.float64]:
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


def _ones(places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ones(len(places_m))
