"""Maps of what is known of the channel: predicted power, deviation, chance of connection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planopt.channel.belief import Belief
from planopt.channel.channel_map import PosteriorMap
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station
from planopt.problems.problem import Problem
from planopt.report.grid import believed_rasters
from planopt.report.maps import (
    PATH_Z,
    PLACE_Z,
    X_LABEL,
    Y_LABEL,
    draw_ground,
    draw_layer,
    draw_level,
    draw_places,
)
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    DEVIATION_MAP,
    ORANGE,
    POWER_MAP,
    PROBABILITY_MAP,
    VERMILLION,
    WHITE,
    dress,
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


DOT_AREA, SMALLEST_DOT_AREA, MANY = 12.0, 1.5, 300
"""Size of a measurement's dot; it shrinks where there are more than `MANY`."""

PANEL_IN, AROUND_IN, MAX_SLENDER = 4.0, 1.9, 2.0
"""Width of a panel and height of titles and legend in inches; a map is drawn at most twice as high
as it is wide, and a higher one narrower."""


def draw_posterior_map(
    maps: PosteriorMap, measurements: Measurements, station: Station, title: str
) -> Figure:
    """Draw predicted power [dBm], its deviation [dB] and P(connected) beside each other.

    Parameters
    ----------
    maps
        The map.
    measurements
        What it was predicted from: dots on the deviation, the censored ones in another colour.
    station
        Marked where it is inside the map.
    title
        Of the figure.
    """
    from matplotlib.gridspec import GridSpec

    threshold = maps.threshold_dbm
    x_min, x_max, y_min, y_max = _edges(maps)
    slender = (y_max - y_min) / (x_max - x_min)
    height_in = AROUND_IN + PANEL_IN * min(slender, MAX_SLENDER)
    figure = new_figure(16.5, height_in, maps_only=True)
    cells = GridSpec(1, 3, figure=figure)
    panels = [add_panel(figure, cells[0, column]) for column in range(3)]
    titles = ("predicted power", "deviation of the prediction", f"P(power ≥ {threshold:g} dBm)")
    for panel, words in zip(panels, titles, strict=True):
        dress(panel, words, X_LABEL, Y_LABEL, grid=False)
        panel.set_aspect("equal")
    mark = "power [dBm] (line: threshold)"
    draw_layer(panels[0], maps.mean_db, POWER_MAP, figure, mark, mark=threshold)
    draw_level(panels[0], maps.mean_db, threshold, VERMILLION)
    draw_layer(panels[1], maps.deviation_db, DEVIATION_MAP, figure, "deviation [dB]")
    draw_layer(
        panels[2], maps.connectivity, PROBABILITY_MAP, figure, "P(connected) [1]", (0.0, 1.0)
    )
    entries = _draw_dots(panels[1], measurements)
    if _inside(maps, station):
        entries += [_draw_station(panel, station) for panel in panels][:1]
    for panel in panels:
        _frame(panel, maps)
    legend_below(figure, entries, 3)
    head(figure, title)
    return figure


def _draw_dots(panel: Panel, measurements: Measurements) -> list[Artist]:
    area = max(SMALLEST_DOT_AREA, DOT_AREA * min(1.0, MANY / len(measurements)))
    artists: list[Artist] = []
    for label, selection, colour in (
        ("measured", ~measurements.censored, BLACK),
        ("measured at the floor (censored)", measurements.censored, VERMILLION),
    ):
        if selection.any():
            x, y = measurements.positions_m[selection].T
            look = {"color": colour, "linewidths": 0, "zorder": PATH_Z}
            panel.scatter(x, y, s=area, **look)
            # In the legend a dot is to be seen however small the others are.
            artists.append(panel.scatter([], [], s=DOT_AREA, label=label, **look))
    return artists


def _draw_station(panel: Panel, station: Station) -> Artist:
    x, y = station.position_m
    look = {"color": ORANGE, "edgecolors": "black", "linewidths": 1.0, "label": "station"}
    return panel.scatter([x], [y], marker="^", s=80.0, zorder=PLACE_Z, **look)


def _edges(maps: PosteriorMap) -> tuple[float, float, float, float]:
    """x_min, x_max, y_min, y_max of the cells."""
    raster = maps.mean_db
    wide, high = raster.cell_m
    x, y = raster.x_m, raster.y_m
    return x[0] - wide / 2, x[-1] + wide / 2, y[0] - high / 2, y[-1] + high / 2


def _inside(maps: PosteriorMap, station: Station) -> bool:
    x_min, x_max, y_min, y_max = _edges(maps)
    x, y = station.position_m
    return x_min <= x <= x_max and y_min <= y <= y_max


def _frame(panel: Panel, maps: PosteriorMap) -> None:
    """Show the map and nothing beyond, whatever was measured there."""
    x_min, x_max, y_min, y_max = _edges(maps)
    panel.set_xlim(x_min, x_max)
    panel.set_ylim(y_min, y_max)
