"""The map around one plan: where it goes, how likely it connects there, how near obstacles are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.planning.holes import BlockedWay, Hole
from planopt.planning.plan import Plan
from planopt.planning.solution import Solution
from planopt.problems.problem import Problem
from planopt.report.grid import Bounds, believed_rasters
from planopt.report.maps import (
    MARGIN_Z,
    PATH_Z,
    PLACE_Z,
    draw_ground,
    draw_layer,
    draw_level,
    draw_moving,
    draw_places,
    ring_xy,
)
from planopt.report.panel import Panel
from planopt.report.style import (
    BLACK,
    PREDICTED,
    PROBABILITY_MAP,
    PURPLE,
    VERMILLION,
    WHITE,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

WINDOW_MARGIN = 0.3
"""Room around the plan, as a share of its extent."""

BORDER = 0.05
"""Room beyond places and the bounds of the workspace, as a share of the window's side."""

MIN_WINDOW_STEPS = 10.0
"""The window is never narrower than this many longest steps."""

INSET = 0.3
"""Side of the inset as a share of the map's."""

INSET_BELOW = 0.6
"""A window wider than this share of the workspace needs no inset."""


def window_about(problem: Problem, places_m: NDArray[np.float64]) -> Bounds:
    """A square around places (n, 2), moved into the workspace as far as it fits."""
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    side = max(
        float((high - low).max()) * (1.0 + 2.0 * WINDOW_MARGIN),
        MIN_WINDOW_STEPS * problem.step_length_m,
    )
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    x = _window_begin(float(low[0]), float(high[0]), side, x_min, x_max)
    y = _window_begin(float(low[1]), float(high[1]), side, y_min, y_max)
    return x, y, x + side, y + side


def _window_begin(low: float, high: float, side: float, first: float, last: float) -> float:
    """Return the begin of a window about `low` to `high`, of bounds `first` to `last`."""
    room = BORDER * side
    begin = (low + high - side) / 2.0
    if last - first + 2.0 * room <= side:
        begin = (first + last - side) / 2.0
    else:
        begin = min(max(begin, first - room), last + room - side)
    # Places beyond the bounds, as stations may be, stay in sight.
    return min(max(begin, high + room - side), low - room)


def is_small(problem: Problem, window: Bounds) -> bool:
    """Return whether a window shows so little of the workspace that it needs an inset."""
    x_min, _, x_max, _ = problem.workspace.bounds_m
    return window[2] - window[0] < INSET_BELOW * (x_max - x_min)


def draw_plan_map(figure: Figure, panel: Panel, solution: Solution) -> list[Artist]:
    """Draw the map in a window around the plan; the artists, for the legend."""
    from matplotlib.lines import Line2D

    problem, plan = solution.problem, solution.plan
    p_min = problem.constraints.p_min
    shown = np.vstack([plan.positions_m, plan.route_m]) if plan.holes else plan.positions_m
    window = window_about(problem, shown)
    _, _, layer = believed_rasters(problem, solution.belief, window)
    draw_ground(panel, problem.workspace, "the plan on the predicted P(connected)")
    draw_layer(
        panel, layer, PROBABILITY_MAP, figure, "P(connected) [1] (line: p_min)", (0.0, 1.0), p_min
    )
    draw_level(panel, layer, p_min, VERMILLION)
    margin = _draw_margin(panel, problem, window)
    moving = draw_moving(panel, problem, len(plan.t_s) - 1, predicted=True)
    x, y = plan.positions_m.T
    panel.plot(x, y, color=WHITE, linewidth=4.0, zorder=PATH_Z, solid_capstyle="round")
    (path,) = panel.plot(
        x,
        y,
        color=PREDICTED,
        linewidth=2.0,
        marker="o",
        markersize=5.0,
        markeredgecolor=WHITE,
        markeredgewidth=0.8,
        zorder=PATH_Z,
        label="planned waypoints and swept path",
    )
    route = _draw_route(panel, plan)
    places = draw_places(panel, problem)
    panel.set_xlim(window[0], window[2])
    panel.set_ylim(window[1], window[3])
    if is_small(problem, window):
        draw_inset(panel, problem, plan.positions_m, window)
    level = Line2D([], [], color=VERMILLION, linewidth=1.2, label=f"P(connected) = {p_min:g}")
    return [path, *route, margin, level, *moving, *places]


def _draw_route(panel: Panel, plan: Plan) -> list[Artist]:
    """Draw the way on from a plan's last place, and all holes; nothing of a plan without."""
    artists: list[Artist] = []
    if len(plan.route_m):
        way = np.vstack([plan.positions_m[-1:], plan.route_m])
        artists += _draw_dotted(panel, way, "the way on to the goal")
    return artists + draw_holes(panel, np.vstack([plan.positions_m, plan.route_m]), plan.holes)


