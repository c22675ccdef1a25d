"""Time series of plans and runs, one panel each: power, connection, target, channel, fallbacks."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import StepLog
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.results import Run
from planopt.planning.team.reservations import (
    driven_motion,
    least_moving_clearances_m,
    least_separations_m,
)
from planopt.problems.problem import Problem
from planopt.report.panel import Panel
from planopt.report.style import (
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
    dress,
    legend_above,
    plain_log_ticks,
    robot_colour,
    robot_marker,
    spaced,
)
from planopt.robots.drive import Drive

TIME = "time [s]"

LEAST_SPAN_DB = 1.0
"""Least span of an axis of errors: small changes must not look large."""

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
"""Marker and colour of every fallback."""

Series = tuple[Callable[[Panel], None], float]
"""Draws one panel; its share of the height."""


def run_series(run: Run) -> list[Series]:
    """Return the panels that a run has data for."""
    strip = 0.18 + 0.13 * len(run.runs)
    panels: list[Series] = []
    if run.target is not None:
        panels.append((lambda panel: _draw_target(panel, run), 1.3))
    elif run.channel is not None:
        given = run.problem.channel.given
        if given is None or given.k_pl_db is None:
            # Known path loss has no uncertainty to draw.
            panels.append((lambda panel: _draw_path_loss(panel, run), 1.0))
        panels.append((lambda panel: _draw_map_error(panel, run), 1.0))
    if run.target is not None or run.problem.constraints.p_min > 0.0:
        panels.append((lambda panel: _draw_connectivity(panel, run), 1.0))
        panels.append((lambda panel: _draw_connection(panel, run), strip))
    if run.target is not None and run.channel is not None:
        panels.append((lambda panel: _draw_map_error(panel, run), 1.0))
    if keeps_distance(run.problem):
        tracks = [(one.log.positions_m, one.drive) for one in run.runs]
        t_s = run.runs[0].log.t_s
        panels.append((lambda panel: _draw_distances(panel, run.problem, tracks, t_s), 1.0))
    panels.append((lambda panel: _draw_fallbacks(panel, run), strip))
    return panels


def power_series(run: Run) -> list[Series]:
    """Return the panels of one robot's power, connection and planning times."""
    return [
        (lambda panel: _draw_power(panel, run), 3.0),
        (lambda panel: _draw_connection(panel, run), 0.5),
        (lambda panel: _draw_connectivity(panel, run), 2.0),
        (lambda panel: _draw_step_times(panel, run.run.log), 2.0),
    ]


def plan_series(
    problem: Problem, plans: Sequence[Plan], target_m: NDArray[np.float64] | None
) -> list[Series]:
    """Return the panels that plans have data for; `target_m` (N, 2) is the expected target."""
    panels: list[Series] = []
    if target_m is not None:
        panels.append((lambda panel: _draw_target_distance(panel, problem, plans, target_m), 1.0))
    panels.append((lambda panel: _draw_planned_power(panel, problem, plans), 1.0))
    if target_m is not None or problem.constraints.p_min > 0.0:
        panels.append((lambda panel: _draw_planned_connectivity(panel, problem, plans), 1.0))
    if keeps_distance(problem):
        tracks = [(plan.positions_m, plan.drive) for plan in plans]
        t_s = plans[0].t_s
        panels.append((lambda panel: _draw_distances(panel, problem, tracks, t_s), 1.0))
    return panels


def keeps_distance(problem: Problem) -> bool:
    """Return whether robots must keep a distance from each other or from moving obstacles."""
    separated = len(problem.robots) > 1 and problem.constraints.separation_m > 0.0
    return separated or bool(problem.workspace.moving)


