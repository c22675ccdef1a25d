"""Figures of the channel (maps, fits, calibration, sensitivity, stations) and of drafts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from planopt.arrays import Floats
from planopt.channel.calibration import EDGES, ReliabilityBin
from planopt.channel.channel_map import PosteriorMap
from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.correlation_fit import BINS, empirical_correlation
from planopt.channel.held_out import HeldOutScore
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, Station, regressors, station_distance_m
from planopt.channel.posterior import Belief
from planopt.errors import InputError
from planopt.problems.draft import Draft
from planopt.problems.problem import Problem
from planopt.report.maps import (
    PATH_Z,
    PLACE_Z,
    X_LABEL,
    Y_LABEL,
    believed_rasters,
    draw_discs,
    draw_ground,
    draw_layer,
    draw_level,
    draw_measurements,
    draw_places,
    draw_sites,
    raster_bounds,
    show_bounds,
)
from planopt.report.panel import (
    BLACK,
    DEVIATION_MAP,
    LABEL_PT,
    MARKERS,
    NOTE_BOX,
    NOTE_PT,
    OBSTACLE_EDGE,
    POWER_MAP,
    PREDICTED,
    PROBABILITY_MAP,
    SERIES,
    SKY,
    VERMILLION,
    Look,
    Panel,
    curve_look,
    dashed_look,
    draw_band,
    draw_intervals,
    dress,
    head,
    legend_below,
    legend_inside,
    log_scale,
    new_figure,
)
from planopt.world.raster import Raster

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

PANEL_IN, AROUND_IN, MAX_SLENDER = 4.0, 1.9, 2.0
"""Width of a map panel and height of titles and legend in inches, and maximum aspect ratio."""
SHOWN_DECORRELATIONS, SHOWN_EXTENT = 5.0, 0.25
"""Maximum lag shown: the larger of 5 decorrelation distances and 25 % of the extent."""
SHOWN_DISTANCES_M = (1.0, 1000.0)
"""Distances to the station for which a fit without measurements is drawn."""
LINE_DEVIATIONS, LINE_POINTS = 2.0, 200
"""Half width of a fitted line's band in standard deviations, and number of points per curve."""
SERIES_WIDTH = 0.6  # Total width of all series within a bin of the reliability diagram

MEASURED = "#dcdcdc"

PARAMETERS = {
    "k_pl_db": "path loss at 1 m, K_PL",
    "n_pl": "path loss exponent, n_PL",
    "shadow_variance_db2": "shadowing variance, ξ²",
    "decorrelation_m": "decorrelation distance, β",
    "multipath_std_db": "multipath standard deviation, ω",
}


def draw_belief(problem: Problem, belief: Belief) -> Figure:
    """Draw predicted power [dBm], its standard deviation [dB], P(connected) and the p_min contour.

    With several stations, power and standard deviation belong to the serving station.

    Parameters
    ----------
    problem
        Problem with the map, the threshold and p_min.
    belief
        Belief that predicts the channel; its measurements are dots, hollow if censored.
    """
    threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
    chance = "P(any station connects)" if len(problem.stations) > 1 else _chance_words(threshold)
    figure, panels = new_figure(16.5, 5.8, ["ABC"], maps_only=True)
    for panel in panels:
        draw_ground(panel, problem.workspace, "")
    rasters = believed_rasters(problem, belief, problem.workspace.bounds_m)
    entries = _prediction_maps(figure, panels, rasters, threshold, chance, p_min)
    measurements = belief.posterior.measurements
    dots = [draw_measurements(panel, measurements) for panel in panels[:2]]
    places = [draw_places(panel, problem) for panel in panels]
    legend_below(figure, [*places[0], *dots[0], *entries], 6)
    words = f"{len(measurements)} measurements, {belief.fit.method} fit"
    head(figure, f"{problem.name}: predictions from {words}")
    return figure


