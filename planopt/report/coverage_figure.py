"""Pictures of networks: cells, paths, radio links, teams at events, cost over time, animation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from planopt.coverage.control.radio import radio_tree
from planopt.coverage.events import Event
from planopt.coverage.ground import Ground
from planopt.coverage.limits import RadioLimits
from planopt.coverage.simulation import ABSENT, NetworkRun
from planopt.report.animation import animate
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    BLUE,
    GREEN,
    OBSTACLE,
    OBSTACLE_EDGE,
    ORANGE,
    PURPLE,
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


CELL = "#9a9a9a"
"""Colour of borders between cells."""

EVENT_SHADE = 0.12

LINK: dict[str, Any] = {"colors": GREEN, "linewidths": 1.7, "zorder": 2.5, "label": "radio link"}
"""Links of the radio tree."""

UNLINKED: dict[str, Any] = {"color": PURPLE, "marker": "x", "label": "no connection"}
"""Agents without a way to a station that holds with probability `p_min`."""


@dataclass(frozen=True, eq=False)
class NetworkPicture:
    """The run of a network that is drawn, and what it ran on."""

    name: str  # Of the problem
    run: NetworkRun  # What happened on what
    ground: Ground
    obstacles: tuple[shapely.Polygon, ...]  # Areas that agents may not enter
    events: tuple[Event, ...]  # What appeared
    # Links to base stations that agents are to keep; None for none
    radio: RadioLimits | None = None

    def links(self, step: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the links ``(e, 2, 2)`` of the radio tree in a step, and who has none ``(u, 2)``.

        The tree is that of the places in the step. An agent has none if every way to a station
        fails with more than the allowed probability.
        """
        here = self.run.positions_m[step, self.run.states[step] != ABSENT]
        if self.radio is None:
            return np.zeros((0, 2, 2)), np.zeros((0, 2))
        tree = radio_tree(here, self.radio)
        # Station k is parent -1 - k: the stations in reverse order follow the agents.
        ends = np.concatenate((here, self.radio.stations_m[::-1]))[tree.parent]
        return np.stack((here, ends), axis=1)[tree.connected], here[~tree.connected]

    @property
    def busiest(self) -> int:
        """The last step with an event in which most agents respond; 0 without events."""
        times_s = self.run.times_s[:-1].tolist()
        there = np.array([any(e.is_there(t) for e in self.events) for t in times_s])
        team = np.where(there, (self.run.states >= 0).sum(axis=1), 0)
        return int(len(team) - 1 - team[::-1].argmax()) if team.any() else 0


def draw_network(picture: NetworkPicture) -> Figure:
    """Draw where a network was when most agents responded and at its end, and what it cost."""
    from matplotlib.gridspec import GridSpec

    figure, run = new_figure(12.0, 8.2), picture.run
    eventful = bool(picture.events)
    columns = 6
    grid = GridSpec(2, columns, figure=figure, height_ratios=(1.75, 1.0))
    entries: dict[str, Artist] = {}
    steps = (picture.busiest, len(run.costs) - 1)
    for place, step in enumerate(steps):
        panel = add_panel(figure, grid[0, 3 * place : 3 * place + 3])
        words = ("at the start" if step == 0 else "while agents respond", "at the end")[place]
        entries |= _area(panel, picture.ground, picture.obstacles, picture.radio)
        entries |= {str(each.get_label()): each for each in _state(panel, picture, step)}
        _paths(panel, picture, 0 if place == 0 else steps[0], step, entries)
        dress(panel, f"{words}, {run.times_s[step]:g} s", "x [m]", "y [m]", grid=False)
    times_s, each = run.times_s[:-1], columns // (3 if eventful else 2)
    cost = add_panel(figure, grid[1, :each])
    cost.plot(times_s, run.costs, color=BLUE, linewidth=1.6)
    cost.set_yscale("log")
    dress(cost, "coverage cost H", "time [s]", "H [m$^4$ x density]")
    second = add_panel(figure, grid[1, each : 2 * each])
    if eventful:
        _teams(second, picture)
        third = add_panel(figure, grid[1, 2 * each :])
        _errors(third, picture)
        shaded = (cost, second, third)
    else:
        second.plot(times_s, np.maximum(run.residuals_m, 1e-9), color=BLUE, linewidth=1.6)
        second.set_yscale("log")
        dress(second, "largest distance still driven for", "time [s]", "distance [m]")
        shaded = ()
    for panel in shaded:
        _shade(panel, picture)
    legend_below(figure, entries.values(), len(entries))
    head(figure, f"{spaced(picture.name)}: H {run.costs[0]:.4g} to {run.costs[-1]:.4g}")
    return figure


