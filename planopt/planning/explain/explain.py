"""Explain a problem without verified plan, and plans that cross coverage holes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError, NoPlanError
from planopt.parts import part_of
from planopt.planning.explain.explanation import Case, Crossing, Explanation, Relaxation
from planopt.planning.explain.no_verified_plan import (
    Deadline,
    deadline_from_now,
    explain_no_verified_plan,
)
from planopt.planning.explain.no_way import explain_blocked, explain_no_way, is_open
from planopt.planning.given import team_seeds
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Plan, Verdict
from planopt.planning.prepare import prepare
from planopt.planning.proof.predictions import broad_prediction
from planopt.planning.scene import Scene, build_scene, first_moves
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.solution import Solution
from planopt.planning.solve import solve, solve_on
from planopt.planning.team.reservations import beside, others_of, planned_motion
from planopt.planning.team.team_step import build_team
from planopt.problems.problem import Problem, problem_of_robot
from planopt.world.road_map import shortest_ways, way_from


@one_blas_thread()
def explain(asked: Solution | Problem, seed: int = 0) -> Explanation:
    """Return changes that would give every robot a verified plan, and why holes are crossed.

    There are none of a verified plan, which keeps all bounds; ``print(explain(...))`` says so.

    Each change is by itself, and of its robot alone. Problems are solved again with the proposed
    value, for some seconds in all. For a verified plan that crosses coverage holes on the way to
    its goal these are listed, with the length of the way that keeps contact.

    Parameters
    ----------
    asked
        From :func:`planopt.solve`; or a problem, which is solved first. Where that raises a
        `NoPlanError`, what would open a way to the goal is returned.
    seed
        That the problem was planned with; a solution knows its own.

    Examples
    --------
    >>> import planopt
    >>> print(planopt.explain(planopt.load("open_field")))
    Every plan is verified: it keeps all bounds.
    """
    if not isinstance(asked, Problem):
        remedy = "give a Problem, or what planopt.solve returned"
        return _explain_solution(part_of("asked", asked, Solution, remedy))
    try:
        solution = solve(asked, seed=seed)
    except (NoPlanError, InputError) as error:
        # What opens a way can be said without measurements as well.
        found = explain_no_plan(asked, seed)
        if not found and isinstance(error, InputError):
            raise
        return Explanation(found, _summary(Verdict.NONE, found))
    return _explain_solution(solution)


def _summary(verdict: Verdict, found: Sequence[Relaxation]) -> str:
    if verdict is Verdict.VERIFIED:
        return "Every plan is verified: it keeps all bounds."
    said = "There is no plan" if verdict is Verdict.NONE else "Not every plan is verified"
    if found:
        return f"{said}; each of these changes by itself would help, as far as it is verified:"
    return f"{said}; no change of a single key or obstacle that was tried helps."


def _explain_solution(solution: Solution) -> Explanation:
    found: list[Relaxation] = []
    problem, deadline = solution.problem, deadline_from_now()
    motions = [planned_motion(problem, plan) for plan in solution.plans]
    for number, plan in enumerate(solution.plans):
        if plan.verdict is Verdict.VERIFIED:
            continue
        moving = beside(problem, 0, others_of(motions, number))
        case = Case(problem, number, solution.belief.posteriors, plan, moving)

        def plan_again(changed: Problem, number: int = number) -> Plan | None:
            return _planned(changed, solution, number)

        found += explain_no_verified_plan(case, plan_again, deadline)
    crossed = crossings(problem, solution.plans, solution.belief.posteriors)
    return Explanation((*found, *crossed), _summary(solution.verdict, found))


def _planned(problem: Problem, solution: Solution, number: int) -> Plan | None:
    """Plan a changed problem for one robot; with the others if they keep apart."""
    if problem.task == "reach":
        return _reached(problem, solution.belief, number)
    if problem.constraints.separation_m > 0.0:
        return solve_on(problem, solution.belief, solution.seed).plans[number]
    seeds = team_seeds(problem, solution.seed)
    watch = watch_target(problem, seeds.target)
    watched = aim_of(watch, number, problem.planner.horizon)
    member = build_team(problem, seeds)[number]
    moving = beside(problem, 0, {})
    return member.plan(solution.belief, member.start, watched, None, moving)[0]


@one_blas_thread()
def explain_no_plan(problem: Problem, seed: int) -> tuple[Relaxation, ...]:
    """Return what would open a way to the goal of a problem that has none; each change suffices.

    With several robots, to the goals of those that have no way if they are alone. Parameters are
    those of :func:`explain`.
    """
    deadline = deadline_from_now()
    owns = [problem_of_robot(problem, number) for number in range(len(problem.robots))]
    try:
        belief = prepare(problem, seed).belief
    except InputError:
        # Without measurements nothing can be solved again; what opens a way can still be said.
        shut = [own for own in owns if not is_open(own)]
        return tuple(
            one for own in shut for one in explain_no_way(own, lambda _: Verdict.NONE, deadline)
        )
    found: list[Relaxation] = []
    for own in owns:
        if len(owns) == 1 or _reached(own, belief) is None:
            found += _explain_robot(own, belief, deadline)
    return tuple(found)


def _explain_robot(problem: Problem, belief: Belief, deadline: Deadline) -> tuple[Relaxation, ...]:
    """Explain why the only robot of a problem has no way to its goal."""
    scenes: list[Scene] = []

    def solve_again(changed: Problem) -> Verdict:
        if deadline.over:
            return Verdict.NONE
        plan = _reached(changed, belief, scenes=scenes or None)
        return Verdict.NONE if plan is None else plan.verdict

    try:
        scene = build_scene(problem)
    except NoPlanError:
        return explain_no_way(problem, solve_again, deadline)
    scenes.append(scene)  # no bound on connectivity changes the ground
    radio, p_min = problem.stations[0], problem.constraints.p_min
    margins = NodeMargins(scene.road_map, radio.threshold_dbm, p_min)
    margins.refresh(belief.posterior, broad_prediction(problem, belief.posteriors))
    first, _ = first_moves(scene.ground, problem, np.asarray(problem.robots[0].start_m))
    return explain_blocked(problem, scene.road_map, first, scene.goal_node, margins, solve_again)


def _reached(
    problem: Problem, belief: Belief, number: int = 0, scenes: Sequence[Scene] | None = None
) -> Plan | None:
    """Plan a changed problem to its goal, on its ground; None where nothing leads there."""
    try:
        return solve_on(problem, belief, 0, scenes).plans[number]
    except NoPlanError:
        return None


BY_ALL_MEANS = 1e4
"""Price at which contact counts first and length second."""


def crossings(
    problem: Problem, plans: Sequence[Plan], posteriors: Sequence[ChannelPosterior]
) -> tuple[Crossing, ...]:
    """Return what verified plans to goals cross and why, one for each robot that crosses a hole."""
    found = [
        explain_crossing(problem_of_robot(problem, number), posteriors, plan)
        for number, plan in enumerate(plans)
        if plan.verdict is Verdict.VERIFIED
    ]
    return tuple(one for one in found if one is not None)


def explain_crossing(
    problem: Problem, posteriors: Sequence[ChannelPosterior], plan: Plan
) -> Crossing | None:
    """Return what a robot's way to its goal crosses and why; None where it keeps the bound."""
    if not plan.holes:
        return None
    scene = build_scene(problem)
    rule, constraints = problem.constraints.rule, problem.constraints
    threshold_dbm = problem.stations[0].threshold_dbm - (rule.slack_max_db or 0.0)
    everywhere = problem.reach.charges_everywhere
    margins = NodeMargins(scene.road_map, threshold_dbm, constraints.p_min, everywhere)
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
