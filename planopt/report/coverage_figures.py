"""Figures and animation of networks: cells, paths, radio links, event response, cost over time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from planopt.arrays import Floats
from planopt.coverage.control.radio import radio_tree
from planopt.coverage.events import Event
from planopt.coverage.geodesic import Ground
from planopt.coverage.limits import RadioLimits
from planopt.coverage.simulation import ABSENT, NetworkRun
from planopt.report.animation import animate
from planopt.report.maps import X_LABEL, Y_LABEL, draw_lines, draw_polygons, draw_sites
from planopt.report.panel import (
    BLACK,
    BLUE,
    GREEN,
    OBSTACLE_EDGE,
    ORANGE,
    PURPLE,
    TIME,
    VERMILLION,
    Panel,
    colour_of,
    dress,
    frame_title,
    head,
    legend_below,
    legend_inside,
    log_scale,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

CELL = "#9a9a9a"
"""Colour of boundaries between cells."""
EVENT_SHADE = 0.12  # Opacity of the shading of events

COST = "H [m$^4$ x density]"


@dataclass(frozen=True, eq=False)
class NetworkPicture:
    """Data from which a network's run is drawn: the run, its ground, obstacles and events."""

    name: str  # Name of the problem
    run: NetworkRun
    ground: Ground
    obstacles: tuple[shapely.Polygon, ...]  # Areas forbidden to agents
    events: tuple[Event, ...]
    radio: RadioLimits | None = None  # Required links to base stations, if any

    def links(self, step: int) -> tuple[Floats, Floats]:
        """Return the links (e, 2, 2) of the radio tree in a step, and unlinked agents (u, 2)."""
        here = self.run.positions_m[step, self.run.states[step] != ABSENT]
        if self.radio is None:
            return np.zeros((0, 2, 2)), np.zeros((0, 2))
        tree = radio_tree(here, self.radio)
        # Station k is parent -1 - k, so the stations follow the agents in reverse order.
        ends = np.concatenate((here, self.radio.stations_m[::-1]))[tree.parent]
        return np.stack((here, ends), axis=1)[tree.connected], here[~tree.connected]

    @property
    def busiest(self) -> int:
        """Return the last step at which most agents respond to events; 0 without events."""
        times_s = self.run.times_s[:-1].tolist()
        there = np.array([any(e.is_there(t) for e in self.events) for t in times_s])
        team = np.where(there, (self.run.states >= 0).sum(axis=1), 0)
        return int(len(team) - 1 - team[::-1].argmax()) if team.any() else 0


def draw_network(picture: NetworkPicture) -> Figure:
    """Draw a network at peak response and at the end of the run, and the cost over time."""
    run, eventful = picture.run, bool(picture.events)
    rows = ["AAABBB", "CCDDEE" if eventful else "CCCDDD"]
    figure, panels = new_figure(12.0, 8.2, rows, height_ratios=(1.75, 1.0))
    busiest, last = picture.busiest, len(run.costs) - 1
    entries: list[Artist] = []
    for panel, begin, step, words in (
        (panels[0], 0, busiest, "while agents respond" if busiest else "at the start"),
        (panels[1], busiest, last, "at the end"),
    ):
        entries += _draw_area(panel, picture.ground, picture.obstacles, picture.radio)
        entries += _draw_state(panel, picture, step)
        if begin < step:
            paths = run.positions_m[begin : step + 1].transpose(1, 0, 2)
            responds = (run.states[begin] >= 0) | (run.states[step] >= 0)
            look = {"linewidths": 0.9, "alpha": 0.55, "zorder": 2.0, "label": "path"}
            look["colors"] = np.where(responds, ORANGE, BLUE).tolist()
            entries.append(draw_lines(panel, list(paths), **look))
        dress(panel, f"{words}, {run.times_s[step]:g} s", X_LABEL, Y_LABEL, grid=False)
    panels[2].plot(run.times_s[:-1], run.costs, color=BLUE, linewidth=1.6)
    log_scale(panels[2], "y")
    dress(panels[2], "coverage cost H", TIME, COST)
    if eventful:
        _draw_response(panels[3], panels[4], picture)
        for panel in panels[2:]:
            _shade_events(panel, picture)
    else:
        panels[3].plot(run.times_s[:-1], np.maximum(run.residuals_m, 1e-9), color=BLUE)
        log_scale(panels[3], "y")
        dress(panels[3], "largest distance to an agent's target", TIME, "distance [m]")
    legend_below(figure, entries, 10)
    head(figure, f"{picture.name}: coverage cost {run.costs[0]:.4g} to {run.costs[-1]:.4g}")
    return figure


def draw_deployment(
    name: str,
    ground: Ground,
    obstacles: tuple[shapely.Polygon, ...],
    places_m: Floats,  # (n, 2)
    cost: float,
) -> Figure:
    """Draw the best final positions of a network's agents, their cells, and the cost."""
    figure, (panel,) = new_figure(6.6, 6.4)
    entries = _draw_area(panel, ground, obstacles, None)
    entries.append(_draw_cells(panel, ground, places_m))
    entries.append(panel.scatter(*places_m.T, s=18.0, color=BLUE, zorder=3, label="covering agent"))
    dress(panel, f"coverage cost H {cost:.4g}", X_LABEL, Y_LABEL, grid=False)
    legend_below(figure, entries, 3)
    head(figure, name)
    return figure


