"""Figures of whole results: the plans of a solution, or a run, of one robot or several.

One plan has its map, what it is predicted to receive on the way, and its verdict and certificate in
words. Several robots share one map, beside panels of their plans or of the run over time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.planning.certificate import Certificate
from planopt.planning.plan import Plan, Verdict
from planopt.planning.run import Run
from planopt.planning.solution import Solution
from planopt.planning.team.reservations import driven_motion
from planopt.problems.constraints import Constraints
from planopt.problems.problem import Problem
from planopt.report.apart_panel import draw_apart, has_apart
from planopt.report.maps import PATH_Z, draw_moving
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.plan_map import draw_blocked, draw_plan_map
from planopt.report.run_figure import draw_run
from planopt.report.style import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    NOTE_PT,
    dress,
    head,
    legend_above,
    legend_below,
    spaced,
)
from planopt.report.team_map import (
    draw_expected_target,
    draw_measured,
    draw_plans,
    draw_target,
    draw_team_ground,
    draw_tracks,
    layers_of,
)
from planopt.report.team_series import TIME, robot_colour, robot_marker, series_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

MEANING = {
    Verdict.VERIFIED: "constraints hold; contact is left only where unavoidable or worth its price",
    Verdict.FEASIBLE_UNVERIFIED: "not rejected, but a part of the proof is missing",
    Verdict.VIOLATED: "a constraint does not hold",
    Verdict.NONE: "there is no plan",
}


def plan_words(plan: Plan, constraints: Constraints) -> list[str]:
    """Return the plan and the verdict of an independent check in words, a line each."""
    proof = plan.certificate
    clearance = (
        f"least clearance {proof.min_clearance_m:.3f} m of the whole swept path, "
        f"{constraints.clearance_m:g} m asked"
        if math.isfinite(proof.min_clearance_m)
        else "no obstacles to keep clear of"
    )
    lines = [
        f"verdict: {spaced(plan.verdict)} ({MEANING[plan.verdict]})",
        clearance,
        *apart_words(proof),
        f"least P(connected) {proof.min_connectivity:.3f}"
        + (f", {constraints.step_p_min:g} asked" if constraints.step_p_min > 0.0 else "")
        + f" (posterior: {proof.posterior})",
        f"motion model kept to {proof.dynamics_defect:.2g} m; "
        + (
            "not polished"
            if proof.kkt_residual is None
            else f"KKT residual of the polish {proof.kkt_residual:.2g}"
        ),
        f"cost {plan.objective:.1f} s (lattice start {plan.lattice_objective:.1f} s); "
        f"{spaced(plan.termination)} after {plan.iterations} iterations, "
        f"{1e3 * plan.wall_s:.0f} ms; rung: {spaced(plan.rung)}",
    ]
    if proof.rule is not None:
        lines.append(proof.rule.words)
    if proof.relaxed_steps:
        lines.append(
            f"the bound is not met at {len(proof.relaxed_steps)} of {len(plan.t_s) - 1} steps; "
            f"missed by at most {max(proof.relaxation_db):.2f} dB"
        )
    return [*lines, *proof.reasons, *([plan.message] if plan.message else [])]


def apart_words(proof: Certificate) -> list[str]:
    """Return how far a plan keeps from robots and discs that move; nothing without any."""
    parts = [
        f"{distance:.3f} m from {what}"
        for distance, what in (
            (proof.min_separation_m, "other robots"),
            (proof.min_moving_clearance_m, "moving obstacles"),
        )
        if distance is not None
    ]
    return [f"always at least {', '.join(parts)}"] if parts else []


PlanDrawer = Callable[[Panel, Sequence[Plan]], None]


def plan_series_of(
    problem: Problem, target_m: NDArray[np.float64] | None
) -> tuple[PlanDrawer, ...]:
    """The panels that plans have something to show in."""

    def power(panel: Panel, plans: Sequence[Plan]) -> None:
        draw_plan_power(panel, problem, plans)

    def connectivity(panel: Panel, plans: Sequence[Plan]) -> None:
        draw_plan_connectivity(panel, problem, plans)

    def apart(panel: Panel, plans: Sequence[Plan]) -> None:
        step_s = problem.planner.step_s
        motions = [driven_motion(plan.positions_m, plan.drive, step_s) for plan in plans]
        draw_apart(panel, problem, motions, plans[0].t_s)

    last = (apart,) if has_apart(problem) else ()
    if target_m is None:
        return (power, connectivity, *last) if problem.constraints.p_min > 0.0 else (power, *last)

    def distance(panel: Panel, plans: Sequence[Plan]) -> None:
        _draw_distance(panel, problem, plans, target_m)

    return (distance, power, connectivity, *last)


def _draw_curve(panel: Panel, plan: Plan, number: int, y: NDArray[np.float64]) -> None:
    panel.plot(
        plan.t_s[-len(y) :],
        y,
        color=robot_colour(number),
        marker=robot_marker(number),
        markersize=4.0,
        linewidth=1.3,
    )


def draw_plan_power(panel: Panel, problem: Problem, plans: Sequence[Plan]) -> None:
    """Predicted power of every robot with its band, and the threshold where it counts."""
    for number, plan in enumerate(plans):
        panel.fill_between(
            plan.t_s,
            plan.mean_dbm - BAND_Z * plan.deviation_db,
            plan.mean_dbm + BAND_Z * plan.deviation_db,
            color=robot_colour(number),
            alpha=0.15,
            linewidth=0.0,
            label=BAND_WORDS if number == 0 else None,
        )
        _draw_curve(panel, plan, number, plan.mean_dbm)
    if any(term.sensor for term in problem.terms) or problem.constraints.p_min > 0.0:
        threshold = problem.stations[0].threshold_dbm
        panel.axhline(threshold, color=BLACK, linestyle="dashed", label="threshold")
    dress(panel, "predicted power", TIME, "power [dBm]")
    legend_above(panel)


def draw_plan_connectivity(panel: Panel, problem: Problem, plans: Sequence[Plan]) -> None:
    """Predicted chance of a connection of every robot, and its bound where there is one."""
    for number, plan in enumerate(plans):
        _draw_curve(panel, plan, number, plan.connectivity)
    p_min = problem.constraints.step_p_min
    lowest = min(float(plan.connectivity.min()) for plan in plans)
    if p_min > 0.0:
        panel.axhline(p_min, color=BLACK, linestyle="dashed", label=f"p_min = {p_min:g}")
        legend_above(panel)
        lowest = min(lowest, p_min)
    missed = [
        (plan.t_s[step], plan.connectivity[step])
        for plan in plans
        for step in plan.certificate.relaxed_steps
    ]
    if missed:
        panel.scatter(
            *np.array(missed).T,
            s=70.0,
            facecolors="none",
            edgecolors=BLACK,
            zorder=PATH_Z,
            label="not met",
        )
        legend_above(panel)
    dress(panel, "predicted connectivity", TIME, "P(connected) [1]")
    panel.set_ylim(min(0.9, lowest) - 0.02, 1.02)


def _draw_distance(
    panel: Panel, problem: Problem, plans: Sequence[Plan], target_m: NDArray[np.float64]
) -> None:
    """Distance of every robot to where the target is expected, and where its sensor is best."""
    for number, plan in enumerate(plans):
        away = np.linalg.norm(plan.positions_m[1:] - target_m, axis=1)
        _draw_curve(panel, plan, number, away)
    sensor = next(term.sensor for term in problem.terms if term.sensor is not None)
    panel.axhline(
        sensor.sweet_spot_m,
        color=BLACK,
        linestyle="dashed",
        label=f"sensor is best at {sensor.sweet_spot_m:g} m",
    )
    dress(panel, "distance to the target", TIME, "distance [m]")
    panel.set_ylim(0.0, None)
    legend_above(panel)


def team_plan_words(plans: Sequence[Plan]) -> list[str]:
    """Return each robot's plan and the verdict of an independent check, a few lines each."""
    lines: list[str] = []
    for plan in plans:
        proof = plan.certificate
        clearance = (
            f"least clearance {proof.min_clearance_m:.2f} m"
            if math.isfinite(proof.min_clearance_m)
            else "no obstacles"
        )
        lines += [
            f"{plan.robot}: {spaced(plan.verdict)}, {clearance}, "
            f"least P(connected) {proof.min_connectivity:.3f}",
            *(f"    {words}" for words in apart_words(proof)),
            f"    worth {plan.objective:.4g} (best start {plan.lattice_objective:.4g}); "
            f"rung {spaced(plan.rung)}, {1e3 * plan.wall_s:.0f} ms",
            *(f"    {reason}" for reason in proof.reasons[:2]),
        ]
    return lines


