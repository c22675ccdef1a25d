"""Time series of plans and runs, one per panel: power, connection, target, channel, fallbacks."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from planopt.arrays import Floats
from planopt.planning.loop.log import StepLog
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.reservations import (
    driven_motion,
    least_moving_clearances_m,
    least_separations_m,
)
from planopt.problems.problem import Problem
from planopt.report.panel import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    BLUE,
    GREEN,
    NOTE_PT,
    ORANGE,
    PREDICTED,
    PURPLE,
    SKY,
    THRESHOLD,
    TRUE,
    VERMILLION,
    WHITE,
    Panel,
    draw_band,
    dress,
    legend_above,
    log_scale,
    robot_colour,
    robot_marker,
    spaced,
)
from planopt.robots.dynamics import Drive

TIME = "time [s]"

LEAST_SPAN_DB = 1.0
"""Minimum span of an error axis in dB, so that small changes do not look large."""

RUNG_LOOKS = {
    Rung.PLAN: ("o", PREDICTED),
    Rung.COLD_RETRY: ("s", ORANGE),
    Rung.LATTICE: ("^", GREEN),
    Rung.RELAXED: ("D", PURPLE),
    Rung.SHIFTED: ("v", SKY),
    Rung.RESERVED: ("P", BLACK),
    Rung.DIRECT: (">", BLACK),
    Rung.GIVE_WAY: ("d", BLACK),
    Rung.LEAVE: ("<", VERMILLION),
    Rung.STOP: ("X", VERMILLION),
}
"""Marker and colour of each fallback."""

Series = tuple[Callable[[Panel], None], float]
"""Function that draws a panel, and its relative height."""
Curve = tuple[Floats, Floats, str]
"""Times (n,), values (n,) and label of one robot."""
Track = tuple[Floats, Drive | None]
"""Positions (n + 1, 2) of a robot, and its states and inputs if it has dynamics."""


def run_series(run: Run) -> list[Series]:
    """Return the panels for which a run has data."""
    problem, t_s, channel = run.problem, run.runs[0].log.t_s, run.channel
    strip = 0.18 + 0.13 * len(run.runs)
    panels: list[Series] = []
    error = (
        [] if channel is None else [(partial(_draw_map_error, t_s=t_s, rms_db=channel.rms_db), 1.0)]
    )
    if run.target is not None:
        panels.append((partial(_draw_target, run=run), 1.3))
    elif channel is not None:
        initial = problem.channel.given
        if initial is None or initial.k_pl_db is None:
            # A known path loss has no uncertainty to draw.
            variance = np.asarray(channel.theta_variance_db, dtype=np.float64)
            panels.append((partial(_draw_path_loss, t_s=t_s, variance_db=variance), 1.0))
        panels += error
    if run.target is not None or problem.constraints.p_min > 0.0:
        panels.append((partial(_draw_run_connectivity, run=run), 1.0))
        panels.append((partial(_draw_connection, run=run), strip))
    if run.target is not None:
        panels += error
    tracks = [(one.log.positions_m, one.drive) for one in run.runs]
    panels += _distance_series(problem, tracks, t_s)
    panels.append((partial(_draw_fallbacks, run=run), strip))
    return panels


def power_series(run: Run) -> list[Series]:
    """Return the panels of one robot's power, connection and planning times."""
    return [
        (partial(_draw_power, run=run), 3.0),
        (partial(_draw_connection, run=run), 0.5),
        (partial(_draw_run_connectivity, run=run), 2.0),
        (partial(_draw_step_times, log=run.run.log), 2.0),
    ]


def plan_series(problem: Problem, plans: Sequence[Plan], target_m: Floats | None) -> list[Series]:
    """Return the panels for which plans have data; `target_m` (N, 2) is the expected track."""
    panels: list[Series] = []
    if target_m is not None:
        panels.append(
            (partial(_draw_target_distance, problem=problem, plans=plans, target_m=target_m), 1.0)
        )
    panels.append((partial(_draw_planned_power, problem=problem, plans=plans), 1.0))
    if target_m is not None or problem.constraints.p_min > 0.0:
        panels.append((partial(_draw_planned_connectivity, problem=problem, plans=plans), 1.0))
    tracks = [(plan.positions_m, plan.drive) for plan in plans]
    return panels + _distance_series(problem, tracks, plans[0].t_s)


