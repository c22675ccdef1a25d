"""The parts that every map has: obstacles that stand or move, bounds, marks, a layer below."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.report.panel import Panel, add_colorbar
from planopt.report.style import (
    BLACK,
    FRAME,
    GREEN,
    LABEL_PT,
    NOTE_PT,
    OBSTACLE,
    OBSTACLE_EDGE,
    ORANGE,
    TICK_PT,
    WHITE,
    YELLOW,
    dress,
)
from planopt.world.moving_obstacle import centres_at, growth_m
from planopt.world.raster import Raster
from planopt.world.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from matplotlib.path import Path as Outline


LAYER_Z, CONTOUR_Z, OBSTACLE_Z, MARGIN_Z, PATH_Z, PLACE_Z = 1.0, 1.5, 2.0, 2.5, 3.0, 4.0
"""What is drawn above what."""

X_LABEL, Y_LABEL = "x [m]", "y [m]"


def draw_ground(panel: Panel, workspace: Workspace, title: str) -> None:
    """Draw obstacles and bounds, with axes in metres of equal scale over the whole workspace.

    Obstacles that come or go are hatched, and say when.
    """
    from matplotlib.collections import PathCollection

    obstacles = PathCollection(
        [outline(obstacle.polygon) for obstacle in workspace.lasting],
        facecolors=OBSTACLE,
        edgecolors=OBSTACLE_EDGE,
        linewidths=0.4,
        zorder=OBSTACLE_Z,
    )
    panel.add_collection(obstacles, autolim=False)
    timed = PathCollection(
        [outline(obstacle.polygon) for obstacle in workspace.timed],
        facecolors="none",
        edgecolors=FRAME,
        linewidths=0.9,
        linestyles="dashed",
        hatch="///",
        zorder=OBSTACLE_Z,
    )
    panel.add_collection(timed, autolim=False)
    for obstacle in workspace.timed:
        x, y = shapely.get_coordinates(obstacle.polygon.representative_point())[0]
        until = "" if np.isinf(obstacle.until_s) else f" until {obstacle.until_s:g} s"
        panel.text(
            x,
            y,
            f"from {obstacle.known_from_s:g} s{until}",
            fontsize=NOTE_PT,
            ha="center",
            va="center",
            clip_on=True,
            zorder=PLACE_Z,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": WHITE, "edgecolor": "none"},
        )
    x_min, y_min, x_max, y_max = workspace.bounds_m
    panel.plot(*rectangle(workspace.bounds_m), color=FRAME, linewidth=1.2, zorder=MARGIN_Z)
    dress(panel, title, X_LABEL, Y_LABEL, grid=False)
    panel.set_aspect("equal")
    panel.set_xlim(x_min, x_max)
    panel.set_ylim(y_min, y_max)


def rectangle(bounds_m: tuple[float, float, float, float]) -> tuple[list[float], list[float]]:
    """Return x and y of the closed outline of a rectangle."""
    x_min, y_min, x_max, y_max = bounds_m
    return [x_min, x_max, x_max, x_min, x_min], [y_min, y_min, y_max, y_max, y_min]


def draw_layer(
    panel: Panel,
    raster: Raster,
    colours: str,
    figure: Figure,
    label: str,
    limits: tuple[float, float] | None = None,
    mark: float | None = None,
) -> None:
    """Draw a raster below the obstacles, with its colour bar."""
    wide, high = raster.cell_m
    low, top = (None, None) if limits is None else limits
    layer = panel.imshow(
        raster.values,
        origin="lower",
        extent=(
            raster.x_m[0] - wide / 2,
            raster.x_m[-1] + wide / 2,
            raster.y_m[0] - high / 2,
            raster.y_m[-1] + high / 2,
        ),
        cmap=colours,
        vmin=low,
        vmax=top,
        interpolation="nearest",
        zorder=LAYER_Z,
    )
    bar = add_colorbar(figure, layer, panel, aspect=30, pad=0.02)
    bar.set_ylabel(label, fontsize=LABEL_PT)
    bar.tick_params(labelsize=TICK_PT)
    if mark is not None:
        bar.axhline(mark, color=WHITE, linewidth=3.0)
        bar.axhline(mark, color=FRAME, linewidth=1.2)


def draw_level(
    panel: Panel, raster: Raster, level: float, colour: str, label: str = ""
) -> list[Artist]:
    """Draw the contour of a raster at `level`, if it has one; a legend entry for a label."""
    from matplotlib.lines import Line2D

    known = raster.values[np.isfinite(raster.values)]
    if known.size and known.min() < level < known.max():
        panel.contour(
            raster.x_m,
            raster.y_m,
            raster.values,
            levels=[level],
            colors=[colour],
            linewidths=1.1,
            zorder=CONTOUR_Z,
        )
    return [Line2D([], [], color=colour, linewidth=1.2, label=label)] if label else []


def draw_places(panel: Panel, problem: Problem) -> list[Artist]:
    """Mark start and goal of every robot and the stations; the artists, for a legend."""
    goals = [robot.goal_m for robot in problem.robots if robot.goal_m is not None]
    marks = (
        ("start", "o", 70.0, GREEN, [robot.start_m for robot in problem.robots]),
        ("goal", "*", 200.0, YELLOW, goals),
        ("station", "^", 80.0, ORANGE, [radio.site.position_m for radio in problem.stations]),
    )
    artists: list[Artist] = []
    for label, marker, size, colour, places in marks:
        if not places:
            continue
        x, y = np.array(places, dtype=np.float64).T
        artists.append(
            panel.scatter(
                x,
                y,
                marker=marker,
                s=size,
                color=colour,
                edgecolors="black",
                linewidths=1.0,
                zorder=PLACE_Z,
                label=label,
            )
        )
    return artists


def outline(polygon: shapely.Polygon) -> Outline:
    """A polygon with its holes as one path; rings turn opposite ways, so that holes stay open."""
    from matplotlib.path import Path as Outline

    turned = shapely.geometry.polygon.orient(polygon)
    rings = [ring_xy(ring) for ring in (turned.exterior, *turned.interiors)]
    codes = [
        np.array([Outline.MOVETO, *[Outline.LINETO] * (len(ring) - 2), Outline.CLOSEPOLY])
        for ring in rings
    ]
    return Outline(np.concatenate(rings), np.concatenate(codes))


def ring_xy(ring: shapely.LineString) -> NDArray[np.float64]:
    """Corners of a closed ring, the first again at the end; (n, 2)."""
    return np.asarray(shapely.get_coordinates(ring), dtype=np.float64)


DISCS = 6
"""Drawn of each obstacle at most, evenly over the time; later ones are paler."""

DARKEST, PALEST = 0.9, 0.3
"""Opacity of the first and of the last disc."""


def draw_moving(panel: Panel, problem: Problem, steps: int, *, predicted: bool) -> list[Artist]:
    """Draw where every moving obstacle is when, over the first `steps` steps; for a legend."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    artists: list[Artist] = []
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    end_s = problem.planner.step_s * steps
    every = max(-(-steps // (DISCS - 1)), 1)
    times = problem.planner.step_s * np.arange(0, steps + 1, every, dtype=np.float64)
    for obstacle in problem.workspace.moving:
        centres = centres_at(obstacle, times).tolist()
        grown = growth_m(obstacle, times) if predicted else np.zeros(len(times))
        discs = PatchCollection(
            [Circle(centre, obstacle.radius_m) for centre in centres],
            facecolors=OBSTACLE,
            edgecolors=BLACK,
            linewidths=1.0,
            alpha=np.linspace(DARKEST, PALEST, len(times)),
            zorder=MARGIN_Z,
            label="moving obstacle, paler later",
        )
        panel.add_collection(discs, autolim=False)
        if grown.any():
            rims = PatchCollection(
                [
                    Circle(centre, obstacle.radius_m + growth)
                    for centre, growth in zip(centres, grown.tolist(), strict=True)
                ],
                facecolors="none",
                edgecolors=BLACK,
                linestyles="dotted",
                zorder=MARGIN_Z,
            )
            panel.add_collection(rims, autolim=False)
        artists = artists or [discs]
        known = [time for time in obstacle.times_s if 0.0 < time < end_s]
        way = centres_at(obstacle, np.array(sorted({0.0, *known, end_s})))
        panel.plot(*way.T, color=WHITE, linewidth=2.6, zorder=MARGIN_Z)
        panel.plot(*way.T, color=FRAME, linewidth=1.1, linestyle="dashdot", zorder=MARGIN_Z + 0.1)
        for (x, y), time in zip(centres, times.tolist(), strict=True):
            if not (x_min <= x <= x_max and y_min <= y <= y_max):
                continue  # text far outside cannot be rendered, nor seen
            panel.text(
                x,
                y,
                obstacle.name if time == 0.0 else f"{time:g} s",
                fontsize=NOTE_PT,
                ha="center",
                va="center",
                zorder=MARGIN_Z + 0.2,
                clip_on=True,
            )
    return artists
