"""Solve and simulate whatever a problem asks: one way to ask, two kinds of answer.

A problem that is to reach a goal has one robot and is answered by a Solution or a Simulation. All
others maximise a sum of terms, with one robot or several, and are answered by a TeamSolution or a
TeamRun.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import overload

from planopt.planning.loop.closed_loop import simulate as simulate_reach
from planopt.planning.loop.simulation import Simulation
from planopt.planning.solution import Solution
from planopt.planning.solve import solve as solve_reach
from planopt.planning.team.team_loop import simulate_team
from planopt.planning.team.team_run import TeamRun
from planopt.planning.team.team_solution import TeamSolution
from planopt.planning.team.team_solve import solve_team
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem
from planopt.problems.systems import Answer, Request, SystemProblem


@overload
def solve(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
) -> Solution | TeamSolution: ...


@overload
def solve(
    problem: SystemProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    seed: int = 0,
) -> Answer: ...


def solve(
    problem: Problem | SystemProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
) -> Solution | TeamSolution | Answer:
    """Plan `horizon` steps ahead from the start, for each robot.

    Parameters
    ----------
    problem
        From :func:`planopt.load` or made in Python.
    horizon, planner, cost_to_go
        Override the problem's planner settings; a cost to go only where there is a goal.
    seed
        Of the truth's fading, the measured places and the first estimate of a target.

    Returns
    -------
    Solution | TeamSolution | Answer
        The first where the task is ``reach``, the last for problems of a system.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used.
    NoPlanError
        Obstacles cut the goal off.
    """
    if isinstance(problem, SystemProblem):
        return _answer(problem, "solve", horizon, planner, seed)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    if problem.task == "reach":
        return solve_reach(problem, seed=seed)
    return solve_team(problem, seed=seed)


@overload
def simulate(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    on_step: Callable[[int], None] | None = None,
) -> Simulation | TeamRun: ...


@overload
def simulate(
    problem: SystemProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    seed: int = 0,
) -> Answer: ...


def simulate(
    problem: Problem | SystemProblem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
    on_step: Callable[[int], None] | None = None,
) -> Simulation | TeamRun | Answer:
    """Drive a problem's robots in the true channel.

    Parameters
    ----------
    problem
        The problem; it must have a truth.
    horizon, planner, cost_to_go
        Override the problem's planner settings; a cost to go only where there is a goal.
    seed
        Of everything that happens.
    on_step
        Called after every step with its number, for progress display.

    Returns
    -------
    Simulation | TeamRun | Answer
        The first where the task is ``reach``, the last for problems of a system.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used, or there is no truth.
    NoPlanError
        Obstacles cut the goal off.
    """
    if isinstance(problem, SystemProblem):
        return _answer(problem, "simulate", horizon, planner, seed)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    if problem.task == "reach":
        return simulate_reach(problem, seed=seed, on_step=on_step)
    return simulate_team(problem, seed=seed, on_step=on_step)


def _answer(
    problem: SystemProblem, action: str, horizon: int | None, planner: str | None, seed: int
) -> Answer:
    horizons = () if horizon is None else (horizon,)
    planners = () if planner is None else (planner,)
    answer = problem.answer(action, Request(seed, horizons, planners))
    if answer.failure is not None:
        raise answer.failure
    return answer