def _draw_robots(panel: Panel, curves: Sequence[Curve]) -> None:
    """Draw one curve per robot."""
    for number, (t_s, values, label) in enumerate(curves):
        look = {"color": robot_colour(number), "marker": robot_marker(number), "markersize": 3.5}
        panel.plot(t_s, values, linewidth=1.2, label=label, **look)


def _draw_power(panel: Panel, run: Run) -> None:
    """Draw the power predicted one step ahead with its band, and the true power."""
    log, station = run.run.log, run.problem.stations[0]
    half = BAND_Z * log.deviation_db
    low, high = log.predicted_dbm - half, log.predicted_dbm + half
    draw_band(panel, log.t_s, low, high, PREDICTED, BAND_WORDS)
    panel.plot(log.t_s, log.predicted_dbm, color=PREDICTED, label="predicted one step ahead")
    look = {"color": TRUE, "linewidth": 0.8, "marker": ".", "markersize": 4.0}
    panel.plot(log.t_s, log.true_dbm, label="true", **look)
    panel.axhline(station.threshold_dbm, color=THRESHOLD, linestyle="dashed", label="threshold")
    least = station.true_threshold_dbm
    if least != station.threshold_dbm:
        panel.axhline(least, color=THRESHOLD, linestyle="dotted", label="true threshold")
    dress(panel, "received power", TIME, "power [dBm]")
    legend_above(panel)


def _draw_planned_power(panel: Panel, problem: Problem, plans: Sequence[Plan]) -> None:
    """Draw each robot's predicted power with its band, and the threshold if it is relevant."""
    _draw_robots(panel, [(plan.t_s, plan.mean_dbm, "_power") for plan in plans])
    for number, plan in enumerate(plans):
        half, label = BAND_Z * plan.deviation_db, None if number else BAND_WORDS
        low, high = plan.mean_dbm - half, plan.mean_dbm + half
        draw_band(panel, plan.t_s, low, high, robot_colour(number), label)
    if any(term.sensor for term in problem.terms) or problem.constraints.p_min > 0.0:
        threshold = problem.stations[0].threshold_dbm
        panel.axhline(threshold, color=BLACK, linestyle="dashed", label="threshold")
    dress(panel, "predicted power", TIME, "power [dBm]")
    legend_above(panel)


def _draw_run_connectivity(panel: Panel, run: Run) -> None:
    """Draw the probability of connection predicted one step ahead, and relaxed steps."""
    several = len(run.runs) > 1
    curves: list[Curve] = []
    relaxed: list[tuple[float, float]] = []
    for one in run.runs:
        log, steps = one.log, one.log.relaxation_db > 0.0
        curves.append((log.t_s, log.connectivity, one.robot if several else "_chance"))
        relaxed += zip(log.t_s[steps].tolist(), log.connectivity[steps].tolist(), strict=True)
    _draw_connectivity(panel, run.problem, curves, relaxed, "P(connected) predicted one step ahead")


def _draw_planned_connectivity(panel: Panel, problem: Problem, plans: Sequence[Plan]) -> None:
    """Draw each robot's predicted probability of connection, and relaxed steps."""
    curves = [(one.t_s[-len(one.connectivity) :], one.connectivity, "_chance") for one in plans]
    relaxed = [
        (float(plan.t_s[step]), float(plan.connectivity[step]))
        for plan in plans
        for step in plan.certificate.relaxed_steps
    ]
    _draw_connectivity(panel, problem, curves, relaxed, "P(connected) along the plan")


def _draw_connectivity(
    panel: Panel,
    problem: Problem,
    curves: Sequence[Curve],
    relaxed: Sequence[tuple[float, float]],  # Times and probabilities
    title: str,
) -> None:
    """Draw probabilities of connection, the bound p_min and the steps at which it is relaxed."""
    _draw_robots(panel, curves)
    p_min = problem.constraints.step_p_min
    lowest = float(np.fmin.reduce([0.9, *np.concatenate([values for _, values, _ in curves])]))
    if p_min > 0.0:
        panel.axhline(p_min, color=BLACK, linestyle="dashed", label=f"p_min = {p_min:g}")
        lowest = min(lowest, p_min)
    if relaxed:
        look = {"marker": "D", "s": 28.0, "color": PURPLE, "edgecolors": BLACK}
        panel.scatter(*np.array(relaxed).T, zorder=3.0, label="P(connected) below p_min", **look)
    dress(panel, title, TIME, "P(connected) [1]")
    # The axis follows the values but does not magnify values that are all close to 1.
    panel.set_ylim(lowest - 0.02, 1.02)
    legend_above(panel)