def _draw_power(panel: Panel, run: Run) -> None:
    """Draw the power predicted one step ahead, with its band, and the true power."""
    log, station = run.run.log, run.problem.stations[0]
    _draw_band(panel, log.t_s, log.predicted_dbm, log.deviation_db, PREDICTED, BAND_WORDS)
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
    """Draw each robot's predicted power with its band, and the threshold if it matters."""
    for number, plan in enumerate(plans):
        label = BAND_WORDS if number == 0 else None
        _draw_band(panel, plan.t_s, plan.mean_dbm, plan.deviation_db, robot_colour(number), label)
        _draw_robot_curve(panel, plan.t_s, plan.mean_dbm, number)
    if any(term.sensor for term in problem.terms) or problem.constraints.p_min > 0.0:
        threshold = problem.stations[0].threshold_dbm
        panel.axhline(threshold, color=BLACK, linestyle="dashed", label="threshold")
    dress(panel, "predicted power", TIME, "power [dBm]")
    legend_above(panel)


def _draw_band(
    panel: Panel,
    t_s: NDArray[np.float64],
    mean: NDArray[np.float64],
    deviation: NDArray[np.float64],
    colour: str,
    label: str | None,
) -> None:
    half = BAND_Z * deviation
    look = {"color": colour, "alpha": 0.18, "linewidth": 0.0}
    panel.fill_between(t_s, mean - half, mean + half, label=label, **look)


def _draw_robot_curve(
    panel: Panel,
    t_s: NDArray[np.float64],
    values: NDArray[np.float64],
    number: int,
    label: str | None = None,
) -> None:
    look = {"color": robot_colour(number), "marker": robot_marker(number), "markersize": 3.5}
    panel.plot(t_s, values, linewidth=1.2, label=label, **look)


def _draw_connectivity(panel: Panel, run: Run) -> None:
    """Draw the probability of connection predicted one step ahead, and relaxed steps."""
    relaxed: list[tuple[float, float]] = []
    for number, one in enumerate(run.runs):
        log = one.log
        label = one.robot if len(run.runs) > 1 else None
        _draw_robot_curve(panel, log.t_s, log.connectivity, number, label)
        steps = log.relaxation_db > 0.0
        relaxed += zip(log.t_s[steps].tolist(), log.connectivity[steps].tolist(), strict=True)
    lowest = float(np.fmin.reduce([1.0, *np.concatenate([r.log.connectivity for r in run.runs])]))
    _finish_connectivity(panel, run.problem, lowest, relaxed, "P(connected), one step ahead")


def _draw_planned_connectivity(panel: Panel, problem: Problem, plans: Sequence[Plan]) -> None:
    """Draw each robot's predicted probability of connection, and relaxed steps."""
    for number, plan in enumerate(plans):
        _draw_robot_curve(panel, plan.t_s[-len(plan.connectivity) :], plan.connectivity, number)
    relaxed = [
        (float(plan.t_s[step]), float(plan.connectivity[step]))
        for plan in plans
        for step in plan.certificate.relaxed_steps
    ]
    lowest = min(float(plan.connectivity.min()) for plan in plans)
    _finish_connectivity(panel, problem, lowest, relaxed, "P(connected) along the plan")


def _finish_connectivity(
    panel: Panel,
    problem: Problem,
    lowest: float,
    relaxed: Sequence[tuple[float, float]],
    title: str,
) -> None:
    """Draw the bound and the relaxed steps of a panel of probabilities, and label it."""
    p_min = problem.constraints.step_p_min
    if p_min > 0.0:
        panel.axhline(p_min, color=BLACK, linestyle="dashed", label=f"p_min = {p_min:g}")
        lowest = min(lowest, p_min)
    if relaxed:
        look = {"marker": "D", "s": 28.0, "color": PURPLE, "edgecolors": BLACK}
        panel.scatter(*np.array(relaxed).T, zorder=3.0, label="bound relaxed", **look)
    dress(panel, title, TIME, "P(connected) [1]")
    # The axis follows the values, but does not magnify values that are all close to 1.
    panel.set_ylim(min(0.9, lowest) - 0.02, 1.02)
    legend_above(panel)


