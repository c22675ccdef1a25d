"""One closed loop: on the map, and over time."""

from __future__ import annotations

import itertools
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import StepLog
from planopt.planning.loop.robot_run import true_serving_dbm
from planopt.planning.plan import Rung
from planopt.planning.run import Run
from planopt.problems.base_station import BaseStation
from planopt.report.maps import LAYER_Z, PATH_Z, draw_ground, draw_layer, draw_moving, draw_places
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.plan_map import draw_blocked
from planopt.report.style import (
    BAND_WORDS,
    BAND_Z,
    BLACK,
    CONNECTED,
    DISCONNECTED,
    GREEN,
    NOTE_PT,
    ORANGE,
    POWER_MAP,
    PREDICTED,
    PURPLE,
    SKY,
    THRESHOLD,
    TRUE,
    VERMILLION,
    WHITE,
    dress,
    head,
    legend_above,
    legend_below,
    plain_log_ticks,
    spaced,
)
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
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
"""Marker and colour of every fallback."""


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
    """Draw the planning time of every step, marked by the fallback that released it."""
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


TITLE_WIDTH = 100
"""Letters in a line of how the run ended."""


def draw_run(simulation: Run) -> Figure:
    """Draw a run over the true power [dBm]: first plan, driven path, relaxed steps, measurements.

    A step of the driven path looks as the place that it leads to is: connected in truth or not.
    Without its ground truth, such as one from Python that no file holds, there is no power.
    """
    from matplotlib.gridspec import GridSpec

    problem, run = simulation.problem, simulation.run
    figure = new_figure(10.0, 9.6, maps_only=True)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    words = wrap(f"{spaced(run.outcome)}: {run.reason}", TITLE_WIDTH)
    draw_ground(panel, problem.workspace, "\n".join(words))
    if simulation.truths:
        draw_layer(
            panel,
            true_power(simulation),
            POWER_MAP,
            figure,
            "true power [dBm] (line: threshold)",
            mark=problem.stations[0].true_threshold_dbm,
        )
    entries = [
        *draw_places(panel, problem),
        *_draw_measurements(panel, simulation),
        *draw_moving(panel, problem, len(run.log.t_s) - 1, predicted=False),
        *_draw_driven(panel, run.log),
        *_draw_first_plan(panel, simulation),
        *_draw_relaxed(panel, run.log),
        *draw_blocked(panel, simulation.blocked),
    ]
    legend_below(figure, entries, 4)
    head(
        figure,
        f"{problem.name}: horizon {problem.planner.horizon}, {problem.cost_to_go} cost to go, "
        f"seed {simulation.seed}",
    )
    return figure


def true_power(simulation: Run) -> Raster:
    """Return the true power, of several stations the serving one's, on the first one's cells."""
    truths = simulation.truths
    raster = truths[0].raster
    if len(truths) == 1:
        return raster
    cells = np.stack(np.meshgrid(raster.x_m, raster.y_m), axis=-1)
    power = true_serving_dbm(simulation.problem, truths, cells.reshape(-1, 2))
    return Raster(raster.x_m, raster.y_m, power.reshape(cells.shape[:2]))


def _draw_driven(panel: Panel, log: StepLog) -> list[Artist]:
    """Draw the driven path: blue on white where connected, else dashes of vermillion on black.

    Lightness and dashes tell them apart without colour. Each is drawn where there is any.
    """
    from matplotlib.collections import LineCollection

    artists: list[Artist] = []
    for label, colour, casing, dashes, kind in (
        ("driven, connected", CONNECTED, WHITE, "solid", True),
        ("driven, not connected", DISCONNECTED, BLACK, (0, (1.2, 0.8)), False),
    ):
        pieces = _pieces(log, kind)
        if not pieces:
            continue
        below = LineCollection(
            pieces, colors=casing, linewidths=6.0, capstyle="round", zorder=PATH_Z
        )
        lines = LineCollection(
            pieces,
            colors=colour,
            linewidths=4.0,
            linestyles=[dashes],
            capstyle="butt",
            zorder=PATH_Z + 0.1,
            label=label,
        )
        for collection in (below, lines):
            panel.add_collection(collection, autolim=False)
        artists.append(lines)
    return artists


def _pieces(log: StepLog, connected: bool) -> list[NDArray[np.float64]]:
    """Return the longest pieces of the path all of whose steps end connected, or all not."""
    kinds = log.connected[1:]
    changes = np.flatnonzero(np.diff(kinds)) + 1
    bounds = [0, *changes.tolist(), len(kinds)] if len(kinds) else [0]
    return [
        log.positions_m[first : last + 1]
        for first, last in itertools.pairwise(bounds)
        if kinds[first] == connected
    ]


def _draw_first_plan(panel: Panel, simulation: Run) -> list[Artist]:
    """Draw the plan at the start; nothing where no plan was released."""
    return [
        artist
        for plan in simulation.plans[0][:1]
        for artist in panel.plot(
            *plan.positions_m.T,
            color=BLACK,
            linewidth=1.2,
            linestyle=(0, (3, 1.5)),
            zorder=PATH_Z + 0.4,
            label="first plan",
        )
    ]


def _draw_relaxed(panel: Panel, log: StepLog) -> list[Artist]:
    """Mark the places where the bound was relaxed, if any."""
    relaxed = log.relaxation_db > 0.0
    if not relaxed.any():
        return []
    x, y = log.positions_m[relaxed].T
    return [
        panel.scatter(
            x,
            y,
            marker="D",
            s=60.0,
            color=PURPLE,
            linewidths=0.0,
            zorder=PATH_Z - 0.1,  # beneath the path, which stays to be seen
            label="bound relaxed",
        )
    ]


def _draw_measurements(panel: Panel, simulation: Run) -> list[Artist]:
    """Mark where was measured before the run and on the way."""
    places = simulation.belief.posterior.measurements.positions_m
    first = simulation.first_measurements
    artists: list[Artist] = []
    for label, part, size, colour, level in (
        ("measured before", places[:first], 12.0, BLACK, LAYER_Z),
        ("measured on the way", places[first:], 4.0, WHITE, PATH_Z),
    ):
        if len(part):
            artists.append(
                panel.scatter(
                    *part.T,
                    s=size,
                    color=colour,
                    edgecolors=BLACK if colour == WHITE else WHITE,
                    linewidths=0.4,
                    zorder=level + 0.2,
                    label=label,
                )
            )
    return artists
