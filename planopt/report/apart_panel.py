"""The distances of robots from each other and from moving obstacles, over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.team.reservations import least_moving_clearances_m, least_separations_m
from planopt.problems.problem import Problem
from planopt.report.panel import Panel
from planopt.report.style import BLUE, VERMILLION, dress, legend_above
from planopt.world.timed_motion import TimedMotion

TIME = "time [s]"


def has_apart(problem: Problem) -> bool:
    """Return whether a problem asks robots to keep apart from each other or from what moves."""
    separated = len(problem.robots) > 1 and problem.constraints.separation_m > 0.0
    return separated or bool(problem.workspace.moving)


def draw_apart(
    panel: Panel,
    problem: Problem,
    motions: Sequence[TimedMotion],
    t_s: NDArray[np.float64],  # (n + 1,) when
) -> None:
    """Draw the least distances during each step, and what must be kept."""
    lowest = 0.0
    curves: list[tuple[str, str, float, NDArray[np.float64]]] = []
    if len(motions) > 1:
        separation = problem.constraints.separation_m
        curves.append(("two robots", BLUE, separation, least_separations_m(motions)))
    if problem.workspace.moving:
        least = least_moving_clearances_m(problem, motions)
        curves.append(("moving obstacle", VERMILLION, problem.constraints.clearance_m, least))
    for label, colour, asked, least in curves:
        # The value of a step stands over the whole of it.
        steps = np.append(least[:1], least)
        panel.plot(t_s, steps, color=colour, drawstyle="steps-pre", label=label)
        panel.axhline(asked, color=colour, linestyle="dashed")
        lowest = min(lowest, float(least.min()))
    dress(panel, "least distance (dashed: asked)", TIME, "distance [m]")
    panel.set_ylim(lowest, None)
    legend_above(panel)
