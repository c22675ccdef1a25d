"""A channel fit against its measurements: path loss, correlation of the rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.lemma1 import BINS, empirical_correlation
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station, regressors, station_distance_m
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    OBSTACLE_EDGE,
    PREDICTED,
    VERMILLION,
    dress,
    head,
    legend_inside,
    plain_log_ticks,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN_DECORRELATIONS = 5.0
SHOWN_EXTENT = 0.25
"""Correlation is shown up to so many decorrelation distances or this share of the extent, whichever
is more, but not beyond the extent, where there are no pairs."""


LINE_DEVIATIONS = 2.0
LINE_POINTS = 200


def draw_fit(measurements: Measurements, fit: ChannelFit, station: Station) -> Figure:
    """Draw power by distance with the fitted line, and the residuals' covariance by lag.

    Parameters
    ----------
    measurements
        What was fitted.
    fit
        The fit.
    station
        Where distances are measured from.
    """
    from matplotlib.gridspec import GridSpec

    figure = new_figure(13.0, 5.8)
    cells = GridSpec(2, 2, figure=figure, width_ratios=[1.15, 1.0], height_ratios=[3.0, 1.0])
    _draw_path_loss(add_panel(figure, cells[:2, 0]), measurements, fit.parameters, station)
    _draw_covariance(
        add_panel(figure, cells[0, 1]), add_panel(figure, cells[1, 1]), measurements, fit, station
    )
    words = (
        f"{fit.method} fit to {len(measurements)} measurements, "
        f"{int(measurements.censored.sum())} of them censored: {fit.status}"
    )
    head(figure, words)
    return figure


def _draw_path_loss(
    panel: Panel, measurements: Measurements, parameters: ChannelParameters, station: Station
) -> None:
    """Draw power by distance, with the line and two deviations of what it leaves."""
    distance = station_distance_m(measurements.positions_m, station)
    for label, selection, fill in (
        ("measured", ~measurements.censored, BLACK),
        ("at most this (censored)", measurements.censored, "none"),
    ):
        if selection.any():
            panel.scatter(
                distance[selection],
                measurements.power_dbm[selection],
                s=14.0,
                marker="o" if fill == BLACK else "v",
                facecolors=fill,
                edgecolors=BLACK if fill == BLACK else VERMILLION,
                linewidths=0.0 if fill == BLACK else 1.0,
                alpha=0.7,
                label=label,
            )
    nearest, farthest = float(distance.min()), float(distance.max())
    if farthest < 1.01 * nearest:
        nearest, farthest = 0.9 * nearest, 1.1 * farthest  # an axis needs an extent
    span = np.geomspace(nearest, farthest, LINE_POINTS)
    line = parameters.k_pl_db - 10.0 * parameters.n_pl * np.log10(span)
    spread = LINE_DEVIATIONS * np.hypot(parameters.shadow_std_db, parameters.multipath_std_db)
    panel.fill_between(
        span,
        line - spread,
        line + spread,
        color=PREDICTED,
        alpha=0.15,
        linewidth=0.0,
        label=f"±{LINE_DEVIATIONS:g} deviations",
    )
    panel.plot(
        span,
        line,
        color=PREDICTED,
        linewidth=2.0,
        label=f"{parameters.k_pl_db:.1f} dBm - {10.0 * parameters.n_pl:.1f} dB log10(d / 1 m)",
    )
    dress(panel, "path loss", "distance to the station d [m]", "power [dBm]")
    panel.set_xscale("log")
    plain_log_ticks(panel.xaxis)
    legend_inside(panel)


def _draw_covariance(
    panel: Panel,
    counts: Panel,
    measurements: Measurements,
    fit: ChannelFit,
    station: Station,
) -> None:
    """Draw residual products by lag, the fitted covariance, and how many pairs there are.

    Over uncensored pairs: the residual of a censored power is not known.
    """
    parameters = fit.parameters
    exact = ~measurements.censored
    positions = measurements.positions_m[exact]
    extent = float(np.hypot(*np.ptp(positions, axis=0))) if len(positions) else 0.0
    shown = max(SHOWN_DECORRELATIONS * parameters.decorrelation_m, SHOWN_EXTENT * extent)
    if extent > 0.0:
        shown = min(shown, extent)
        theta = np.array([parameters.k_pl_db, parameters.n_pl])
        residual = measurements.power_dbm[exact] - regressors(positions, station) @ theta
        bins = empirical_correlation(positions, residual, extent)
        near = bins.lag_m <= shown
        lag, pairs = bins.lag_m[near], bins.pairs[near]
        panel.scatter(lag, bins.covariance_db2[near], s=22.0, color=BLACK, label="mean of a bin")
        counts.bar(lag, pairs, width=0.8 * extent / BINS, color=OBSTACLE_EDGE)
    lags = np.linspace(0.0, shown, LINE_POINTS)
    panel.plot(
        lags,
        parameters.shadow_std_db**2 * np.exp(-lags / parameters.decorrelation_m),
        color=PREDICTED,
        linewidth=2.0,
        label=(
            f"fit: deviation {_with_error(fit, 'shadow_std_db')} dB, "
            f"decorrelation {_with_error(fit, 'decorrelation_m')} m"
        ),
    )
    panel.plot(
        [0.0],
        [parameters.shadow_std_db**2 + parameters.multipath_std_db**2],
        linestyle="none",
        marker="D",
        color=PREDICTED,
        clip_on=False,
        label=f"with multipath, deviation {_with_error(fit, 'multipath_std_db')} dB",
    )
    dress(panel, "covariance of the residuals (uncensored)", "", "covariance [dB²]")
    dress(counts, "", "distance between measurements [m]", "pairs [count]")
    for either in (panel, counts):
        either.set_xlim(0.0, shown)
    legend_inside(panel, "upper right")


def _with_error(fit: ChannelFit, name: str) -> str:
    """An estimate with its standard error, where that is known."""
    value, error = getattr(fit.parameters, name), fit.standard_errors.get(name, math.inf)
    if not math.isfinite(error):
        return f"{value:.3g}"
    return f"{value:.3g} ± {error:.2g}" if error < 100.0 else f"{value:.3g} ± {error:.0f}"
