"""Figures of plans, runs and problems without plan: maps, time series and certificates."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.posterior import Belief
from planopt.planning.certificate import BlockedPath
from planopt.planning.loop.results import Run, Solution
from planopt.problems.problem import Problem, problem_of_robot
from planopt.report.maps import draw_ground, draw_moving, draw_places, map_window, window_about
from planopt.report.motion_map import (
    draw_belief_maps,
    draw_blocked,
    draw_clearance,
    draw_connected_track,
    draw_expected_target,
    draw_measured,
    draw_plans,
    draw_relaxed,
    draw_target,
    draw_tracks,
    draw_true_power,
    layers_of,
)
from planopt.report.motion_series import TIME, Series, plan_series, power_series, run_series
from planopt.report.motion_words import certificate_in_words, plan_in_words
from planopt.report.panel import (
    NOTE_PT,
    Panel,
    fit_to_map,
    head,
    legend_below,
    new_figure,
    spaced,
    split_panel,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 5
"""Number of columns of a legend."""
MESSAGE_WIDTH = 100
"""Maximum line length of a message above a map, in characters."""
WORDS_WIDTH, WORDS_LINES = 70, 15
"""Line length in characters and number of lines per robot of the certificates."""


def draw_solution(solution: Solution) -> Figure:
    """Draw plans on the predicted channel, with their predictions and certificates."""
    problem, plans = solution.problem, solution.plans
    target_m = solution.aims[0].target_m
    shown = [plan.positions_m for plan in plans]
    shown += [plan.route_m for plan in plans if plan.holes and len(plan.route_m)]
    if target_m is not None:
        shown.append(target_m)
    positions = np.concatenate(shown)
    words = _certificates(solution)
    series = plan_series(problem, plans, target_m)
    figure, maps, curves = _sheet(problem, [*series, (lambda panel: None, 0.3 + 0.11 * len(words))])
    alone = problem.has_goal and len(plans) == 1
    window = (window_about if alone else map_window)(problem, positions)
    entries = draw_belief_maps(figure, maps, problem, solution.belief, positions, window)
    measured = solution.belief.posterior.measurements.positions_m
    for panel in maps:
        drawn = draw_plans(panel, problem, plans, 0)
        drawn += draw_moving(panel, problem, len(plans[0].t_s) - 1, predicted=True)
        if alone:
            drawn += draw_clearance(panel, problem, window)
        else:
            drawn += draw_measured(panel, measured, "measured")
        if target_m is not None:
            drawn += draw_expected_target(panel, target_m)
        entries = [*drawn, *entries]
    _draw_series(series, curves[:-1], float(plans[0].t_s[0]), float(plans[0].t_s[-1]))
    curves[-1].set_axis_off()
    curves[-1].text(
        0.0, 1.0, "\n".join(words), va="top", fontsize=NOTE_PT, linespacing=1.35, in_layout=False
    )
    legend_below(figure, entries, COLUMNS)
    verdict = f", {spaced(solution.verdict)}"
    steps = len(plans[0].t_s) - 1
    head(figure, f"{problem.name}: {steps} steps, {problem.planner.name} planner{verdict}")
    return figure


def _certificates(solution: Solution) -> list[str]:
    """Return the plans as lines of text for their panel; for one robot, with its certificate."""
    found: list[str] = []
    in_words = certificate_in_words if len(solution.plans) == 1 else plan_in_words
    for number, plan in enumerate(solution.plans):
        words = in_words(problem_of_robot(solution.problem, number), plan)
        lines = [
            piece for line in words for piece in wrap(line, WORDS_WIDTH, subsequent_indent="    ")
        ]
        cut = len(lines) > WORDS_LINES
        found += [*lines[: WORDS_LINES - 1], "..."] if cut else lines
    return found


def draw_run(run: Run) -> Figure:
    """Draw the executed paths; time series of a courier are drawn by :func:`draw_run_series`.

    The map then shows the true power; maps of other runs show the first robot's final belief.

    Parameters
    ----------
    run
        Result of :func:`planopt.simulate`.
    """
    problem = run.problem
    alone = problem.has_goal and len(run.runs) == 1
    figure = _draw_courier(run) if alone else _draw_team(run)
    cost = f", {problem.cost_to_go} cost-to-go" if problem.cost_to_go else ""
    steps = len(run.runs[0].log.t_s) - 1
    head(
        figure,
        f"{problem.name}: horizon {problem.planner.horizon}{cost}, "
        f"{problem.planner.name} planner, seed {run.seed}, {steps} steps",
    )
    return figure


def _draw_courier(run: Run) -> Figure:
    """Draw the path of one robot to its goal on the true power, if available."""
    problem, log = run.problem, run.run.log
    figure, (panel,) = new_figure(10.0, 9.6, maps_only=True)
    message = wrap(f"{spaced(run.outcome)}: {run.reason}", MESSAGE_WIDTH)
    draw_ground(panel, problem.workspace, "\n".join(message))
    fit_to_map(figure, panel, 8.3)
    if run.truths:
        draw_true_power(figure, panel, run)
    measured = run.belief.posterior.measurements.positions_m
    before, during = np.split(measured, [run.first_measurements])
    entries = [
        *draw_places(panel, problem),
        *draw_measured(panel, before, "measured before the run"),
        *draw_measured(panel, during, "measured during the run", on_path=True),
        *draw_moving(panel, problem, len(log.t_s) - 1, predicted=False),
        *draw_connected_track(panel, log),
        *draw_plans(panel, problem, run.plans[0][:1], 0),
        *draw_relaxed(panel, log),
        *draw_blocked(panel, run.blocked),
    ]
    legend_below(figure, entries, COLUMNS)
    return figure


def _draw_team(run: Run) -> Figure:
    """Draw all robots on the first robot's final belief, and the time series of the run."""
    problem = run.problem
    plans = [released[-1] for released in run.plans if released]
    shown = [one.log.positions_m for one in run.runs] + [plan.positions_m for plan in plans]
    if run.target is not None:
        shown.append(run.target.true_m)
    positions = np.concatenate(shown)
    series = run_series(run)
    figure, maps, curves = _sheet(problem, series)
    window = map_window(problem, positions)
    entries = draw_belief_maps(figure, maps, problem, run.beliefs[0], positions, window)
    t_s = run.runs[0].log.t_s
    before = run.beliefs[0].posterior.measurements.positions_m[: run.first_measurements]
    for panel in maps:
        drawn = draw_measured(panel, before, "measured before the run")
        drawn += draw_moving(panel, problem, len(t_s) - 1, predicted=False)
        drawn += draw_tracks(panel, problem, run.runs)
        drawn += draw_plans(panel, problem, plans, 1)
        if run.target is not None:
            drawn += draw_target(panel, run.target)
        entries = [*drawn, *draw_blocked(panel, run.blocked), *entries]
    half_step = problem.planner.step_s / 2.0
    _draw_series(series, curves, float(t_s[0]) - half_step, float(t_s[-1]) + half_step)
    legend_below(figure, entries, COLUMNS)
    return figure


