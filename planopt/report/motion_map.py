"""Maps of plans and runs: channel layers, paths, coverage holes, the target; their animation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from planopt.arrays import Floats, Mask
from planopt.channel.posterior import Belief
from planopt.planning.certificate import BlockedPath, Hole
from planopt.planning.loop.log import RobotRun, StepLog, TargetLog
from planopt.planning.loop.metrics import true_serving_dbm
from planopt.planning.loop.results import Run
from planopt.planning.plan import Plan
from planopt.problems.problem import Problem
from planopt.report.animation import animate
from planopt.report.maps import (
    LAYER_Z,
    MARGIN_Z,
    PATH_Z,
    PLACE_Z,
    Bounds,
    believed_rasters,
    draw_discs,
    draw_ground,
    draw_layer,
    draw_level,
    draw_lines,
    draw_path,
    draw_places,
    map_window,
    show_bounds,
    show_window,
)
from planopt.report.panel import (
    BLACK,
    CONNECTED,
    DEVIATION_MAP,
    DISCONNECTED,
    NOTE_BOX,
    POWER_MAP,
    PROBABILITY_MAP,
    PURPLE,
    VERMILLION,
    WHITE,
    Look,
    Panel,
    colour_of,
    fit_to_map,
    frame_title,
    head,
    new_figure,
    robot_marker,
    spaced,
)
from planopt.robots.dynamics import Drive
from planopt.world.motion import centres_at
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

CURVE_POINTS = 16  # Number of points per step on the path of a robot with dynamics
LAYERS = {"map": ("power", "deviation"), "learn": ("power",)}
"""Channel layers by task; other tasks show the probability of connection."""


def layers_of(problem: Problem) -> tuple[str, ...]:
    """Return the channel layers of a problem, one per panel."""
    return LAYERS.get(problem.task, ("connectivity",))


def draw_belief_maps(
    figure: Figure,
    panels: Sequence[Panel],
    problem: Problem,
    belief: Belief,
    positions_m: Floats,  # (n, 2) positions that the maps must show
    window: Bounds,
) -> list[Artist]:
    """Draw the workspace on each layer of the predicted channel; return legend entries."""
    mean, deviation, chance = believed_rasters(problem, belief, window)
    p_min = problem.constraints.step_p_min
    entries: list[Artist] = []
    for panel, layer in zip(panels, layers_of(problem), strict=True):
        if layer == "connectivity":
            draw_ground(panel, problem.workspace, "predicted P(connected)")
            label = "P(connected) [1]" + (" (line: p_min)" if p_min > 0.0 else "")
            mark = p_min if p_min > 0.0 else None
            draw_layer(panel, chance, PROBABILITY_MAP, figure, label, (0.0, 1.0), mark)
            if p_min > 0.0:
                entries = draw_level(panel, chance, p_min, f"P(connected) = {p_min:g}")
        elif layer == "power":
            draw_ground(panel, problem.workspace, "predicted power")
            draw_layer(panel, mean, POWER_MAP, figure, "power [dBm]")
        else:
            draw_ground(panel, problem.workspace, "standard deviation of the prediction")
            draw_layer(panel, deviation, DEVIATION_MAP, figure, "standard deviation [dB]")
        entries = [*draw_places(panel, problem), *entries]
        show_window(panel, problem, positions_m, window)
    return entries


def draw_true_power(figure: Figure, panel: Panel, run: Run) -> None:
    """Draw the true power of the serving station, with the threshold marked on the colour bar."""
    raster = run.truths[0].raster
    if len(run.truths) > 1:
        cells = np.stack(np.meshgrid(raster.x_m, raster.y_m), axis=-1)
        power = true_serving_dbm(run.problem, run.truths, cells.reshape(-1, 2))
        raster = Raster(raster.x_m, raster.y_m, power.reshape(cells.shape[:2]))
    label = "true power [dBm] (line: threshold)"
    mark = run.problem.stations[0].true_threshold_dbm
    draw_layer(panel, raster, POWER_MAP, figure, label, mark=mark)


def path_curve(
    problem: Problem, positions_m: Floats, drive: Drive | None, first: int = 0
) -> tuple[Floats, list[int]]:
    """Return points (k, 2) on a path, and the indices of the step positions among the points."""
    if drive is None or len(drive.inputs) <= first:
        return positions_m[first:], list(range(len(positions_m) - first))
    dynamics, step_s = drive.dynamics, problem.planner.step_s
    curves = dynamics.curves(drive.states[first:-1], drive.inputs[first:], step_s)
    curve, marks = [positions_m[first : first + 1]], [0]
    for each in curves:
        points, _ = each.points_m()
        count = min(CURVE_POINTS, len(points))
        chosen = np.linspace(0, len(points) - 1, count).round().astype(int)
        curve.append(points[chosen[1:]])
        marks.append(marks[-1] + len(chosen) - 1)
    return np.concatenate(curve), marks


def draw_tracks(panel: Panel, problem: Problem, runs: Sequence[RobotRun]) -> list[Artist]:
    """Draw the executed path of each robot, with every step marked."""
    entries: list[Artist] = []
    for number, run in enumerate(runs):
        curve, steps = path_curve(problem, run.log.positions_m, run.drive)
        look = {"color": colour_of(number), "linewidth": 1.8, "marker": robot_marker(number)}
        look |= {"markersize": 4.5, "markeredgecolor": WHITE, "markeredgewidth": 0.6}
        look |= {"zorder": PATH_Z + 0.1, "markevery": steps, "label": f"{run.robot}, driven"}
        entries += draw_path(panel, curve, casing=4.2, **look)
    return entries


def draw_plans(panel: Panel, problem: Problem, plans: Sequence[Plan], first: int) -> list[Artist]:
    """Draw each plan from position `first` on, its route to the goal and that route's holes."""
    entries: list[Artist] = []
    for number, plan in enumerate(plans):
        curve, steps = path_curve(problem, plan.positions_m, plan.drive, first)
        entries += draw_path(
            panel,
            curve,
            casing=3.6,
            color=colour_of(number),
            linewidth=1.8,
            linestyle=(0, (2.5, 1.0)),
            marker=robot_marker(number),
            markevery=steps,
            markersize=5.5,
            markerfacecolor=WHITE,
            markeredgecolor=colour_of(number),
            markeredgewidth=1.2,
            zorder=PATH_Z + 0.2,
            label=f"{plan.robot}, planned",
        )
        if len(plan.route_m):
            route = np.vstack([plan.positions_m[-1:], plan.route_m])
            entries += _draw_dotted(panel, route, "remaining route to the goal")
        entries += _draw_holes(panel, np.vstack([plan.positions_m, plan.route_m]), plan.holes)
    return entries


