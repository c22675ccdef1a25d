"""Animation of a run: robots, their plans, moving obstacles and the target, step by step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planopt.planning.loop.log import RobotRun
from planopt.planning.plan import Plan
from planopt.planning.results import Run
from planopt.problems.problem import Problem
from planopt.report.animation import animate, frames
from planopt.report.map_window import map_window
from planopt.report.maps import MARGIN_Z, PATH_Z, PLACE_Z, draw_ground, draw_places
from planopt.report.motion_map import draw_true_power, path_curve
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    DISCONNECTED,
    OBSTACLE,
    WHITE,
    frame_title,
    head,
    robot_colour,
    robot_marker,
    spaced,
)
from planopt.world.moving_obstacle import centres_at

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from PIL.Image import Image

WIDTH_IN, HEIGHT_IN = 7.4, 7.2


def save_animation(run: Run, path: Path) -> None:
    """Write a run as an animated GIF; errors as :func:`planopt.report.animation.animate`."""
    figure, panel, entries = _background(run)
    animate(figure, path, _count(run), lambda step: _frame(panel, run, step), entries)


def animation_frames(run: Run) -> Iterator[Image]:
    """Draw the frames of a run's animation."""
    figure, panel, entries = _background(run)
    return frames(figure, _count(run), lambda step: _frame(panel, run, step), entries)


def _count(run: Run) -> int:
    return len(run.runs[0].log.t_s)


def _background(run: Run) -> tuple[Figure, Panel, list[Artist]]:
    """Draw the workspace on the true power; legend entries."""
    from matplotlib.gridspec import GridSpec

    problem = run.problem
    shown = [one.log.positions_m for one in run.runs]
    shown += [np.array([robot.goal_m]) for robot in problem.robots if robot.goal_m is not None]
    if run.target is not None:
        shown.append(run.target.true_m)
    window = map_window(problem, np.concatenate(shown))
    figure = new_figure(WIDTH_IN, HEIGHT_IN, maps_only=True)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    draw_ground(panel, problem.workspace, "")
    draw_true_power(figure, panel, run)
    panel.set_xlim(window[0], window[2])
    panel.set_ylim(window[1], window[3])
    head(figure, f"{problem.name}: horizon {problem.planner.horizon}, seed {run.seed}")
    return figure, panel, draw_places(panel, problem)


def _frame(panel: Panel, run: Run, step: int) -> list[Artist]:
    """Draw everything that changes, as it is after `step` steps."""
    time_s = float(run.runs[0].log.t_s[step])
    ending = f", {spaced(run.outcome)}" if step == _count(run) - 1 else ""
    drawn = [frame_title(panel, f"t = {time_s:.0f} s{ending}")]
    drawn += _draw_moving(panel, run.problem, time_s)
    for number, (one, plans) in enumerate(zip(run.runs, run.plans, strict=True)):
        drawn += _draw_robot(panel, run.problem, one, plans, number, step)
    if run.target is not None:
        drawn += panel.plot(
            *run.target.true_m[: step + 1].T,
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
    panel: Panel, problem: Problem, run: RobotRun, plans: Sequence[Plan], number: int, step: int
) -> list[Artist]:
    """Draw a robot, its path so far, its positions out of contact, and its plan."""
    several = len(problem.robots) > 1
    name = f"{run.robot}, " if several else ""
    colour, log = robot_colour(number), run.log
    path = log.positions_m[: step + 1]
    drawn: list[Artist] = []
    if step:
        drawn += panel.plot(*path.T, color=WHITE, linewidth=4.4, zorder=PATH_Z, label="_casing")
    drawn += panel.plot(
        *path.T,
        color=colour,
        linewidth=2.4,
        marker=robot_marker(number),
        markersize=9.0,
        markevery=[-1],
        markeredgecolor=WHITE,
        zorder=PATH_Z + 0.5,
        label=f"{name}driven",
    )
    lost = path[~log.connected[: step + 1]]
    if len(lost):
        drawn.append(
            panel.scatter(
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
        ahead, _ = path_curve(problem, plans[step].positions_m, plans[step].drive)
        drawn += panel.plot(
            *np.vstack([path[-1:], ahead]).T,
            color=colour if several else BLACK,
            linewidth=1.6,
            linestyle=(0, (2.0, 1.0)),
            zorder=PATH_Z + 0.2,
            label=f"{name}planned",
        )
    return drawn


def _draw_moving(panel: Panel, problem: Problem, time_s: float) -> list[Artist]:
    """Draw moving obstacles at one time."""
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
    panel.add_collection(discs, autolim=False)
    return [discs]
