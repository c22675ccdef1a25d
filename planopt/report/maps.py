"""Maps: predicted rasters, obstacles, layers, marks, and the visible part of the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import shapely

from planopt.arrays import Floats, Mask
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.connectivity_law import above_thresholds_db, any_probability, serving_power_dbm
from planopt.channel.measurements import Measurements
from planopt.channel.posterior import Belief
from planopt.problems.problem import Problem
from planopt.report.panel import (
    BLACK,
    FRAME,
    GREEN,
    LABEL_PT,
    NOTE_BOX,
    NOTE_PT,
    OBSTACLE,
    OBSTACLE_EDGE,
    ORANGE,
    PREDICTED,
    TICK_PT,
    VERMILLION,
    WHITE,
    YELLOW,
    Look,
    Panel,
    dress,
)
from planopt.world.clearance import clearance_m, index_obstacles, inside_bounds, polygons_of
from planopt.world.motion import centres_at, growth_m
from planopt.world.raster import Raster
from planopt.world.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from matplotlib.path import Path as Outline

Bounds = tuple[float, float, float, float]

NODES = 150  # Number of grid cells along the longer side of a map, each about four pixels wide
LAYER_Z, CONTOUR_Z, OBSTACLE_Z, MARGIN_Z, PATH_Z, PLACE_Z = 1.0, 1.5, 2.0, 2.5, 3.0, 4.0
"""Drawing order of layers, contours, obstacles, margins, paths and positions."""

X_LABEL, Y_LABEL = "x [m]", "y [m]"

DISCS = 6  # Maximum number of discs per moving obstacle, evenly spaced in time; later ones paler
DARKEST, PALEST = 0.9, 0.3  # Opacity of the first and of the last disc
MANY, DOT_AREA, SMALLEST_DOT_AREA = 300, 13.0, 1.5
"""Number of measurements above which dots shrink, and normal and minimum dot area."""
WINDOW_MARGIN = 0.3  # Margin around the positions to show, as a share of their extent
BORDER = 0.05  # Margin around positions and workspace bounds, as a share of the window's side
EDGE_MARGIN = 0.02  # Margin around the whole workspace, as a share of its longer side
MIN_WINDOW_STEPS = 10.0  # Minimum side of a window, in maximum step lengths of a robot
INSET = 0.3  # Side of the inset, as a share of the map's
INSET_BELOW = 0.6  # Minimum side of a window without inset, as a share of the workspace's side


def drawn_cells(workspace: Workspace, x_m: Floats, y_m: Floats) -> Mask:
    """Return a mask (ny, nx) of cells with a free centre or a free neighbour."""
    centres = np.stack(np.meshgrid(x_m, y_m), axis=-1)
    places = centres.reshape(-1, 2)
    free = inside_bounds(workspace, places)
    free &= clearance_m(index_obstacles(workspace), places) > 0.0
    padded = np.pad(free.reshape(centres.shape[:2]), 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


@one_blas_thread()
def believed_rasters(
    problem: Problem, belief: Belief, bounds_m: Bounds
) -> tuple[Raster, Raster, Raster]:
    """Return the best station's power, its deviation and P(any connection); NaN in obstacles."""
    x_min, y_min, x_max, y_max = bounds_m
    side, axes = max(x_max - x_min, y_max - y_min) / NODES, list[Floats]()
    for low, high in ((x_min, x_max), (y_min, y_max)):
        count = max(2, round((high - low) / side))
        half = (high - low) / count / 2.0
        axes.append(np.linspace(low + half, high - half, count))
    x, y = axes
    drawn = drawn_cells(problem.workspace, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1)[drawn]
    thresholds = [radio.threshold_dbm for radio in problem.stations]
    powers = [posterior.predict(places) for posterior in belief.posteriors]
    above, _ = above_thresholds_db(powers, thresholds)
    deviations = np.stack([power.deviation_db for power in powers])

    def raster(values: Floats) -> Raster:
        cells = np.full(drawn.shape, np.nan)
        cells[drawn] = values
        return Raster(x, y, cells)

    return (
        raster(serving_power_dbm(np.stack([power.mean_db for power in powers]), thresholds)),
        raster(deviations[above.argmax(axis=0), np.arange(len(places))]),
        raster(any_probability(powers, thresholds)),
    )