def draw_blocked(panel: Panel, blocked: Sequence[BlockedPath]) -> list[Artist]:
    """Draw the cheapest paths that a hard chance constraint forbids, and their coverage holes."""
    entries: list[Artist] = []
    for one in blocked:
        entries += _draw_dotted(panel, one.path_m, "cheapest path (violates a constraint)")
        entries += _draw_holes(panel, one.path_m, one.holes)
    return entries


def _draw_dotted(panel: Panel, path_m: Floats, label: str) -> Sequence[Artist]:
    look: Look = {"color": BLACK, "linewidth": 1.2, "linestyle": (0, (1, 2))}
    return draw_path(panel, path_m, zorder=PATH_Z - 0.2, label=label, **look)


def _draw_holes(panel: Panel, path_m: Floats, holes: Sequence[Hole]) -> list[Artist]:
    """Draw the coverage holes that a path (n, 2) crosses, with their lengths."""
    entries: list[Artist] = []
    for hole in holes:
        # The part extends half a step beyond the hole on either side.
        first, last = sorted(
            int(np.argmin(np.linalg.norm(path_m - np.array(end), axis=1)))
            for end in (hole.from_m, hole.to_m)
        )
        before = 0.5 * (path_m[max(first - 1, 0)] + path_m[first])
        behind = 0.5 * (path_m[min(last + 1, len(path_m) - 1)] + path_m[last])
        part = np.vstack([before, path_m[first : last + 1], behind])
        look = {"color": VERMILLION, "linewidth": 5.0, "solid_capstyle": "butt"}
        label = "coverage hole on the path"
        entries += draw_path(panel, part, casing=7.0, zorder=PATH_Z - 0.3, label=label, **look)
        x, y = part[len(part) // 2]
        words = f"{hole.length_m:.0f} m"
        panel.text(x, y, words, zorder=PATH_Z + 0.5, clip_on=True, bbox=NOTE_BOX)
    return entries


def draw_clearance(panel: Panel, problem: Problem, window: Bounds) -> list[Artist]:
    """Draw the clearance contour around obstacles; nothing if none is in view."""
    clearance = problem.constraints.clearance_m
    around = shapely.box(*window).buffer(clearance)
    near = [
        obstacle.polygon.buffer(clearance)
        for obstacle in problem.workspace.obstacles
        if obstacle.polygon.intersects(around)
    ]
    rings = shapely.get_parts(shapely.boundary(shapely.union_all(near)))
    if not len(rings):
        return []
    look: Look = {"colors": PURPLE, "linewidths": 0.9, "linestyles": "dashed", "zorder": MARGIN_Z}
    label = f"clearance of {clearance:g} m"
    return [
        draw_lines(panel, [shapely.get_coordinates(ring) for ring in rings], label=label, **look)
    ]


def draw_connected_track(panel: Panel, log: StepLog) -> list[Artist]:
    """Draw an executed path: solid where connected, dashed where not, thin where unknown."""
    entries: list[Artist] = []
    unknown = ~log.connected & ~log.disconnected
    for label, colour, casing, dashes, width, states in (
        ("driven, connected", CONNECTED, WHITE, "solid", 4.0, log.connected),
        ("driven, not connected", DISCONNECTED, BLACK, (0, (1.2, 0.8)), 4.0, log.disconnected),
        ("driven, no reading", BLACK, WHITE, "solid", 1.2, unknown),
    ):
        pieces = _pieces(log, states[1:])
        if not pieces:
            continue
        draw_lines(panel, pieces, colors=casing, linewidths=width + 2.0, capstyle="round")
        look: Look = {"colors": colour, "linewidths": width, "linestyles": [dashes]}
        look |= {"capstyle": "butt", "zorder": PATH_Z + 0.1, "label": label}
        entries.append(draw_lines(panel, pieces, **look))
    return entries


def _pieces(log: StepLog, states: Mask) -> list[Floats]:
    """Return the contiguous parts of a path whose steps are set in the mask `states` (steps,)."""
    changes = np.flatnonzero(np.diff(states)) + 1
    bounds = [0, *changes.tolist(), len(states)] if len(states) else [0]
    return [
        log.positions_m[first : last + 1]
        for first, last in itertools.pairwise(bounds)
        if states[first]
    ]


def draw_measured(
    panel: Panel, positions_m: Floats, label: str, *, on_path: bool = False
) -> list[Artist]:
    """Mark measured positions (n, 2), below the paths or as small dots on them."""
    if not len(positions_m):
        return []
    look = {
        "s": 4.0 if on_path else 13.0,
        "color": WHITE if on_path else BLACK,
        "edgecolors": BLACK if on_path else WHITE,
        "zorder": (PATH_Z if on_path else LAYER_Z) + 0.2,
    }
    return [panel.scatter(*positions_m.T, linewidths=0.4, label=label, **look)]


def draw_relaxed(panel: Panel, log: StepLog) -> list[Artist]:
    """Mark, below the path, the positions at which the chance constraint was relaxed."""
    positions = log.positions_m[log.relaxation_db > 0.0]
    look = {"marker": "D", "s": 60.0, "color": PURPLE, "linewidths": 0.0, "zorder": PATH_Z - 0.1}
    if not len(positions):
        return []
    return [panel.scatter(*positions.T, label="P(connected) below p_min", **look)]


def draw_target(panel: Panel, target: TargetLog) -> list[Artist]:
    """Draw the true trajectory of the target above the station's estimates."""
    true_m, station_m = target.true_m, target.station_mean_m
    look = {"color": BLACK, "linewidth": 1.6, "zorder": PATH_Z + 0.4}
    track = draw_path(panel, true_m, casing=2.6, label="target, true path", **look)
    look = {"color": BLACK, "edgecolors": WHITE, "linewidths": 0.8, "zorder": PLACE_Z + 0.1}
    end = panel.scatter(*true_m[-1:].T, marker="*", s=190.0, label="target at the end", **look)
    look = {"color": WHITE, "edgecolors": BLACK, "linewidths": 0.9, "zorder": PATH_Z + 0.3}
    estimates = panel.scatter(*station_m.T, s=30.0, label="station's estimates", **look)
    return [*track, end, estimates]


def draw_expected_target(panel: Panel, target_m: Floats) -> list[Artist]:
    """Draw the expected position of the target after each step (N, 2)."""
    look: Look = {"color": BLACK, "linewidth": 1.4, "linestyle": "dotted", "marker": "*"}
    look |= {"markersize": 9.0, "markeredgecolor": WHITE, "markeredgewidth": 0.5}
    label = "expected target"
    return list(draw_path(panel, target_m, zorder=PATH_Z + 0.1, label=label, **look))


def save_animation(run: Run, path: Path) -> None:
    """Write a run as an animated GIF; errors as in :func:`planopt.report.animation.animate`."""
    problem = run.problem
    shown = [one.log.positions_m for one in run.runs]
    shown += [np.array([robot.goal_m]) for robot in problem.robots if robot.goal_m is not None]
    if run.target is not None:
        shown.append(run.target.true_m)
    figure, (panel,) = new_figure(7.4, 7.2, maps_only=True)
    draw_ground(panel, problem.workspace, "")
    draw_true_power(figure, panel, run)
    show_bounds(panel, map_window(problem, np.concatenate(shown)))
    fit_to_map(figure, panel, 5.6)
    head(figure, f"{problem.name}: horizon {problem.planner.horizon}, seed {run.seed}")
    entries = draw_places(panel, problem)
    count = len(run.runs[0].log.t_s)
    animate(figure, path, count, lambda step: _draw_frame(panel, run, step), entries)


def _draw_frame(panel: Panel, run: Run, step: int) -> list[Artist]:
    """Draw all dynamic content after `step` steps."""
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
    colour, log, plans = colour_of(number), run.runs[number].log, run.plans[number]
    path = log.positions_m[: step + 1]
    drawn: list[Artist] = []
    if step:
        drawn += draw_path(panel, path, color=WHITE, linewidth=4.4, label="_casing")
    look: Look = {"color": colour, "linewidth": 2.4, "marker": robot_marker(number)}
    look |= {"markersize": 9.0, "markevery": [-1], "markeredgecolor": WHITE}
    drawn += draw_path(panel, path, zorder=PATH_Z + 0.5, label=f"{name}driven", **look)
    lost = path[log.disconnected[: step + 1]]
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