def _draw_connection(panel: Panel, run: Run) -> None:
    """Draw a row per robot: its marker at connected steps, a cross at disconnected ones."""
    for number, one in enumerate(run.runs):
        own = {"marker": robot_marker(number), "color": robot_colour(number)}
        cross = {"marker": "x", "color": BLACK}
        for selection, look in ((one.log.connected, own), (one.log.disconnected, cross)):
            times = one.log.t_s[selection]
            if len(times):
                panel.scatter(times, np.full(len(times), float(number)), s=20.0, **look)
    share = np.mean([one.metrics.true_connected_share for one in run.runs])
    words = f"{100.0 * share:.1f} % of steps; x: outage" if run.rungs else "no step was driven"
    dress(panel, f"true connection ({words})", TIME, "", grid=False)
    _label_rows(panel, run.problem)


def _draw_fallbacks(panel: Panel, run: Run) -> None:
    """Draw each robot's fallbacks in a row; circle plans that are not verified."""
    logs = [one.log for one in run.runs]
    for rung, (marker, colour) in RUNG_LOOKS.items():
        rows = [_release_times(log, rung) for log in logs]
        look = {"marker": marker, "color": colour, "s": 18.0, "zorder": 3.0}
        _draw_rows(panel, rows, spaced(rung), **look)
    rows = [
        np.array([t_s for t_s, one in released if one is not Verdict.VERIFIED])
        for released in (zip(log.t_s[1:], log.verdict[1:], strict=True) for log in logs)
    ]
    look = {"s": 80.0, "facecolors": "none", "edgecolors": BLACK, "linewidths": 1.3}
    _draw_rows(panel, rows, "not verified", **look)
    rate = f"{100.0 * run.verified_rate:.0f} % verified" if run.rungs else "no step was driven"
    dress(panel, f"released plans by fallback; {rate}", TIME, "", grid=False)
    _label_rows(panel, run.problem)
    if run.rungs:
        legend_above(panel, 3)


def _draw_rows(panel: Panel, rows: Sequence[Floats], label: str, **look: object) -> None:
    """Mark the times (n,) of each robot in its row; the label shows their number."""
    counts = [len(times) for times in rows]
    if sum(counts):
        at = np.repeat(np.arange(len(rows), dtype=np.float64), counts)
        panel.scatter(np.concatenate(rows), at, label=f"{label} ({sum(counts)})", **look)


def _draw_step_times(panel: Panel, log: StepLog) -> None:
    """Draw the planning time of every step, marked by the fallback that released it."""
    milliseconds = 1e3 * log.step_s
    for rung, (marker, colour) in RUNG_LOOKS.items():
        times = _release_times(log, rung)
        if len(times):
            look = {"marker": marker, "color": colour, "s": 16.0, "zorder": 2.0}
            if rung is not Rung.PLAN:
                look |= {"s": 34.0, "zorder": 3.0}
            label = f"{spaced(rung)} ({len(times)})"
            panel.scatter(times, milliseconds[np.isin(log.t_s, times)], label=label, **look)
    dress(panel, "planning time per step, by fallback", TIME, "step time [ms]")
    if len(log.t_s) > 1:
        log_scale(panel, "y")
        legend_above(panel)
    else:
        panel.text(log.t_s[0], 0.5, "no step was released", fontsize=NOTE_PT)


def _release_times(log: StepLog, rung: Rung) -> Floats:
    """Return the times at which a fallback released a plan, except for the start."""
    return log.t_s[1:][np.array([found is rung for found in log.rung[1:]], dtype=bool)]


def _label_rows(panel: Panel, problem: Problem) -> None:
    """Label one row per robot, the first on top."""
    count = len(problem.robots)
    panel.set_yticks([float(row) for row in range(count)], [r.name for r in problem.robots])
    panel.set_ylim(count - 0.4, -0.6)


