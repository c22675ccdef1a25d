"""Cost of reaching a goal: travel time, effort and distance out of contact, with cost-to-go.

A step of length l and duration h that starts short of the goal costs ``h + w l^2 / h``. A path of
length D beyond the horizon costs at least ``D min_v (1 + w v^2) / v`` (equation 4.16); this minimum
is the cost rate. A metre at probability of connection P counts as ``1 + price (1 - P)`` metres.
"""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from planopt.arrays import Floats, Mask
from planopt.problems.problem import Problem


def cruising_speed_m_s(effort_weight_s2_m2: float, speed_max_m_s: float) -> float:
    """Return the speed of least cost per metre: ``1 / sqrt(w)``, at most `speed_max_m_s`."""
    if effort_weight_s2_m2 > 0.0:
        return min(speed_max_m_s, effort_weight_s2_m2**-0.5)
    return speed_max_m_s


def cost_rate_s_m(effort_weight_s2_m2: float, speed_max_m_s: float) -> float:
    """Return the least cost per metre in s/m: min over 0 < v <= v_max of (1 + w v^2) / v."""
    best = cruising_speed_m_s(effort_weight_s2_m2, speed_max_m_s)
    return (1.0 + effort_weight_s2_m2 * best**2) / best


def rate_s_m(problem: Problem) -> float:
    """Return the least cost per metre in s/m of a problem's first robot (equation 4.16)."""
    return cost_rate_s_m(problem.reach.effort_weight_s2_m2, problem.robots[0].speed_max_m_s)


def step_cost_s(length_m: Floats, step_s: float, effort_weight_s2_m2: float) -> Floats:
    """Return the cost in seconds of steps of lengths `length_m` that start short of the goal."""
    return step_s + effort_weight_s2_m2 * length_m**2 / step_s


def outage_share(probability: Floats, is_below: Mask, everywhere: bool = False) -> Floats:
    """Return the share of a metre at each position that counts as out of contact."""
    return np.where(is_below | everywhere, 1.0 - probability, 0.0)


def charged_length_m(lengths_m: Floats, share: Floats) -> float:
    """Return a path's length out of contact, from its step lengths and outage shares."""
    # Shapes: lengths_m (n,); share (n + 1,).
    return float(0.5 * lengths_m @ (share[:-1] + share[1:]))


PIECE_M = 1.0
"""Maximum interval of the quadrature of a route's cost, in metres."""

GAUSS = np.polynomial.legendre.leggauss(3)


def integrated_cost_m(metre_cost: Callable[[Floats], Floats], places_m: Floats) -> float:
    """Return the integral of the cost per metre along a polyline (n, 2), by quadrature."""
    lengths = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    at, weights = 0.5 * (GAUSS[0] + 1.0), 0.5 * GAUSS[1]
    points, shares = [np.zeros((0, 2))], [np.zeros(0)]
    for (begin, end), length in zip(pairwise(places_m), lengths.tolist(), strict=True):
        if length == 0.0:
            continue
        count = math.ceil(length / PIECE_M)
        along = np.add.outer(np.arange(count, dtype=np.float64), at).ravel() / count
        points.append(begin + along[:, None] * (end - begin))
        shares.append(np.tile(weights * length / count, count))
    return float(metre_cost(np.concatenate(points)) @ np.concatenate(shares))


def path_cost_s(
    positions_m: Floats,
    goal_m: Floats,
    goal_radius_m: float,
    step_s: float,
    effort_weight_s2_m2: float,
    resting_m: Floats | None = None,
) -> float:
    """Return the cost of a path (n + 1, 2) up to its end or arrival, without cost-to-go."""
    # A robot with dynamics has arrived once it can also stop at the goal. `resting_m` (n + 1, 2) is
    # its rest position after braking from each position.
    lengths = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    short_of_goal = np.linalg.norm(positions_m[:-1] - goal_m, axis=1) > goal_radius_m
    if resting_m is not None:
        short_of_goal |= np.linalg.norm(resting_m[:-1] - goal_m, axis=1) > goal_radius_m
    costs = np.where(short_of_goal, step_cost_s(lengths, step_s, effort_weight_s2_m2), 0.0)
    return float(costs.sum())


def steps_cost_s(problem: Problem, positions_m: Floats, resting_m: Floats | None = None) -> float:
    """Return the :func:`path_cost_s` of a path (n + 1, 2) of a problem's first robot."""
    radius_m, step_s = problem.constraints.goal_radius_m, problem.planner.step_s
    weight, goal = problem.reach.effort_weight_s2_m2, np.asarray(problem.goal_m)
    return path_cost_s(positions_m, goal, radius_m, step_s, weight, resting_m)
