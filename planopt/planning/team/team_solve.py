"""Solve a problem whose objective is a sum of terms once: a plan for each robot from its start."""

from __future__ import annotations

from planopt.channel.belief import Belief
from planopt.channel.one_thread import one_blas_thread
from planopt.planning.history import BEGINNING
from planopt.planning.loop.target_watch import aim_of, watch_target
from planopt.planning.prepare import prepare
from planopt.planning.team.crew import build_crew
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.team.team_solution import TeamSolution
from planopt.planning.team.team_step import TeamMoment, plan_together
from planopt.problems.overrides import with_overrides
from planopt.problems.problem import Problem


@one_blas_thread()
def solve_team(
    problem: Problem,
    *,
    horizon: int | None = None,
    planner: str | None = None,
    seed: int = 0,
) -> TeamSolution:
    """Plan `horizon` steps ahead for each robot from its start.

    The target is expected where its first estimate takes it. The plans are those that a run of the
    same seed begins with.

    Parameters
    ----------
    problem
        A problem whose objective is a sum of terms.
    horizon, planner
        Override the problem's planner settings.
    seed
        Of the truth's fading, the measured places and the first estimate of the target.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used.
    """
    problem = with_overrides(problem, horizon=horizon, planner=planner)
    return solve_team_on(problem, prepare(problem, seed).belief, seed)


def solve_team_on(problem: Problem, belief: Belief, seed: int) -> TeamSolution:
    """Plan for each robot from its start, on a belief that is given.

    Parameters
    ----------
    problem
        A problem whose objective is a sum of terms.
    belief
        Of the channel, the same for all.
    seed
        Of the first estimate of the target, and of planners that draw.
    """
    seeds = team_seeds(problem, seed)
    watch = watch_target(problem, seeds.target)
    steps = problem.planner.horizon
    crew = build_crew(problem, seeds)
    robots = range(len(crew))
    moment = TeamMoment(
        beliefs=[belief for _ in robots],
        states=[member.start for member in crew],
        watched=[aim_of(watch, number, steps) for number in robots],
        histories=[BEGINNING for _ in robots],
        warm=[None for _ in robots],
    )
    plans, aims = plan_together(problem, crew, moment)
    return TeamSolution(problem, seed, belief, tuple(plans), tuple(aims))
