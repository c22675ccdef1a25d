"""Pictures of pursuits: the paths, what pursuers knew when, and an animation of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.pursuit.knowledge import Snapshot, Track, mote_centres_m, snapshot
from planopt.pursuit.service import SnapshotService
from planopt.pursuit.simulation import Pursuit, Use
from planopt.report.animation import animate
from planopt.report.panel import Panel, add_colorbar, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    BLUE,
    DEVIATION_MAP,
    OBSTACLE,
    OBSTACLE_EDGE,
    ORANGE,
    SERIES,
    VERMILLION,
    dress,
    frame_title,
    head,
    legend_below,
    legend_inside,
    spaced,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

ANGLES = np.linspace(0.0, 2.0 * np.pi, 49)
UNIT_CIRCLE = np.array([np.cos(ANGLES), np.sin(ANGLES)])
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])


def draw_pursuit(name: str, pursuit: Pursuit) -> Figure:
    """Draw who went where, and how old and how far off the records were."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(12.0, 6.4)
    grid = GridSpec(2, 2, figure=figure, width_ratios=(1.5, 1.0))
    plane = add_panel(figure, grid[:, 0])
    entries = _scene(plane, pursuit)
    # A flight that is nearly straight fills the panel all the same.
    plane.set_aspect("equal", adjustable="datalim")
    for states in pursuit.pursuers:
        entries["pursuer"] = plane.plot(
            states[:, 0], states[:, 1], color=BLUE, linewidth=1.5, label="pursuer"
        )[0]
        plane.plot(states[:1, 0], states[:1, 1], color=BLUE, marker="s", markersize=6.0)
    for places in pursuit.evaders_m:
        entries["evader"] = plane.plot(
            places[:, 0], places[:, 1], color=VERMILLION, linewidth=1.5, label="evader"
        )[0]
        plane.plot(places[:1, 0], places[:1, 1], color=VERMILLION, marker="o", markersize=6.0)
    reported = np.array([use.record.reported_m for use in pursuit.uses]).reshape(-1, 2)
    if len(reported):
        entries["report"] = plane.scatter(
            reported[:, 0], reported[:, 1], s=16.0, color=ORANGE, zorder=3, label="reported place"
        )
    _captures(plane, pursuit, entries)
    _knowledge(add_panel(figure, grid[0, 1]), add_panel(figure, grid[1, 1]), pursuit)
    legend_below(figure, entries.values(), len(entries))
    head(figure, f"{spaced(name)}: {_outcome(pursuit)}")
    return figure


