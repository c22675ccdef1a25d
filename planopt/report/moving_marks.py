"""Moving obstacles on a map: their way, and the disc as predicted at some times on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from planopt.problems.problem import Problem
from planopt.report.maps import MARGIN_Z
from planopt.report.panel import Panel
from planopt.report.style import BLACK, FRAME, NOTE_PT, OBSTACLE, WHITE
from planopt.world.moving_obstacle import centres_at, growth_m

if TYPE_CHECKING:
    from matplotlib.artist import Artist

DISCS = 6
"""Drawn of each obstacle at most, evenly over the time; later ones are paler."""

DARKEST, PALEST = 0.9, 0.3
"""Opacity of the first and of the last disc."""


def draw_moving(panel: Panel, problem: Problem, steps: int, *, predicted: bool) -> list[Artist]:
    """Draw where every moving obstacle is when, over the first `steps` steps; for a legend.

    Parameters
    ----------
    panel, problem
        Where, and of what.
    steps
        Over how many steps from time 0.
    predicted
        Whether all steps are ahead, so that discs are grown by what is not known of their way.
    """
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    artists: list[Artist] = []
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    end_s = problem.planner.step_s * steps
    every = max(-(-steps // (DISCS - 1)), 1)
    times = problem.planner.step_s * np.arange(0, steps + 1, every, dtype=np.float64)
    for obstacle in problem.workspace.moving:
        centres = centres_at(obstacle, times).tolist()
        grown = growth_m(obstacle, times) if predicted else np.zeros(len(times))
        discs = PatchCollection(
            [Circle(centre, obstacle.radius_m) for centre in centres],
            facecolors=OBSTACLE,
            edgecolors=BLACK,
            linewidths=1.0,
            alpha=np.linspace(DARKEST, PALEST, len(times)),
            zorder=MARGIN_Z,
            label="moving obstacle, paler later",
        )
        panel.add_collection(discs, autolim=False)
        if grown.any():
            rims = PatchCollection(
                [
                    Circle(centre, obstacle.radius_m + growth)
                    for centre, growth in zip(centres, grown.tolist(), strict=True)
                ],
                facecolors="none",
                edgecolors=BLACK,
                linestyles="dotted",
                zorder=MARGIN_Z,
            )
            panel.add_collection(rims, autolim=False)
        artists = artists or [discs]
        known = [time for time in obstacle.times_s if 0.0 < time < end_s]
        way = centres_at(obstacle, np.array(sorted({0.0, *known, end_s})))
        panel.plot(*way.T, color=WHITE, linewidth=2.6, zorder=MARGIN_Z)
        panel.plot(*way.T, color=FRAME, linewidth=1.1, linestyle="dashdot", zorder=MARGIN_Z + 0.1)
        for (x, y), time in zip(centres, times.tolist(), strict=True):
            if not (x_min <= x <= x_max and y_min <= y <= y_max):
                continue  # text far outside cannot be rendered, nor seen
            panel.text(
                x,
                y,
                obstacle.name if time == 0.0 else f"{time:g} s",
                fontsize=NOTE_PT,
                ha="center",
                va="center",
                zorder=MARGIN_Z + 0.2,
                clip_on=True,
            )
    return artists
