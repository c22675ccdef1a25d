"""Map of a team: what is believed of the channel, the robots' ways and plans, the target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.planning.loop.log import RobotRun, TargetLog
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.report.grid import Bounds, believed_rasters
from planopt.report.maps import (
    LAYER_Z,
    PATH_Z,
    PLACE_Z,
    draw_ground,
    draw_layer,
    draw_level,
    draw_places,
)
from planopt.report.panel import Panel
from planopt.report.plan_map import draw_inset, is_small, window_about
from planopt.report.style import (
    BLACK,
    DEVIATION_MAP,
    POWER_MAP,
    PROBABILITY_MAP,
    WHITE,
)
from planopt.report.team_series import driven_line, robot_colour, robot_marker
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

EDGE_ROOM = 0.02
"""Around the whole workspace, as a share of its longer side."""

Layer = Literal["connectivity", "power", "deviation"]


def layers_of(problem: Problem) -> tuple[Layer, ...]:
    """The maps that a problem's task is about, one or two."""
    match problem.task:
        case "map":
            return ("power", "deviation")
        case "learn":
            return ("power",)
        case _:
            return ("connectivity",)


def team_window(problem: Problem, places_m: NDArray[np.float64]) -> Bounds:
    """Return the map's window: about `places_m` and stations if these fill only a part.

    Where the whole channel matters, the whole workspace.
    """
    if layers_of(problem) != ("connectivity",):
        return _whole(problem)
    stations = [radio.site.position_m for radio in problem.stations]
    window = window_about(problem, np.vstack([places_m, np.array(stations)]))
    return window if is_small(problem, window) else _whole(problem)


def _whole(problem: Problem) -> Bounds:
    """The workspace with room for markers on its edge."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    room = EDGE_ROOM * max(x_max - x_min, y_max - y_min)
    return (x_min - room, y_min - room, x_max + room, y_max + room)


def draw_team_ground(
    figure: Figure,
    panels: Sequence[Panel],
    problem: Problem,
    belief: Belief,
    places_m: NDArray[np.float64],  # (n, 2) what the maps have to show
) -> list[Artist]:
    """Draw a panel for each of :func:`layers_of`, without robots; the artists, for a legend."""
    workspace = problem.workspace
    window = team_window(problem, places_m)
    mean, deviation, chance = believed_rasters(problem, belief, window)
    artists: list[Artist] = []
    for panel, layer in zip(panels, layers_of(problem), strict=True):
        match layer:
            case "connectivity":
                draw_ground(panel, workspace, "predicted P(connected)")
                _draw_chance(figure, panel, problem, chance)
            case "power":
                draw_ground(panel, workspace, "predicted power")
                draw_layer(panel, mean, POWER_MAP, figure, "power [dBm]")
            case "deviation":
                draw_ground(panel, workspace, "deviation of the prediction")
                draw_layer(panel, deviation, DEVIATION_MAP, figure, "deviation [dB]")
        artists = draw_places(panel, problem)
        panel.set_xlim(window[0], window[2])
        panel.set_ylim(window[1], window[3])
        if is_small(problem, window):
            draw_inset(panel, problem, places_m, window)
    return artists


def _draw_chance(figure: Figure, panel: Panel, problem: Problem, chance: Raster) -> None:
    """Draw the chance of a connection, with the line of p_min where one is asked for."""
    p_min = problem.constraints.step_p_min
    bounded = p_min > 0.0
    draw_layer(
        panel,
        chance,
        PROBABILITY_MAP,
        figure,
        "P(connected) [1]" + (" (line: p_min)" if bounded else ""),
        (0.0, 1.0),
        p_min if bounded else None,
    )
    if bounded:
        draw_level(panel, chance, p_min, BLACK)


def draw_measured(panel: Panel, places_m: NDArray[np.float64], label: str) -> list[Artist]:
    """Mark where was measured, if anywhere."""
    if not len(places_m):
        return []
    return [
        panel.scatter(
            *places_m.T,
            s=13.0,
            color=BLACK,
            edgecolors=WHITE,
            linewidths=0.5,
            zorder=LAYER_Z + 0.2,
            label=label,
        )
    ]


def draw_tracks(panel: Panel, problem: Problem, runs: Sequence[RobotRun]) -> list[Artist]:
    """Draw the driven ways, every step marked."""
    artists: list[Artist] = []
    for number, (robot, run) in enumerate(zip(problem.robots, runs, strict=True)):
        track, steps = driven_line(problem, run.log.positions_m, run.drive)
        panel.plot(*track.T, color=WHITE, linewidth=4.2, zorder=PATH_Z, solid_capstyle="round")
        artists += panel.plot(
            *track.T,
            color=robot_colour(number),
            linewidth=1.8,
            marker=robot_marker(number),
            markevery=steps,
            markersize=4.5,
            markeredgecolor=WHITE,
            markeredgewidth=0.6,
            zorder=PATH_Z + 0.1,
            label=f"{robot.name}, driven",
        )
    return artists


def draw_plans(panel: Panel, problem: Problem, plans: Sequence[Plan], first: int) -> list[Artist]:
    """Draw the plans' places from number `first` on, dashed."""
    artists: list[Artist] = []
    for number, (robot, plan) in enumerate(zip(problem.robots, plans, strict=True)):
        places, steps = driven_line(problem, plan.positions_m, plan.drive, first)
        panel.plot(*places.T, color=WHITE, linewidth=3.6, zorder=PATH_Z, solid_capstyle="round")
        artists += panel.plot(
            *places.T,
            color=robot_colour(number),
            linewidth=1.8,
            linestyle=(0, (2.5, 1.0)),
            marker=robot_marker(number),
            markevery=steps,
            markersize=5.5,
            markerfacecolor=WHITE,
            markeredgecolor=robot_colour(number),
            markeredgewidth=1.2,
            zorder=PATH_Z + 0.2,
            label=f"{robot.name}, planned",
        )
    return artists


def draw_target(panel: Panel, target: TargetLog) -> list[Artist]:
    """Draw the target's true way, and below it where the station thought that it was.

    Estimates are as wide as to be seen beside the way when they are on it.
    """
    x, y = target.true_m.T
    panel.plot(x, y, color=WHITE, linewidth=2.6, zorder=PATH_Z + 0.35)
    (way,) = panel.plot(
        x, y, color=BLACK, linewidth=1.6, zorder=PATH_Z + 0.4, label="target, true way"
    )
    end = panel.scatter(
        x[-1:],
        y[-1:],
        marker="*",
        s=190.0,
        color=BLACK,
        edgecolors=WHITE,
        linewidths=0.8,
        zorder=PLACE_Z + 0.1,
        label="target at the end",
    )
    estimates = panel.scatter(
        *target.station_mean_m.T,
        s=30.0,
        color=WHITE,
        edgecolors=BLACK,
        linewidths=0.9,
        zorder=PATH_Z + 0.3,
        label="the station's estimates",
    )
    return [way, end, estimates]


def draw_expected_target(panel: Panel, target_m: NDArray[np.float64]) -> list[Artist]:
    """Draw where the target is expected after each step ``(N, 2)``."""
    return list(
        panel.plot(
            *target_m.T,
            color=BLACK,
            linewidth=1.4,
            linestyle="dotted",
            marker="*",
            markersize=9.0,
            markeredgecolor=WHITE,
            markeredgewidth=0.5,
            zorder=PATH_Z + 0.1,
            label="target as expected",
        )
    )