def draw_knowledge(known: Snapshot, track: Track) -> Figure:
    """Draw the age of every mote's report of one object, and the object's way."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(7.4, 6.0)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    levels, side_m = known.level_map(), known.service.side_m
    ages_s = np.where(levels >= 0, known.ages_s[np.maximum(levels, 0)], np.nan)
    extent = (0.0, side_m, 0.0, side_m)
    layer = panel.imshow(ages_s, origin="lower", extent=extent, cmap=DEVIATION_MAP)
    add_colorbar(figure, layer, panel, label="age of the report [s]")
    path = track.positions_m
    panel.plot(path[:, 0], path[:, 1], color=VERMILLION, linewidth=1.6, label="the object's way")
    reported = known.reported_m[np.unique(levels[levels >= 0])]
    panel.scatter(
        reported[:, 0], reported[:, 1], s=30.0, color=ORANGE, zorder=3, label="reported places"
    )
    panel.plot(path[-1:, 0], path[-1:, 1], color=VERMILLION, marker="o", label="the object now")
    panel.set_xlim(0.0, side_m)
    panel.set_ylim(0.0, side_m)
    dress(panel, "what every mote knows", "x [m]", "y [m]", grid=False)
    legend_inside(panel, "lower right")
    return figure


def draw_view(
    service: SnapshotService, tracks: Sequence[Track], mote: NDArray[np.int64], time_s: float
) -> Figure:
    """Draw the snapshot that one mote has: how old and how coarse its news of every place is."""
    # Shapes: mote (2,).
    from matplotlib.gridspec import GridSpec

    figure = new_figure(7.4, 6.6)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    here_m = mote_centres_m(service)[mote[1], mote[0]]
    side_m = service.side_m
    # What stands at a place is shown to the mote by the levels that show the mote to the place.
    seen = snapshot(service, Track(np.zeros(1), here_m[None]), time_s)
    layer = panel.imshow(
        np.asarray(seen.ages_s[seen.level_map()], dtype=np.float64),
        origin="lower",
        extent=(0.0, side_m, 0.0, side_m),
        cmap=DEVIATION_MAP,
    )
    add_colorbar(figure, layer, panel, label="age of its records of a place [s]")
    entries: dict[str, Artist] = {}
    for track in tracks:
        known = snapshot(service, track, time_s)
        level = int(known.shown_at(mote).argmax())
        place_m, reported_m = track.at(np.array(time_s)), known.reported_m[level]
        half_m = service.error_bound_m(level) / np.sqrt(2.0)
        square = reported_m + half_m * SQUARE
        entries["record"] = panel.plot(
            square[:, 0], square[:, 1], color=ORANGE, linewidth=2.0, label="reported sub-cell"
        )[0]
        way = np.array([known.sampled_m[level], place_m])
        entries["way"] = panel.plot(
            way[:, 0], way[:, 1], color=VERMILLION, linewidth=1.4, label="its way since"
        )[0]
        entries["now"] = panel.plot(
            way[1:, 0],
            way[1:, 1],
            color=VERMILLION,
            marker="o",
            linestyle="none",
            label="object now",
        )[0]
    entries["mote"] = panel.plot(
        here_m[:1], here_m[1:], color=BLUE, marker="s", linestyle="none", label="the mote"
    )[0]
    panel.set_xlim(0.0, side_m)
    panel.set_ylim(0.0, side_m)
    dress(panel, "the snapshot of one mote", "x [m]", "y [m]", grid=False)
    legend_below(figure, entries.values(), len(entries))
    return figure


def animate_pursuit(name: str, pursuit: Pursuit, path: Path) -> None:
    """Write a GIF of a pursuit: positions, paths, and the record that each pursuer uses."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(6.4, 6.8)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    entries = _scene(panel, pursuit)
    panel.set_aspect("equal")
    _limits(panel, pursuit)
    head(figure, spaced(name))
    count = len(pursuit.times_s)
    animate(figure, path, count, lambda step: _frame(panel, pursuit, step), list(entries.values()))


def _frame(panel: Panel, pursuit: Pursuit, step: int) -> list[Artist]:
    """Draw positions and paths up to one step, and the records in use."""
    now_s = float(pursuit.times_s[step])
    drawn: list[Artist] = []
    for label, colour, marker, paths in (
        ("pursuer", BLUE, "s", pursuit.pursuers),
        ("evader", VERMILLION, "o", pursuit.evaders_m),
    ):
        for path in paths:
            look = {"color": colour, "marker": marker, "markersize": 7.0, "markevery": [-1]}
            drawn += panel.plot(*path[: step + 1, :2].T, linewidth=1.2, label=label, **look)
    ages: list[float] = []
    for number in range(len(pursuit.pursuers)):
        use = _in_use(pursuit, number, now_s)
        if use is None:
            continue
        around = use.record.reported_m[:, None] + use.record.error_m * UNIT_CIRCLE
        drawn += panel.plot(*around, color=ORANGE, linewidth=1.6, label="reported position")
        look = {"color": VERMILLION, "marker": "x", "linestyle": "none", "markersize": 7.0}
        drawn += panel.plot(*use.sampled_m[:, None], label="position when sampled", **look)
        ages.append(now_s - use.record.sampled_s)
    age = f"record {max(ages):.1f} s old" if ages else "no record yet"
    return [frame_title(panel, f"t = {now_s:.1f} s, {age}"), *drawn]