def draw_posterior_map(
    maps: PosteriorMap,
    measurements: Measurements | None,
    station: Station | Sequence[Station],
    title: str,
) -> Figure:
    """Draw predicted power [dBm], its standard deviation [dB] and P(connected), side by side.

    Parameters
    ----------
    maps
        Predicted rasters.
    measurements
        Measurements used: dots on the map of the standard deviation, hollow if censored; or None.
    station
        Station or stations, marked if they are inside the map.
    title
        Title of the figure.
    """
    bounds = x_min, y_min, x_max, y_max = raster_bounds(maps.mean_db)
    slender = min((y_max - y_min) / (x_max - x_min), MAX_SLENDER)
    figure, panels = new_figure(16.5, AROUND_IN + PANEL_IN * slender, ["ABC"], maps_only=True)
    for panel in panels:
        panel.set_aspect("equal")
    rasters, threshold = (maps.mean_db, maps.deviation_db, maps.connectivity), maps.threshold_dbm
    level = _prediction_maps(figure, panels, rasters, threshold, _chance_words(threshold), None)
    entries = [] if measurements is None else draw_measurements(panels[1], measurements)
    stations = [station] if isinstance(station, Station) else station
    sites = np.array([each.position_m for each in stations]).reshape(-1, 2)
    inside = ((sites >= (x_min, y_min)) & (sites <= (x_max, y_max))).all(axis=1)
    if inside.any():
        entries += [draw_sites(panel, sites[inside]) for panel in panels][:1]
    for panel in panels:
        show_bounds(panel, bounds)  # Excludes measurements outside the map
    legend_below(figure, [*entries, *level], 4)
    head(figure, title)
    return figure


def _chance_words(threshold_dbm: float) -> str:
    return f"P(power ≥ {threshold_dbm:g} dBm)"


def _prediction_maps(
    figure: Figure,
    panels: Sequence[Panel],
    rasters: tuple[Raster, Raster, Raster],
    threshold: float,
    chance_words: str,
    p_min: float | None,
) -> list[Artist]:
    """Draw power, standard deviation and probability; return the contour as a legend entry."""
    mean, deviation, chance = rasters
    titles = "predicted power", "standard deviation of the prediction", chance_words
    for panel, title in zip(panels, titles, strict=True):
        dress(panel, title, X_LABEL, Y_LABEL, grid=False)
    draw_layer(panels[0], mean, POWER_MAP, figure, "power [dBm] (line: threshold)", mark=threshold)
    draw_layer(panels[1], deviation, DEVIATION_MAP, figure, "standard deviation [dB]")
    label = "P(connected) [1]" + ("" if p_min is None else " (line: p_min)")
    draw_layer(panels[2], chance, PROBABILITY_MAP, figure, label, (0.0, 1.0), p_min)
    if p_min is None:
        return draw_level(panels[0], mean, threshold, f"{threshold:g} dBm")
    return draw_level(panels[2], chance, p_min, f"p_min = {p_min:g}")


def draw_fit(measurements: Measurements | None, fit: ChannelFit, station: Station) -> Figure:
    """Draw power against distance with the fitted line, and residual covariance against lag.

    Parameters
    ----------
    measurements
        Measurements used by the fit; if None, only the fitted curves are drawn.
    fit
        Fitted channel.
    station
        Origin of distances.
    """
    heights = [1.0] if measurements is None else [3.0, 1.0]
    ratios: Look = {"width_ratios": [1.15, 1.0], "height_ratios": heights}
    figure, panels = new_figure(13.0, 5.8, ["AB", "AC"][: len(heights)], **ratios)
    shown = measurements or Measurements(np.zeros((0, 2)), np.zeros(0))
    _draw_path_loss(panels[0], shown, fit.parameters, station)
    _draw_covariance(panels[1], panels[2:], shown, fit, station)
    words = f"{fit.measurements} measurements, {fit.censored} of them censored: {fit.status}"
    head(figure, f"{fit.method} fit to {words}")
    return figure


