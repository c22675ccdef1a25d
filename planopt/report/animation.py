# pyright: basic
"""A run as a short animation (GIF): robots, their plans, what moves, and the target, step by step.

The ground is drawn once. Each frame copies it and adds what has changed, so that a run over a map
of a thousand buildings takes seconds. This file is the boundary to Matplotlib's Agg canvas and to
Pillow, which leave what is used here untyped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.files.whole import write_whole
from planopt.planning.loop.log import RobotRun, TargetLog
from planopt.planning.plan import Plan
from planopt.planning.run import Run
from planopt.problems.problem import Problem
from planopt.report.maps import (
    MARGIN_Z,
    PATH_Z,
    PLACE_Z,
    draw_ground,
    draw_layer,
    draw_places,
)
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.run_figure import true_power
from planopt.report.style import (
    BLACK,
    DISCONNECTED,
    FRAME,
    OBSTACLE,
    POWER_MAP,
    SERIES,
    TITLE_PT,
    WHITE,
    YELLOW,
    head,
    legend_below,
)
from planopt.report.team_map import team_window
from planopt.report.team_series import driven_line, robot_colour, robot_marker
from planopt.world.moving_obstacle import centres_at

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from PIL.Image import Image

DPI = 76
WIDTH_IN, HEIGHT_IN = 7.4, 7.2
"""Of a frame: some 560 pixels wide, which a README shows as it is."""

MOST_FRAMES = 90
"""Longer runs show every second or third step, so that files stay below some 2 MB."""

COLOURS = 64
"""Of the ground in the palette that all frames share."""

MARKS = (*SERIES, YELLOW, FRAME, OBSTACLE, BLACK, WHITE)
"""Further colours of the palette,"""

SCALE_COLOURS = 48
"""and so many of the colour bar."""

UNCHANGED = 255
"""Number of the colour that means: as in the frame before."""

FRAME_MS, LAST_MS = 120, 2500
"""How long each frame is shown; the last one longer, before the animation begins again."""

LEGEND_COLUMNS = 4


def save_animation(run: Run, path: Path) -> None:
    """Write a run as an animated GIF, whole or not at all.

    Parameters
    ----------
    run
        From :func:`planopt.simulate`, of one robot or several.
    path
        Ends in ``.gif``; its folder is made if need be.

    Raises
    ------
    InputError
        Another ending.
    OutputError
        The file cannot be written.
    """
    if path.suffix.lower() != ".gif":
        raise InputError(
            f"{path.name}: an animation cannot be written as "
            f"{path.suffix or 'a file without ending'!r}",
            remedy="end the name in .gif",
        )
    frames = _with_palette(list(animation_frames(run)))
    durations = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    write_whole(
        path,
        lambda temporary: frames[0].save(
            temporary,
            save_all=True,
            append_images=frames[1:],
            duration=durations,
            loop=0,
            optimize=False,
            disposal=1,
            transparency=UNCHANGED,
        ),
    )


def _with_palette(frames: Sequence[Image]) -> list[Image]:
    """Give frames one palette, and leave out of each what is as in the frame before.

    The palette is that of the last frame, so that nothing flickers, and the colours of the marks
    and of the colour bar, which cover too little to be in it.
    """
    from matplotlib import colormaps
    from PIL import Image, ImageColor

    ground = (frames[-1].quantize(COLOURS).getpalette() or [])[: 3 * COLOURS]
    scale = colormaps[POWER_MAP](np.linspace(0.0, 1.0, SCALE_COLOURS), bytes=True)[:, :3]
    marks = [part for colour in MARKS for part in ImageColor.getrgb(colour)]
    marks += np.asarray(scale).ravel().tolist()
    palette = Image.new("P", (1, 1))
    palette.putpalette(ground + marks)
    indices = [
        np.array(frame.quantize(palette=palette, dither=Image.Dither.NONE)) for frame in frames
    ]
    found: list[Any] = []
    for number, frame in enumerate(indices):
        shown = frame
        if number:
            shown = np.where(frame == indices[number - 1], np.uint8(UNCHANGED), frame)
        image = Image.fromarray(shown.astype(np.uint8), mode="P")
        image.putpalette(ground + marks)
        found.append(image)
    return found


def animation_frames(run: Run) -> Iterator[Image]:
    """Draw the frames of a run, the first at its start, the last at its end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    plans, target = run.plans, run.target
    figure, panel = _ground(run, plans, target)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # The layout stays as it is found for the legend and the longest title.
    figure.set_layout_engine("none")
    for artist in panel.frame_artists:
        artist.remove()
    panel.axes.set_title("", loc="left")
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    for step in shown_steps(len(run.runs[0].log.t_s)):
        canvas.restore_region(background)
        drawn: list[Any] = [*_changing(panel.axes, run.problem, run.runs, plans, target, step)]
        drawn.append(panel.axes.set_title(_words(run, step), fontsize=TITLE_PT, loc="left"))
        for artist in sorted(drawn, key=lambda each: each.get_zorder()):
            artist.draw(canvas.renderer)
        yield Image.fromarray(np.array(canvas.buffer_rgba())[..., :3])
        for artist in drawn[:-1]:
            artist.remove()


