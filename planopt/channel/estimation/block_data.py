"""Measurements as the likelihood of very many needs them: where, columns of the mean, windows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.least_squares import receiver_columns
from planopt.channel.intervals.censoring import intervals
from planopt.channel.intervals.sites import rounded_variance_db2
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurement_covariance import (
    RECEIVER_OFFSET_STD_DB,
    Origins,
    measured_origins,
    measured_path_loss_variance_db2,
    own_distance_m,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.windows import (
    BESIDE,
    BLOCK,
    SITE_BESIDE,
    IntervalRows,
    Window,
    earlier_windows,
    place_blocks,
    surrounding_windows,
)
from planopt.channel.parameters import ChannelParameters


@dataclass(frozen=True, eq=False)
class BlockData:
    """Measurements in windows.

    Attributes
    ----------
    known
        What is not estimated: the forgetting time, and the station.
    origins
        Of n measurements, every receiver's offset known: offsets are coefficients here.
    columns
        ``(n, q)``: the mean model's p columns, then the indicators of the receivers but number 0.
    prior_precision
        ``(q,)`` of the coefficients: 0, flat, for the first p.
    values_db
        ``(n,)`` powers less the mean model's offset.
    fixed_db2
        ``(n,)`` variance beyond omega^2: of rounding, and of path loss by errors of position.
    gaussian, measured
        ``(n,)``: which are not intervals to the likelihood, and which are not censored.
    intervals
        Those that are; None where there are none.
    log_steps
        Sum of the logarithms of the steps that coarse ones were rounded to.
    windows
        Blocks from coarse to fine, each with earlier ones beside it.
    distances_m
        Within each window, position errors included.
    """

    known: ChannelParameters
    origins: Origins
    columns: NDArray[np.float64]
    prior_precision: NDArray[np.float64]
    values_db: NDArray[np.float64]
    fixed_db2: NDArray[np.float64]
    gaussian: NDArray[np.bool_]
    measured: NDArray[np.bool_]
    intervals: IntervalRows | None
    log_steps: float
    windows: tuple[Window, ...]
    distances_m: tuple[NDArray[np.float64], ...]


def block_data(
    model: MeanModel,
    measurements: Measurements,
    known: ChannelParameters,
    decorrelation_bounds_m: tuple[float, float],
    as_interval: NDArray[np.bool_] | None = None,
) -> BlockData:
    """Cut measurements into blocks and windows.

    Parameters
    ----------
    model, measurements, known, as_interval
        As for :func:`planopt.channel.estimation.likelihood_data.likelihood_data`.
    decorrelation_bounds_m
        Range of beta. Where the channel forgets, a second counts for as many metres as let the
        correlation fall as far, at a middling beta.
    """
    chosen = measurements.censored if as_interval is None else as_interval
    origins = measured_origins(measurements, known).without_offsets()
    coordinates = origins.positions_m
    if origins.time_s is not None:
        low, high = decorrelation_bounds_m
        distance_m = math.sqrt(low * high) / known.forgetting_s * origins.time_s
        coordinates = np.column_stack([coordinates, distance_m])
    blocks = place_blocks(coordinates, BLOCK)
    bands = intervals(measurements)
    rounded = np.where(chosen, 0.0, rounded_variance_db2(measurements.resolution_db))
    displaced = measured_path_loss_variance_db2(measurements, known)
    receivers = receiver_columns(measurements)
    windows = earlier_windows(coordinates, blocks, BESIDE)
    rows = np.flatnonzero(chosen)
    width = bands.width_db[rows]
    around = surrounding_windows(
        coordinates, tuple(own for own in blocks if chosen[own].any()), SITE_BESIDE
    )
    return BlockData(
        known,
        origins,
        np.column_stack([model.columns, receivers]),
        np.repeat([0.0, RECEIVER_OFFSET_STD_DB**-2], [model.columns.shape[1], receivers.shape[1]]),
        measurements.power_dbm - model.offset_db,
        rounded + displaced,
        ~chosen,
        ~measurements.censored,
        IntervalRows(
            rows,
            type(bands)(bands.upper_db[rows] - model.offset_db[rows], width),
            displaced[rows],
            around,
            _distances_m(origins, around),
        )
        if len(rows)
        else None,
        float(np.log(width[np.isfinite(width)]).sum()),
        windows,
        _distances_m(origins, windows),
    )


def exact_part(data: BlockData, blocks: int) -> BlockData:
    """The Gaussian measurements of the first blocks, which are spread over all places."""
    windows = data.windows[:blocks]
    taken = np.zeros(len(data.values_db), dtype=np.bool_)
    for window in windows:
        taken[window.own] = True
    taken &= data.gaussian
    rows = np.flatnonzero(taken)
    number = np.cumsum(taken) - 1
    kept = [
        Window(number[one.beside[taken[one.beside]]], number[one.own[taken[one.own]]])
        for one in windows
    ]
    kept = tuple(window for window in kept if len(window.own))
    origins = data.origins.at(rows)
    everyone = np.ones(len(rows), dtype=np.bool_)
    return BlockData(
        data.known,
        origins,
        data.columns[rows],
        data.prior_precision,
        data.values_db[rows],
        data.fixed_db2[rows],
        everyone,
        everyone,
        None,
        0.0,
        kept,
        _distances_m(origins, kept),
    )


def _distances_m(origins: Origins, windows: tuple[Window, ...]) -> tuple[NDArray[np.float64], ...]:
    return tuple(own_distance_m(origins.at(window.rows)) for window in windows)