def draw_deployment(
    name: str,
    ground: Ground,
    obstacles: tuple[shapely.Polygon, ...],
    places_m: NDArray[np.float64],
    cost: float,
) -> Figure:
    """Draw where the agents of a network ``(n, 2)`` should end, their cells, and what it costs."""
    from matplotlib.collections import LineCollection
    from matplotlib.gridspec import GridSpec

    figure = new_figure(6.6, 6.4)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    entries = _area(panel, ground, obstacles, None)
    cells = LineCollection(
        list(ground.borders(places_m)), colors=CELL, linewidths=0.7, label="border of a cell"
    )
    panel.add_collection(cells)
    entries["cells"] = cells
    entries["covers"] = panel.scatter(*places_m.T, s=18.0, color=BLUE, zorder=3, label="covers")
    dress(panel, f"coverage cost H {cost:.4g}", "x [m]", "y [m]", grid=False)
    legend_below(figure, entries.values(), len(entries))
    head(figure, spaced(name))
    return figure


def draw_costs(runs: Mapping[str, NetworkRun]) -> Figure:
    """Draw the coverage cost of runs over time, one line for each name."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(7.0, 4.4)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    for number, (name, run) in enumerate(runs.items()):
        # A line that lies on another shows through its dashes.
        style = "-" if number % 2 == 0 else "--"
        colour = SERIES[number % len(SERIES)]
        panel.plot(
            run.times_s[:-1], run.costs, color=colour, linewidth=1.9, linestyle=style, label=name
        )
    panel.set_yscale("log")
    dress(panel, "coverage cost H", "time [s]", "H [m$^4$ x density]")
    legend_inside(panel, "upper right")
    return figure


def draw_step_times(agents: Sequence[int], times_s: Mapping[str, Sequence[float]]) -> Figure:
    """Draw the processor times of a step by the number of agents, one line for each name."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(7.0, 4.4)
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    sizes = np.array(agents, dtype=np.float64)
    for number, (name, times) in enumerate(times_s.items()):
        colour = SERIES[number % len(SERIES)]
        panel.plot(sizes, times, color=colour, linewidth=1.6, marker="o", markersize=4, label=name)
    panel.set_xscale("log")
    panel.set_yscale("log")
    dress(panel, "a step of the network", "agents", "processor time [s]")
    legend_inside(panel, "upper left")
    return figure


def animate_network(picture: NetworkPicture, path: Path) -> None:
    """Write a GIF of a run: agents, their cells, radio links, events and responders."""
    from matplotlib.gridspec import GridSpec

    figure, run = new_figure(6.6, 6.8), picture.run
    panel = add_panel(figure, GridSpec(1, 1, figure=figure)[0, 0])
    entries = _area(panel, picture.ground, picture.obstacles, picture.radio)
    dress(panel, "", "x [m]", "y [m]", grid=False)
    head(figure, spaced(picture.name))

    def draw_frame(step: int) -> list[Artist]:
        words = f"t = {run.times_s[step]:g} s, H = {run.costs[step]:.4g}"
        return [frame_title(panel, words), *_state(panel, picture, step)]

    animate(figure, path, len(run.costs), draw_frame, list(entries.values()))


def _area(
    panel: Panel,
    ground: Ground,
    obstacles: tuple[shapely.Polygon, ...],
    radio: RadioLimits | None,
) -> dict[str, Artist]:
    """The region's outline and obstacles; legend entries."""
    from matplotlib.collections import PolyCollection

    ring = shapely.get_coordinates(ground.free.exterior)
    panel.plot(ring[:, 0], ring[:, 1], color=OBSTACLE_EDGE, linewidth=1.0)
    panel.set_aspect("equal")
    entries: dict[str, Artist] = {}
    if obstacles:
        rings = [shapely.get_coordinates(each.exterior) for each in obstacles]
        layer = PolyCollection(
            rings, facecolors=OBSTACLE, edgecolors=OBSTACLE_EDGE, label="obstacle"
        )
        panel.add_collection(layer)
        entries["obstacle"] = layer
    if radio is not None:
        x, y = radio.stations_m.T
        look = {"color": ORANGE, "edgecolors": BLACK, "linewidths": 1.0, "label": "base station"}
        entries["station"] = panel.scatter(x, y, s=90.0, marker="^", zorder=6, **look)
    return entries


