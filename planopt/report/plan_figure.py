"""One plan: where it goes, what it is predicted to receive on the way, and what is proven of it."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.channel.connectivity import connection_probability
from planopt.planning.plan import Plan
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem
from planopt.report.grid import Bounds, predicted_rasters
from planopt.report.maps import (
    MARGIN_Z,
    PATH_Z,
    PLACE_Z,
    draw_ground,
    draw_layer,
    draw_level,
    draw_places,
    ring_xy,
)
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.plan_words import plan_words
from planopt.report.style import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    NOTE_PT,
    PREDICTED,
    PROBABILITY_MAP,
    PURPLE,
    THRESHOLD,
    VERMILLION,
    WHITE,
    dress,
    head,
    legend_above,
    legend_below,
)
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

WINDOW_MARGIN = 0.3
"""Room around the plan, as a share of its extent."""

MIN_WINDOW_STEPS = 10.0
"""The window is never narrower than this many longest steps."""

WORDS_WIDTH = 76
"""Letters on a line of the certificate."""

INSET = 0.3
"""Side of the inset as a share of the map's."""


def draw_plan(solution: Solution) -> Figure:
    """Draw a plan on the predicted chance of a connection, with its predictions and certificate."""
    from matplotlib.gridspec import GridSpec

    problem, plan = solution.problem, solution.plan
    figure = new_figure(14.0, 8.0)
    cells = GridSpec(3, 2, figure=figure, width_ratios=[1.5, 1.0], height_ratios=[1.0, 1.0, 0.8])
    ground = add_panel(figure, cells[:, 0])
    window = _window(problem, plan)
    entries = _draw_map(figure, ground, solution, window)
    _draw_inset(ground, problem, plan, window)
    _draw_power(add_panel(figure, cells[0, 1]), problem, plan)
    _draw_connectivity(add_panel(figure, cells[1, 1]), problem, plan)
    words = add_panel(figure, cells[2, 1])
    words.set_axis_off()
    lines = [fill(line, WORDS_WIDTH, subsequent_indent="    ") for line in _words(solution)]
    words.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=NOTE_PT, linespacing=1.4)
    legend_below(figure, entries, 6)
    head(figure, f"{problem.name}: plan of {len(plan.t_s) - 1} steps, {plan.verdict.value}")
    return figure


def _words(solution: Solution) -> list[str]:
    return plan_words(solution.plan, solution.problem.constraints)


def _window(problem: Problem, plan: Plan) -> Bounds:
    """A square around the plan, inside the workspace's bounding square where it fits."""
    low, high = plan.positions_m.min(axis=0), plan.positions_m.max(axis=0)
    side = max(
        float((high - low).max()) * (1.0 + 2.0 * WINDOW_MARGIN),
        MIN_WINDOW_STEPS * problem.step_length_m,
    )
    x, y = (low + high) / 2.0
    return (x - side / 2.0, y - side / 2.0, x + side / 2.0, y + side / 2.0)


def _draw_map(figure: Figure, panel: Panel, solution: Solution, window: Bounds) -> list[Artist]:
    """Draw the map inside the window; the artists, for the legend."""
    from matplotlib.lines import Line2D

    problem, plan = solution.problem, solution.plan
    p_min = problem.constraints.p_min
    mean, deviation = predicted_rasters(solution.belief.posterior, problem.workspace, window)
    chance = connection_probability(
        mean.values, deviation.values, problem.stations[0].threshold_dbm
    )
    layer = Raster(mean.x_m, mean.y_m, chance)
    draw_ground(panel, problem.workspace, "the plan on the predicted P(connected)")
    draw_layer(panel, layer, PROBABILITY_MAP, figure, "P(connected) [1]", (0.0, 1.0), p_min)
    draw_level(panel, layer, p_min, VERMILLION)
    margin = _draw_margin(panel, problem, window)
    x, y = plan.positions_m.T
    panel.plot(x, y, color=WHITE, linewidth=4.0, zorder=PATH_Z, solid_capstyle="round")
    (path,) = panel.plot(
        x,
        y,
        color=PREDICTED,
        linewidth=2.0,
        marker="o",
        markersize=5.0,
        markeredgecolor=WHITE,
        markeredgewidth=0.8,
        zorder=PATH_Z,
        label="planned waypoints and swept path",
    )
    places = draw_places(panel, problem)
    panel.set_xlim(window[0], window[2])
    panel.set_ylim(window[1], window[3])
    level = Line2D([], [], color=VERMILLION, linewidth=1.2, label=f"P(connected) = {p_min:g}")
    return [path, margin, level, *places]


def _draw_margin(panel: Panel, problem: Problem, window: Bounds) -> Artist:
    """Draw how near to the obstacles a path may come."""
    from matplotlib.collections import LineCollection

    clearance = problem.constraints.clearance_m
    around = shapely.box(*window).buffer(clearance)
    near = [
        obstacle.polygon.buffer(clearance)
        for obstacle in problem.workspace.obstacles
        if obstacle.polygon.intersects(around)
    ]
    merged = shapely.union_all(near)
    margin = LineCollection(
        _rings(merged),
        colors=PURPLE,
        linewidths=0.9,
        linestyles="dashed",
        zorder=MARGIN_Z,
        label=f"clearance of {clearance:g} m",
    )
    panel.add_collection(margin, autolim=False)
    return margin


def _rings(area: shapely.Geometry) -> list[NDArray[np.float64]]:
    """All rings of polygons, (n, 2) each."""
    return [ring_xy(line) for line in shapely.get_parts(shapely.boundary(area))]


def _draw_inset(panel: Panel, problem: Problem, plan: Plan, window: Bounds) -> None:
    """Draw the whole workspace small, in the corner of the map that is farthest from the plan."""
    shares = (plan.positions_m - np.array(window[:2])) / (window[2] - window[0])
    corners = [(0.01, 0.01), (0.99 - INSET, 0.01), (0.01, 0.99 - INSET), (0.99 - INSET,) * 2]
    distances = [
        np.linalg.norm(shares - np.array(corner) - INSET / 2.0, axis=1).min() for corner in corners
    ]
    left, bottom = corners[int(np.argmax(distances))]
    inset = panel.inset_axes((left, bottom, INSET, INSET))
    draw_ground(inset, problem.workspace, "")
    for set_label in (inset.set_xlabel, inset.set_ylabel):
        set_label("")
    inset.set_xticks([])
    inset.set_yticks([])
    draw_places(inset, problem)
    x_min, y_min, x_max, y_max = window
    inset.plot(
        [x_min, x_max, x_max, x_min, x_min],
        [y_min, y_min, y_max, y_max, y_min],
        color=PREDICTED,
        linewidth=1.5,
        zorder=PLACE_Z,
    )


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
    panel.plot(
        plan.t_s, plan.mean_dbm, color=PREDICTED, marker="o", markersize=3.5, label="predicted"
    )
    threshold = problem.stations[0].threshold_dbm
    panel.axhline(threshold, color=THRESHOLD, linestyle="dashed", label="threshold")
    dress(panel, "predicted power along the plan", "time [s]", "power [dBm]")
    legend_above(panel)


def _draw_connectivity(panel: Panel, problem: Problem, plan: Plan) -> None:
    """Predicted chance of a connection over time, its bound, and the relaxed steps."""
    panel.plot(
        plan.t_s, plan.connectivity, color=PREDICTED, marker="o", markersize=3.5, label="predicted"
    )
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
            label="bound cannot be met",
        )
    dress(panel, "predicted connectivity along the plan", "time [s]", "P(connected) [1]")
    panel.set_ylim(min(0.0, p_min), 1.03)
    legend_above(panel)