def draw_run_series(run: Run) -> Figure:
    """Draw power, connection, predicted connectivity and step times of one robot over time."""
    series = power_series(run)
    shares = [share for _, share in series]
    rows = [[row] for row in range(len(series))]
    figure, panels = new_figure(12.0, 9.0, rows, height_ratios=shares)
    t_s, half_step = run.run.log.t_s, run.problem.planner.step_s / 2.0
    _draw_series(series, panels, float(t_s[0]) - half_step, float(t_s[-1]) + half_step)
    head(
        figure,
        f"{run.problem.name}: horizon {run.problem.planner.horizon}, seed {run.seed}, "
        f"{spaced(run.outcome)}",
    )
    return figure


def draw_no_plan(
    problem: Problem, belief: Belief, message: str, blocked: Sequence[BlockedPath]
) -> Figure:
    """Draw the cheapest paths of a problem without plan, with their coverage holes."""
    positions = np.concatenate([one.path_m for one in blocked])
    figure, (panel,) = new_figure(10.0, 9.6, maps_only=True)
    window = window_about(problem, positions)
    entries = draw_belief_maps(figure, [panel], problem, belief, positions, window)
    panel.set_title("\n".join(wrap(f"no plan: {message}", MESSAGE_WIDTH)), loc="left")
    legend_below(figure, [*draw_blocked(panel, blocked), *entries], COLUMNS)
    head(figure, f"{problem.name}: horizon {problem.planner.horizon}, no plan")
    return figure


def _sheet(problem: Problem, series: Sequence[Series]) -> tuple[Figure, list[Panel], list[Panel]]:
    """Return a figure, its map panels, and its panels of series next to or below the maps."""
    layers, shares = layers_of(problem), [share for _, share in series]
    if len(layers) == 1:
        size = 15.0, max(7.6, 1.2 + 1.65 * sum(shares))
        figure, panels = new_figure(*size, [["map", "series"]], width_ratios=[1.2, 1.0])
    else:
        curves_in = 0.6 + 1.5 * sum(shares)
        mosaic = [layers, ["series"] * len(layers)]
        figure, panels = new_figure(13.0, 6.5 + curves_in, mosaic, height_ratios=[5.0, curves_in])
    return figure, panels[:-1], split_panel(figure, panels[-1], shares)


def _draw_series(
    series: Sequence[Series], panels: Sequence[Panel], begin_s: float, end_s: float
) -> None:
    """Draw series in stacked panels with a common time axis, labelled below the last."""
    for (draw, _), panel in zip(series, panels, strict=False):
        draw(panel)
        panel.set_xlim(begin_s, end_s)
        panel.set_xlabel("")
    panels[-1].set_xlabel(TIME)
