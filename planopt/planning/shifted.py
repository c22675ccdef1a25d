"""The last plan, one step later.

What no plan may give up, whatever becomes of connectivity: clearance, workspace, speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Plan, Verdict
from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, DYNAMICS_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive, dynamics_defect_m, rolled_out
from planopt.world.clearance import ObstacleIndex, inside_bounds, is_clear, swept_clearance_m


def is_sound(
    problem: Problem,
    index: ObstacleIndex,
    position_m: NDArray[np.float64],
    path_m: NDArray[np.float64],
) -> bool:
    """Whether the problem's first robot, at `position_m` (2,), can drive a path (N, 2) safely."""
    way = np.vstack([position_m, path_m])
    clearance = swept_clearance_m(index, way)
    return bool(
        is_clear(clearance, problem.constraints.clearance_m, CLEARANCE_TOLERANCE_M).all()
        and dynamics_defect_m(way, position_m, problem.step_length_m) <= DYNAMICS_TOLERANCE_M
        and inside_bounds(problem.workspace, way).all()
    )


def shifted_path(
    problem: Problem, index: ObstacleIndex, position_m: NDArray[np.float64], warm: Plan | None
) -> NDArray[np.float64] | None:
    """Rest of a verified plan after its first step, standing still at its end; (N, 2).

    None without a plan, for one that was not verified, and for one that today's robot cannot drive
    on today's map, be it for an obstacle, its place or its speed: nothing starts from such a plan.
    None, too, for a robot that cannot stop at will: see :func:`shifted_drive`.

    Parameters
    ----------
    problem, index
        As they are today.
    position_m
        ``(2,)`` where the robot is.
    warm
        The last plan.
    """
    if warm is None or warm.verdict is not Verdict.VERIFIED or warm.drive is not None:
        return None
    rest = np.vstack([warm.positions_m[2:], warm.positions_m[-1:]])
    if len(rest) != problem.planner.horizon:
        return None
    return rest if is_sound(problem, index, position_m, rest) else None


def shifted_drive(problem: Problem, warm: Plan | None) -> Drive | None:
    """Rest of a plan after its first step, then a step of stopping.

    None without a plan, or where the robot can stop at will. The plan need not be verified: what it
    sweeps does not depend on what is believed of the channel.
    """
    dynamics, step_s = problem.robots[0].dynamics, problem.planner.step_s
    if warm is None or warm.drive is None or dynamics is None:
        return None
    last = dynamics.braking(warm.drive.states[-1], step_s, 1)
    inputs = np.vstack([warm.drive.inputs[1:], last])
    return rolled_out(dynamics, warm.drive.states[1], inputs, step_s)
