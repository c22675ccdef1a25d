"""Panels of plans along the way, of one robot or several, and what is proven of them, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Plan
from planopt.planning.team.least_distances import driven_motion
from planopt.problems.problem import Problem
from planopt.report.apart_panel import draw_apart, has_apart
from planopt.report.maps import PATH_Z
from planopt.report.panel import Panel
from planopt.report.plan_words import apart_words
from planopt.report.style import BAND_WORDS, BAND_Z, BLACK, dress, legend_above, spaced
from planopt.report.team_looks import robot_colour, robot_marker
from planopt.report.team_series import TIME

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
    """What was found for each robot and what an independent check says of it, a few lines each."""
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