def draw_ground(panel: Panel, workspace: Workspace, title: str) -> None:
    """Draw obstacles, hatched if temporary, and bounds on equally scaled axes in metres."""
    draw_polygons(panel, joined([each.polygon for each in workspace.lasting]))
    timed: Look = {"facecolors": "none", "edgecolors": FRAME, "linewidths": 0.9, "hatch": "///"}
    draw_polygons(panel, [each.polygon for each in workspace.timed], linestyles="dashed", **timed)
    for obstacle in workspace.timed:
        x, y = shapely.get_coordinates(obstacle.polygon.representative_point())[0]
        until = "" if np.isinf(obstacle.until_s) else f" until {obstacle.until_s:g} s"
        words = f"from {obstacle.known_from_s:g} s{until}"
        look = {"ha": "center", "va": "center", "clip_on": True, "zorder": PLACE_Z}
        panel.text(x, y, words, fontsize=NOTE_PT, bbox=NOTE_BOX, **look)
    panel.plot(*rectangle(workspace.bounds_m), color=FRAME, linewidth=1.2, zorder=MARGIN_Z)
    dress(panel, title, X_LABEL, Y_LABEL, grid=False)
    panel.set_aspect("equal")
    show_bounds(panel, workspace.bounds_m)


def joined(polygons: Sequence[shapely.Polygon]) -> list[shapely.Polygon]:
    """Return the polygons without shared sides, for instance between tiles of a grid."""
    return polygons_of(shapely.union_all(list(polygons)))


def draw_polygons(
    panel: Panel, polygons: Sequence[shapely.Polygon], label: str = "", **look: Any
) -> Artist:
    """Draw polygons with their holes left open; return a legend entry."""
    from matplotlib.collections import PathCollection
    from matplotlib.patches import Patch

    style = {"facecolors": OBSTACLE, "edgecolors": OBSTACLE_EDGE, "linewidths": 0.4, **look}
    shapes = PathCollection([outline(each) for each in polygons], zorder=OBSTACLE_Z, **style)
    panel.add_collection(shapes, autolim=bool(label))
    return Patch(facecolor=OBSTACLE, edgecolor=OBSTACLE_EDGE, label=label)


def outline(polygon: shapely.Polygon) -> Outline:
    """Return a polygon and its holes as one path, with opposite orientation of the rings."""
    from matplotlib.path import Path as Outline

    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(polygon.normalize())]
    return Outline.make_compound_path(*(Outline(ring, closed=True) for ring in rings))


def rectangle(bounds_m: Bounds) -> tuple[list[float], list[float]]:
    """Return x and y of the closed outline of a rectangle."""
    x_min, y_min, x_max, y_max = bounds_m
    return [x_min, x_max, x_max, x_min, x_min], [y_min, y_min, y_max, y_max, y_min]


def show_bounds(panel: Panel, bounds_m: Bounds) -> None:
    """Limit a panel to a rectangle."""
    x_min, y_min, x_max, y_max = bounds_m
    panel.set_xlim(x_min, x_max)
    panel.set_ylim(y_min, y_max)


def raster_bounds(raster: Raster) -> Bounds:
    """Return the outer bounds of a raster's cells."""
    half = np.array(raster.cell_m) / 2.0
    low = np.array([raster.x_m[0], raster.y_m[0]]) - half
    high = np.array([raster.x_m[-1], raster.y_m[-1]]) + half
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def draw_layer(
    panel: Panel,
    raster: Raster,
    colours: str,
    figure: Figure,
    label: str,
    limits: tuple[float, float] | None = None,
    mark: float | None = None,
) -> None:
    """Draw a raster below the obstacles, with a colour bar on which a value may be marked."""
    x_min, y_min, x_max, y_max = raster_bounds(raster)
    low, top = (None, None) if limits is None else limits
    layer = panel.imshow(
        raster.values,
        origin="lower",
        extent=(x_min, x_max, y_min, y_max),
        cmap=colours,
        vmin=low,
        vmax=top,
        interpolation="nearest",
        zorder=LAYER_Z,
    )
    bar = cast("Any", figure).colorbar(layer, ax=panel, aspect=30, pad=0.02).ax
    bar.set_ylabel(label, fontsize=LABEL_PT)
    bar.tick_params(labelsize=TICK_PT)
    if mark is not None:
        bar.axhline(mark, color=WHITE, linewidth=3.0)
        bar.axhline(mark, color=FRAME, linewidth=1.2)


def draw_level(panel: Panel, raster: Raster, level: float, label: str) -> list[Artist]:
    """Draw a raster's contour at `level`, if there is one; return a legend entry."""
    from matplotlib.lines import Line2D

    known = raster.values[np.isfinite(raster.values)]
    if known.size and known.min() < level < known.max():
        look = {"colors": [VERMILLION], "linewidths": 1.1, "zorder": CONTOUR_Z}
        panel.contour(raster.x_m, raster.y_m, raster.values, levels=[level], **look)
    return [Line2D([], [], color=VERMILLION, linewidth=1.2, label=label)]