def _draw_path_loss(
    panel: Panel, measurements: Measurements, parameters: ChannelParameters, station: Station
) -> None:
    """Draw power over distance, and the fitted line with a band of two standard deviations."""
    distance = station_distance_m(measurements.positions_m, station)
    exact = {"marker": "o", "facecolors": BLACK, "linewidths": 0.0}
    hollow = {"marker": "v", "facecolors": "none", "edgecolors": VERMILLION, "linewidths": 1.0}
    for label, selection, look in (
        ("measured", ~measurements.censored, exact),
        ("upper limit (censored)", measurements.censored, hollow),
    ):
        if selection.any():
            power = measurements.power_dbm[selection]
            panel.scatter(distance[selection], power, s=14.0, alpha=0.7, label=label, **look)
    nearest, farthest = SHOWN_DISTANCES_M
    if len(distance):
        nearest, farthest = float(distance.min()), float(distance.max())
    if farthest < 1.01 * nearest:
        nearest, farthest = 0.9 * nearest, 1.1 * farthest  # an axis needs a positive length
    span = np.geomspace(nearest, farthest, LINE_POINTS)
    line = parameters.k_pl_db - 10.0 * parameters.n_pl * np.log10(span)
    spread = LINE_DEVIATIONS * np.hypot(parameters.shadow_std_db, parameters.multipath_std_db)
    words = f"±{LINE_DEVIATIONS:g} standard deviations"
    draw_band(panel, span, line - spread, line + spread, PREDICTED, words)
    words = f"{parameters.k_pl_db:.1f} dBm - {10.0 * parameters.n_pl:.1f} dB log10(d / 1 m)"
    panel.plot(span, line, color=PREDICTED, linewidth=2.0, label=words)
    dress(panel, "path loss", "distance to the station d [m]", "power [dBm]")
    log_scale(panel, "x")
    legend_inside(panel)


def _draw_covariance(
    panel: Panel,
    counts: Sequence[Panel],  # One panel, or none
    measurements: Measurements,
    fit: ChannelFit,
    station: Station,
) -> None:
    """Draw residual products and fitted covariance over lag, and the number of pairs per lag."""
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
        panel.scatter(lag, bins.covariance_db2[near], s=22.0, color=BLACK, label="bin mean")
        counts[0].bar(lag, pairs, width=0.8 * extent / BINS, color=OBSTACLE_EDGE)
    lags = np.linspace(0.0, shown, LINE_POINTS)
    shadow, decorrelation = parameters.shadow_std_db**2, parameters.decorrelation_m
    shown_values: list[str] = []
    for name in ("shadow_std_db", "decorrelation_m", "multipath_std_db"):
        value, error = getattr(parameters, name), fit.standard_errors.get(name, math.inf)
        spread = f" ± {error:.2g}" if error < 100.0 else f" ± {error:.0f}"
        shown_values.append(f"{value:.3g}{spread if math.isfinite(error) else ''}")
    std, away, multipath = shown_values
    words = f"fit: std {std} dB, decorrelation {away} m", f"with multipath, std {multipath} dB"
    look = {"color": PREDICTED, "linewidth": 2.0}
    panel.plot(lags, shadow * np.exp(-lags / decorrelation), label=words[0], **look)
    look = {"linestyle": "none", "marker": "D", "color": PREDICTED, "clip_on": False}
    panel.plot([0.0], [shadow + parameters.multipath_std_db**2], label=words[1], **look)
    lag_label = "distance between measurements [m]"
    dress(
        panel,
        "covariance of the residuals" + (" (uncensored)" if counts else ""),
        "" if counts else lag_label,
        "covariance [dB²]",
    )
    for each in counts:
        dress(each, "", lag_label, "pairs [count]")
    for either in (panel, *counts):
        either.set_xlim(0.0, shown)
    legend_inside(panel, "upper right")


def draw_calibration(scores: Mapping[str, HeldOutScore]) -> Figure:
    """Draw coverage over nominal level with its 95 % interval, and the histogram of the PIT.

    Parameters
    ----------
    scores
        Scores by the name of the predictor, for the legend.

    Raises
    ------
    InputError
        There are no scores.
    """
    if not scores:
        raise InputError("is empty", key="scores")
    figure, (coverage, pit) = new_figure(12.0, 5.4, ["AB"])
    entries: list[Artist] = []
    for number, (name, one) in enumerate(scores.items()):
        levels = [(level, each.value, each.low, each.high) for level, each in one.coverage.items()]
        label = f"{name}: RMSE {one.rmse_db.value:.2f} dB"
        look = curve_look(number)
        entries.append(draw_intervals(coverage, *(100.0 * np.array(levels).T), label=label, **look))
        steps = {"baseline": None, "color": look["color"], "linewidth": 1.6, "label": name}
        pit.stairs(100.0 * one.pit_share, np.linspace(0.0, 1.0, len(one.pit_share) + 1), **steps)
    nominal = {"color": BLACK, "linewidth": 1.0, "label": "nominal"}
    entries += coverage.plot([0.0, 100.0], [0.0, 100.0], **nominal)
    pit.axhline(100.0 / len(next(iter(scores.values())).pit_share), **nominal)
    coverage.set_xlim(40.0, 101.0)
    coverage.set_ylim(30.0, 101.0)
    pit.set_xlim(0.0, 1.0)
    pit.set_ylim(0.0, None)
    dress(coverage, "coverage", "level of the interval [%]", "measurements inside [%]")
    words = "predicted probability of a lower power [1]"
    dress(pit, "probability integral transform", words, "measurements [%]")
    legend_below(figure, entries, 4)
    head(figure, "calibration on held-out measurements")
    return figure


