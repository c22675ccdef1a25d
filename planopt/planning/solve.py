"""Solve a problem once: a plan for each robot from its start, on the first measurements."""

from __future__ import annotations

from collections.abc import Sequence

from planopt.channel.belief import Belief
from planopt.channel.cholesky import one_blas_thread
from planopt.planning.drawn_places import with_drawn_starts
from planopt.planning.initial_data import UserMeasurements, team_seeds, with_measurements
from planopt.planning.learn import prepare
from planopt.planning.loop.target_watch import watch_target
from planopt.planning.results import Solution
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.stepping import Stepper
from planopt.planning.team.couriers import planning
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
    measurements: UserMeasurements | None = None,
) -> Solution:
    """Plan `horizon` steps ahead from the start, for each robot.

    A target is expected where its first estimate takes it. The plans are those that a run of the
    same seed begins with.

    Parameters
    ----------
    problem
        From :func:`planopt.load` or made in Python.
    horizon, planner, cost_to_go
        Override the problem's planner settings; a cost-to-go only where there is a goal.
    seed
        Of the ground truth's fading, the measured places, the first estimate of a target, and of
        planners that draw.
    measurements
        First measurements in place of those that the problem names: :class:`planopt.Measurements`
        or a table (dictionary or DataFrame) with ``x_m``, ``y_m`` and ``power_dbm``; of several
        stations a sequence with one for each.

    Raises
    ------
    InputError
        An override or a file that the problem names cannot be used.
    NoPlanError
        Obstacles cut the goal off.
    """
    problem, given = with_measurements(problem, measurements)
    problem = with_overrides(problem, horizon=horizon, planner=planner, cost_to_go=cost_to_go)
    # An unreachable goal is found out before the files of the channel are read.
    scenes = build_scenes(problem)
    return _solved(problem, prepare(problem, seed, given).belief, seed, scenes)


def solve_on(
    problem: Problem, belief: Belief, seed: int, scenes: Sequence[Scene] | None = None
) -> Solution:
    """Plan for each robot from its start, on a belief that is given."""
    return _solved(problem, belief, seed, build_scenes(problem) if scenes is None else scenes)


def _solved(
    problem: Problem, belief: Belief, seed: int, scenes: Sequence[Scene] | None
) -> Solution:
    problem = with_drawn_starts(problem, seed)
    seeds = team_seeds(problem, seed)
    watch = watch_target(problem, seeds.target)
    robots = Stepper(problem, belief, planning(problem, scenes, seeds), watch)
    plans = robots.plan()
    return Solution(problem, seed, belief, tuple(plans), tuple(aim for (aim,) in robots.aims))
