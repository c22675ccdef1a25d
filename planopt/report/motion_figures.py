"""Figures of plans, runs and problems without plan: maps, time series and certificates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from planopt.arrays import Floats
from planopt.channel.posterior import Belief
from planopt.planning.certificate import BlockedPath
from planopt.planning.loop.log import StepLog
from planopt.planning.loop.results import Run, Solution
from planopt.planning.plan import Plan, Rung, Verdict
from planopt.planning.reservations import (
    driven_motion,
    least_moving_clearances_m,
    least_separations_m,
)
from planopt.problems.problem import Problem, problem_of_robot
from planopt.report.maps import (
    draw_ground,
    draw_moving,
    draw_places,
    map_window,
    show_window,
    window_about,
)
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
from planopt.report.motion_words import plan_in_words, proof_in_words
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
    TIME,
    TRUE,
    VERMILLION,
    WHITE,
    Panel,
    colour_of,
    draw_band,
    dress,
    fit_to_map,
    head,
    legend_above,
    legend_below,
    log_scale,
    new_figure,
    robot_marker,
    spaced,
    split_panel,
)
from planopt.robots.dynamics import Drive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST_SPAN_DB = 1.0  # Minimum span of an error axis in dB, so that small changes do not look large

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
    error: list[Series] = []
    if channel is not None:
        look = {"t_s": t_s, "values": channel.rms_db, "least": LEAST_SPAN_DB}
        words = "error of the predicted map", "RMS error [dB]"
        error = [(partial(_draw_marked, words=words, **look), 1.0)]
    if run.target is not None:
        panels.append((partial(_draw_target, run=run), 1.3))
    elif channel is not None:
        initial = problem.channel.given
        if initial is None or initial.k_pl_db is None:
            # A known path loss has no uncertainty to draw.
            variance = np.asarray(channel.theta_variance_db, dtype=np.float64)
            words = "uncertainty of path loss", "trace M / |θ|² [dB]"
            panels.append((partial(_draw_marked, t_s=t_s, values=variance, words=words), 1.0))
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


def plan_series(problem: Problem, plans: Sequence[Plan], target_m: Floats | None) -> list[Series]:
    """Return the panels for which plans have data; `target_m` (N, 2) is the expected track."""
    panels: list[Series] = []
    if target_m is not None:
        panels.append(
            (partial(_draw_target_distance, problem=problem, plans=plans, target_m=target_m), 1.0)
        )
    panels.append((partial(_draw_planned_power, problem=problem, plans=plans), 1.0))
    if target_m is not None or problem.constraints.p_min > 0.0:
        curves = [(one.t_s[-len(one.connectivity) :], one.connectivity, "_chance") for one in plans]
        relaxed = [
            (float(plan.t_s[step]), float(plan.connectivity[step]))
            for plan in plans
            for step in plan.certificate.relaxed_steps
        ]
        title = "planned P(connected)"
        look = {"problem": problem, "curves": curves, "relaxed": relaxed, "title": title}
        panels.append((partial(_draw_connectivity, **look), 1.0))
    tracks = [(plan.positions_m, plan.drive) for plan in plans]
    return panels + _distance_series(problem, tracks, plans[0].t_s)


def _draw_robots(panel: Panel, curves: Sequence[Curve]) -> None:
    """Draw one curve per robot."""
    for number, (t_s, values, label) in enumerate(curves):
        look = {"color": colour_of(number), "marker": robot_marker(number), "markersize": 3.5}
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
        draw_band(panel, plan.t_s, low, high, colour_of(number), label)
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
        own = {"marker": robot_marker(number), "color": colour_of(number)}
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
    """Mark the times (n,) of each robot in its row; the label shows the number of times."""
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
    if not (problem.has_separation or problem.workspace.moving):
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


def _draw_marked(
    panel: Panel, t_s: Floats, values: Floats, words: tuple[str, str], least: float = 0.0
) -> None:
    """Draw values over time; `words` are title and label, `least` is the least span of the axis."""
    panel.plot(t_s, values, color=PREDICTED, marker="o", markersize=3.5)
    dress(panel, words[0], TIME, words[1])
    if least:
        low, high = float(np.min(values)), float(np.max(values))
        margin = max(0.05 * (high - low), (least - (high - low)) / 2.0)
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


COLUMNS = 5  # Number of columns of a legend
MESSAGE_WIDTH = 100  # Maximum line length of a message above a map, in characters
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
    words: list[str] = []
    for number, plan in enumerate(plans):
        own = problem_of_robot(problem, number)
        said = plan_in_words(own, plan) + (proof_in_words(own, plan) if len(plans) == 1 else [])
        lines = [
            each for line in said for each in wrap(line, WORDS_WIDTH, subsequent_indent=" " * 4)
        ]
        cut = len(lines) > WORDS_LINES
        words += [*lines[: WORDS_LINES - 1], "..."] if cut else lines
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
    show_window(panel, problem, log.positions_m, problem.workspace.bounds_m)
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
    series: list[Series] = [
        (partial(_draw_power, run=run), 3.0),
        (partial(_draw_connection, run=run), 0.5),
        (partial(_draw_run_connectivity, run=run), 2.0),
        (partial(_draw_step_times, log=run.run.log), 2.0),
    ]
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
