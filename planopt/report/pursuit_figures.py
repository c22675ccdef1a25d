"""Figures of pursuits: paths, age of records, animation, and design of the network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.pursuit.design import DesignTask
from planopt.pursuit.simulation import Pursuit, Use
from planopt.report.animation import animate
from planopt.report.maps import X_LABEL, Y_LABEL, draw_polygons, rectangle, show_bounds
from planopt.report.panel import (
    BLACK,
    BLUE,
    OBSTACLE_EDGE,
    ORANGE,
    TIME,
    VERMILLION,
    Panel,
    colour_of,
    curve_look,
    dress,
    frame_title,
    head,
    legend_below,
    legend_inside,
    new_figure,
    spaced,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

ANGLES = np.linspace(0.0, 2.0 * np.pi, 49)
UNIT_CIRCLE = np.array([np.cos(ANGLES), np.sin(ANGLES)])

QUANTITIES = {
    "evader_speed_m_s": "evader's speed",
    "pursuer_speed_m_s": "pursuer's speed",
    "bit_rate_bit_s": "bit rate",
    "header_bits": "header",
    "record_bits": "record",
    "mote_spacing_m": "mote spacing",
}
"""Labels of the quantities in the sensitivities of a design."""

CURVES = 5  # Number of power curves, one for each of the numbers of bits with the cheapest designs


def draw_pursuit(name: str, pursuit: Pursuit) -> Figure:
    """Draw the paths, the age of the records in use, and the distances to the evaders."""
    figure, (plane, ages, distances) = new_figure(12.0, 6.4, ["AB", "AC"], width_ratios=(1.5, 1.0))
    entries = _draw_scene(plane, pursuit)
    # An almost straight flight must fill the panel as well.
    plane.set_aspect("equal", adjustable="datalim")
    radius_m = pursuit.scene.capture_radius_m
    for label, paths, colour, marker in (
        ("pursuer", pursuit.pursuers, BLUE, "s"),
        ("evader", pursuit.evaders_m, VERMILLION, "o"),
    ):
        look = {"color": colour, "marker": marker, "markersize": 6.0, "markevery": [0]}
        for path in paths:
            entries += plane.plot(*path[:, :2].T, linewidth=1.5, label=label, **look)
    reported = np.array([use.record.reported_m for use in pursuit.uses]).reshape(-1, 2)
    if len(reported):
        look = {"s": 16.0, "color": ORANGE, "zorder": 3, "label": "reported position"}
        entries.append(plane.scatter(*reported.T, **look))
    for places in pursuit.evaders_m[np.isfinite(pursuit.capture_s)]:
        around = places[-1][:, None] + radius_m * UNIT_CIRCLE
        look = {"color": BLACK, "linewidth": 1.0, "linestyle": "--", "label": "capture radius"}
        entries += plane.plot(*around, **look)
    for number in range(len(pursuit.pursuers)):
        _draw_record(ages, distances, pursuit, number)
    distances.axhline(radius_m, color=BLACK, linestyle="--", linewidth=1.0)
    ages.set_ylim(0.0, None)
    distances.set_ylim(0.0, None)
    dress(ages, "age of the record in use", TIME, "age [s]")
    dress(distances, "true distance (dashed: capture radius)", TIME, "distance [m]")
    legend_below(figure, entries, 5)
    outcome = f"not captured in {pursuit.times_s[-1]:.1f} s"
    if pursuit.outcome == "captured":
        outcome = f"captured after {pursuit.capture_time_s:.1f} s"
    head(figure, f"{name}: {outcome}")
    return figure


def _draw_record(ages: Panel, distances: Panel, pursuit: Pursuit, number: int) -> None:
    """Draw the age of one pursuer's record in use, and its distance to the evader, over time."""
    times_s, look = pursuit.times_s, {"color": colour_of(number), "linewidth": 1.4}
    own = [use for use in pursuit.uses if use.pursuer == number]
    if own:
        begun = np.array([use.time_s for use in own])
        sampled = np.array([use.record.sampled_s for use in own])
        held = np.searchsorted(begun, times_s, side="right") - 1
        known = held >= 0
        ages.plot(times_s[known], (times_s - sampled[held])[known], **look)
    chased = np.append(pursuit.chased[number], pursuit.chased[number][-1:])
    if len(chased) and (chased >= 0).all():
        evader = pursuit.evaders_m[chased, np.arange(len(times_s))]
        apart_m = np.linalg.norm(pursuit.pursuers[number][:, :2] - evader, axis=1)
        distances.plot(times_s, apart_m, **look)


