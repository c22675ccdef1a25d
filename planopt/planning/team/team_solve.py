"""Solve a problem whose objective is a sum of terms once: a plan for each robot from its start."""

from __future__ import annotations

from planopt.channel.one_thread import one_blas_thread
from planopt.planning.loop.target_watch import watch_target
from planopt.planning.prepare import prepare
from planopt.planning.team.crew import build_crew
from planopt.planning.team.team_seeds import team_seeds
from planopt.planning.team.team_solution import TeamSolution
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
    belief = prepare(problem, seed).belief
    seeds = team_seeds(problem, seed)
    watch = watch_target(problem, seeds.target)
    steps = problem.planner.horizon
    made = [
        member.plan(
            belief, member.start, None if watch is None else watch.expected_m(number, steps), None
        )
        for number, member in enumerate(build_crew(problem, seeds))
    ]
    return TeamSolution(
        problem, seed, belief, tuple(plan for plan, _ in made), tuple(aim for _, aim in made)
    )