WORDS_WIDTH, WORDS_LINES = 60, 13
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


COLUMNS = 5
"""Of the legend."""


def draw_team_run(run: Run) -> Figure:
    """Draw where a team drove on what the first robot believed at the end, and its time series.

    Robots are told apart by colour and marker. Panels that a problem has nothing for are left out:
    a target only where one is tracked, connections only where they count.

    Parameters
    ----------
    run
        From :func:`planopt.simulate`.
    """
    problem = run.problem
    tracks = [one.log.positions_m for one in run.runs]
    plans = [released[-1] for released in run.plans if released]
    shown = [*tracks, *(plan.positions_m for plan in plans)]
    if run.target is not None:
        shown.append(run.target.true_m)
    drawers = series_of(run)
    figure, maps, others = _sheet(problem, [share for _, share in drawers])
    entries = draw_team_ground(figure, maps, problem, run.beliefs[0], np.concatenate(shown))
    before = run.beliefs[0].posterior.measurements.positions_m[: run.first_measurements]
    for number, panel in enumerate(maps):
        drawn = draw_measured(panel, before, "measured before")
        drawn += draw_moving(panel, problem, len(tracks[0]) - 1, predicted=False)
        drawn += draw_tracks(panel, problem, run.runs)
        if plans:
            drawn += draw_plans(panel, problem, plans, 1)
        if run.target is not None:
            drawn += draw_target(panel, run.target)
        drawn += draw_blocked(panel, run.blocked)
        if number == 0:
            entries = [*entries, *drawn]
    for panel, (draw, _) in zip(others, drawers, strict=True):
        draw(panel, run)
    t_s = run.runs[0].log.t_s
    half_step = problem.planner.step_s / 2.0
    _one_time_axis(others, float(t_s[0]) - half_step, float(t_s[-1]) + half_step)
    legend_below(figure, entries, COLUMNS)
    head(
        figure,
        f"{problem.name}: horizon {problem.planner.horizon}, {problem.planner.name} planner, "
        f"seed {run.seed}, {len(t_s) - 1} steps",
    )
    return figure