def _distance_series(problem: Problem, tracks: Sequence[Track], t_s: Floats) -> list[Series]:
    """Return the panel of distances, if any separation or clearance is required."""
    separated = len(problem.robots) > 1 and problem.constraints.separation_m > 0.0
    if not (separated or problem.workspace.moving):
        return []
    return [(partial(_draw_distances, problem=problem, tracks=tracks, t_s=t_s), 1.0)]


def _draw_distances(panel: Panel, problem: Problem, tracks: Sequence[Track], t_s: Floats) -> None:
    """Draw the minimum distances during each step, and the required distances."""
    limits, motions = (
        problem.constraints,
        [driven_motion(*track, problem.planner.step_s) for track in tracks],
    )
    curves: list[tuple[str, str, float, Floats]] = []
    if len(motions) > 1:
        least = least_separations_m(motions)
        curves.append(("two robots", BLUE, limits.separation_m, least))
    if problem.workspace.moving:
        least = least_moving_clearances_m(problem, motions)
        curves.append(("moving obstacle", VERMILLION, limits.clearance_m, least))
    for label, colour, required, least in curves:
        # Values are constant during a step.
        steps = np.append(least[:1], least)
        panel.plot(t_s, steps, color=colour, drawstyle="steps-pre", label=label)
        panel.axhline(required, color=colour, linestyle="dashed")
    dress(panel, "minimum distance (dashed: required)", TIME, "distance [m]")
    panel.set_ylim(min(0.0, *(float(least.min()) for *_, least in curves)), None)
    legend_above(panel)


def _draw_target(panel: Panel, run: Run) -> None:
    """Draw the trace of the station's covariance, with a mark for each packet that arrived."""
    assert run.target is not None
    t_s, trace = run.runs[0].log.t_s, run.target.station_variance_m2
    panel.plot(t_s, trace, color=PREDICTED)
    arrived = run.target.delivered.any(axis=1)
    for label, selection, fill in (
        ("packets arrived", arrived, PREDICTED),
        ("no packet arrived", ~arrived, WHITE),
    ):
        if selection.any():
            look = {"s": 22.0, "facecolors": fill, "edgecolors": PREDICTED, "zorder": 3.0}
            panel.scatter(t_s[1:][selection], trace[1:][selection], label=label, **look)
    dress(panel, "uncertainty of the target position", TIME, "trace P [m²]")
    log_scale(panel, "y")
    legend_above(panel)


def _draw_path_loss(panel: Panel, t_s: Floats, variance_db: Floats) -> None:
    panel.plot(t_s, variance_db, color=PREDICTED, marker="o", markersize=3.5)
    dress(panel, "uncertainty of path loss", TIME, "trace M / |θ|² [dB]")


def _draw_map_error(panel: Panel, t_s: Floats, rms_db: Floats) -> None:
    panel.plot(t_s, rms_db, color=PREDICTED, marker="o", markersize=3.5)
    dress(panel, "error of the predicted map", TIME, "RMS error [dB]")
    low, high = float(np.min(rms_db)), float(np.max(rms_db))
    margin = max(0.05 * (high - low), (LEAST_SPAN_DB - (high - low)) / 2.0)
    panel.set_ylim(low - margin, high + margin)


def _draw_target_distance(
    panel: Panel, problem: Problem, plans: Sequence[Plan], target_m: Floats
) -> None:
    """Draw each robot's distance to the expected target, and its sensor's optimal distance."""
    distances = [np.linalg.norm(plan.positions_m[1:] - target_m, axis=1) for plan in plans]
    times = [plan.t_s[1:] for plan in plans]
    _draw_robots(panel, [(t, d, "_distance") for t, d in zip(times, distances, strict=True)])
    sensor = next(term.sensor for term in problem.terms if term.sensor is not None)
    label = f"best sensor distance: {sensor.sweet_spot_m:g} m"
    panel.axhline(sensor.sweet_spot_m, color=BLACK, linestyle="dashed", label=label)
    dress(panel, "distance to the target", TIME, "distance [m]")
    panel.set_ylim(0.0, None)
    legend_above(panel)
