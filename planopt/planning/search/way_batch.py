"""Predictions along many ways at once, from one set of measurements near them all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.path_loss import regressors
from planopt.channel.prediction import KrigingTerms, Prediction, combine
from planopt.objectives.local_channel import LocalChannel

NUGGET_SHARE = 1e-4
"""Least variance of multipath as a share of the shadowing's: without any, a place that is measured
twice would make the covariance singular."""


class WayBatch:
    """S and B of theory 4.0 for every way.

    Attributes
    ----------
    ways_m
        ``(c, N, 2)``.
    covariance, trend
        ``(c, N, N)`` S as if theta were known, ``(c, N, 2)`` B.
    """

    def __init__(
        self,
        channel: LocalChannel,
        precision: NDArray[np.float32],
        ways_m: NDArray[np.float64],
    ) -> None:
        self.channel, self.ways_m = channel, ways_m
        parameters = channel.parameters
        places = ways_m.reshape(-1, 2)
        self.phi = shadow_covariance_db2(places, channel.positions_m, parameters, channel.blur_m2)
        self.shape: tuple[int, int] = (len(ways_m), len(places) // max(len(ways_m), 1))
        self.single = self.phi.astype(np.float32)
        solved = (self.single @ precision).reshape(*self.shape, -1)
        by_way = self.single.reshape(*self.shape, -1)
        self.covariance = shadow_covariance_db2(ways_m, ways_m, parameters)
        self.covariance -= solved @ by_way.transpose(0, 2, 1)
        own = np.arange(self.shape[1])
        least = NUGGET_SHARE * parameters.shadow_std_db**2
        nugget = max(parameters.multipath_std_db**2, least)
        self.covariance[:, own, own] += nugget
        trend = regressors(places, parameters.station) - self.phi @ channel.trend
        self.trend = trend.reshape(*self.shape, 2)

    def universal(self) -> NDArray[np.float64]:
        """S + B M B', ``(c, N, N)``."""
        pulled = self.trend @ self.channel.theta_covariance
        return self.covariance + pulled @ self.trend.transpose(0, 2, 1)

    def factor(self) -> NDArray[np.float64]:
        """Cholesky factors of :meth:`universal`."""
        return np.asarray(np.linalg.cholesky(self.universal()), dtype=np.float64)

    def power(self) -> Prediction:
        """Prediction at every place, those of a way together; ``(c N,)``."""
        channel = self.channel
        own = np.arange(self.shape[1])
        terms = KrigingTerms(
            self.phi @ channel.weights,
            self.trend.reshape(-1, 2),
            self.covariance[:, own, own].ravel(),
        )
        return combine(terms, channel.theta, channel.theta_covariance)