def _in_use(pursuit: Pursuit, pursuer: int, now_s: float) -> Use | None:
    own = [use for use in pursuit.uses if use.pursuer == pursuer and use.time_s <= now_s]
    return own[-1] if own else None


def _scene(panel: Panel, pursuit: Pursuit) -> dict[str, Artist]:
    """Obstacles and bounds; legend entries."""
    from matplotlib.collections import PolyCollection

    entries: dict[str, Artist] = {}
    arena = pursuit.scene.arena
    if arena.obstacles is not None:
        rings = [shapely.get_coordinates(each.exterior) for each in arena.obstacles.polygons]
        layer = PolyCollection(
            rings, facecolors=OBSTACLE, edgecolors=OBSTACLE_EDGE, label="obstacle"
        )
        panel.add_collection(layer)
        entries["obstacle"] = layer
    if arena.bounds_m is not None:
        x0, y0, x1, y1 = arena.bounds_m
        panel.plot([x0, x1, x1, x0, x0], [y0, y0, y1, y1, y0], color=OBSTACLE_EDGE, linewidth=0.8)
    dress(panel, "", "x [m]", "y [m]")
    return entries


def _limits(panel: Panel, pursuit: Pursuit) -> None:
    """A square around everything that will be shown."""
    bounds = pursuit.scene.arena.bounds_m
    shown = [
        *(states[:, :2] for states in pursuit.pursuers),
        *pursuit.evaders_m,
        *(use.record.reported_m[None] for use in pursuit.uses),
        *(() if bounds is None else (np.reshape(bounds, (2, 2)),)),
    ]
    places = np.vstack(shown)
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    half_m = 0.53 * float(np.ptp(places, axis=0).max()) + pursuit.scene.capture_radius_m
    panel.set_xlim(float(middle[0]) - half_m, float(middle[0]) + half_m)
    panel.set_ylim(float(middle[1]) - half_m, float(middle[1]) + half_m)


def _captures(panel: Panel, pursuit: Pursuit, entries: dict[str, Artist]) -> None:
    for places, caught_s in zip(pursuit.evaders_m, pursuit.capture_s.tolist(), strict=True):
        if np.isfinite(caught_s):
            around = places[-1][:, None] + pursuit.scene.capture_radius_m * UNIT_CIRCLE
            entries["capture"] = panel.plot(
                around[0],
                around[1],
                color=BLACK,
                linewidth=1.0,
                linestyle="--",
                label="capture radius",
            )[0]


def _knowledge(ages: Panel, distances: Panel, pursuit: Pursuit) -> None:
    """Age of the record in use and distance over time, a line a pursuer."""
    times_s = pursuit.times_s
    for number, states in enumerate(pursuit.pursuers):
        colour = SERIES[number % len(SERIES)]
        own = [use for use in pursuit.uses if use.pursuer == number]
        if own:
            begun = np.array([use.time_s for use in own])
            sampled = np.array([use.record.sampled_s for use in own])
            held = np.searchsorted(begun, times_s, side="right") - 1
            known = held >= 0
            ages.plot(times_s[known], (times_s - sampled[held])[known], color=colour, linewidth=1.4)
        after = np.append(pursuit.chased[number], pursuit.chased[number][-1:])
        if len(after) and (after >= 0).all():
            evader = pursuit.evaders_m[after, np.arange(len(times_s))]
            apart_m = np.linalg.norm(states[:, :2] - evader, axis=1)
            distances.plot(times_s, apart_m, color=colour, linewidth=1.4)
    distances.axhline(pursuit.scene.capture_radius_m, color=BLACK, linestyle="--", linewidth=1.0)
    ages.set_ylim(0.0, None)
    distances.set_ylim(0.0, None)
    dress(ages, "age of the record in use", "time [s]", "age [s]")
    dress(distances, "true distance to the evader (dashed: capture)", "time [s]", "distance [m]")


def _outcome(pursuit: Pursuit) -> str:
    if pursuit.outcome == "captured":
        return f"captured after {pursuit.capture_time_s:.1f} s"
    return f"not captured in {pursuit.times_s[-1]:.1f} s"
