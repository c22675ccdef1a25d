"""One closed loop over time: predicted against true, and what planning it took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import StepLog
from planopt.planning.plan import Rung
from planopt.planning.run import Run
from planopt.problems.base_station import BaseStation
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    CONNECTED,
    DISCONNECTED,
    GREEN,
    NOTE_PT,
    ORANGE,
    PREDICTED,
    PURPLE,
    SKY,
    THRESHOLD,
    TRUE,
    VERMILLION,
    dress,
    head,
    legend_above,
    plain_log_ticks,
    spaced,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
"""Marker and colour of every rung of the failure ladder."""


def draw_run_series(simulation: Run) -> Figure:
    """Draw a run's power, true connection, predicted connectivity and step times over time."""
    from matplotlib.gridspec import GridSpec

    problem, run = simulation.problem, simulation.run
    figure = new_figure(12.0, 9.0)
    cells = GridSpec(4, 1, figure=figure, height_ratios=[3.0, 0.45, 2.0, 2.0])
    panels = [add_panel(figure, cells[row, 0]) for row in range(4)]
    _draw_power(panels[0], run.log, problem.stations[0])
    _draw_connection(panels[1], run.log)
    _draw_connectivity(panels[2], run.log, problem.constraints.p_min)
    _draw_step_times(panels[3], run.log)
    half_step = problem.planner.step_s / 2.0
    for panel in panels:
        panel.set_xlim(float(run.log.t_s[0]) - half_step, float(run.log.t_s[-1]) + half_step)
    head(
        figure,
        f"{problem.name}: horizon {problem.planner.horizon}, {problem.cost_to_go} cost to go, "
        f"seed {simulation.seed}, "
        f"{spaced(run.outcome)}",
    )
    return figure


def _draw_power(panel: Panel, log: StepLog, radio: BaseStation) -> None:
    """Draw the power predicted one step ahead, with its band, against the true one."""
    panel.fill_between(
        log.t_s,
        log.predicted_dbm - BAND_Z * log.deviation_db,
        log.predicted_dbm + BAND_Z * log.deviation_db,
        color=PREDICTED,
        alpha=0.2,
        linewidth=0.0,
        label=BAND_WORDS,
    )
    panel.plot(log.t_s, log.predicted_dbm, color=PREDICTED, label="predicted one step ahead")
    panel.plot(
        log.t_s, log.true_dbm, color=TRUE, linewidth=0.8, marker=".", markersize=4.0, label="true"
    )
    panel.axhline(radio.threshold_dbm, color=THRESHOLD, linestyle="dashed", label="threshold")
    if radio.true_threshold_dbm != radio.threshold_dbm:
        least = radio.true_threshold_dbm
        panel.axhline(least, color=THRESHOLD, linestyle="dotted", label="true threshold")
    dress(panel, "received power", "", "power [dBm]")
    legend_above(panel)


def _draw_connection(panel: Panel, log: StepLog) -> None:
    """Draw a strip of whether each place was connected in truth."""
    edges = _edges(log)
    for label, colour, selection in (
        ("connected", CONNECTED, log.connected),
        ("not connected", DISCONNECTED, ~log.connected),
    ):
        if selection.any():
            panel.bar(
                edges[:-1][selection],
                np.ones(int(selection.sum())),
                width=np.diff(edges)[selection],
                align="edge",
                color=colour,
                linewidth=0.0,
                label=label,
            )
    share = float(log.connected[1:].mean()) if len(log.t_s) > 1 else float(log.connected[0])
    dress(panel, f"connected in truth: {100.0 * share:.1f} % of the steps", "", "", grid=False)
    legend_above(panel)
    panel.set_ylim(0.0, 1.0)
    panel.set_yticks([])


def _draw_connectivity(panel: Panel, log: StepLog, p_min: float) -> None:
    """Draw the chance of a connection predicted one step ahead against its bound."""
    panel.plot(log.t_s, log.connectivity, color=PREDICTED, label="predicted one step ahead")
    panel.axhline(p_min, color=THRESHOLD, linestyle="dashed", label=f"p_min = {p_min:g}")
    relaxed = log.relaxation_db > 0.0
    if relaxed.any():
        panel.scatter(
            log.t_s[relaxed],
            log.connectivity[relaxed],
            marker="D",
            s=28.0,
            color=PURPLE,
            edgecolors=BLACK,
            linewidths=0.6,
            zorder=3.0,
            label="bound relaxed",
        )
    dress(panel, "predicted connectivity", "", "P(connected) [1]")
    panel.set_ylim(None, 1.03)
    legend_above(panel)


def _draw_step_times(panel: Panel, log: StepLog) -> None:
    """Draw the planning time of every step, marked by the rung that released it."""
    milliseconds = 1e3 * log.step_s
    rungs = np.array([rung.value for rung in log.rung])
    for rung, (marker, colour) in RUNG_LOOKS.items():
        selection = rungs == rung.value
        selection[0] = False  # the start was not planned
        if selection.any():
            panel.scatter(
                log.t_s[selection],
                milliseconds[selection],
                marker=marker,
                s=16.0 if rung is Rung.PLAN else 34.0,
                color=colour,
                zorder=2.0 if rung is Rung.PLAN else 3.0,
                label=f"{spaced(rung)} ({int(selection.sum())})",
            )
    dress(panel, "planning time of a step, by rung", "time [s]", "step time [ms]")
    if len(log.t_s) > 1:
        panel.set_yscale("log")
        plain_log_ticks(panel.yaxis)
        legend_above(panel)
    else:
        panel.text(log.t_s[0], 0.5, "no step was released", fontsize=NOTE_PT)


def _edges(log: StepLog) -> NDArray[np.float64]:
    """Borders between the times of the log, (steps + 2,)."""
    middle = (log.t_s[:-1] + log.t_s[1:]) / 2.0
    return np.concatenate([log.t_s[:1], middle, log.t_s[-1:]])