def draw_reliability(series: Mapping[str, Sequence[ReliabilityBin]], title: str) -> Figure:
    """Draw the observed share of connection over the predicted probability, and their difference.

    Bars are 95 % intervals over groups, if there are enough groups. Each bin is labelled with the
    number of predictions of the first series.
    """
    edges = sorted({(one.low, one.high) for bins in series.values() for one in bins})
    if not edges:
        raise InputError("has no predictions", key="reliability")
    figure, (diagram, difference) = new_figure(13.0, 5.4, ["AB"], width_ratios=[1.0, 1.5])
    nominal = {"color": BLACK, "linewidth": 1.0, "label": "as predicted"}
    entries = list(diagram.plot([0.0, 100.0], [0.0, 100.0], **nominal))
    difference.axhline(0.0, color=BLACK, linewidth=1.0)
    for number, (name, bins) in enumerate(series.items()):
        at = np.array([edges.index((one.low, one.high)) for one in bins], dtype=np.float64)
        at += SERIES_WIDTH * ((number + 0.5) / len(series) - 0.5)
        predicted = 100.0 * np.array([one.predicted for one in bins])
        rows = [(one.realised, *(one.interval or (np.nan, np.nan))) for one in bins]
        found = 100.0 * np.array(rows)  # Share connected, bounds of its interval
        look = {**curve_look(number), "label": name}
        entries.append(draw_intervals(diagram, predicted, *found.T, **look))
        look["linestyle"] = "none"
        draw_intervals(difference, at, *(found.T - predicted), **look)
    counts = {(one.low, one.high): one.count for one in next(iter(series.values()))}
    labels = [f"{100 * low:g}-{100 * high:g}" for low, high in edges]
    labels = [f"{w}\nn={counts.get(edge, 0)}" for w, edge in zip(labels, edges, strict=True)]
    difference.set_xticks(np.arange(len(edges), dtype=np.float64), labels=labels)
    difference.set_xlim(-0.6, len(edges) - 0.4)
    least = 100.0 * min(low for low, _ in edges)
    diagram.set_xlim(min(least, 100.0 * EDGES[-2]) - 1.0, 101.0)
    dress(diagram, "reliability", "predicted P(connected) [%]", "observed connection [%]")
    words = "bin of predicted P(connected) [%]", "difference [percentage points]"
    dress(difference, "observed minus predicted connection", *words)
    legend_below(figure, entries, 4)
    head(figure, title)
    return figure


def draw_sensitivity(relative_errors: Sequence[float], curves: Mapping[str, Floats]) -> Figure:
    """Draw the mean Delta^2 [dB^2] over the relative error [%], one curve per parameter.

    Parameters
    ----------
    relative_errors
        Relative errors ``(k,)``.
    curves
        Result of :func:`planopt.channel.sensitivity_curves`, or averages of several.

    Raises
    ------
    InputError
        A curve and the errors differ in length, or there is no curve.
    """
    if not curves or any(len(curve) != len(relative_errors) for curve in curves.values()):
        raise InputError(
            f"should have one value for each of the {len(relative_errors)} relative errors",
            key="curves",
            remedy="give the result of sensitivity_curves for these errors",
        )
    percent = 100.0 * np.asarray(relative_errors, dtype=np.float64)
    figure, (panel,) = new_figure(8.0, 5.4)
    for number, (name, curve) in enumerate(curves.items()):
        panel.plot(percent, curve, label=PARAMETERS.get(name, name), **curve_look(number))
    panel.set_ylim(0.0, None)
    dress(panel, "", "error of one parameter [%]", "mean squared error Δ² [dB²]")
    legend_below(figure, panel.get_legend_handles_labels()[0], 2)
    head(figure, "map error caused by an error of one parameter")
    return figure