def draw_sites(panel: Panel, positions_m: Floats, label: str = "station") -> Artist:
    """Mark base stations (n, 2)."""
    look = {"marker": "^", "s": 80.0, "color": ORANGE, "edgecolors": BLACK, "linewidths": 1.0}
    return panel.scatter(*positions_m.T, zorder=PLACE_Z, label=label, **look)


def draw_places(panel: Panel, problem: Problem) -> list[Artist]:
    """Mark the stations and the start and goal of every robot; return legend entries."""
    starts = np.array([robot.start_m for robot in problem.robots], dtype=np.float64)
    goals = [robot.goal_m for robot in problem.robots if robot.goal_m is not None]
    look = {"edgecolors": BLACK, "linewidths": 1.0, "zorder": PLACE_Z}
    artists: list[Artist] = [
        panel.scatter(*starts.T, marker="o", s=70.0, color=GREEN, label="start", **look)
    ]
    if goals:
        x, y = np.array(goals, dtype=np.float64).T
        artists.append(panel.scatter(x, y, marker="*", s=200.0, color=YELLOW, label="goal", **look))
    if problem.stations:
        sites = np.array([radio.site.position_m for radio in problem.stations], dtype=np.float64)
        artists.append(draw_sites(panel, sites))
    return artists


def draw_measurements(panel: Panel, measurements: Measurements) -> list[Artist]:
    """Mark measured positions, hollow if censored; return legend entries."""
    area = max(SMALLEST_DOT_AREA, DOT_AREA * min(1.0, MANY / max(len(measurements), 1)))
    artists: list[Artist] = []
    for label, selection, fill, edge in (
        ("measured", ~measurements.censored, BLACK, WHITE),
        ("measured at the floor (censored)", measurements.censored, "none", VERMILLION),
    ):
        if selection.any():
            look = {"facecolors": fill, "edgecolors": edge, "zorder": PATH_Z}
            width = (0.5 if fill == BLACK else 1.1) * np.sqrt(area / DOT_AREA)
            positions = measurements.positions_m[selection]
            panel.scatter(*positions.T, s=area, linewidths=width, **look)
            # The legend dot must be visible even if the dots on the map are tiny.
            artists.append(panel.scatter([], [], s=DOT_AREA, linewidths=1.0, label=label, **look))
    return artists


def draw_path(
    panel: Panel, path_m: Floats, *, casing: float = 0.0, **look: Any
) -> Sequence[Artist]:
    """Draw a path (n, 2) with a white outline of `casing` points; return the line."""
    zorder = look.pop("zorder", PATH_Z)
    if casing:
        rounded = {"solid_capstyle": "round", "label": "_casing"}
        panel.plot(*path_m.T, color=WHITE, linewidth=casing, zorder=zorder - 0.05, **rounded)
    return panel.plot(*path_m.T, zorder=zorder, **look)


def draw_lines(panel: Panel, lines: Sequence[Floats], **look: Any) -> Artist:
    """Draw lines, each (k, 2), as one artist."""
    from matplotlib.collections import LineCollection

    drawn = LineCollection(list(lines), **{"zorder": PATH_Z, **look})
    panel.add_collection(drawn, autolim=False)
    return drawn