def animate_pursuit(name: str, pursuit: Pursuit, path: Path) -> None:
    """Write a GIF of a pursuit: positions, paths, and the record that each pursuer uses."""
    figure, (panel,) = new_figure(6.4, 6.8)
    entries = _draw_scene(panel, pursuit)
    panel.set_aspect("equal")
    bounds = pursuit.scene.arena.bounds_m
    shown = [
        *(states[:, :2] for states in pursuit.pursuers),
        *pursuit.evaders_m,
        *(use.record.reported_m[None] for use in pursuit.uses),
        *(() if bounds is None else (np.reshape(bounds, (2, 2)),)),
    ]
    low, high = np.vstack(shown).min(axis=0), np.vstack(shown).max(axis=0)
    half_m = 0.53 * float((high - low).max()) + pursuit.scene.capture_radius_m
    x, y = (0.5 * (low + high)).tolist()
    show_bounds(panel, (x - half_m, y - half_m, x + half_m, y + half_m))
    head(figure, name)
    count = len(pursuit.times_s)
    animate(figure, path, count, lambda step: _draw_frame(panel, pursuit, step), entries)


def _draw_frame(panel: Panel, pursuit: Pursuit, step: int) -> list[Artist]:
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
    begun = [use for use in pursuit.uses if use.time_s <= now_s]
    in_use: dict[int, Use] = {use.pursuer: use for use in begun}  # The latest of each pursuer
    for use in in_use.values():
        around = use.record.reported_m[:, None] + use.record.error_m * UNIT_CIRCLE
        drawn += panel.plot(*around, color=ORANGE, linewidth=1.6, label="reported position")
        look = {"color": VERMILLION, "marker": "x", "linestyle": "none", "markersize": 7.0}
        drawn += panel.plot(*use.sampled_m[:, None], label="position when sampled", **look)
    ages = [now_s - use.record.sampled_s for use in in_use.values()]
    age = f"record {max(ages):.1f} s old" if ages else "no record yet"
    return [frame_title(panel, f"t = {now_s:.1f} s, {age}"), *drawn]


def _draw_scene(panel: Panel, pursuit: Pursuit) -> list[Artist]:
    """Draw obstacles and bounds; return legend entries."""
    arena = pursuit.scene.arena
    dress(panel, "", X_LABEL, Y_LABEL)
    if arena.bounds_m is not None:
        panel.plot(*rectangle(arena.bounds_m), color=OBSTACLE_EDGE, linewidth=0.8)
    if arena.obstacles is None:
        return []
    return [draw_polygons(panel, list(arena.obstacles.polygons), "obstacle", linewidths=1.0)]


def draw_design(task: DesignTask, data: Mapping[str, Any]) -> Figure:
    """Draw the solution of a design problem: power, sensitivities, and energy over time."""
    front = data["pareto"]
    figure, panels = new_figure(13.0, 4.6, ["ABC"] if front else ["AB"])
    _draw_power(panels[0], task, data)
    found = sorted(data["sensitivities"].items(), key=lambda item: abs(item[1]))
    places = np.arange(len(found), dtype=np.float64)
    colours = [VERMILLION if value > 0.0 else BLUE for _, value in found]
    panels[1].barh(places, [value for _, value in found], height=0.5, color=colours)
    panels[1].axvline(0.0, color=BLACK, linewidth=0.8)
    panels[1].set_yticks(places, [QUANTITIES[name] for name, _ in found])
    what = "energy" if data["objective_name"] == "energy_per_capture_j" else "power"
    dress(panels[1], "effect of a 1 % increase", f"change of the minimum {what} [%]", "")
    if front:
        times_s = [row["capture_time_s"] for row in front]
        energies_j = [row["energy_per_capture_j"] for row in front]
        panels[2].plot(times_s, energies_j, **{**curve_look(0), "markersize": 4.0})
        words = "maximum time to capture [s]", "energy per capture [J]"
        dress(panels[2], "energy against capture time (Lemma III.3)", *words)
    binding = spaced(" and ".join(data["binding"])) or "none"
    head(figure, f"{data['problem']}: {data['cost_w']:.4g} W, active constraint: {binding}")
    return figure


def _draw_power(panel: Panel, task: DesignTask, data: Mapping[str, Any]) -> None:
    """Draw power over slot width, up to the widest feasible slot, for each number of bits."""
    rows = [row for row in data["cost_curve"] if row["objective"] is not None]
    least = sorted(rows, key=lambda row: row["objective"])[:CURVES]
    for number, row in enumerate(sorted(least, key=lambda row: row["bits_per_axis"])):
        bits, widest_s = row["bits_per_axis"], row["slot_width_s"]
        first_s = max(0.4 * widest_s, min(task.network.least_slot_s(bits), widest_s))
        slots_s = np.linspace(first_s, widest_s, 60, dtype=np.float64)
        powers = [task.network.power_w(s, bits, data["rate_divisor"]) for s in slots_s.tolist()]
        look = {**curve_look(number), "marker": "o", "markevery": [-1], "label": f"{bits} bits"}
        panel.plot(1e3 * slots_s, powers, **look)
    look = {"color": BLACK, "marker": "*", "markersize": 14.0, "linestyle": "none"}
    panel.plot([1e3 * data["slot_width_s"]], [data["cost_w"]], label="chosen", **look)
    dress(panel, "power against slot width", "slot width [ms]", "power [W]")
    legend_inside(panel)
