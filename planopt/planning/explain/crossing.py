"""Why a plan's way to a goal crosses coverage holes, and what keeping contact would take."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.explain.explanation import Crossing
from planopt.planning.ground import first_moves
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.robot_problem import problem_of_robot
from planopt.planning.scene import Scene, build_scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.problems.problem import Problem
from planopt.world.road_map import shortest_ways, way_from

BY_ALL_MEANS = 1e4
"""Price at which contact counts first and length second."""


def crossings(
    problem: Problem, plans: Sequence[Plan], posteriors: Sequence[ChannelPosterior]
) -> tuple[Crossing, ...]:
    """Return what verified plans to goals cross and why, one for each robot that crosses a hole.

    Parameters
    ----------
    problem
        With all robots.
    plans
        Of each robot, in the problem's order.
    posteriors
        What is believed of each station.
    """
    found = [
        explain_crossing(problem_of_robot(problem, number), posteriors, plan)
        for number, plan in enumerate(plans)
        if plan.verdict is Verdict.VERIFIED
    ]
    return tuple(one for one in found if one is not None)


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return what a robot's way to its goal crosses and why; None where it keeps the bound.

    Parameters
    ----------
    problem
        With this robot alone.
    posteriors
        What is believed of each station.
    plan
        The robot's plan from its start.
    """
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min)
    margins.refresh(posteriors[0], broad_prediction(problem, posteriors))
    price, start = problem.reach.outage_price, plan.positions_m[0]
    cost_m, _ = _way(problem, scene, margins, start, price * margins.outage_share)
    _, way = _way(problem, scene, margins, start, np.where(margins.outside, BY_ALL_MEANS, 0.0))
    lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
    outside = margins.at(way)[0] < 0.0
    return Crossing(
        plan.robot,
        plan.holes,
        cost_m,
        price,
        float(lengths.sum()),
        float(0.5 * lengths @ (outside[:-1].astype(float) + outside[1:])),
        constraints.p_min,
    )


def _way(
    problem: Problem,
    scene: Scene,
    margins: NodeMargins,
    start_m: NDArray[np.float64],
    surcharge: NDArray[np.float64],
) -> tuple[float, NDArray[np.float64]]:
    """Cost and places (n, 2) of the cheapest way from a place to the goal.

    A metre at each node costs one and its `surcharge` (n,).
    """
    road_map = scene.road_map
    ways = shortest_ways(road_map, scene.goal_node, 1.0 + surcharge)
    nodes, lengths = first_moves(scene.ground, problem, start_m)
    first = int(np.argmin(lengths * (1.0 + surcharge[nodes]) + ways.cost_m[nodes]))
    cost_m = float(lengths[first] * (1.0 + surcharge[nodes[first]]) + ways.cost_m[nodes[first]])
    rest = way_from(road_map, ways, int(nodes[first]), np.inf)
    return cost_m, np.vstack([start_m, road_map.nodes_m[rest]])