def _draw_connection(panel: Panel, run: Run) -> None:
    """Draw a row for each robot: its marker where truly connected, a cross elsewhere."""
    for number, one in enumerate(run.runs):
        for selection, look in (
            (one.log.connected, {"marker": robot_marker(number), "color": robot_colour(number)}),
            (~one.log.connected, {"marker": "x", "color": BLACK}),
        ):
            if selection.any():
                times = one.log.t_s[selection]
                panel.scatter(times, np.full(len(times), float(number)), s=20.0, **look)
    share = np.mean([one.metrics.true_connected_share for one in run.runs])
    words = f"{100.0 * share:.1f} % of the steps; x: not" if run.rungs else "no step was driven"
    dress(panel, f"truly connected ({words})", TIME, "", grid=False)
    _label_rows(panel, run.problem)


def _draw_fallbacks(panel: Panel, run: Run) -> None:
    """Draw a row for each robot: the fallback of every plan, circled if it is not verified."""
    for rung, (marker, colour) in RUNG_LOOKS.items():
        rows = [_release_times(one.log, rung) for one in run.runs]
        counts = [len(times) for times in rows]
        if sum(counts):
            panel.scatter(
                np.concatenate(rows),
                np.repeat(np.arange(len(rows), dtype=np.float64), counts),
                marker=marker,
                s=18.0,
                color=colour,
                zorder=3.0,
                label=f"{spaced(rung)} ({sum(counts)})",
            )
    unverified = [
        (t_s, float(row))
        for row, one in enumerate(run.runs)
        for t_s, verdict in zip(one.log.t_s[1:], one.log.verdict[1:], strict=True)
        if verdict is not Verdict.VERIFIED
    ]
    if unverified:
        look = {"s": 80.0, "facecolors": "none", "edgecolors": BLACK, "linewidths": 1.3}
        panel.scatter(*np.array(unverified).T, label=f"not verified ({len(unverified)})", **look)
    rate = f"{100.0 * run.verified_rate:.0f} % verified" if run.rungs else "no step was driven"
    dress(panel, f"fallbacks, {rate}", TIME, "", grid=False)
    _label_rows(panel, run.problem)
    if run.rungs:
        legend_above(panel, 3)


def _draw_step_times(panel: Panel, log: StepLog) -> None:
    """Draw the planning time of every step, marked by the fallback that released it."""
    milliseconds = 1e3 * log.step_s
    for rung, (marker, colour) in RUNG_LOOKS.items():
        times = _release_times(log, rung)
        if len(times):
            panel.scatter(
                times,
                milliseconds[np.isin(log.t_s, times)],
                marker=marker,
                s=16.0 if rung is Rung.PLAN else 34.0,
                color=colour,
                zorder=2.0 if rung is Rung.PLAN else 3.0,
                label=f"{spaced(rung)} ({len(times)})",
            )
    dress(panel, "planning time of a step, by fallback", TIME, "step time [ms]")
    if len(log.t_s) > 1:
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
        legend_above(panel)
    else:
        panel.text(log.t_s[0], 0.5, "no step was released", fontsize=NOTE_PT)


def _release_times(log: StepLog, rung: Rung) -> NDArray[np.float64]:
    """Return when plans of a fallback were released; the start has no plan."""
    chosen = np.array([found is rung for found in log.rung])
    chosen[0] = False
    return log.t_s[chosen]


def _label_rows(panel: Panel, problem: Problem) -> None:
    """Give every robot a row, the first on top."""
    count = len(problem.robots)
    panel.set_yticks([float(row) for row in range(count)], [r.name for r in problem.robots])
    panel.set_ylim(count - 0.4, -0.6)


