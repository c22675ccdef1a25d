"""Censored and coarsely rounded measurements as Gaussian ones, where there are very many.

The same fixed point as :func:`planopt.channel.intervals.censoring.gaussian_sites`, but for the
measurements left out beside each block, at a cost linear in their number
(:mod:`planopt.channel.nearest.window_sites`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planopt.channel.intervals.censoring import MIN_NOISE_VARIANCE_DB2, intervals, needs_site
from planopt.channel.intervals.sites import Sites, rounded_variance_db2
from planopt.channel.measurement_covariance import (
    measured_origins,
    measured_path_loss_variance_db2,
)
from planopt.channel.measurements import Measurements
from planopt.channel.nearest.window_sites import IntervalRows, window_sites
from planopt.channel.nearest.windows import BLOCK, SITE_BESIDE, place_blocks, surrounding_windows
from planopt.channel.parameters import ChannelParameters
from planopt.channel.path_loss import regressors

TOLERANCE = 1e-3
"""Sites have converged when none moves by more than this in units of its posterior: less than what
the measurements left out change. It takes some ten sweeps."""


def neighbour_sites(parameters: ChannelParameters, measurements: Measurements) -> Sites:
    """Replace censored and rounded measurements as `gaussian_sites` does, each by its neighbours.

    Parameters
    ----------
    parameters
        The channel; its theta is taken as exact.
    measurements
        n measurements, some of which may be censored or rounded.

    Returns
    -------
    Sites
        As :func:`planopt.channel.intervals.censoring.gaussian_sites` has them.
    """
    omega2 = parameters.multipath_std_db**2
    values = measurements.power_dbm.astype(np.float64)
    variances = omega2 + rounded_variance_db2(measurements.resolution_db)
    chosen = needs_site(measurements, omega2)
    rows = np.flatnonzero(chosen)
    if not len(rows):
        return Sites(values, variances)
    omega2 = max(omega2, MIN_NOISE_VARIANCE_DB2)
    displaced = measured_path_loss_variance_db2(measurements, parameters)
    blocks = place_blocks(measurements.positions_m, BLOCK)
    found = window_sites(
        replace(parameters, multipath_std_db=math.sqrt(omega2)),
        measured_origins(measurements, parameters),
        (values, np.maximum(variances, MIN_NOISE_VARIANCE_DB2) + displaced),
        IntervalRows(
            rows,
            intervals(measurements.take(rows)),
            displaced[rows],
            surrounding_windows(
                measurements.positions_m,
                tuple(own for own in blocks if chosen[own].any()),
                SITE_BESIDE,
            ),
        ),
        regressors(measurements.positions_m, parameters.station)
        @ [parameters.k_pl_db, parameters.n_pl],
        None,
        TOLERANCE,
    )
    values[rows], variances[rows] = found.values_db, 1.0 / found.precision
    return Sites(values, variances)