def _state(panel: Panel, picture: NetworkPicture, step: int) -> list[Artist]:
    """Draw cells, radio links, agents, events and estimates of one step."""
    from matplotlib.collections import LineCollection

    run = picture.run
    here, states = run.positions_m[step], run.states[step]
    borders = list(picture.ground.borders(here[states != ABSENT]))
    cells = LineCollection(borders, colors=CELL, linewidths=0.7, label="border of a cell")
    panel.add_collection(cells)
    drawn: list[Artist] = [cells]
    links, lonely = picture.links(step)
    if len(links):
        tree = LineCollection(list(links), **LINK)
        panel.add_collection(tree)
        drawn.append(tree)
    if len(lonely):
        drawn.append(panel.scatter(*lonely.T, s=45.0, zorder=4, **UNLINKED))
    looks = (
        ("covers", states == -1, BLUE, "o", 18.0),
        ("responds", states >= 0, ORANGE, "o", 30.0),
        ("absent", states == ABSENT, CELL, "x", 20.0),
    )
    for label, which, colour, marker, size in looks:
        if which.any():
            look = {"s": size, "color": colour, "marker": marker, "zorder": 3, "label": label}
            drawn.append(panel.scatter(*here[which].T, **look))
    time_s = float(run.times_s[step])
    for number, event in enumerate(picture.events):
        if event.is_there(time_s):
            x, y = event.place_at(time_s).tolist()
            look = {"s": 170.0, "color": VERMILLION, "marker": "*", "zorder": 4, "label": "event"}
            drawn.append(panel.scatter([x], [y], **look))
        guess = run.estimates_m[step, number]
        if np.isfinite(guess).all():
            look = {"s": 110.0, "color": BLACK, "marker": "+", "zorder": 5, "label": "estimate"}
            drawn.append(panel.scatter(guess[:1], guess[1:], **look))
    return drawn


def _paths(
    panel: Panel, picture: NetworkPicture, begin: int, end: int, entries: dict[str, Artist]
) -> None:
    """The paths between two steps, those of agents that respond at either end in their colour."""
    from matplotlib.collections import LineCollection

    run = picture.run
    if end <= begin:
        return
    paths = run.positions_m[begin : end + 1].transpose(1, 0, 2)
    responds = (run.states[begin] >= 0) | (run.states[end] >= 0)
    colours = list(np.where(responds, ORANGE, BLUE))
    layer = LineCollection(
        list(paths), colors=colours, linewidths=0.9, alpha=0.55, label="path so far"
    )
    panel.add_collection(layer)
    entries["path"] = layer


def _teams(panel: Panel, picture: NetworkPicture) -> None:
    """Draw how many agents respond to each event, and how many it asks for."""
    run, times_s = picture.run, picture.run.times_s[:-1]
    for number, event in enumerate(picture.events):
        colour = SERIES[number % len(SERIES)]
        responding = (run.states == number).sum(axis=1).astype(np.float64)
        wanted = run.wanted[:, number].astype(np.float64)
        panel.plot(times_s, responding, color=colour, linewidth=1.8, label=event.name)
        panel.plot(times_s, wanted, color=colour, linewidth=1.0, linestyle="--")
    panel.set_ylim(0.0, None)
    dress(panel, "agents that respond (dashed: wanted)", "time [s]", "agents")
    if len(picture.events) > 1:
        legend_inside(panel, "upper right")


def _errors(panel: Panel, picture: NetworkPicture) -> None:
    """Draw the errors of the estimated places, and what the agents think."""
    run, times_s = picture.run, picture.run.times_s[:-1]
    for number, event in enumerate(picture.events):
        colour = SERIES[number % len(SERIES)]
        places = np.array([event.place_at(each) for each in times_s.tolist()])
        error_m = np.linalg.norm(run.estimates_m[:, number] - places, axis=1)
        panel.plot(times_s, error_m, color=colour, linewidth=1.6)
        std_m = np.where(np.isfinite(run.stds_m[:, number]), run.stds_m[:, number], np.nan)
        panel.plot(times_s, std_m, color=colour, linewidth=1.0, linestyle="--")
    if np.isfinite(run.estimates_m).any():
        panel.set_yscale("log")
    panel.set_xlim(float(times_s[0]), float(times_s[-1]))
    dress(panel, "error of the estimate (dashed: its std)", "time [s]", "distance [m]")


def _shade(panel: Panel, picture: NetworkPicture) -> None:
    """Shade the times when events are there."""
    last_s = float(picture.run.times_s[-1])
    for number, event in enumerate(picture.events):
        colour = SERIES[number % len(SERIES)]
        if event.appears_s < last_s:
            end_s = min(event.ends_s, last_s)
            panel.axvspan(event.appears_s, end_s, color=colour, alpha=EVENT_SHADE, linewidth=0.0)