def draw_stations(true_m: Floats, estimates_m: Mapping[str, Floats], measured_m: Floats) -> Figure:
    """Draw the first method's estimates on a map, and the error distribution of each method.

    Parameters
    ----------
    true_m
        ``(m, 2)`` true positions.
    estimates_m
        ``(m, 2)`` estimated positions by the name of the method, for the legend.
    measured_m
        ``(k, 2)`` positions of the measurements.

    Raises
    ------
    InputError
        There are no estimates, or not as many as true positions.
    """
    wrong = [name for name, found in estimates_m.items() if found.shape != true_m.shape]
    if not estimates_m or wrong or not len(true_m):
        raise InputError(
            f"should have one estimate for each of the {len(true_m)} true positions",
            key=wrong[0] if wrong else "estimates_m",
        )
    figure, (scene, errors) = new_figure(13.0, 6.0, ["AB"], width_ratios=[1.1, 1.0])
    shown = next(iter(estimates_m))
    found_m = estimates_m[shown]
    scene.scatter(*measured_m.T, s=3.0, color=MEASURED, linewidths=0.0)
    # NaN interrupts the line between two pairs.
    ends = np.stack([true_m, found_m, np.full_like(true_m, np.nan)], axis=1).reshape(-1, 2)
    scene.plot(*ends.T, color=OBSTACLE_EDGE, linewidth=0.9)
    hollow = {"facecolors": "none", "edgecolors": SERIES[0], "linewidths": 1.2}
    entries: list[Artist] = [
        scene.scatter(*true_m.T, s=14.0, color=BLACK, label="true", zorder=3),
        scene.scatter(*found_m.T, s=22.0, label="estimated", zorder=4, **hollow),
        # The legend needs a larger dot than the map.
        scene.scatter([], [], color=MEASURED, marker=MARKERS[0], label="measured position"),
    ]
    scene.set_aspect("equal", adjustable="datalim")
    dress(scene, f"{shown}: true and estimated positions", X_LABEL, Y_LABEL)
    for number, (name, found) in enumerate(estimates_m.items()):
        ordered = np.sort(np.hypot(*(found - true_m).T))
        # The empirical distribution steps up by one transmitter at each error.
        shares = np.repeat(np.arange(len(ordered) + 1), 2)[1:-1] / len(ordered)
        words = f"median {np.median(ordered):.2f} m, 90 % {np.quantile(ordered, 0.9):.2f} m"
        look = dashed_look(number)
        errors.plot(np.repeat(ordered, 2), 100.0 * shares, label=f"{name}: {words}", **look)
    log_scale(errors, "x")
    errors.set_ylim(0.0, 100.0)
    dress(errors, "position error", "distance to the true position [m]", "transmitters [%]")
    legend_inside(errors, "upper left")
    legend_below(figure, entries, 3)
    head(figure, f"{len(true_m)} transmitters located by their received power")
    return figure


DRAFT_PANEL_IN, DRAFT_SLENDER = 6.0, 1.6  # Width of a panel in inches, and its maximum aspect ratio
MOST_COLUMNS = 3  # Maximum number of panels in a row
MARGIN = 0.05  # Margin around log, map and stations, as a share of their extent


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
    slender = min(max((y_max - y_min) / (x_max - x_min), 1.0 / DRAFT_SLENDER), DRAFT_SLENDER)
    columns = min(len(draft.stations), MOST_COLUMNS)
    count = -(-len(draft.stations) // columns) * columns
    names = [str(number) if number < len(draft.stations) else "." for number in range(count)]
    mosaic = [names[row : row + columns] for row in range(0, count, columns)]
    size = (DRAFT_PANEL_IN * columns + 1.0, DRAFT_PANEL_IN * slender * len(mosaic) + 1.2)
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
        name = station.name
        if not math.isfinite(station.region_m):
            name += "\nposition not determined"
        elif not station.is_given:
            disc = {"facecolors": "none", "zorder": PLACE_Z, "label": "95 % region"}
            region_m = np.array([station.region_m])
            entries.append(draw_discs(panel, np.array([place]), region_m, **disc))
        note = {"xytext": (10, 10), "textcoords": "offset points", "zorder": PLACE_Z + 1.0}
        panel.annotate(name, place, fontsize=NOTE_PT, bbox=NOTE_BOX, **note)
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
