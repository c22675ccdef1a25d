"""The curve that a robot drives from place to place, for pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.robots.drive import Drive

POINTS = 16
"""Of the curve of a step."""


def driven_line(
    problem: Problem, places_m: NDArray[np.float64], drive: Drive | None, first: int = 0
) -> tuple[NDArray[np.float64], list[int]]:
    """Points (k, 2) of a line through places, and which of them are the places.

    Parameters
    ----------
    problem
        Whose steps they are of.
    places_m
        ``(n + 1, 2)``.
    drive
        How the robot drives from place to place; None if straight.
    first
        Begin with the place of this number.
    """
    if drive is None or len(drive.inputs) <= first:
        return places_m[first:], list(range(len(places_m) - first))
    ways = drive.dynamics.ways(drive.states[first:-1], drive.inputs[first:], problem.planner.step_s)
    line, marks = [places_m[first : first + 1]], [0]
    for way in ways:
        points, _ = way.points_m()
        chosen = np.linspace(0, len(points) - 1, min(POINTS, len(points))).round().astype(int)
        line.append(points[chosen[1:]])
        marks.append(marks[-1] + len(chosen) - 1)
    return np.concatenate(line), marks
