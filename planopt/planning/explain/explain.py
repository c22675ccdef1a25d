"""Explain a problem that has no verified plan: which keys are at odds, and what would help."""

from __future__ import annotations

import numpy as np

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.planning.explain.case import Case
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.no_verified_plan import explain_no_verified_plan
from planopt.planning.explain.no_way import explain_blocked, explain_no_way
from planopt.planning.ground import first_moves
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Plan, Verdict
from planopt.planning.prepare import prepare
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.scene import build_scene
from planopt.planning.search.node_margins import NodeMargins
from planopt.planning.solution import Solution
from planopt.planning.solve import solve_on
from planopt.planning.team.crew import build_crew
from planopt.planning.team.reservations import beside, others_of, planned_motion
from planopt.planning.team.team_seeds import team_seeds
from planopt.problems.problem import Problem


@one_blas_thread()
def explain(solution: Solution) -> tuple[Relaxation, ...]:
    """Return changes that would give every robot a verified plan; none if each has one.

    Each change is by itself, and of its robot alone. Problems are solved again with what is
    proposed, which takes some fifty times the plan's own time.

    Parameters
    ----------
    solution
        From :func:`planopt.solve`.
    """
    found: list[Relaxation] = []
    problem = solution.problem
    motions = [planned_motion(problem, plan) for plan in solution.plans]
    for number, plan in enumerate(solution.plans):
        if plan.verdict is Verdict.VERIFIED:
            continue
        moving = beside(problem, 0, others_of(motions, number))
        case = Case(problem, number, solution.belief.posteriors, plan, moving)

        def plan_again(changed: Problem, number: int = number) -> Plan | None:
            return _planned(changed, solution, number)

        found += explain_no_verified_plan(case, plan_again)
    return tuple(found)


@one_blas_thread()
def explain_no_plan(problem: Problem, seed: int) -> tuple[Relaxation, ...]:
    """What would open a way to the goal of a problem that has none; of the changes each suffices.

    Parameters
    ----------
    problem
        A problem that is to reach a goal, for which planning raised a `NoPlanError`.
    seed
        As it was planned with.
    """
    try:
        belief = prepare(problem, seed).belief
    except InputError:
        # Without measurements nothing can be solved again; what opens a way can still be said.
        return explain_no_way(problem, lambda _: Verdict.NONE)

    def solve_again(changed: Problem) -> Verdict:
        return _verdict(_reached(changed, belief))

    try:
        scene = build_scene(problem)
    except NoPlanError:
        return explain_no_way(problem, solve_again)
    radio, p_min = problem.stations[0], problem.constraints.p_min
    margins = NodeMargins(scene.road_map, radio.threshold_dbm, p_min)
    margins.refresh(belief.posterior, broad_prediction(problem, belief.posteriors))
    first, _ = first_moves(scene.ground, problem, np.asarray(problem.robots[0].start_m))
    return explain_blocked(problem, scene.road_map, first, scene.goal_node, margins, solve_again)


def _verdict(plan: Plan | None) -> Verdict:
    return Verdict.NONE if plan is None else plan.verdict


def _reached(problem: Problem, belief: Belief) -> Plan | None:
    """Plan a changed problem to its goal; None where nothing leads there."""
    try:
        return solve_on(problem, belief, 0).plan
    except NoPlanError:
        return None


def _planned(problem: Problem, solution: Solution, number: int) -> Plan | None:
    """Plan a changed problem for one robot; with the others if they keep apart."""
    if problem.task == "reach":
        return _reached(problem, solution.belief)
    if problem.constraints.separation_m > 0.0:
        return solve_on(problem, solution.belief, solution.seed).plans[number]
    seeds = team_seeds(problem, solution.seed)
    watch = watch_target(problem, seeds.target)
    watched = aim_of(watch, number, problem.planner.horizon)
    member = build_crew(problem, seeds)[number]
    moving = beside(problem, 0, {})
    return member.plan(solution.belief, member.start, watched, None, moving)[0]
