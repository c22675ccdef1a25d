"""Path loss of a conditioned channel by least squares, with the error it has under the model.

Least squares weighs every measurement alike. That is not the best estimate where shadowing is
correlated, but it does not depend on xi, beta and omega.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.identifiability import MIN_REGRESSOR_SPREAD_DB
from planopt.channel.estimation.least_squares import receiver_columns
from planopt.channel.mean_model import regressors
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import Station


def least_squares_theta(
    measurements: Measurements,
    values_db: NDArray[np.float64],
    lower: NDArray[np.float64],
    station: Station,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Theta and its error covariance (G'G)^-1 G'UG (G'G)^-1; None where it is not identified.

    Censored measurements are left out, since a limit has no residual. Offsets of receivers are
    estimated along with theta.

    Parameters
    ----------
    measurements, values_db
        n of them, and ``(n,)`` their powers.
    lower
        ``(n, n)`` Cholesky factor of U.
    station
        The fixed station.
    """
    exact = ~measurements.censored
    known = measurements.take(exact)
    gamma = regressors(known.positions_m, station)
    if not len(known) or float(np.ptp(gamma[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return None
    columns = np.column_stack([gamma, receiver_columns(known)])
    inverse = np.linalg.pinv(columns)[: gamma.shape[1]]
    half = inverse @ lower[exact]
    return inverse @ values_db[exact], half @ half.T
