"""Proof of a plan's quality: a smoothed route, its cost, and a bound on every plan's cost.

For a goal the bound is that of :mod:`planopt.bounds.route`. The cost that is compared with it has
the time and effort of the plan's steps, the rate (4.16) for the route, and the outage integrated
along both (equation 6.13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.bounds.bound import Bound
from planopt.bounds.reach import route_problem, why_unbounded
from planopt.bounds.route import route_bounds
from planopt.channel.posterior import Belief, ChannelPosterior
from planopt.objectives.reach import integrated_cost_m
from planopt.planning.certificate import holes_on
from planopt.planning.plan import Pivot, Plan
from planopt.planning.proof.bounds import bound_of, metre_cost_of
from planopt.planning.proof.context import connectivity_law, search_prediction
from planopt.planning.search.route_smoothing import smooth_route
from planopt.planning.tolerances import CLEARANCE_PAD_M
from planopt.planning.values.objective_value import ReachCost
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.clearance import index_obstacles

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
        plan = with_smooth_route(own, belief.posteriors, plan)
        # Each bound is at least as good as the one before.
        best = list(route_bounds(route_problem(own, belief.posteriors), share))[-1]
        bound = bound_of(own, belief.posteriors, plan, best.value_m, best.potential, len(plans))
        found.append(replace(plan, bound=replace(bound, wall_s=best.seconds)))
    return tuple(found)


def with_smooth_route(problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan) -> Plan:
    """Return the plan with a smoothed route, whose integrated cost is the new cost-to-go.

    Plans of robots with dynamics, and those without a route, are unchanged.
    """
    if plan.drive is not None or plan.pivot is None or not len(plan.route_m):
        return plan
    constraints, goal = problem.constraints, np.asarray(problem.goal_m)
    corners = np.vstack([plan.positions_m[-1:], plan.route_m])
    last = corners[-2] - goal
    away = float(np.linalg.norm(last))
    if constraints.goal_radius_m < away:
        corners[-1] = goal + INSIDE_GOAL * constraints.goal_radius_m / away * last
    metre_cost = metre_cost_of(problem, posteriors)
    if problem.reach.cost_to_go != "connected":
        metre_cost = _ones
    route = smooth_route(
        metre_cost,
        index_obstacles(problem.workspace),
        problem.workspace.bounds_m,
        constraints.clearance_m + CLEARANCE_PAD_M,
        corners,
    )
    ahead = Pivot(plan.positions_m[-1], integrated_cost_m(metre_cost, route))
    law = connectivity_law(problem, posteriors)
    cost = ReachCost(problem, plan.positions_m[0], law.power, lambda _: ahead)
    places = np.vstack([plan.positions_m, route[1:]])
    holes = holes_on(problem, search_prediction(law, places), places)
    objective = cost(plan.positions_m[1:])
    return replace(plan, route_m=route[1:], pivot=ahead, objective=objective, holes=holes)


def _ones(places_m: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ones(len(places_m))