def shown_steps(count: int) -> list[int]:
    """Rows of a log of `count` rows that are frames: evenly, the first and the last among them."""
    every = -(-count // MOST_FRAMES)
    return sorted({*range(0, count, every), count - 1})


class _Ground:
    """Axes with the ground, and the artists that stood in for what changes in the legend."""

    def __init__(self, axes: Panel, frame_artists: Sequence[Artist]) -> None:
        self.axes = axes
        self.frame_artists = frame_artists


def _ground(
    run: Run, plans: Sequence[Sequence[Plan]], target: TargetLog | None
) -> tuple[Figure, _Ground]:
    """Draw what does not change, and the last step for the legend."""
    from matplotlib.gridspec import GridSpec

    problem = run.problem
    places = [one.log.positions_m for one in run.runs]
    places += [np.array([robot.goal_m]) for robot in problem.robots if robot.goal_m is not None]
    if target is not None:
        places.append(target.true_m)
    window = team_window(problem, np.concatenate(places))
    figure = new_figure(WIDTH_IN, HEIGHT_IN, maps_only=True)
    figure.set_dpi(DPI)
    axes = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    last = len(run.runs[0].log.t_s) - 1
    draw_ground(axes, problem.workspace, _words(run, last))
    raster, threshold = true_power(run), problem.stations[0].true_threshold_dbm
    label = "true power [dBm] (line: threshold)"
    draw_layer(axes, raster, POWER_MAP, figure, label, mark=threshold)
    axes.set_xlim(window[0], window[2])
    axes.set_ylim(window[1], window[3])
    entries = draw_places(axes, problem)
    # Of the first step as well: a run that ends at its goal has no plan there any more.
    changing = [
        artist
        for step in (0, last)
        for artist in _changing(axes, problem, run.runs, plans, target, step)
    ]
    named = {str(each.get_label()): each for each in changing}
    entries += [each for name, each in named.items() if not name.startswith("_")]
    legend_below(figure, entries, LEGEND_COLUMNS)
    planner = problem.planner
    head(figure, f"{problem.name}: horizon {planner.horizon}, seed {run.seed}")
    return figure, _Ground(axes, changing)


def _words(run: Run, step: int) -> str:
    """The time, and how the run ended once it has."""
    log = run.runs[0].log
    words = f"t = {log.t_s[step]:.0f} s"
    if step == len(log.t_s) - 1:
        words += f", {run.runs[0].outcome.value.replace('_', ' ')}"
    return words


def _changing(
    axes: Panel,
    problem: Problem,
    runs: Sequence[RobotRun],
    plans: Sequence[Sequence[Plan]],
    target: TargetLog | None,
    step: int,
) -> list[Artist]:
    """Draw what is there after `step` steps; labelled for a legend."""
    drawn = _draw_moving(axes, problem, float(runs[0].log.t_s[step]))
    for number, (run, released) in enumerate(zip(runs, plans, strict=True)):
        drawn += _draw_robot(axes, problem, run, released, number, step)
    if target is not None:
        drawn += axes.plot(
            *target.true_m[: step + 1].T,
            color=BLACK,
            linewidth=1.4,
            marker="*",
            markersize=13.0,
            markevery=[-1],
            markeredgecolor=WHITE,
            zorder=PLACE_Z + 0.3,
            label="target",
        )
    return drawn


def _draw_robot(
    axes: Panel, problem: Problem, run: RobotRun, plans: Sequence[Plan], number: int, step: int
) -> list[Artist]:
    """Draw a robot, what it has driven, where it was out of contact, and its plan."""
    several = len(problem.robots) > 1
    name = f"{run.robot}, " if several else ""
    colour, log = robot_colour(number), run.log
    places = log.positions_m[: step + 1]
    drawn: list[Artist] = []
    if step:
        drawn += axes.plot(*places.T, color=WHITE, linewidth=4.4, zorder=PATH_Z, label="_casing")
    drawn += axes.plot(
        *places.T,
        color=colour,
        linewidth=2.4,
        marker=robot_marker(number),
        markersize=9.0,
        markevery=[-1],
        markeredgecolor=WHITE,
        zorder=PATH_Z + 0.5,
        label=f"{name}driven",
    )
    lost = places[~log.connected[: step + 1]]
    if len(lost):
        drawn.append(
            axes.scatter(
                *lost.T,
                marker="x",
                s=26.0,
                color=DISCONNECTED,
                linewidths=1.6,
                zorder=PATH_Z + 0.6,
                label="out of contact",
            )
        )
    if step < len(plans):
        ahead, _ = driven_line(problem, plans[step].positions_m, plans[step].drive)
        drawn += axes.plot(
            *_joined(places[-1], ahead).T,
            color=BLACK if not several else colour,
            linewidth=1.6,
            linestyle=(0, (2.0, 1.0)),
            zorder=PATH_Z + 0.2,
            label=f"{name}planned",
        )
    return drawn


def _joined(place_m: NDArray[np.float64], ahead_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """A plan's line, from where the robot is."""
    return np.vstack([place_m, ahead_m])


def _draw_moving(axes: Panel, problem: Problem, time_s: float) -> list[Artist]:
    """Draw moving obstacles where they are."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    if not problem.workspace.moving:
        return []
    discs = PatchCollection(
        [
            Circle(tuple(centres_at(each, np.array([time_s]))[0].tolist()), each.radius_m)
            for each in problem.workspace.moving
        ],
        facecolors=OBSTACLE,
        edgecolors=BLACK,
        linewidths=1.2,
        zorder=MARGIN_Z,
        label="moving obstacle",
    )
    axes.add_collection(discs, autolim=False)
    return [discs]
