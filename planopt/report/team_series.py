"""A team's run over time: the target, the channel, the connections, and what planning did.

Robots are told apart by a colour and a marker each, the same in maps and curves.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import ChannelLog, RobotRun
from planopt.planning.plan import Rung, Verdict
from planopt.planning.run import Run
from planopt.planning.team.reservations import driven_motion
from planopt.problems.problem import Problem
from planopt.report.apart_panel import draw_apart, has_apart
from planopt.report.panel import Panel
from planopt.report.run_figure import RUNG_LOOKS
from planopt.report.style import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PREDICTED,
    PURPLE,
    SKY,
    VERMILLION,
    WHITE,
    dress,
    legend_above,
    plain_log_ticks,
    spaced,
)
from planopt.robots.drive import Drive

if TYPE_CHECKING:
    from planopt.report.panel import Panel

POINTS = 16
"""Of the curve of a step."""


def driven_line(
    problem: Problem, places_m: NDArray[np.float64], drive: Drive | None, first: int = 0
) -> tuple[NDArray[np.float64], list[int]]:
    """Points (k, 2) of a line through places, and which of them are the places."""
    # Shapes: places_m (n + 1, 2).
    if drive is None or len(drive.inputs) <= first:
        return places_m[first:], list(range(len(places_m) - first))
    ways = drive.dynamics.ways(drive.states[first:-1], drive.inputs[first:], problem.planner.step_s)
    line, marks = [places_m[first : first + 1]], [0]
    for way in ways:
        points, _ = way.points_m()
        chosen = np.linspace(0, len(points) - 1, min(POINTS, len(points))).round().astype(int)
        line.append(points[chosen[1:]])
        marks.append(marks[-1] + len(chosen) - 1)
    return np.concatenate(line), marks


ROBOT_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE)
ROBOT_MARKERS = ("o", "s", "D", "v", "P", "X", "h")
"""Of different numbers, so that colour and marker together repeat late."""


def robot_colour(number: int) -> str:
    """Colour of robot number `number`, 0 is the first."""
    return ROBOT_COLOURS[number % len(ROBOT_COLOURS)]


def robot_marker(number: int) -> str:
    """Marker of robot number `number`."""
    return ROBOT_MARKERS[number % len(ROBOT_MARKERS)]


def name_rows(panel: Panel, problem: Problem) -> None:
    """Give every robot a row of a strip, the first on top."""
    count = len(problem.robots)
    panel.set_yticks([float(row) for row in range(count)], [r.name for r in problem.robots])
    panel.set_ylim(count - 0.4, -0.6)


Drawer = Callable[[Panel, Run], None]

TIME = "time [s]"

LEAST_SPAN_DB = 1.0
"""An axis of errors spans this at least: smaller changes are not to look like large ones."""


def series_of(run: Run) -> tuple[tuple[Drawer, float], ...]:
    """The panels that a run has something to show in, each with its share of the height."""
    strip = 0.18 + 0.13 * len(run.runs)
    connection: tuple[tuple[Drawer, float], ...] = (
        (_draw_connectivity, 1.0),
        (_draw_connection, strip),
    )
    last: tuple[tuple[Drawer, float], ...] = ((_draw_rungs, strip),)
    if has_apart(run.problem):
        last = ((_draw_apart, 1.0), *last)
    if run.target is not None:
        return ((_draw_target_variance, 1.3), *connection, (_draw_map_error, 1.0), *last)
    bounded = connection if run.problem.constraints.p_min > 0.0 else ()
    if run.channel is None:
        return (*bounded, *last)
    knowledge: tuple[tuple[Drawer, float], ...] = ((_draw_map_error, 1.0),)
    given = run.problem.channel.given
    if given is None or given.k_pl_db is None:
        # Path loss that is known has no uncertainty to draw.
        knowledge = ((_draw_theta_variance, 1.0), *knowledge)
    return (*knowledge, *bounded, *last)


def _draw_apart(panel: Panel, run: Run) -> None:
    """Draw how far robots keep from each other and from what moves."""
    log = run.runs[0].log
    step_s = run.problem.planner.step_s
    motions = [driven_motion(one.log.positions_m, one.drive, step_s) for one in run.runs]
    draw_apart(panel, run.problem, motions, log.t_s)


def _draw_target_variance(panel: Panel, run: Run) -> None:
    """Trace of the station's covariance, marked where a packet arrived."""
    target = run.target
    if target is None:
        raise AssertionError("there is no target")
    t_s, trace = run.runs[0].log.t_s, target.station_variance_m2
    panel.plot(t_s, trace, color=PREDICTED)
    arrived = np.concatenate([[0], target.delivered.sum(axis=1)])
    for label, selection, fill in (
        ("packets arrived", arrived > 0, PREDICTED),
        ("none arrived", arrived == 0, WHITE),
    ):
        selection[0] = False  # nothing was sent at the start
        if selection.any():
            panel.scatter(
                t_s[selection],
                trace[selection],
                s=22.0,
                facecolors=fill,
                edgecolors=PREDICTED,
                zorder=3.0,
                label=label,
            )
    dress(panel, "uncertainty of the target", TIME, "trace P [m²]")
    panel.set_yscale("log")
    plain_log_ticks(panel.yaxis)
    legend_above(panel)


