"""The exact posterior at fixed places, kept up to date measurement by measurement.

What a new measurement tells of every place is one more row of L^-1 Phi. The rows so far are kept,
so that a row costs one product with them, and no factor and no earlier row is touched. The price
is memory, ``8 kappa n`` bytes; :class:`planopt.channel.tile_map.TileMap` needs less and is faster,
but uses the nearest measurements only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import spacious, whiten
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.parameters import ChannelParameters
from planopt.channel.path_loss import regressors
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine

COLUMNS = 4096
"""Places worked on at once."""


class CachedMap:
    """Predictions at fixed places that follow a growing posterior exactly.

    Parameters
    ----------
    positions_m
        ``(n, 2)`` where to predict.

    Raises
    ------
    InputError
        Positions are not ``(n, 2)`` and finite.
    """

    def __init__(self, positions_m: NDArray[np.float64]) -> None:
        self._places_m = require_places(positions_m)
        self._parameters: ChannelParameters | None = None
        # Position, value and noise variance of every measurement already counted.
        self._seen: NDArray[np.float64] = np.zeros((0, 4))
        self._rows: NDArray[np.float64] = np.zeros((0, len(self._places_m)))
        self._data: NDArray[np.float64] = np.zeros(0)
        self._trend: NDArray[np.float64] = np.zeros((2, 0))
        self._latent: NDArray[np.float64] = np.zeros(0)

    def refresh(self, posterior: ChannelPosterior) -> Prediction:
        """Predict from `posterior`, as :func:`planopt.channel.posterior.predict` does.

        Parameters
        ----------
        posterior
            Usually the last one extended, which costs O(kappa n) for each new measurement;
            anything else is computed from nothing, O(kappa^2 n).
        """
        now = np.column_stack(
            [posterior.measurements.positions_m, posterior.values_db, posterior.noise_variance_db2]
        )
        before = len(self._seen)
        if posterior.parameters != self._parameters or not np.array_equal(now[:before], self._seen):
            before = 0
            self._start(posterior.parameters)
        self._append(posterior, before)
        self._seen = now
        nugget = posterior.parameters.multipath_std_db**2
        # Rounding alone can make the latent variance negative, at a place that is known exactly.
        terms = KrigingTerms(self._data, self._trend.T, np.maximum(self._latent, 0.0) + nugget)
        return combine(terms, posterior.theta, posterior.theta_covariance)

    def _start(self, parameters: ChannelParameters) -> None:
        """Begin without measurements."""
        count = len(self._places_m)
        self._parameters = parameters
        self._data = np.zeros(count)
        self._trend = np.ascontiguousarray(regressors(self._places_m, parameters.station).T)
        self._latent = np.full(count, float(parameters.shadow_std_db) ** 2)

    def _append(self, posterior: ChannelPosterior, before: int) -> None:
        """Add the rows of L^-1 Phi from `before` on, and what they tell."""
        count = len(posterior.measurements)
        if len(self._rows) < count:
            grown = np.empty((spacious(count), len(self._places_m)))
            grown[:before] = self._rows[:before]
            self._rows = grown
        lower = posterior.factor
        across, within = lower[before:, :before], lower[before:, before:]
        values = posterior.whitened_values[before:]
        columns = posterior.whitened_regressors[before:].T
        at = posterior.measurements.positions_m[before:]
        for start in range(0, len(self._places_m) if count > before else 0, COLUMNS):
            part = slice(start, start + COLUMNS)
            new = shadow_covariance_db2(at, self._places_m[part], posterior.parameters)
            new -= across @ self._rows[:before, part]
            new = whiten(within, new)
            self._rows[before:count, part] = new
            self._data[part] += values @ new
            self._trend[:, part] -= columns @ new
            self._latent[part] -= np.einsum("ij,ij->j", new, new)
