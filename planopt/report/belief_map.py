"""The belief as three maps: predicted power, its deviation, and the chance of a connection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.channel.belief import Belief
from planopt.channel.measurements import Measurements
from planopt.problems.problem import Problem
from planopt.report.grid import believed_rasters
from planopt.report.maps import PATH_Z, draw_ground, draw_layer, draw_level, draw_places
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    DEVIATION_MAP,
    POWER_MAP,
    PROBABILITY_MAP,
    VERMILLION,
    WHITE,
    head,
    legend_below,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def draw_belief(problem: Problem, belief: Belief) -> Figure:
    """Draw predicted power [dBm], its deviation [dB] and P(connected) with the p_min contour.

    Of several stations, power and deviation are the serving one's.

    Parameters
    ----------
    problem
        Gives the map, the threshold and p_min.
    belief
        What is predicted from; its measurements are dots, the censored ones hollow.
    """
    from matplotlib.gridspec import GridSpec
    from matplotlib.lines import Line2D

    threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
    workspace = problem.workspace
    mean, deviation, chance = believed_rasters(problem, belief, workspace.bounds_m)
    several = len(problem.stations) > 1
    figure = new_figure(16.5, 5.8, maps_only=True)
    cells = GridSpec(1, 3, figure=figure)
    panels = [add_panel(figure, cells[0, column]) for column in range(3)]

    draw_ground(panels[0], workspace, "predicted power")
    draw_layer(panels[0], mean, POWER_MAP, figure, "power [dBm] (line: threshold)", mark=threshold)
    draw_ground(panels[1], workspace, "deviation of the prediction")
    draw_layer(panels[1], deviation, DEVIATION_MAP, figure, "deviation [dB]")
    draw_ground(
        panels[2],
        workspace,
        "P(any station connects)" if several else f"P(power ≥ {threshold:g} dBm)",
    )
    draw_layer(
        panels[2],
        chance,
        PROBABILITY_MAP,
        figure,
        "P(connected) [1] (line: p_min)",
        (0.0, 1.0),
        p_min,
    )
    draw_level(panels[2], chance, p_min, VERMILLION)

    places: list[Artist] = []
    for panel in panels:
        places = draw_places(panel, problem)
    dots = draw_measurements(panels[0], belief.posterior.measurements)
    draw_measurements(panels[1], belief.posterior.measurements)
    level = Line2D([], [], color=VERMILLION, linewidth=1.2, label=f"p_min = {p_min:g}")
    legend_below(figure, [*places, *dots, level], 6)
    count = len(belief.posterior.measurements)
    head(figure, f"{problem.name}: what {count} measurements tell ({belief.fit.method} fit)")
    return figure


def draw_measurements(panel: Panel, measurements: Measurements) -> list[Artist]:
    """Mark where was measured, censored ones hollow; the artists, for a legend."""
    artists: list[Artist] = []
    for label, selection, fill, edge in (
        ("measured", ~measurements.censored, BLACK, WHITE),
        ("measured at the floor (censored)", measurements.censored, "none", VERMILLION),
    ):
        if selection.any():
            x, y = measurements.positions_m[selection].T
            artists.append(
                panel.scatter(
                    x,
                    y,
                    s=13.0,
                    facecolors=fill,
                    edgecolors=edge,
                    linewidths=0.5 if fill == BLACK else 1.1,
                    zorder=PATH_Z,
                    label=label,
                )
            )
    return artists
