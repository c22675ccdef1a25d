"""Fit the channel when the station's position is not known (equation 2.12).

The position is found by :mod:`planopt.channel.station.station_position`, the channel is fitted with
the station there, and the position's uncertainty is carried into theta's.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import ChannelFit
from planopt.channel.estimation.fit import fit_channel
from planopt.channel.estimation.fit_method import GivenMethod, Loss
from planopt.channel.estimation.identifiability import require_usable
from planopt.channel.estimation.likelihood_starts import thinned
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.station.station_position import StationMethod, locate
from planopt.channel.station.station_uncertainty import (
    joint_covariance_m2,
    line_covariance_m2,
    theta_by_position,
)
from planopt.errors import InputError

MIN_UNCENSORED = 8
"""Two coordinates and five parameters are wanted."""


@one_blas_thread()
def fit_channel_and_station(
    measurements: Measurements | Table,
    method: GivenMethod = "reml",
    height_m: float = 0.0,
    forgetting_s: float = math.inf,
    *,
    station_method: StationMethod = "joint",
    loss: Loss = "squares",
    intervals: bool = True,
) -> ChannelFit:
    """Estimate the station's position with the channel.

    Parameters
    ----------
    measurements
        At least `MIN_UNCENSORED` uncensored ones, not on one line (from a line the two sides
        cannot be told apart).
    method
        Of the final fit, as in :func:`planopt.channel.estimation.fit.fit_channel`.
    height_m
        Height of the station's antenna above the robots'; not estimated.
    forgetting_s
        As in :func:`planopt.channel.estimation.fit.fit_channel`.
    station_method
        ``joint``: maximum likelihood over position, theta and covariance. ``line``: the position
        from which the path loss line fits best. Of more than `MOST_DENSE` a fixed draw
        serves for the position.
    loss, intervals
        Of the final fit, as in :func:`planopt.channel.estimation.fit.fit_channel`.

    Returns
    -------
    ChannelFit
        With the estimated station in its parameters, its covariance in `station_covariance_m2` and
        a warning that says so. Covariance and standard errors of theta count its uncertainty. Where
        the measurements do not bound the position, its variances and the standard errors of theta
        are infinite, the status is ``degenerate``, and the covariance of theta takes the position
        as exact.

    Raises
    ------
    InputError
        The measurements cannot tell where the station is; or the power grows with the distance
        from every position tried; or there is no such way.
    """
    measurements = as_measurements(measurements)
    if station_method not in get_args(StationMethod):
        raise InputError(
            f"{station_method!r} is no way to find the station",
            key="station_method",
            remedy=f"use {', '.join(get_args(StationMethod))}",
        )
    require_usable(measurements, None)
    measurements = measurements.by_place()
    _require_locating(measurements)
    station = locate(measurements, station_method, height_m, forgetting_s)
    found = fit_channel(measurements, station, method, forgetting_s, loss=loss, intervals=intervals)
    sample = measurements.take(thinned(len(measurements), MOST_DENSE))
    doubt = line_covariance_m2 if station_method == "line" else joint_covariance_m2
    covariance = doubt(sample, found.parameters)
    x, y = station.position_m
    if covariance is None:
        return _undetermined(
            found, f"the station's position ({x:.2f}, {y:.2f}) m is not bounded by the measurements"
        )
    slope = theta_by_position(sample, found.parameters)
    return _with_station(
        found,
        covariance,
        found.theta_covariance + slope @ covariance @ slope.T,
        f"the station's position ({x:.2f}, {y:.2f}) m is estimated, not given",
    )


def _with_station(
    found: ChannelFit,
    covariance_m2: NDArray[np.float64],
    theta_covariance: NDArray[np.float64],
    warning: str,
) -> ChannelFit:
    """The fit with the doubt in its station."""
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    errors = {**found.standard_errors, "k_pl_db": float(k_error), "n_pl": float(n_error)}
    return replace(
        found,
        theta_covariance=theta_covariance,
        standard_errors=errors,
        station_covariance_m2=covariance_m2,
        warnings=(warning, *found.warnings),
    )


def _undetermined(found: ChannelFit, warning: str) -> ChannelFit:
    """The fit where the station might be anywhere, as far as the search went."""
    return replace(
        found,
        status="degenerate",
        standard_errors={**found.standard_errors, "k_pl_db": math.inf, "n_pl": math.inf},
        station_covariance_m2=np.diag([math.inf, math.inf]),
        warnings=(warning, *found.warnings),
    )


def _require_locating(measurements: Measurements) -> None:
    """Refuse measurements that are too few, or on one line."""
    remedy = "give the station's position"
    exact = measurements.positions_m[~measurements.censored]
    if len(exact) < MIN_UNCENSORED:
        raise InputError(
            f"{len(exact)} uncensored measurements cannot tell where the station is", remedy=remedy
        )
    spread = np.linalg.svd(exact - exact.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise InputError(
            "all measurements are on one line: the station may be on either side", remedy=remedy
        )