def _draw_distances(
    panel: Panel,
    problem: Problem,
    tracks: Sequence[tuple[NDArray[np.float64], Drive | None]],
    t_s: NDArray[np.float64],  # (n + 1,)
) -> None:
    """Draw the least distances during each step, and the required ones."""
    step_s = problem.planner.step_s
    motions = [driven_motion(positions, drive, step_s) for positions, drive in tracks]
    curves: list[tuple[str, str, float, NDArray[np.float64]]] = []
    if len(motions) > 1:
        least = least_separations_m(motions)
        curves.append(("two robots", BLUE, problem.constraints.separation_m, least))
    if problem.workspace.moving:
        least = least_moving_clearances_m(problem, motions)
        curves.append(("moving obstacle", VERMILLION, problem.constraints.clearance_m, least))
    for label, colour, required, least in curves:
        # The value of a step holds during the whole step.
        steps = np.append(least[:1], least)
        panel.plot(t_s, steps, color=colour, drawstyle="steps-pre", label=label)
        panel.axhline(required, color=colour, linestyle="dashed")
    dress(panel, "least distance (dashed: required)", TIME, "distance [m]")
    panel.set_ylim(min(0.0, *(float(least.min()) for *_, least in curves)), None)
    legend_above(panel)


def _draw_target(panel: Panel, run: Run) -> None:
    """Draw the trace of the station's covariance, marked where a packet arrived."""
    if run.target is None:
        raise AssertionError("there is no target")
    t_s, trace = run.runs[0].log.t_s, run.target.station_variance_m2
    panel.plot(t_s, trace, color=PREDICTED)
    arrived = np.concatenate([[0], run.target.delivered.sum(axis=1)])
    for label, selection, fill in (
        ("packets arrived", arrived > 0, PREDICTED),
        ("none arrived", arrived == 0, WHITE),
    ):
        selection[0] = False  # nothing was sent at the start
        if selection.any():
            look = {"s": 22.0, "facecolors": fill, "edgecolors": PREDICTED, "zorder": 3.0}
            panel.scatter(t_s[selection], trace[selection], label=label, **look)
    dress(panel, "uncertainty of the target", TIME, "trace P [m²]")
    panel.set_yscale("log")
    plain_log_ticks(panel.yaxis)
    legend_above(panel)


def _draw_path_loss(panel: Panel, run: Run) -> None:
    _draw_channel_curve(panel, run, "theta_variance_db")
    dress(panel, "uncertainty of path loss", TIME, "trace M / |θ|² [dB]")


def _draw_map_error(panel: Panel, run: Run) -> None:
    rms_db = _draw_channel_curve(panel, run, "rms_db")
    dress(panel, "error of the predicted map", TIME, "RMS error [dB]")
    low, high = float(rms_db.min()), float(rms_db.max())
    margin = max(0.05 * (high - low), (LEAST_SPAN_DB - (high - low)) / 2.0)
    panel.set_ylim(low - margin, high + margin)


def _draw_channel_curve(panel: Panel, run: Run, name: str) -> NDArray[np.float64]:
    values = np.asarray(getattr(run.channel, name), dtype=np.float64)
    panel.plot(run.runs[0].log.t_s, values, color=PREDICTED, marker="o", markersize=3.5)
    return values


def _draw_target_distance(
    panel: Panel, problem: Problem, plans: Sequence[Plan], target_m: NDArray[np.float64]
) -> None:
    """Draw each robot's distance to the expected target, and the best distance of its sensor."""
    for number, plan in enumerate(plans):
        distance = np.linalg.norm(plan.positions_m[1:] - target_m, axis=1)
        _draw_robot_curve(panel, plan.t_s[1:], distance, number)
    sensor = next(term.sensor for term in problem.terms if term.sensor is not None)
    label = f"sensor is best at {sensor.sweet_spot_m:g} m"
    panel.axhline(sensor.sweet_spot_m, color=BLACK, linestyle="dashed", label=label)
    dress(panel, "distance to the target", TIME, "distance [m]")
    panel.set_ylim(0.0, None)
    legend_above(panel)
