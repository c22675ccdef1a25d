"""Measurements drawn from the model itself, for the tests of estimation."""

import numpy as np

from planopt.channel import Measurements
from planopt.channel.measurements import shadow_covariance_db2
from planopt.channel.parameters import regressors


def simulated(channel, seed, count, side_m, censored_share=0.0, positions=None):
    """Uniform positions on a square, Gaussian powers, the weakest share cut at a floor."""
    rng = np.random.default_rng(seed)
    if positions is None:
        positions = rng.uniform(0.0, side_m, (count, 2))
    covariance = shadow_covariance_db2(positions, positions, channel)
    covariance += channel.multipath_std_db**2 * np.eye(count)
    mean = regressors(positions, channel.station) @ [channel.k_pl_db, channel.n_pl]
    power = mean + np.linalg.cholesky(covariance) @ rng.standard_normal(count)
    floor = np.quantile(power, censored_share) if censored_share else -np.inf
    return Measurements(positions, np.maximum(power, floor), power < floor)


def subset(measurements, rows):
    """The measurements at an index array or mask, in that order."""
    return Measurements(
        measurements.positions_m[rows], measurements.power_dbm[rows], measurements.censored[rows]
    )
