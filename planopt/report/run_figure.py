"""One closed loop on the map: what was planned first, what was driven, and where it connected."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.planning.loop.log import StepLog
from planopt.planning.loop.true_serving import true_serving_dbm
from planopt.planning.run import Run
from planopt.report.maps import LAYER_Z, PATH_Z, draw_ground, draw_layer, draw_places
from planopt.report.moving_marks import draw_moving
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    CONNECTED,
    DISCONNECTED,
    POWER_MAP,
    PURPLE,
    WHITE,
    head,
    legend_below,
    spaced,
)
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def draw_run(simulation: Run) -> Figure:
    """Draw a run over the true power [dBm]: first plan, driven path, relaxed steps, measurements.

    A step of the driven path looks as the place that it leads to is: connected in truth or not.
    """
    from matplotlib.gridspec import GridSpec

    problem, run = simulation.problem, simulation.run
    figure = new_figure(10.0, 9.6, maps_only=True)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    draw_ground(panel, problem.workspace, f"{spaced(run.outcome)}: {run.reason}")
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