def animate_network(picture: NetworkPicture, path: Path) -> None:
    """Write a GIF of a run: agents, cells, links, events, responders, and curves over time.

    The curves next to the map show coverage cost, messages per step and responding agents.
    """
    run, eventful = picture.run, bool(picture.events)
    times_s, sent = run.times_s[:-1], run.messages.sum(axis=1)
    rows = ["AAB", "AAC", "AAD"] if eventful else ["AAB", "AAC"] if sent.any() else ["AAB"]
    figure, (panel, *others) = new_figure(11.0, 7.2, rows)
    entries = _draw_area(panel, picture.ground, picture.obstacles, picture.radio)
    dress(panel, "", X_LABEL, Y_LABEL, grid=False)
    head(figure, picture.name)
    curves = [(run.costs, "coverage cost H", COST), (sent, "messages in a step", "messages [1]")]
    curves.append(((run.states >= 0).sum(axis=1), "responding agents", "agents [1]"))
    for other, (values, title, label) in zip(others, curves, strict=False):
        other.plot(times_s, values, color=CELL, linewidth=1.0)
        if values is run.costs:
            log_scale(other, "y")
        else:
            other.set_ylim(0.0, None)
        if eventful:
            _shade_events(other, picture)
        dress(other, title, TIME, label)

    def draw_frame(step: int) -> list[Artist]:
        words = f"t = {run.times_s[step]:g} s, H = {run.costs[step]:.4g}"
        drawn = [frame_title(panel, words), *_draw_state(panel, picture, step)]
        for other, (values, _, _) in zip(others, curves, strict=False):
            so_far = slice(step + 1)
            look = {"color": BLUE, "linewidth": 1.8, "marker": "o", "markevery": [-1]}
            drawn += other.plot(times_s[so_far], values[so_far], **look)
        return drawn

    animate(figure, path, len(run.costs), draw_frame, entries)


def _draw_area(
    panel: Panel, ground: Ground, obstacles: tuple[shapely.Polygon, ...], radio: RadioLimits | None
) -> list[Artist]:
    """Draw the outline of the region, obstacles and base stations; return legend entries."""
    ring = shapely.get_coordinates(ground.free.exterior)
    panel.plot(*ring.T, color=OBSTACLE_EDGE, linewidth=1.0)
    panel.set_aspect("equal")
    entries: list[Artist] = []
    if obstacles:
        entries.append(draw_polygons(panel, obstacles, "obstacle", linewidths=1.0))
    if radio is not None:
        entries.append(draw_sites(panel, radio.stations_m, "base station"))
    return entries


def _draw_cells(panel: Panel, ground: Ground, places_m: Floats) -> Artist:
    look = {"colors": CELL, "linewidths": 0.7, "zorder": 2.0, "label": "cell boundary"}
    return draw_lines(panel, list(ground.borders(places_m)), **look)


def _draw_state(panel: Panel, picture: NetworkPicture, step: int) -> list[Artist]:
    """Draw cells, radio links, agents, events and estimates of one step."""
    run = picture.run
    here, states, time_s = run.positions_m[step], run.states[step], float(run.times_s[step])
    drawn = [_draw_cells(panel, picture.ground, here[states != ABSENT])]
    links, unlinked = picture.links(step)
    if len(links):
        look = {"colors": GREEN, "linewidths": 1.7, "zorder": 2.5, "label": "radio link"}
        drawn.append(draw_lines(panel, list(links), **look))
    places = [event.place_at(time_s) for event in picture.events if event.is_there(time_s)]
    estimates = run.estimates_m[step]
    for label, positions, colour, marker, size in (
        ("disconnected agent", unlinked, PURPLE, "x", 45.0),
        ("covering agent", here[states == -1], BLUE, "o", 18.0),
        ("responding agent", here[states >= 0], ORANGE, "o", 30.0),
        ("absent agent", here[states == ABSENT], CELL, "x", 20.0),
        ("event", np.array(places).reshape(-1, 2), VERMILLION, "*", 170.0),
        ("estimate", estimates[np.isfinite(estimates).all(axis=1)], BLACK, "+", 110.0),
    ):
        if len(positions):
            look = {"s": size, "color": colour, "marker": marker, "zorder": 4.0 - size / 200.0}
            drawn.append(panel.scatter(*positions.T, label=label, **look))
    return drawn


def _draw_response(teams: Panel, errors: Panel, picture: NetworkPicture) -> None:
    """Draw the responding agents of each event, and the error of its estimated position."""
    run, times_s = picture.run, picture.run.times_s[:-1]
    for number, event in enumerate(picture.events):
        strong = {"color": colour_of(number), "linewidth": 1.7}
        dashed = {"color": colour_of(number), "linewidth": 1.0, "linestyle": "--"}
        teams.plot(times_s, (run.states == number).sum(axis=1), label=event.name, **strong)
        teams.plot(times_s, run.wanted[:, number], **dashed)
        places = np.array([event.place_at(each) for each in times_s.tolist()])
        errors.plot(times_s, np.linalg.norm(run.estimates_m[:, number] - places, axis=1), **strong)
        std_m = run.stds_m[:, number]
        errors.plot(times_s, np.where(np.isfinite(std_m), std_m, np.nan), **dashed)
    teams.set_ylim(0.0, None)
    dress(teams, "responding agents (dashed: required)", TIME, "agents [1]")
    if len(picture.events) > 1:
        legend_inside(teams, "upper right")
    if np.isfinite(run.estimates_m).any():
        log_scale(errors, "y")
    errors.set_xlim(float(times_s[0]), float(times_s[-1]))
    dress(errors, "error (dashed: standard deviation)", TIME, "estimation error [m]")


def _shade_events(panel: Panel, picture: NetworkPicture) -> None:
    """Shade the durations of events."""
    last_s = float(picture.run.times_s[-1])
    for number, event in enumerate(picture.events):
        if event.appears_s < last_s:
            look = {"color": colour_of(number), "alpha": EVENT_SHADE, "linewidth": 0.0}
            panel.axvspan(event.appears_s, min(event.ends_s, last_s), **look)
