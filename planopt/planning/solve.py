"""Solve a problem once, from its start, on what the first measurements tell."""

from __future__ import annotations

from planopt.channel.one_thread import one_blas_thread
from planopt.planning.plan import Plan
from planopt.planning.prepare import prepare
from planopt.planning.reach_planner import ReachPlanner
from planopt.planning.scene import build_scene
from planopt.planning.solution import Solution
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem


@one_blas_thread()
def solve(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    cost_to_go: str | None = None,
    seed: int = 0,
) -> Solution:
    """Plan `horizon` steps ahead from the start.

    Parameters
    ----------
    problem
        From :func:`planopt.load` or made in Python.
    horizon, planner, cost_to_go
        Override the problem's planner settings.
    seed
        Of the truth's fading and of the measured places.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used.
    NoPlanError
        Obstacles cut the goal off.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    scene = build_scene(problem)
    belief = prepare(problem, seed).belief
    plan: Plan = ReachPlanner(problem, scene).plan(belief, problem.robots[0].start_state)
    return Solution(problem, seed, belief, plan)
