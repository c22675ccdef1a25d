"""Figure of a draft: log, map, stations and unknown space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from planopt.problems.draft import Draft
from planopt.report.maps import PATH_Z, PLACE_Z, draw_ground, draw_places, show_bounds
from planopt.report.panel import (
    BLACK,
    LABEL_PT,
    NOTE_PT,
    POWER_MAP,
    SKY,
    VERMILLION,
    WHITE,
    head,
    legend_below,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

PANEL_IN, MAX_SLENDER = 6.0, 1.6
"""Width of a panel in inches, and its maximum aspect ratio."""
MOST_COLUMNS = 3
"""Maximum number of panels in a row."""
MARGIN = 0.05
"""Margin around log, map and stations, as a share of their extent."""


def draw_draft(draft: Draft) -> Figure:
    """Draw the readings of each transmitter over the map, with unknown space and stations.

    Parameters
    ----------
    draft
        Draft of a problem file.
    """
    workspace = draft.problem.workspace
    low, high = np.reshape(workspace.bounds_m, (2, 2))
    shown = np.vstack(
        [
            low,
            high,
            *(each.measurements.positions_m for each in draft.stations),
            *(np.array([each.fit.parameters.station.position_m]) for each in draft.stations),
        ]
    )
    margin = MARGIN * float((shown.max(axis=0) - shown.min(axis=0)).max())
    (x_min, y_min), (x_max, y_max) = shown.min(axis=0) - margin, shown.max(axis=0) + margin
    slender = min(max((y_max - y_min) / (x_max - x_min), 1.0 / MAX_SLENDER), MAX_SLENDER)
    columns = min(len(draft.stations), MOST_COLUMNS)
    count = -(-len(draft.stations) // columns) * columns
    names = [str(number) if number < len(draft.stations) else "." for number in range(count)]
    mosaic = [names[row : row + columns] for row in range(0, count, columns)]
    size = (PANEL_IN * columns + 1.0, PANEL_IN * slender * len(mosaic) + 1.2)
    figure, panels = new_figure(*size, mosaic, maps_only=True)
    power = np.concatenate([each.measurements.power_dbm for each in draft.stations])
    limits = {"vmin": float(power.min()), "vmax": max(float(power.max()), float(power.min()) + 1.0)}
    entries: list[Artist] = []
    for panel, station in zip(panels, draft.stations, strict=True):
        read = station.measurements
        title = f"{station.name}: {len(read)} readings"
        draw_ground(panel, workspace, title)
        if draft.grid is not None:
            entries += _draw_unknown(panel, draft)
        dots = panel.scatter(
            *read.positions_m.T, c=read.power_dbm, cmap=POWER_MAP, s=9.0, zorder=PATH_Z, **limits
        )
        if read.censored.any():
            look = {"facecolors": "none", "edgecolors": VERMILLION, "linewidths": 0.5}
            label = "upper limit (censored)"
            spots = read.positions_m[read.censored]
            entries.append(panel.scatter(*spots.T, s=14.0, zorder=PATH_Z, label=label, **look))
        entries += draw_places(panel, draft.problem)
        place = station.fit.parameters.station.position_m
        circle = {"facecolors": "none", "edgecolors": BLACK, "linewidths": 1.4}
        own = panel.scatter(*place, s=260.0, zorder=PLACE_Z, label="its station", **circle)
        entries.append(own)
        box = {"boxstyle": "round,pad=0.15", "facecolor": WHITE, "edgecolor": "none", "alpha": 0.8}
        note = {"xytext": (10, 10), "textcoords": "offset points", "zorder": PLACE_Z + 1.0}
        panel.annotate(station.name, place, fontsize=NOTE_PT, bbox=box, **note)
        show_bounds(panel, (x_min, y_min, x_max, y_max))
        bar = cast("Any", figure).colorbar(dots, ax=panel, aspect=30, pad=0.02).ax
        bar.set_ylabel("power [dBm]", fontsize=LABEL_PT)
    legend_below(figure, entries, 6)
    head(figure, f"{draft.problem.name}: log, map and stations")
    return figure


def _draw_unknown(panel: Any, draft: Draft) -> list[Artist]:
    """Shade unknown cells and return the legend entry; obstacles are drawn over them."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch
    from matplotlib.transforms import Affine2D

    grid = draft.grid
    if grid is None or not grid.unknown.any():
        return []
    rows, columns = grid.unknown.shape
    (x, y), side = grid.origin_m, grid.resolution_m
    turn = Affine2D().rotate_around(x, y, grid.yaw_rad)
    panel.imshow(
        np.where(grid.unknown, 1.0, np.nan),
        origin="lower",
        extent=(x, x + side * columns, y, y + side * rows),
        cmap=ListedColormap([SKY]),
        alpha=0.45,
        interpolation="nearest",
        zorder=PATH_Z - 0.5,
        transform=turn + panel.transData,
    )
    return [Patch(facecolor=SKY, alpha=0.45, label="unknown, counts as occupied")]
