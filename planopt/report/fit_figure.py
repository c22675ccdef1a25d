"""A channel fit against its measurements: path loss, correlation of the rest, and what is sure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.lemma1 import BINS, empirical_correlation
from planopt.channel.estimation.likelihood_climb import thinned
from planopt.channel.estimation.profile import CUT_95, WORDS, Profile, interval_words
from planopt.channel.estimation.profile_likelihood import profiles_around
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station, regressors, station_distance_m
from planopt.errors import InputError
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import (
    BLACK,
    OBSTACLE_EDGE,
    PREDICTED,
    VERMILLION,
    dress,
    head,
    legend_below,
    legend_inside,
    plain_log_ticks,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

LEAST_SHOWN = -4.4
"""Lowest log likelihood that is shown, less the largest."""

CURVE_POINTS = 300

SHORT = {
    "shadow_std_db": "shadowing",
    "decorrelation_m": "decorrelation",
    "multipath_std_db": "multipath",
}


def draw_profiles(
    panels: Sequence[Panel], profiles: Sequence[Profile], fit: ChannelFit
) -> list[Artist]:
    """Draw each profile with the 95 % cut, the set of values above it, and the fit's estimate."""
    entries: list[Artist] = []
    for number, (panel, profile) in enumerate(zip(panels, profiles, strict=True)):
        name, (long_name, unit) = SHORT[profile.parameter], WORDS[profile.parameter]
        entries = _draw_profile(panel, profile, getattr(fit.parameters, profile.parameter), fit)
        label = "log likelihood less its largest [1]" if number == 0 else ""
        known = interval_words(*profile.interval_95(), unit)
        dress(panel, f"{name}: {known}", f"{long_name} [{unit}]", label)
        panel.set_xscale("log")
        plain_log_ticks(panel.xaxis)
        panel.set_ylim(LEAST_SHOWN, 0.35)
    return entries


def _draw_profile(panel: Panel, profile: Profile, estimate: float, fit: ChannelFit) -> list[Artist]:
    """Draw the curve, what of it is above the cut, and the estimate."""
    values, drop = profile.curve(CURVE_POINTS)
    low, high = profile.interval_95()
    inside = (values >= low) & (values <= high)
    (curve,) = panel.plot(
        values, drop, color=PREDICTED, linewidth=2.0, label="profile of the restricted likelihood"
    )
    (line,) = panel.plot(
        [estimate, estimate],
        [LEAST_SHOWN, 0.0],
        color=BLACK,
        linewidth=1.4,
        linestyle=":",
        label=f"estimate of {fit.method}",
    )
    return [
        curve,
        panel.axhline(
            -CUT_95, color=VERMILLION, linewidth=1.2, linestyle="--", label="95 % cut (chi-square)"
        ),
        panel.fill_between(
            values[inside],
            drop[inside],
            LEAST_SHOWN,
            color=PREDICTED,
            alpha=0.15,
            linewidth=0.0,
            label="95 % confidence set",
        ),
        line,
    ]


SHOWN_DECORRELATIONS = 5.0
SHOWN_EXTENT = 0.25
"""Correlation is shown up to so many decorrelation distances or this share of the extent, whichever
is more, but not beyond the extent, where there are no pairs."""


MOST_PROFILED = 5_000
"""Profiles are drawn of at most so many measurements: they cost some forty evaluations of the
likelihood."""

LINE_DEVIATIONS = 2.0
LINE_POINTS = 200


def draw_fit(measurements: Measurements, fit: ChannelFit, station: Station) -> Figure:
    """Draw power by distance with the fitted line, the residuals' covariance by lag, and profiles.

    The profiles are those of the restricted likelihood whatever the method; they are left out where
    the measurements are too few for it.

    Parameters
    ----------
    measurements
        What was fitted.
    fit
        The fit.
    station
        Where distances are measured from.
    """
    from matplotlib.gridspec import GridSpec, GridSpecFromSubplotSpec

    profiles = _profiles(measurements, fit, station)
    heights = [3.0, 1.0, 2.2] if profiles else [3.0, 1.0]
    figure = new_figure(13.0, 8.8 if profiles else 5.8)
    cells = GridSpec(
        len(heights), 2, figure=figure, width_ratios=[1.15, 1.0], height_ratios=heights
    )
    _draw_path_loss(add_panel(figure, cells[:2, 0]), measurements, fit.parameters, station)
    _draw_covariance(
        add_panel(figure, cells[0, 1]), add_panel(figure, cells[1, 1]), measurements, fit, station
    )
    words = (
        f"{fit.method} fit to {len(measurements)} measurements, "
        f"{int(measurements.censored.sum())} of them censored: {fit.status}"
    )
    if profiles:
        below = GridSpecFromSubplotSpec(1, len(profiles), cells[2, :])
        panels = [add_panel(figure, below[0, column]) for column in range(len(profiles))]
        legend_below(figure, draw_profiles(panels, profiles, fit), 4)
        if profiles[0].measurements < len(measurements):
            words += f"; profiles from {profiles[0].measurements} of them"
    head(figure, words)
    return figure


def _profiles(measurements: Measurements, fit: ChannelFit, station: Station) -> tuple[Profile, ...]:
    """Profiles of xi, beta and omega; none where the measurements do not allow them."""
    try:
        some = measurements.by_place()
        some = some.take(thinned(len(some), MOST_PROFILED))
        return profiles_around(some, station, fit.parameters.forgetting_s)
    except InputError:
        return ()


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
