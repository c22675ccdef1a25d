"""The last plan, one step later."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Plan, Verdict
from planopt.planning.soundness import is_sound
from planopt.problems.problem import Problem
from planopt.world.clearance import ObstacleIndex


def shifted_path(
    problem: Problem, index: ObstacleIndex, position_m: NDArray[np.float64], warm: Plan | None
) -> NDArray[np.float64] | None:
    """Rest of a verified plan after its first step, standing still at its end; (N, 2).

    None without a plan, for one that was not verified, and for one that today's robot cannot drive
    on today's map, be it for an obstacle, its place or its speed: nothing starts from such a plan.

    Parameters
    ----------
    problem, index
        As they are today.
    position_m
        ``(2,)`` where the robot is.
    warm
        The last plan.
    """
    if warm is None or warm.verdict is not Verdict.VERIFIED:
        return None
    rest = np.vstack([warm.positions_m[2:], warm.positions_m[-1:]])
    if len(rest) != problem.planner.horizon:
        return None
    return rest if is_sound(problem, index, position_m, rest) else None
