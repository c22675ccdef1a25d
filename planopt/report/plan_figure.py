"""One plan: its map, what it is predicted to receive on the way, and what is proven of it."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

from planopt.planning.solution import Solution
from planopt.report.panel import add_panel, new_figure
from planopt.report.plan_map import draw_plan_map
from planopt.report.plan_panels import draw_plan_connectivity, draw_plan_power
from planopt.report.plan_words import plan_words
from planopt.report.style import (
    NOTE_PT,
    head,
    legend_below,
    spaced,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORDS_WIDTH, WORDS_LINES = 66, 13
"""Letters on a line, and lines, that there is room for under the curves."""


def draw_plan(solution: Solution) -> Figure:
    """Draw a plan on the predicted chance of a connection, with its predictions and certificate."""
    from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec

    problem, plan = solution.problem, solution.plan
    figure = new_figure(14.0, 8.0)
    cells = GridSpec(1, 2, figure=figure, width_ratios=[1.6, 1.0])
    side = GridSpecFromSubplotSpec(3, 1, cells[0, 1], height_ratios=[1.0, 1.0, 1.1])
    ground = add_panel(figure, cells[0, 0])
    entries = draw_plan_map(figure, ground, solution)
    draw_plan_power(add_panel(figure, side[0, 0]), problem, [plan])
    draw_plan_connectivity(add_panel(figure, side[1, 0]), problem, [plan])
    words = add_panel(figure, side[2, 0])
    words.set_axis_off()
    lines = [
        piece
        for line in plan_words(plan, problem.constraints)
        for piece in wrap(line, WORDS_WIDTH, subsequent_indent="    ")
    ]
    if len(lines) > WORDS_LINES:
        lines = [*lines[: WORDS_LINES - 1], "..."]
    words.text(
        0.0, 1.0, "\n".join(lines), va="top", fontsize=NOTE_PT, linespacing=1.35, in_layout=False
    )
    legend_below(figure, entries, 6)
    head(figure, f"{problem.name}: plan of {len(plan.t_s) - 1} steps, {spaced(plan.verdict)}")
    return figure
