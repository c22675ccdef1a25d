"""The part of the workspace that a map shows, and the inset that locates it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.problems.problem import Problem
from planopt.report.grid import Bounds
from planopt.report.maps import draw_ground, draw_places, rectangle
from planopt.report.panel import Panel
from planopt.report.style import PREDICTED

WINDOW_MARGIN = 0.3
"""Margin around the shown positions, as a share of their extent."""

BORDER = 0.05
"""Margin beyond positions and workspace bounds, as a share of the window's side."""

EDGE_MARGIN = 0.02
"""Margin around the whole workspace, as a share of its longer side."""

MIN_WINDOW_STEPS = 10.0
"""Least side of a window, in longest steps of a robot."""

INSET = 0.3
"""Side of the inset as a share of the map's."""

INSET_BELOW = 0.6
"""A window wider than this share of the workspace has no inset."""


def window_about(problem: Problem, positions_m: NDArray[np.float64]) -> Bounds:
    """Return a square around positions (n, 2), shifted into the workspace as far as it fits."""
    low, high = positions_m.min(axis=0), positions_m.max(axis=0)
    side = max(
        float((high - low).max()) * (1.0 + 2.0 * WINDOW_MARGIN),
        MIN_WINDOW_STEPS * problem.step_length_m,
    )
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    x = _window_begin(float(low[0]), float(high[0]), side, x_min, x_max)
    y = _window_begin(float(low[1]), float(high[1]), side, y_min, y_max)
    return x, y, x + side, y + side


def _window_begin(low: float, high: float, side: float, first: float, last: float) -> float:
    """Return where a window around `low` to `high` begins, within `first` to `last`."""
    margin = BORDER * side
    begin = (low + high - side) / 2.0
    if last - first + 2.0 * margin <= side:
        begin = (first + last - side) / 2.0
    else:
        begin = min(max(begin, first - margin), last + margin - side)
    # Positions outside the bounds, such as base stations, stay visible.
    return min(max(begin, high + margin - side), low - margin)


def map_window(problem: Problem, positions_m: NDArray[np.float64]) -> Bounds:
    """Return the window around positions and stations; the whole workspace if that is not larger.

    Problems about the channel itself show the whole workspace.
    """
    x_min, y_min, x_max, y_max = problem.workspace.bounds_m
    margin = EDGE_MARGIN * max(x_max - x_min, y_max - y_min)
    whole = (x_min - margin, y_min - margin, x_max + margin, y_max + margin)
    if problem.task in ("learn", "map"):
        return whole
    stations = [radio.site.position_m for radio in problem.stations]
    window = window_about(problem, np.vstack([positions_m, np.array(stations)]))
    return window if is_small(problem, window) else whole


def is_small(problem: Problem, window: Bounds) -> bool:
    """Return whether a window shows so little of the workspace that it needs an inset."""
    x_min, _, x_max, _ = problem.workspace.bounds_m
    return window[2] - window[0] < INSET_BELOW * (x_max - x_min)


def show_window(
    panel: Panel, problem: Problem, positions_m: NDArray[np.float64], window: Bounds
) -> None:
    """Limit a map to a window; a small one gets an inset of the workspace away from positions."""
    x_min, y_min, x_max, y_max = window
    panel.set_xlim(x_min, x_max)
    panel.set_ylim(y_min, y_max)
    if not is_small(problem, window):
        return
    shares = (positions_m - np.array(window[:2])) / (x_max - x_min)
    corners = [(0.01, 0.01), (0.99 - INSET, 0.01), (0.01, 0.99 - INSET), (0.99 - INSET,) * 2]
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
