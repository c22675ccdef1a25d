"""Where a robot may come to that cannot turn or stop at will, for searches of what is in reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.proof.reachability import MayReach
from planopt.problems.problem import Problem


def may_reach_from(problem: Problem, state: NDArray[np.float64]) -> MayReach | None:
    """Where the problem's first robot may be some steps after `state`; None if anywhere near."""
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if dynamics is None:
        return None

    def may_reach(places_m: NDArray[np.float64], step: int, slack_m: float) -> NDArray[np.bool_]:
        return dynamics.may_reach(state, places_m, step * step_s, slack_m)

    return may_reach