def draw_blocked(panel: Panel, ways: Sequence[BlockedWay]) -> list[Artist]:
    """Draw the cheapest ways that a hard bound forbids, and the holes that forbid them."""
    artists: list[Artist] = []
    for number, one in enumerate(ways):
        drawn = _draw_dotted(panel, one.way_m, "the cheapest way, forbidden")
        drawn += draw_holes(panel, one.way_m, one.holes)
        if number == 0:
            artists += drawn
    return artists


def _draw_dotted(panel: Panel, way_m: NDArray[np.float64], label: str) -> list[Artist]:
    return list(
        panel.plot(
            *way_m.T,
            color=BLACK,
            linewidth=1.2,
            linestyle=(0, (1, 2)),
            zorder=PATH_Z - 0.2,
            label=label,
        )
    )


def draw_holes(panel: Panel, places: NDArray[np.float64], holes: Sequence[Hole]) -> list[Artist]:
    """Draw the holes of a path of places (n, 2), with their lengths; the first, for the legend."""
    artists: list[Artist] = []
    for number, hole in enumerate(holes):
        x, y = _places_of(places, hole).T
        panel.plot(x, y, color=WHITE, linewidth=7.0, zorder=PATH_Z - 0.4, solid_capstyle="butt")
        (line,) = panel.plot(
            x,
            y,
            color=VERMILLION,
            linewidth=5.0,
            zorder=PATH_Z - 0.3,
            solid_capstyle="butt",
            label="crosses a coverage hole",
        )
        if number == 0:
            artists.append(line)
        middle = len(x) // 2
        panel.text(
            x[middle],
            y[middle],
            f"{hole.length_m:.0f} m",
            zorder=PATH_Z + 0.5,
            clip_on=True,
            bbox={"boxstyle": "round,pad=0.15", "fc": WHITE, "ec": "none", "alpha": 0.8},
        )
    return artists


def _places_of(places_m: NDArray[np.float64], hole: Hole) -> NDArray[np.float64]:
    """Places (n, 2) of a path from half a step before a hole to half a step behind it."""
    first = int(np.argmin(np.linalg.norm(places_m - np.array(hole.from_m), axis=1)))
    last = int(np.argmin(np.linalg.norm(places_m - np.array(hole.to_m), axis=1)))
    first, last = min(first, last), max(first, last)
    inside = places_m[first : last + 1]
    before = 0.5 * (places_m[max(first - 1, 0)] + places_m[first])
    behind = 0.5 * (places_m[min(last + 1, len(places_m) - 1)] + places_m[last])
    return np.vstack([before, inside, behind])


def _draw_margin(panel: Panel, problem: Problem, window: Bounds) -> Artist:
    """Draw how near to the obstacles a path may come."""
    from matplotlib.collections import LineCollection

    clearance = problem.constraints.clearance_m
    around = shapely.box(*window).buffer(clearance)
    near = [
        obstacle.polygon.buffer(clearance)
        for obstacle in problem.workspace.obstacles
        if obstacle.polygon.intersects(around)
    ]
    merged = shapely.union_all(near)
    margin = LineCollection(
        _rings(merged),
        colors=PURPLE,
        linewidths=0.9,
        linestyles="dashed",
        zorder=MARGIN_Z,
        label=f"clearance of {clearance:g} m",
    )
    panel.add_collection(margin, autolim=False)
    return margin


def _rings(area: shapely.Geometry) -> list[NDArray[np.float64]]:
    """Return all rings of polygons, (n, 2) each."""
    return [ring_xy(line) for line in shapely.get_parts(shapely.boundary(area))]


def draw_inset(
    panel: Panel, problem: Problem, places_m: NDArray[np.float64], window: Bounds
) -> None:
    """Draw the whole workspace small, in the corner of the map that is farthest from the places."""
    shares = (places_m - np.array(window[:2])) / (window[2] - window[0])
    corners = [(0.01, 0.01), (0.99 - INSET, 0.01), (0.01, 0.99 - INSET), (0.99 - INSET,) * 2]
    distances = [
        np.linalg.norm(shares - np.array(corner) - INSET / 2.0, axis=1).min() for corner in corners
    ]
    left, bottom = corners[int(np.argmax(distances))]
    inset = panel.inset_axes((left, bottom, INSET, INSET))
    draw_ground(inset, problem.workspace, "")
    for set_label in (inset.set_xlabel, inset.set_ylabel):
        set_label("")
    inset.set_xticks([])
    inset.set_yticks([])
    draw_places(inset, problem)
    x_min, y_min, x_max, y_max = window
    inset.plot(
        [x_min, x_max, x_max, x_min, x_min],
        [y_min, y_min, y_max, y_max, y_min],
        color=PREDICTED,
        linewidth=1.5,
        zorder=PLACE_Z,
    )
