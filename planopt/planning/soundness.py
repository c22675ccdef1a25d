"""What no plan may give up, whatever becomes of connectivity: clearance, workspace, speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M, DYNAMICS_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.robots.single_integrator import dynamics_defect_m
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
