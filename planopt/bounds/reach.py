"""Route problem that bounds one robot's objective: cost per metre and free space.

A bound is stated only if every plan of the robot costs at least the cheapest route of the route
problem. Constraints that only raise the cost are ignored and listed.
"""

from collections.abc import Sequence

import numpy as np

from planopt.bounds.bound import SEPARATION
from planopt.bounds.route import RouteProblem
from planopt.channel.posterior import ChannelPosterior
from planopt.problems.problem import Problem
from planopt.robots.models import DoubleIntegrator, SingleIntegrator, Unicycle

LEAST_FADING_DB = 0.05
"""Minimum standard deviation of multipath fading for which probabilities can be bounded."""
MOVING = "moving obstacles"  # Words for a constraint that the bound of a route ignores
SAG_SHARE = 1.001
"""Factor on the sag of a step (distance from its chord), for the verifier's input tolerance."""


def why_unbounded(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> str:
    """Return the reason why the first robot's objective has no bound; empty if it has one."""
    if problem.constraints.rule.slack_max_db and len(problem.stations) > 1:
        return "no bound is implemented for slack_max_db with several stations"
    return why_not_enclosed(problem, posteriors)


def why_not_enclosed(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> str:
    """Return the reason why the first robot's probabilities or moves are unbounded, else ""."""
    if problem.constraints.rule.parameter_uncertainty != "path_loss":
        return "no bound is implemented for constraints.parameter_uncertainty = all"
    if any((posterior.measurements.receiver != 0).any() for posterior in posteriors):
        return "no bound is implemented for several receivers"
    if any(not posterior.has_factor for posterior in posteriors):
        return f"no bound is implemented beyond {posteriors[0].exact_limit:,} measurements"
    if any(posterior.theta_rule == "least_squares" for posterior in posteriors):
        return "no bound is implemented for path loss by least squares"
    if any(posterior.parameters.multipath_std_db < LEAST_FADING_DB for posterior in posteriors):
        return f"no bound is implemented for multipath fading below {LEAST_FADING_DB:g} dB"
    if longest_sag_m(problem) is None:
        return "no bound is implemented for user-defined dynamics"
    return ""


def relaxed_constraints(problem: Problem, robots: int) -> tuple[str, ...]:
    """Return descriptions of the constraints that the bound of a robot ignores."""
    rule = problem.constraints.rule
    found: list[str] = []
    if problem.constraints.requires_connection and not rule.is_plain:
        name = "p_min at each step" if rule.by_step else f"the rule {rule.connectivity}"
        found.append(f"{name} (outage is only priced)")
    return (*found, *ignored_motion(problem, robots))


def ignored_motion(problem: Problem, robots: int) -> tuple[str, ...]:
    """Return descriptions of the motion constraints that no bound considers."""
    found: list[str] = []
    if problem.workspace.moving:
        found.append(MOVING)
    if problem.workspace.timed:
        found.append("obstacles that appear or disappear")
    if not problem.robots[0].moves_freely:
        found.append("inertia and turning")
    if robots > 1 and problem.constraints.separation_m > 0.0:
        found.append(SEPARATION)
    return tuple(found)


def longest_sag_m(problem: Problem) -> float | None:
    """Return the maximum distance of a step from its chord; None if unknown (equation 6.18)."""
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if type(dynamics) is SingleIntegrator:
        return 0.0
    if type(dynamics) is DoubleIntegrator:
        return SAG_SHARE * dynamics.acceleration_max_m_s2 * step_s**2 / 8.0
    if type(dynamics) is Unicycle and -dynamics.speed_min_m_s <= dynamics.speed_max_m_s:
        return SAG_SHARE * dynamics.speed_max_m_s * dynamics.turn_rate_max_rad_s * step_s**2 / 8.0
    return None


def route_problem(problem: Problem, posteriors: Sequence[ChannelPosterior]) -> RouteProblem:
    """Return the route problem that bounds the objective of a problem's first robot."""
    reach, constraints = problem.reach, problem.constraints
    slack_db = constraints.rule.slack_max_db or 0.0
    # A geodesic cost-to-go does not penalise outage beyond the horizon.
    price = reach.outage_price if reach.cost_to_go == "connected" else 0.0
    return RouteProblem(
        bounds_m=problem.workspace.bounds_m,
        obstacles=[obstacle.polygon for obstacle in problem.workspace.lasting],
        clearance_m=constraints.clearance_m - (longest_sag_m(problem) or 0.0),
        start_m=np.asarray(problem.robots[0].start_m, dtype=np.float64),
        goal_m=np.asarray(problem.goal_m, dtype=np.float64),
        goal_radius_m=constraints.goal_radius_m,
        price=price,
        free_above=2.0 if reach.charges_everywhere else constraints.p_min,
        posteriors=posteriors,
        thresholds_dbm=[station.threshold_dbm - slack_db for station in problem.stations],
    )
