"""The run of one robot of several, from its track and the plans that led along it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.driven import driven
from planopt.planning.loop.metrics import metrics_of
from planopt.planning.loop.run import Outcome, Run
from planopt.planning.loop.step_log import step_log
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem


def completed_run(
    problem: Problem,
    seed: int,
    track_m: NDArray[np.float64],
    true_dbm: NDArray[np.float64],
    plans: Sequence[Plan],
    learnt: Sequence[bool],
    ended: tuple[Outcome, str],
) -> Run:
    """The run of a problem with one robot.

    Parameters
    ----------
    problem, seed
        What was run.
    track_m, true_dbm
        ``(steps + 1, 2)`` where the robot was, and ``(steps + 1,)`` the true power there.
    plans, learnt
        The plan that each step was the first of, and whether it brought a measurement.
    ended
        The outcome, and why.
    """
    log = step_log(problem, track_m, true_dbm, plans)
    return Run(
        robot=problem.robots[0].name,
        horizon=problem.planner.horizon,
        planner=problem.planner.name,
        cost_to_go=None,
        seed=seed,
        outcome=ended[0],
        reason=ended[1],
        log=log,
        metrics=metrics_of(log, plans, ended[0], learnt),
        drive=driven(problem.robots[0], plans),
    )