def _knowledge(run: Run) -> ChannelLog:
    if run.channel is None:
        raise AssertionError("nothing was logged of the channel")
    return run.channel


def _draw_theta_variance(panel: Panel, run: Run) -> None:
    variance_db = _knowledge(run).theta_variance_db
    panel.plot(run.runs[0].log.t_s, variance_db, color=PREDICTED, marker="o", markersize=3.5)
    dress(panel, "uncertainty of path loss", TIME, "trace M / |θ|² [dB]")


def _draw_map_error(panel: Panel, run: Run) -> None:
    rms_db = _knowledge(run).rms_db
    panel.plot(run.runs[0].log.t_s, rms_db, color=PREDICTED, marker="o", markersize=3.5)
    dress(panel, "error of the predicted map", TIME, "RMS error [dB]")
    low, high = float(rms_db.min()), float(rms_db.max())
    room = max(0.05 * (high - low), (LEAST_SPAN_DB - (high - low)) / 2.0)
    panel.set_ylim(low - room, high + room)


def _draw_connectivity(panel: Panel, run: Run) -> None:
    """Each robot's chance of a connection, predicted one step ahead, and the bound if there is."""
    for number, one in enumerate(run.runs):
        panel.plot(
            one.log.t_s,
            one.log.connectivity,
            color=robot_colour(number),
            marker=robot_marker(number),
            markersize=3.5,
            linewidth=1.2,
            label=one.robot,
        )
    p_min = run.problem.constraints.step_p_min
    if p_min > 0.0:
        panel.axhline(p_min, color=BLACK, linestyle="dashed", label=f"p_min = {p_min:g}")
    dress(panel, "one step ahead", TIME, "P(connected) [1]")
    # The axis follows the values, but not into the last digits of values that are all near 1.
    lowest = min([p_min or 1.0, *(float(np.nanmin(one.log.connectivity)) for one in run.runs)])
    panel.set_ylim(min(0.9, lowest) - 0.02, 1.02)
    legend_above(panel)


def _draw_connection(panel: Panel, run: Run) -> None:
    """Draw a row for each robot: where it was connected in truth, its packets arrived."""
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
    dress(
        panel, f"connected in truth ({words})", TIME, "",
        grid=False,
    )  # fmt: skip
    name_rows(panel, run.problem)


def _draw_rungs(panel: Panel, run: Run) -> None:
    """Draw a row for each robot: the fallback of every plan, ringed if it is not verified."""
    for rung, (marker, colour) in RUNG_LOOKS.items():
        rows = [_times(one, rung) for one in run.runs]
        count = sum(len(times) for times in rows)
        if count:
            panel.scatter(
                np.concatenate(rows),
                np.repeat(np.arange(len(rows), dtype=np.float64), [len(times) for times in rows]),
                marker=marker,
                s=18.0,
                color=colour,
                zorder=3.0,
                label=f"{spaced(rung)} ({count})",
            )
    unproven = [
        (t_s, float(row))
        for row, one in enumerate(run.runs)
        for t_s, verdict in zip(one.log.t_s[1:], one.log.verdict[1:], strict=True)
        if verdict is not Verdict.VERIFIED
    ]
    if unproven:
        panel.scatter(
            *np.array(unproven).T,
            s=80.0,
            facecolors="none",
            edgecolors=BLACK,
            linewidths=1.3,
            label=f"not verified ({len(unproven)})",
        )
    rate = f"{100.0 * run.verified_rate:.0f} % verified" if run.rungs else "no step was driven"
    dress(panel, rate, TIME, "", grid=False)
    name_rows(panel, run.problem)
    if len(run.runs[0].log.t_s) > 1:
        legend_above(panel, 3)


def _times(run: RobotRun, rung: Rung) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return when plans of a fallback were released."""
    chosen = np.array([found is rung for found in run.log.rung])
    chosen[0] = False  # the start was not planned
    return run.log.t_s[chosen]
