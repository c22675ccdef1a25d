"""Predictions on a grid over the free space, for map layers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief
from planopt.channel.connection.serving_power import (
    above_thresholds_db,
    any_probability,
    serving_power_dbm,
)
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.problems.problem import Problem
from planopt.world.clearance import clearance_m, index_obstacles, inside_bounds
from planopt.world.raster import Raster
from planopt.world.workspace import Workspace

Bounds = tuple[float, float, float, float]

NODES = 150
"""Grid cells along the longer side of a map: about four pixels each."""


def cell_centres(bounds_m: Bounds) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres along x and y of about square cells that fill `bounds_m`; see `NODES`."""
    x_min, y_min, x_max, y_max = bounds_m
    side = max(x_max - x_min, y_max - y_min) / NODES
    axes: list[NDArray[np.float64]] = []
    for low, high in ((x_min, x_max), (y_min, y_max)):
        count = max(2, round((high - low) / side))
        half = (high - low) / count / 2.0
        axes.append(np.linspace(low + half, high - half, count))
    return axes[0], axes[1]


def drawn_cells(
    workspace: Workspace, x_m: NDArray[np.float64], y_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Cells of the grid that are free at their centre, and those beside one; (ny, nx).

    With the cells beside, a layer reaches under the outlines of the obstacles drawn over it.
    """
    centres = np.stack(np.meshgrid(x_m, y_m), axis=-1)
    places = centres.reshape(-1, 2)
    free = inside_bounds(workspace, places)
    free &= clearance_m(index_obstacles(workspace), places) > 0.0
    padded = np.pad(free.reshape(centres.shape[:2]), 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


def predicted_rasters(
    posterior: ChannelPosterior, workspace: Workspace, bounds_m: Bounds
) -> tuple[Raster, Raster]:
    """Predicted power (dBm) and its deviation (dB) inside `bounds_m`; NaN under obstacles."""
    x, y = cell_centres(bounds_m)
    drawn = drawn_cells(workspace, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1)[drawn]
    prediction = posterior.predict(places)
    mean, deviation = np.full(drawn.shape, np.nan), np.full(drawn.shape, np.nan)
    mean[drawn] = prediction.mean_db
    deviation[drawn] = prediction.deviation_db
    return Raster(x, y, mean), Raster(x, y, deviation)


def believed_rasters(
    problem: Problem, belief: Belief, bounds_m: Bounds
) -> tuple[Raster, Raster, Raster]:
    """Predicted power (dBm), its deviation (dB) and P(connected) inside `bounds_m`.

    Of several stations, power and deviation are those of the one whose predicted power is furthest
    above its threshold, for the first one's; the probability is that of any.
    """
    thresholds = [radio.threshold_dbm for radio in problem.stations]
    each = [predicted_rasters(own, problem.workspace, bounds_m) for own in belief.posteriors]
    means = np.stack([mean.values for mean, _ in each])
    deviations = np.stack([deviation.values for _, deviation in each])
    drawn = np.isfinite(means[0])
    powers = [
        Prediction(mean[drawn], deviation[drawn])
        for mean, deviation in zip(means, deviations, strict=True)
    ]
    above, _ = above_thresholds_db(powers, thresholds)
    chance = np.full(drawn.shape, np.nan)
    chance[drawn] = any_probability(powers, thresholds)
    deviation = np.full(drawn.shape, np.nan)
    deviation[drawn] = deviations[:, drawn][above.argmax(axis=0), np.arange(above.shape[1])]
    x, y = each[0][0].x_m, each[0][0].y_m
    mean = serving_power_dbm(means, thresholds)
    return Raster(x, y, mean), Raster(x, y, deviation), Raster(x, y, chance)
