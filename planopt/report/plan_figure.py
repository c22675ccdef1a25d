"""One plan: its map, what it is predicted to receive on the way, and what is proven of it."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from planopt.planning.plan import Plan
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem
from planopt.report.maps import (
    PATH_Z,
)
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.plan_map import draw_plan_map
from planopt.report.plan_words import plan_words
from planopt.report.style import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    NOTE_PT,
    PREDICTED,
    THRESHOLD,
    dress,
    head,
    legend_above,
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
    _draw_power(add_panel(figure, side[0, 0]), problem, plan)
    _draw_connectivity(add_panel(figure, side[1, 0]), problem, plan)
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


def _draw_power(panel: Panel, problem: Problem, plan: Plan) -> None:
    """Predicted power over time with its band, and the threshold."""
    panel.fill_between(
        plan.t_s,
        plan.mean_dbm - BAND_Z * plan.deviation_db,
        plan.mean_dbm + BAND_Z * plan.deviation_db,
        color=PREDICTED,
        alpha=0.2,
        linewidth=0.0,
        label=BAND_WORDS,
    )
    panel.plot(plan.t_s, plan.mean_dbm, color=PREDICTED, marker="o", markersize=3.5)
    threshold = problem.stations[0].threshold_dbm
    panel.axhline(threshold, color=THRESHOLD, linestyle="dashed", label="threshold")
    dress(panel, "predicted power", "time [s]", "power [dBm]")
    legend_above(panel)


def _draw_connectivity(panel: Panel, problem: Problem, plan: Plan) -> None:
    """Predicted chance of a connection over time, its bound, and the relaxed steps."""
    panel.plot(plan.t_s, plan.connectivity, color=PREDICTED, marker="o", markersize=3.5)
    p_min = problem.constraints.p_min
    panel.axhline(p_min, color=THRESHOLD, linestyle="dashed", label=f"p_min = {p_min:g}")
    relaxed = np.array(plan.certificate.relaxed_steps, dtype=np.intp)
    if relaxed.size:
        panel.scatter(
            plan.t_s[relaxed],
            plan.connectivity[relaxed],
            s=70.0,
            facecolors="none",
            edgecolors=BLACK,
            zorder=PATH_Z,
            label="not met",
        )
    dress(panel, "predicted connectivity", "time [s]", "P(connected) [1]")
    panel.set_ylim(min(0.0, p_min), 1.03)
    legend_above(panel)
