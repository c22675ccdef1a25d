"""Figure of a problem without a plan: the cheapest way, and the holes that forbid it."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.belief import Belief
from planopt.planning.holes import BlockedWay
from planopt.problems.problem import Problem
from planopt.report.grid import believed_rasters
from planopt.report.maps import draw_ground, draw_layer, draw_level, draw_places
from planopt.report.panel import add_panel, new_figure
from planopt.report.plan_map import draw_blocked, window_about
from planopt.report.style import PROBABILITY_MAP, VERMILLION, head, legend_below

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEGEND_COLUMNS = 4

MESSAGE_WIDTH = 110
"""Letters in a line of why there is no plan."""


def draw_no_plan(
    problem: Problem, belief: Belief, message: str, ways: Sequence[BlockedWay]
) -> Figure:
    """Draw why there is no plan: the cheapest ways, and the holes in which a bound forbids them."""
    from matplotlib.gridspec import GridSpec

    places = np.concatenate([one.way_m for one in ways])
    window = window_about(problem, places)
    figure = new_figure(10.0, 9.6, maps_only=True)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    p_min = problem.constraints.p_min
    draw_ground(panel, problem.workspace, "\n".join(wrap(f"no plan: {message}", MESSAGE_WIDTH)))
    _, _, layer = believed_rasters(problem, belief, window)
    words = "P(connected) [1] (line: p_min)"
    draw_layer(panel, layer, PROBABILITY_MAP, figure, words, (0.0, 1.0), p_min)
    draw_level(panel, layer, p_min, VERMILLION)
    entries = [*draw_blocked(panel, ways), *draw_places(panel, problem)]
    panel.set_xlim(window[0], window[2])
    panel.set_ylim(window[1], window[3])
    legend_below(figure, entries, LEGEND_COLUMNS)
    head(figure, f"{problem.name}: horizon {problem.planner.horizon}, no plan")
    return figure
