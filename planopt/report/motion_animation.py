"""Animation of a run: robots, their plans, moving obstacles and the target, step by step."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planopt.planning.results import Run
from planopt.report.animation import animate
from planopt.report.maps import (
    PATH_Z,
    PLACE_Z,
    draw_discs,
    draw_ground,
    draw_path,
    draw_places,
    map_window,
    show_bounds,
)
from planopt.report.motion_map import draw_true_power, path_curve
from planopt.report.panel import Look, Panel, new_figure
from planopt.report.style import (
    BLACK,
    DISCONNECTED,
    WHITE,
    frame_title,
    head,
    robot_colour,
    robot_marker,
    spaced,
)
from planopt.world.moving_discs import centres_at

if TYPE_CHECKING:
    from matplotlib.artist import Artist


def save_animation(run: Run, path: Path) -> None:
    """Write a run as an animated GIF; errors as :func:`planopt.report.animation.animate`."""
    problem = run.problem
    shown = [one.log.positions_m for one in run.runs]
    shown += [np.array([robot.goal_m]) for robot in problem.robots if robot.goal_m is not None]
    if run.target is not None:
        shown.append(run.target.true_m)
    figure, (panel,) = new_figure(7.4, 7.2, maps_only=True)
    draw_ground(panel, problem.workspace, "")
    draw_true_power(figure, panel, run)
    show_bounds(panel, map_window(problem, np.concatenate(shown)))
    head(figure, f"{problem.name}: horizon {problem.planner.horizon}, seed {run.seed}")
    entries = draw_places(panel, problem)
    count = len(run.runs[0].log.t_s)
    animate(figure, path, count, lambda step: _draw_frame(panel, run, step), entries)


def _draw_frame(panel: Panel, run: Run, step: int) -> list[Artist]:
    """Draw everything that changes, as it is after `step` steps."""
    t_s = run.runs[0].log.t_s
    ending = f", {spaced(run.outcome)}" if step == len(t_s) - 1 else ""
    drawn = [frame_title(panel, f"t = {t_s[step]:.0f} s{ending}")]
    moving = run.problem.workspace.moving
    if moving:
        centres = np.concatenate([centres_at(each, t_s[step : step + 1]) for each in moving])
        radii = np.array([each.radius_m for each in moving])
        drawn.append(draw_discs(panel, centres, radii, linewidths=1.2, label="moving obstacle"))
    for number in range(len(run.runs)):
        drawn += _draw_robot(panel, run, number, step)
    if run.target is not None:
        look: Look = {"color": BLACK, "linewidth": 1.4, "marker": "*", "markersize": 13.0}
        look |= {"markevery": [-1], "markeredgecolor": WHITE, "zorder": PLACE_Z + 0.3}
        drawn += draw_path(panel, run.target.true_m[: step + 1], label="target", **look)
    return drawn


def _draw_robot(panel: Panel, run: Run, number: int, step: int) -> list[Artist]:
    """Draw a robot, its path so far, its positions out of contact, and its plan."""
    several = len(run.runs) > 1
    name = f"{run.runs[number].robot}, " if several else ""
    colour, log, plans = robot_colour(number), run.runs[number].log, run.plans[number]
    path = log.positions_m[: step + 1]
    drawn: list[Artist] = []
    if step:
        drawn += draw_path(panel, path, color=WHITE, linewidth=4.4, label="_casing")
    look: Look = {"color": colour, "linewidth": 2.4, "marker": robot_marker(number)}
    look |= {"markersize": 9.0, "markevery": [-1], "markeredgecolor": WHITE}
    drawn += draw_path(panel, path, zorder=PATH_Z + 0.5, label=f"{name}driven", **look)
    lost = path[~log.connected[: step + 1]]
    if len(lost):
        look = {"marker": "x", "s": 26.0, "color": DISCONNECTED, "linewidths": 1.6}
        cross = panel.scatter(*lost.T, zorder=PATH_Z + 0.6, label="out of contact", **look)
        drawn.append(cross)
    if step < len(plans):
        ahead, _ = path_curve(run.problem, plans[step].positions_m, plans[step].drive)
        look = {"color": colour if several else BLACK, "linestyle": (0, (2.0, 1.0))}
        planned = np.vstack([path[-1:], ahead])
        label = f"{name}planned"
        drawn += draw_path(panel, planned, linewidth=1.6, zorder=PATH_Z + 0.2, label=label, **look)
    return drawn
