"""Which places of a path lie in which obstacle, and which ways come too near to which."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.tolerances import CLEARANCE_TOLERANCE_M
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    containing_obstacle,
    is_clear,
    segment_lines,
    swept_clearance_m,
)


def obstacles_met(
    problem: Problem, index: ObstacleIndex, path_m: NDArray[np.float64], first: int = 0
) -> list[str]:
    """A reason for every place (n, 2) of a path, and every way between, that is not clear.

    The path begins after step `first`.
    """
    reasons: list[str] = []
    inside: set[int] = set()
    for step, place in enumerate(path_m):
        obstacle = containing_obstacle(index, place)
        if obstacle is not None:
            inside.add(step)
            x, y = place
            reasons.append(
                f"step {first + step}: ({x:.3f}, {y:.3f}) lies in obstacle {obstacle.name}"
            )
    clearance = swept_clearance_m(index, path_m)
    near = ~is_clear(clearance, problem.constraints.clearance_m, CLEARANCE_TOLERANCE_M)
    lines = segment_lines(path_m[:-1], path_m[1:])
    for segment in np.nonzero(near)[0].tolist():
        if segment in inside or segment + 1 in inside:
            continue
        nearest = index.obstacles[int(np.asarray(index.tree.nearest(lines[segment])))]
        reasons.append(
            f"step {first + segment + 1}: the way there comes within {clearance[segment]:.3f} m of "
            f"obstacle {nearest.name}"
        )
    return reasons