def draw_team_plan(
    problem: Problem,
    plans: Sequence[Plan],
    belief: Belief,
    target_m: NDArray[np.float64] | None,
) -> Figure:
    """Draw the plans of one moment, their predictions along the way and their certificates.

    Parameters
    ----------
    problem
        What was asked.
    plans
        One of each robot, in the problem's order.
    belief
        What the map is drawn from.
    target_m
        ``(N, 2)`` where the target is expected after each step; None without target.
    """
    shown = [plan.positions_m for plan in plans]
    if target_m is not None:
        shown.append(target_m)
    drawers = plan_series_of(problem, target_m)
    words = team_plan_words(plans)
    figure, maps, others = _sheet(problem, [*(1.0 for _ in drawers), 0.3 + 0.11 * len(words)])
    entries = draw_team_ground(figure, maps, problem, belief, np.concatenate(shown))
    for number, panel in enumerate(maps):
        drawn = draw_measured(panel, belief.posterior.measurements.positions_m, "measured")
        drawn += draw_moving(panel, problem, len(plans[0].t_s) - 1, predicted=True)
        drawn += draw_plans(panel, problem, plans, 0)
        if target_m is not None:
            drawn += draw_expected_target(panel, target_m)
        if number == 0:
            entries = [*entries, *drawn]
    for panel, draw in zip(others, drawers, strict=False):
        draw(panel, plans)
    t_s = plans[0].t_s
    _one_time_axis(others[:-1], float(t_s[0]), float(t_s[-1]))
    others[-1].set_axis_off()
    others[-1].text(
        0.0, 1.0, "\n".join(words), va="top", fontsize=NOTE_PT, linespacing=1.35, in_layout=False
    )
    legend_below(figure, entries, COLUMNS)
    head(
        figure,
        f"{problem.name}: plans of {len(t_s) - 1} steps, {problem.planner.name} planner",
    )
    return figure


def _sheet(problem: Problem, shares: Sequence[float]) -> tuple[Figure, list[Panel], list[Panel]]:
    """A figure with panels for the maps and for curves of these shares of the height.

    Curves are beside one map, and below two.
    """
    from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec

    count = len(layers_of(problem))
    if count == 1:
        figure = new_figure(15.0, max(7.6, 1.2 + 1.65 * sum(shares)))
        cells = GridSpec(1, 2, figure=figure, width_ratios=[1.2, 1.0])
        spots: list[SubplotSpec] = [cells[0, 0]]
        below = cells[0, 1]
    else:
        curves_in = 0.6 + 1.5 * sum(shares)
        figure = new_figure(13.0, 6.5 + curves_in)
        cells = GridSpec(2, count, figure=figure, height_ratios=[5.0, curves_in])
        spots = [cells[0, column] for column in range(count)]
        below = cells[1, :]
    rows = GridSpecFromSubplotSpec(len(shares), 1, below, height_ratios=list(shares))
    maps = [add_panel(figure, spot) for spot in spots]
    return figure, maps, [add_panel(figure, rows[row, 0]) for row in range(len(shares))]


def _one_time_axis(panels: Sequence[Panel], begin_s: float, end_s: float) -> None:
    """Give panels above each other the same times, named under the last."""
    for panel in panels:
        panel.set_xlim(begin_s, end_s)
        panel.set_xlabel("")
    panels[-1].set_xlabel(TIME)


def draw_solution(solution: Solution) -> Figure:
    """Draw the plans on the map, their predictions and their certificates."""
    if solution.problem.task == "reach" and len(solution.plans) == 1:
        return draw_plan(solution)
    target_m = solution.aims[0].target_m
    return draw_team_plan(solution.problem, solution.plans, solution.belief, target_m)


def draw_driven(run: Run) -> Figure:
    """Draw where robots drove: one to a goal on the ground truth, else on what they believed."""
    alone = run.problem.task == "reach" and len(run.runs) == 1
    return draw_run(run) if alone else draw_team_run(run)
