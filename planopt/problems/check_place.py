"""Places where a robot must stand: in bounds and clear of every obstacle."""

from __future__ import annotations

import numpy as np
import shapely

from planopt.errors import InputError
from planopt.problems.problem import Problem
from planopt.world.clearance import (
    ObstacleIndex,
    clearance_m,
    containing_obstacle,
    inside_bounds,
)


def check_bounds(problem: Problem) -> None:
    """The workspace has an inside."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    if not (x_min < x_max and y_min < y_max):
        raise InputError(
            f"is {list(problem.workspace.bounds_m)}, should have x_min < x_max and y_min < y_max",
            file=problem.file,
            key="world.bounds_m",
            remedy="[x_min, y_min, x_max, y_max]",
        )


def check_place(
    problem: Problem, index: ObstacleIndex, place: tuple[float, float], key: str
) -> None:
    """A place where a robot must stand: in bounds and clear of every obstacle."""
    positions_m = np.array([place])
    if not inside_bounds(problem.workspace, positions_m).all():
        raise InputError(
            f"is {list(place)}, outside the bounds {list(problem.workspace.bounds_m)}",
            file=problem.file,
            key=key,
            remedy="move it, or widen world.bounds_m",
        )
    around = containing_obstacle(index, positions_m[0])
    if around is not None:
        raise InputError(
            f"is {list(place)}, inside the obstacle {around.name}",
            file=problem.file,
            key=key,
            remedy="move it",
        )
    distance = float(clearance_m(index, positions_m)[0])
    if distance < problem.constraints.clearance_m:
        nearest = index.obstacles[int(index.tree.nearest(shapely.Point(place)))]
        raise InputError(
            f"is {list(place)}, {distance:.3g} m from the obstacle {nearest.name}, less than "
            f"the clearance of {problem.constraints.clearance_m:g} m",
            file=problem.file,
            key=key,
            remedy="move it, or lessen constraints.clearance_m",
        )
