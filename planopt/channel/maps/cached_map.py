"""The exact posterior at fixed places, kept up to date measurement by measurement.

What a new measurement tells of every place is one more row of L^-1 Phi. The rows so far are kept,
so that a row costs one product with them, and no factor and no earlier row is touched. The price
is memory, ``8 kappa n`` bytes; :class:`planopt.channel.maps.tile_map.TileMap` needs less and is
faster, but uses the nearest measurements only.

Where the channel forgets, the rows are those of the time when they were begun. All measurements age
by the same factor, so that what they tell at a later time is a multiple of that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.factor import spacious, whiten
from planopt.channel.mean_model import regressors
from planopt.channel.measurement_covariance import covariance_db2, fading, place_origins
from planopt.channel.places import require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import KrigingTerms, Prediction, combine

COLUMNS = 4096
"""Places worked on at once."""

LEAST_FADING = 1e-3
"""Rows are computed anew, for the present, once they have faded to this share."""


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
        # All its measurements are counted.
        self._last: ChannelPosterior | None = None
        self._rows: NDArray[np.float64] = np.zeros((0, len(self._places_m)))
        self._path_loss: NDArray[np.float64] = np.zeros((2, 0))
        self._begun_s = 0.0
        # What the rows, of the time when they were begun, say of y, of Gamma and of the variance.
        self._data: NDArray[np.float64] = np.zeros(0)
        self._projected: NDArray[np.float64] = np.zeros((2, 0))
        self._explained: NDArray[np.float64] = np.zeros(0)

    def refresh(self, posterior: ChannelPosterior) -> Prediction:
        """Predict from `posterior`, as :func:`planopt.channel.kriging.predict` does.

        Parameters
        ----------
        posterior
            Usually the last one extended, which costs O(kappa n) for each new measurement;
            anything else is computed from nothing, O(kappa^2 n).
        """
        parameters = posterior.parameters
        before = 0 if self._last is None else len(self._last.measurements)
        faded = fading(
            posterior.measurements.time_s[:before], self._begun_s, posterior.now_s, parameters
        )
        if (
            self._last is None
            or faded is None
            or faded < LEAST_FADING
            or not posterior.continues(self._last)
        ):
            before, faded = 0, 1.0
            self._start(posterior)
        self._append(posterior, before, faded)
        self._last = posterior
        variance = float(parameters.shadow_std_db) ** 2 - faded**2 * self._explained
        terms = KrigingTerms(
            faded * self._data,
            (self._path_loss - faded * self._projected).T,
            # Rounding alone can make the latent variance negative, at a place known exactly.
            np.maximum(variance, 0.0) + parameters.multipath_std_db**2,
        )
        return combine(terms, posterior.theta, posterior.theta_covariance)

    def _start(self, posterior: ChannelPosterior) -> None:
        """Begin without measurements."""
        count = len(self._places_m)
        self._begun_s = posterior.now_s
        station = posterior.parameters.station
        self._path_loss = np.ascontiguousarray(regressors(self._places_m, station).T)
        self._data = np.zeros(count)
        self._projected = np.zeros((2, count))
        self._explained = np.zeros(count)

    def _append(self, posterior: ChannelPosterior, before: int, faded: float) -> None:
        """Add the rows of L^-1 Phi from `before` on, and what they tell.

        `faded` is what kept rows have to be multiplied by to be of the present.
        """
        count = len(posterior.measurements)
        if len(self._rows) < count:
            grown = np.empty((spacious(count), len(self._places_m)))
            grown[:before] = self._rows[:before]
            self._rows = grown
        lower = posterior.factor
        across, within = lower[before:, :before], lower[before:, before:]
        values = posterior.whitened_values[before:]
        columns = posterior.whitened_regressors[before:].T
        origins = posterior.origins.at(slice(before, None))
        for start in range(0, len(self._places_m) if count > before else 0, COLUMNS):
            part = slice(start, start + COLUMNS)
            places = place_origins(self._places_m[part], posterior.now_s, posterior.parameters)
            new = covariance_db2(origins, places, posterior.parameters)
            if faded != 1.0:
                new /= faded
            new -= across @ self._rows[:before, part]
            new = whiten(within, new)
            self._rows[before:count, part] = new
            self._data[part] += values @ new
            self._projected[:, part] += columns @ new
            self._explained[part] += np.einsum("ij,ij->j", new, new)