def draw_discs(panel: Panel, centres_m: Floats, radii_m: Floats, **look: Any) -> Artist:
    """Draw discs around centres (n, 2)."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    circles = [Circle(c, r) for c, r in zip(centres_m.tolist(), radii_m.tolist(), strict=True)]
    style: Look = {"facecolors": OBSTACLE, "edgecolors": BLACK, "zorder": MARGIN_Z, **look}
    discs = PatchCollection(circles, **style)
    panel.add_collection(discs, autolim=False)
    return discs


def draw_moving(panel: Panel, problem: Problem, steps: int, *, predicted: bool) -> list[Artist]:
    """Draw every moving obstacle over the first `steps` steps; return legend entries."""
    artists: list[Artist] = []
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    end_s = problem.planner.step_s * steps
    every = max(-(-steps // (DISCS - 1)), 1)
    times = problem.planner.step_s * np.arange(0, steps + 1, every, dtype=np.float64)
    for obstacle in problem.workspace.moving:
        centres = centres_at(obstacle, times)
        radii = np.full(len(times), obstacle.radius_m)
        faded = {"alpha": np.linspace(DARKEST, PALEST, len(times)), "linewidths": 1.0}
        artists.append(
            draw_discs(panel, centres, radii, label="moving obstacle (later: paler)", **faded)
        )
        if predicted and growth_m(obstacle, times).any():
            grown = radii + growth_m(obstacle, times)
            draw_discs(panel, centres, grown, facecolors="none", linestyles="dotted")
        known = [time for time in obstacle.times_s if 0.0 < time < end_s]
        path = centres_at(obstacle, np.array(sorted({0.0, *known, end_s})))
        look = {"color": FRAME, "linewidth": 1.1, "linestyle": "dashdot"}
        draw_path(panel, path, casing=2.6, zorder=MARGIN_Z + 0.1, **look)
        for (x, y), time in zip(centres.tolist(), times.tolist(), strict=True):
            if not (x_min <= x <= x_max and y_min <= y <= y_max):
                continue  # text far outside cannot be rendered
            words = obstacle.name if time == 0.0 else f"{time:g} s"
            middle = {"ha": "center", "va": "center", "clip_on": True, "zorder": MARGIN_Z + 0.2}
            panel.text(x, y, words, fontsize=NOTE_PT, **middle)
    return artists[:1]


def window_about(problem: Problem, positions_m: Floats) -> Bounds:
    """Return a square around positions (n, 2), shifted into the workspace or cut off beyond it."""
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    side = max(
        float((high - low).max()) * (1.0 + 2.0 * WINDOW_MARGIN),
        MIN_WINDOW_STEPS * problem.step_length_m,
    )
    margin = BORDER * side
    first, last = np.array(problem.workspace.bounds_m).reshape(2, 2)
    begin = np.where(
        last - first + 2.0 * margin <= side,
        (first + last - side) / 2.0,
        np.clip((low + high - side) / 2.0, first - margin, last + margin - side),
    )
    # Positions outside the bounds, such as base stations, remain visible.
    begin = np.minimum(np.maximum(begin, high + margin - side), low - margin)
    end = np.minimum(begin + side, np.maximum(last, high) + margin)
    begin = np.maximum(begin, np.minimum(first, low) - margin)
    return *begin.tolist(), *end.tolist()


def map_window(problem: Problem, positions_m: Floats) -> Bounds:
    """Return the window around positions and stations; the workspace if the channel is learnt."""
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    margin = EDGE_MARGIN * max(x_max - x_min, y_max - y_min)
    whole = (x_min - margin, y_min - margin, x_max + margin, y_max + margin)
    if problem.task in ("learn", "map"):
        return whole
    stations = [radio.site.position_m for radio in problem.stations]
    window = window_about(problem, np.vstack([positions_m, np.array(stations)]))
    return window if _is_small(problem, window) else whole


def _is_small(problem: Problem, window: Bounds) -> bool:
    """Return True if a window is so small that an inset of the workspace is needed."""
    shown, whole = (
        max(x_max - x_min, y_max - y_min)
        for x_min, y_min, x_max, y_max in (window, problem.workspace.bounds_m)
    )
    return shown < INSET_BELOW * whole


def show_window(panel: Panel, problem: Problem, positions_m: Floats, window: Bounds) -> None:
    """Limit a panel to a window; in a small window, draw an inset of the whole workspace."""
    show_bounds(panel, window)
    low, high = np.reshape(window, (2, 2))
    for radio in problem.stations:
        edge = np.clip(radio.site.position_m, low, high)
        if (edge != radio.site.position_m).any():
            # An arrow at the edge points to the station.
            away_m = radio.site.position_m - edge
            distance_m = float(np.linalg.norm(away_m))
            arrow = {"arrowstyle": "-|>", "edgecolor": BLACK, "facecolor": ORANGE, "linewidth": 1.2}
            look = {"ha": "center", "va": "center", "fontsize": NOTE_PT, "bbox": NOTE_BOX}
            look |= {"textcoords": "offset points", "arrowprops": arrow, "zorder": PLACE_Z}
            inwards = tuple(away_m / -distance_m * (64.0, 30.0))
            panel.annotate(f"station {distance_m:.0f} m", edge, inwards, **look)
            positions_m = np.vstack([positions_m, edge])
    if not _is_small(problem, window):
        return
    shares = (positions_m - low) / (high - low)
    corners = [(x, y) for y in (0.01, 0.99 - INSET) for x in (0.01, 0.99 - INSET)]
    distances = [
        np.linalg.norm(shares - np.array(corner) - INSET / 2.0, axis=1).min() for corner in corners
    ]
    left, bottom = corners[int(np.argmax(distances))]
    inset = panel.inset_axes((left, bottom, INSET, INSET))
    draw_ground(inset, problem.workspace, "")
    inset.set_xlabel("")
    inset.set_ylabel("")
    inset.set_xticks([])
    inset.set_yticks([])
    draw_places(inset, problem)
    inset.plot(*rectangle(window), color=PREDICTED, linewidth=1.5, zorder=9.0)
