"""When a run of a sum of terms ends, and in which words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.run import Outcome
from planopt.problems.problem import Problem


def steps_to_drive(problem: Problem, connected: NDArray[np.bool_]) -> int:
    """How many steps a run takes: until all robots are connected at once, for the task connect.

    Parameters
    ----------
    problem
        What is run.
    connected
        ``(steps, robots)`` who was connected, in truth, after each step so far.
    """
    most = problem.planner.max_steps
    if problem.task != "connect":
        return most
    together = np.nonzero(connected.reshape(len(connected), -1).all(axis=1))[0]
    return min(most, int(together[0]) + 1) if together.size else most


def team_ending(problem: Problem, connected: NDArray[np.bool_]) -> tuple[Outcome, str]:
    """The outcome of a run, and why it ended; `connected` is of all its steps."""
    steps = len(connected)
    if problem.task != "connect":
        return Outcome.COMPLETED, f"all {steps} steps driven"
    if steps and bool(connected[-1].all()):
        return Outcome.COMPLETED, f"connected after step {steps}"
    return Outcome.STEP_LIMIT, f"not connected after planner.max_steps {steps}"
