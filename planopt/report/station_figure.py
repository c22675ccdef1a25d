"""Estimated positions of transmitters against the true ones: a map, and the sizes of the errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planopt.errors import InputError
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    OBSTACLE_EDGE,
    SERIES,
    dress,
    head,
    legend_below,
    legend_inside,
    plain_log_ticks,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

MEASURED = "#dcdcdc"
DASHES = ("-", "--", "-.", ":")


def draw_stations(
    true_m: NDArray[np.float64],
    estimates_m: Mapping[str, NDArray[np.float64]],
    measured_m: NDArray[np.float64],
) -> Figure:
    """Draw the first estimates on a map, and the distribution of the errors of all.

    Parameters
    ----------
    true_m
        ``(m, 2)`` true positions.
    estimates_m
        ``(m, 2)`` estimated positions by the name of the method, for the legend.
    measured_m
        ``(k, 2)`` where the power was measured.

    Raises
    ------
    InputError
        There are no estimates, or not as many as true positions.
    """
    from matplotlib.gridspec import GridSpec

    wrong = [name for name, found in estimates_m.items() if found.shape != true_m.shape]
    if not estimates_m or wrong or not len(true_m):
        raise InputError(
            f"there is not one estimate for each of {len(true_m)} true positions",
            key=wrong[0] if wrong else "estimates_m",
        )
    figure = new_figure(13.0, 6.0)
    cells = GridSpec(1, 2, figure=figure, width_ratios=[1.1, 1.0])
    scene, errors = (add_panel(figure, cells[0, column]) for column in range(2))
    shown = next(iter(estimates_m))
    entries = _draw_map(scene, true_m, estimates_m[shown], measured_m)
    dress(scene, f"{shown}: from true to estimated", "x [m]", "y [m]")
    for number, (name, found) in enumerate(estimates_m.items()):
        _draw_errors(errors, name, np.hypot(*(found - true_m).T), number)
    errors.set_xscale("log")
    errors.set_ylim(0.0, 100.0)
    dress(errors, "error of position", "distance to the true position [m]", "transmitters [%]")
    plain_log_ticks(errors.xaxis)
    legend_inside(errors, "upper left")
    legend_below(figure, entries, 3)
    head(figure, f"{len(true_m)} transmitters, located by the power received from them")
    return figure


def _draw_map(
    panel: Panel,
    true_m: NDArray[np.float64],
    found_m: NDArray[np.float64],
    measured_m: NDArray[np.float64],
) -> list[Artist]:
    """Draw true and estimated positions with lines between; the artists for the legend."""
    panel.scatter(measured_m[:, 0], measured_m[:, 1], s=3.0, color=MEASURED, linewidths=0.0)
    # On the map the dots are smaller than can be told in a legend.
    (measured,) = panel.plot(
        [], [], color=MEASURED, marker="o", linestyle="none", label="measured here"
    )
    # NaN breaks the line between two pairs.
    ends = np.stack([true_m, found_m, np.full_like(true_m, np.nan)], axis=1).reshape(-1, 2)
    panel.plot(ends[:, 0], ends[:, 1], color=OBSTACLE_EDGE, linewidth=0.9)
    true = panel.scatter(true_m[:, 0], true_m[:, 1], s=14.0, color=BLACK, label="true", zorder=3)
    found = panel.scatter(
        found_m[:, 0],
        found_m[:, 1],
        s=22.0,
        facecolors="none",
        edgecolors=SERIES[0],
        linewidths=1.2,
        label="estimated",
        zorder=4,
    )
    panel.set_aspect("equal", adjustable="datalim")
    return [true, found, measured]


def _draw_errors(panel: Panel, name: str, error_m: NDArray[np.float64], number: int) -> None:
    """Draw the empirical distribution of errors (m,)."""
    ordered = np.sort(error_m)
    # The curve steps up by one transmitter at each error.
    panel.plot(
        np.repeat(ordered, 2),
        100.0 * np.repeat(np.arange(len(ordered) + 1), 2)[1:-1] / len(ordered),
        color=SERIES[number % len(SERIES)],
        linestyle=DASHES[number % len(DASHES)],
        linewidth=1.8,
        label=f"{name}: median {np.median(error_m):.2f} m, 90 % {np.quantile(error_m, 0.9):.2f} m",
    )
