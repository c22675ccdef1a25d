"""Multipath that lasts for some time at a receiver, estimated from the times of a log.

A receiver's averaging, the direction of its antenna and people nearby act alike on successive
readings of a drive, and differently on a later drive. Without regard to time, this part counts as
shadowing, and predictions for a later drive are too confident.
"""

import math
from dataclasses import replace

import numpy as np

from planopt.arrays import Floats
from planopt.channel.cholesky import half_inverse
from planopt.channel.estimation.channel_fit import MIN_VARIANCE_DB2, covariance_bounds
from planopt.channel.estimation.least_squares import Identifiability
from planopt.channel.estimation.likelihood import LikelihoodData, LogNormal, likelihood_data
from planopt.channel.estimation.reml import minimise_damped
from planopt.channel.measurements import Measurements, measured_origins
from planopt.channel.parameters import ChannelParameters, Lasting, mean_model

SAMPLED, RUN = 250, 10  # Maximum sample size, and number of successive readings in its runs
LEAST_SAMPLE = 50  # Minimum sample size for an estimate
LEAST_GAIN = 3.0  # Minimum gain in log-likelihood over white multipath
TOLERANCE = 1e-2  # Predicted gain in log-likelihood at which the search ends
GAPS = (1.0 / 3.0, 5.0, 300.0)
"""Least, initial and greatest time scale, in median times between successive readings."""
SHARES = (0.3, 0.3, 0.4)  # Initial shares of shadowing, white and lasting multipath


def lasting_multipath(
    measurements: Measurements, known: ChannelParameters, allows: Identifiability
) -> Lasting | None:
    """Return the multipath that lasts for some time; None if there is no evidence of it."""
    rows = np.flatnonzero(~measurements.censored)
    asked = replace(known, lasting=Lasting(0.5, 1.0))
    times_s = measured_origins(measurements, asked).lasting_s
    if times_s is None:
        raise AssertionError("origins with lasting multipath have times")
    rows = rows[np.argsort(times_s[rows], kind="stable")]
    if len(rows) > SAMPLED:
        first = np.linspace(0, len(rows) - RUN, SAMPLED // RUN).astype(np.intp)
        rows = rows[np.unique(first[:, None] + np.arange(RUN))]
    sample, times_s = measurements.take(rows), times_s[rows]
    gaps_s = np.diff(times_s)
    if len(rows) < LEAST_SAMPLE or not (gaps_s > 0.0).any():
        return None
    every = np.ones(len(rows), dtype=np.bool_)
    model = mean_model(sample.positions_m, every, known.station, allows.n_pl_reason is None)
    data = likelihood_data(model, sample, known)
    prior = LogNormal.for_extent(allows.rotated_extent_m)
    variance = max(float(data.values_db.var()), MIN_VARIANCE_DB2)
    bounds = covariance_bounds(variance, allows.decorrelation_bounds_m)
    scales = np.array(GAPS) * np.median(gaps_s[gaps_s > 0.0])
    ranges = (bounds.shadow_db2, bounds.multipath_db2, bounds.shadow_db2, bounds.decorrelation_m)
    apart_s = np.abs(times_s[:, None] - times_s)
    box = np.log([*ranges, (scales[0], scales[2])]).T
    start = np.log([*np.multiply(SHARES, variance), prior.median_m, scales[1]])

    def objective(logs: Floats) -> tuple[float, Floats, Floats]:
        return _objective(data, apart_s, logs, prior)

    lasting, logs = minimise_damped(objective, start, box[0], box[1], TOLERANCE)
    # Without it, lasting multipath counts as shadowing.
    white = np.array([np.logaddexp(logs[0], logs[2]), logs[1], box[0, 2], *logs[3:]])
    fixed = np.where([False, False, True, False, True], white, box)
    alone, _ = minimise_damped(objective, white, fixed[0], fixed[1], TOLERANCE)
    if alone - lasting < LEAST_GAIN:
        return None
    return Lasting(1.0 / (1.0 + math.exp(logs[1] - logs[2])), math.exp(logs[4]))


def _objective(
    data: LikelihoodData, apart_s: Floats, logs: Floats, prior: LogNormal
) -> tuple[float, Floats, Floats]:
    """Return -log L, its gradient (5,) and curvature (5, 5) with respect to logarithms."""
    # The logarithms of xi^2, white omega^2, lasting omega^2, beta and the time scale.
    shadow, white, lasting, beta, lasting_s = np.exp(logs)
    placed, gap = shadow * data.correlation(0, beta), apart_s / lasting_s
    lasted = lasting * np.exp(-gap)
    total = placed + lasted
    total.flat[:: len(total) + 1] += white + data.fixed_db2
    determinant, half = half_inverse(total)
    inverse = half + np.triu(half, 1).T
    weights = inverse @ data.columns
    information = data.columns.T @ weights + np.diag(data.prior_precision)
    projection = inverse - weights @ np.linalg.inv(information) @ weights.T
    left = projection @ data.values_db
    unit = np.diag(np.full(len(total), white))
    slopes = (placed, unit, lasted, placed * data.distances_m[0] / beta, lasted * gap)
    moved = np.stack([slope @ left for slope in slopes])
    traces = np.array([np.vdot(projection, slope) for slope in slopes])
    apart = math.log(beta / prior.median_m) / prior.deviation
    logarithm = determinant + float(np.linalg.slogdet(information)[1])
    gradient, curvature = traces - moved @ left, moved @ projection @ moved.T
    gradient[3] += 2.0 * apart / prior.deviation
    curvature[3, 3] += 2.0 / prior.deviation**2
    value = logarithm + float(data.values_db @ left) + apart**2
    return 0.5 * value, 0.5 * gradient, 0.5 * curvature
