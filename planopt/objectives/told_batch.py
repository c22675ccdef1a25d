"""What the measurements that the loop will take along many ways tell, from S and B of all places.

A place of gate g counts as :mod:`planopt.objectives.gated_batch` has it: 1 where it brings a
measurement, 0 where it brings none, and between where ways climb, so that slopes show the way out.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.gated_batch import blind_variance_db2
from planopt.objectives.local_channel import LocalGrid
from planopt.objectives.way_batch import WayBatch
from planopt.objectives.way_slopes import Pull


class ToldBatch:
    """S_g and B_g of every way.

    Parameters
    ----------
    batch
        S and B of one station.
    gate
        ``(c, N)``; None where every place brings a measurement.

    Attributes
    ----------
    batch, gate
        As given.
    covariance, trend
        ``(c, N, N)`` S_g as if theta were known, ``(c, N, 2)`` B_g.
    blind_db2
        Variance of a measurement that tells nothing.
    """

    def __init__(self, batch: WayBatch, gate: NDArray[np.float64] | None) -> None:
        self.batch, self.gate = batch, gate
        self.covariance, self.trend = batch.covariance, batch.trend
        self.blind_db2 = blind_variance_db2(batch.channel.parameters)
        if gate is None:
            return
        blind = self.blind_db2 * np.eye(batch.shape[1])
        self._told = batch.covariance - blind
        self.covariance = gate[:, :, None] * gate[:, None] * self._told + blind
        self.trend = gate[:, :, None] * batch.trend

    @cached_property
    def universal(self) -> NDArray[np.float64]:
        """S_g + B_g M B_g', ``(c, N, N)``."""
        if self.gate is None:
            return self.batch.universal
        pulled = self.trend @ self.batch.channel.theta_covariance
        return self.covariance + pulled @ self.trend.transpose(0, 2, 1)

    @cached_property
    def factor(self) -> NDArray[np.float64]:
        """Cholesky factors of :attr:`universal`."""
        return np.asarray(np.linalg.cholesky(self.universal), dtype=np.float64)

    @cached_property
    def inverse(self) -> NDArray[np.float64]:
        """Inverses of :attr:`universal`."""
        return np.asarray(np.linalg.inv(self.universal), dtype=np.float64)

    @cached_property
    def noise_db2(self) -> NDArray[np.float64]:
        """Variance at every place that is no channel's, ``(c, N)``: all of it where gates are 0."""
        noise = np.full(self.batch.shape, self.batch.channel.parameters.multipath_std_db**2)
        if self.gate is None:
            return noise
        return self.blind_db2 + self.gate**2 * (noise - self.blind_db2)

    @cached_property
    def across(self) -> NDArray[np.float32]:
        """c(g) weighted, of the gated measurements; ``(c, N, g)``."""
        across = self.batch.across[2]
        return across if self.gate is None else self.gate.astype(np.float32)[:, :, None] * across

    @property
    def grid(self) -> LocalGrid:
        """Where a map is wanted."""
        return self.batch.required_grid

    def above_db2(self, threshold_db2: float) -> NDArray[np.float64]:
        """How much L_ii^2 is above a threshold, times the squared gate where it is; ``(c, N)``."""
        variance = np.diagonal(self.factor, axis1=1, axis2=2) ** 2
        if self.gate is not None:
            # With a gate g, L_ii^2 is kappa + g^2 (that of the whole measurement - kappa).
            variance = variance - self.blind_db2
            threshold = self.gate**2 * (threshold_db2 - self.blind_db2)
            return np.maximum(variance - threshold, 0.0)
        return np.maximum(variance - threshold_db2, 0.0)

    def pulled_back(self, pull: Pull) -> Pull:
        """From slopes by S_g, B_g and the gates to those by S, B and the gates."""
        if self.gate is None:
            return pull
        by_gate = np.zeros(self.batch.shape) if pull.by_gate is None else pull.by_gate.copy()
        by_covariance, by_trend = pull.by_covariance, pull.by_trend
        if by_covariance is not None:
            by_gate += 2.0 * np.einsum("cij,cij,cj->ci", by_covariance, self._told, self.gate)
            by_covariance = self.gate[:, :, None] * self.gate[:, None] * by_covariance
        if by_trend is not None:
            by_gate += (by_trend * self.batch.trend).sum(axis=2)
            by_trend = self.gate[:, :, None] * by_trend
        return Pull(pull.by_place, by_covariance, by_trend, pull.by_phi, by_gate)
