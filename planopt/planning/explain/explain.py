"""Explain a problem that has no verified plan: which keys are at odds, and what would help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.errors import InputError, NoPlanError
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.no_connection import explain_no_connection
from planopt.planning.explain.no_way import explain_no_way
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.plan import Verdict
from planopt.planning.prepare import prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.robot_problem import problem_of_robot
from planopt.planning.scene import build_scene
from planopt.planning.solution import Solution
from planopt.planning.team.crew import build_crew
from planopt.planning.team.reservations import beside
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.team.team_solution import TeamSolution
from planopt.problems.problem import Problem


def explain(solution: Solution | TeamSolution) -> tuple[Relaxation, ...]:
    """What would give every robot a verified plan; empty where each has one.

    Each change is by itself, and of its robot alone. Problems are solved again with what is
    proposed, which takes some ten times the plan's own time.

    Parameters
    ----------
    solution
        From :func:`planopt.solve`.
    """
    return _explain_one(solution) if isinstance(solution, Solution) else _explain_team(solution)


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
    return explain_no_way(problem, lambda changed: _reached(changed, belief))


@one_blas_thread()
def _explain_one(solution: Solution) -> tuple[Relaxation, ...]:
    if solution.plan.verdict is Verdict.VERIFIED:
        return ()
    belief = solution.belief
    return explain_no_connection(
        solution.problem,
        belief.posterior,
        solution.plan,
        lambda changed: _reached(changed, belief),
    )


@one_blas_thread()
def _explain_team(solution: TeamSolution) -> tuple[Relaxation, ...]:
    found: list[Relaxation] = []
    for number, plan in enumerate(solution.plans):
        if plan.verdict is Verdict.VERIFIED:
            continue

        def solve_again(changed: Problem, number: int = number) -> Verdict:
            whole = replace(
                solution.problem,
                constraints=changed.constraints,
                stations=changed.stations,
                planner=changed.planner,
            )
            return _planned(whole, solution, number)

        own = problem_of_robot(solution.problem, number)
        found += explain_no_connection(own, solution.belief.posterior, plan, solve_again)
    return tuple(found)


def _reached(problem: Problem, belief: Belief) -> Verdict:
    """What the plan to the goal of a changed problem is worth."""
    try:
        scene = build_scene(problem)
    except NoPlanError:
        return Verdict.NONE
    return ReachPlanner(problem, scene).plan(belief, problem.robots[0].start_state).verdict


def _planned(problem: Problem, solution: TeamSolution, number: int) -> Verdict:
    """What one robot's plan of a changed problem is worth."""
    seeds = team_seeds(problem, solution.seed)
    watch = watch_target(problem, seeds.target)
    watched = aim_of(watch, number, problem.planner.horizon)
    member = build_crew(problem, seeds)[number]
    # The others go where they plan to, and stay there where the changed horizon is longer.
    steps = np.arange(problem.planner.horizon + 1)
    others = {
        other: plan.positions_m[np.minimum(steps, len(plan.positions_m) - 1)]
        for other, plan in enumerate(solution.plans)
        if other != number
    }
    plan, _ = member.plan(solution.belief, member.start, watched, None, beside(problem, 0, others))
    return plan.verdict
