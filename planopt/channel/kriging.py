"""Kriging: mean and standard deviation of power from all measurements or from the nearest.

:class:`LocalChannel` estimates path loss and receiver offsets, with their uncertainty, from all
measurements, and shadowing from those nearest to chosen positions. Its variance is at least that
given all measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaincinv, ndtr, ndtri

from planopt.arrays import Floats, Indices
from planopt.channel.cholesky import inverse, lower_factor, whiten, whitened_by
from planopt.channel.long_logs import EARLIER_NEIGHBOURS, OffsetsGivenTheta, offsets_given_theta
from planopt.channel.measurements import (
    Measurements,
    Origins,
    ageing,
    covariance_db2,
    measured_origins,
    measured_path_loss_variance_db2,
    own_covariance_db2,
    own_variance_db2,
    path_loss_variance_db2,
    place_origins,
    shadow_covariance_db2,
)
from planopt.channel.parameters import ChannelParameters, regressors, require_count, require_places
from planopt.short_repr import short_repr

if TYPE_CHECKING:
    from planopt.channel.posterior import ChannelPosterior


@dataclass(frozen=True)
class Prediction:
    """Predicted received power.

    Attributes
    ----------
    mean_db
        ``(n,)`` predicted mean in dBm.
    deviation_db
        ``(n,)`` standard deviation of the power that would be measured, from shadowing, multipath
        and the uncertainty of theta.
    """

    mean_db: Floats
    deviation_db: Floats

    __repr__ = short_repr

    def at(self, rows: Indices) -> Prediction:
        """Return the prediction at the positions with indices `rows`."""
        return Prediction(self.mean_db[rows], self.deviation_db[rows])


@dataclass(frozen=True)
class KrigingTerms:
    """Terms of a prediction at n positions that do not depend on path loss (equation 1.6)."""

    data_db: Floats  # (n,) a = phi' U^-1 y
    trend: Floats  # (n, 2) varphi = gamma - Gamma' U^-1 phi
    variance_db2: Floats  # (n,) s = xi^2 + omega^2 - phi' U^-1 phi


def combine(terms: KrigingTerms, theta: Floats, theta_covariance: Floats) -> Prediction:
    """Return the prediction for the path loss theta with covariance M (equation 1.8)."""
    first, second = terms.trend[..., 0], terms.trend[..., 1]
    mean = terms.data_db + first * theta[0] + second * theta[1]
    variance = terms.variance_db2 + (
        theta_covariance[0, 0] * first**2
        + 2.0 * theta_covariance[0, 1] * first * second
        + theta_covariance[1, 1] * second**2
    )
    return Prediction(mean, np.sqrt(variance))


def bound_quantile(p_min: float) -> float:
    """Return z_p, the `p_min` quantile of the standard normal (equation 3.2)."""
    return float(np.asarray(ndtri(p_min), dtype=np.float64))


def bound_margin_db(
    mean_db: Floats, deviation_db: Floats, threshold_dbm: float, p_min: float
) -> Floats:
    """Return mean - z_p deviation - threshold in dB, infinite if `p_min` is 0 (equation 3.2)."""
    kept_db = bound_quantile(p_min) * (deviation_db if p_min > 0.0 else 1.0)
    return mean_db - kept_db - threshold_dbm


def connection_probability(mean_db: Floats, deviation_db: Floats, threshold_dbm: float) -> Floats:
    """Return P(power >= threshold) = Phi((mean - threshold) / deviation) (equation 3.1)."""
    # The result is NaN if the prediction is NaN, and 0 or 1 if the standard deviation is 0.
    above = mean_db - threshold_dbm
    certain = np.where(above >= 0.0, np.inf, -np.inf)
    return score_probability(np.divide(above, deviation_db, out=certain, where=deviation_db != 0.0))


def score_probability(score: Floats) -> Floats:
    """Return the normal probability of scores (mean - threshold) / deviation."""
    return np.asarray(ndtr(score), dtype=np.float64)


CONFIDENCE = 0.95  # Level of all confidence intervals


def binomial_interval(successes: float, trials: float) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a probability; counts may be fractional."""
    failures, tail = trials - successes, 0.5 - 0.5 * CONFIDENCE
    low = 0.0 if successes <= 0.0 else float(betaincinv(successes, failures + 1.0, tail))
    high = 1.0 if failures <= 0.0 else float(betaincinv(successes + 1.0, failures, 1.0 - tail))
    return low, high


PREDICTION_ELEMENTS = 2**17
"""Target number of covariances in a block of predictions, so that a block stays in cache."""

LEAST_BLOCK = 256


def predict(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,  # (n, 2); memory is bounded for any n
    position_std_m: Floats | None = None,  # (n,)
) -> Prediction:
    """Predict mean and standard deviation of the power that would be measured (equation 1.8)."""
    places = require_places(positions_m, at_least=0)
    terms = kriging_terms(posterior, places, position_std_m)
    return combine(terms, posterior.theta, posterior.theta_covariance)


def kriging_terms(
    posterior: ChannelPosterior,
    positions_m: Floats,  # (n, 2)
    position_std_m: Floats | None = None,  # (n,)
) -> KrigingTerms:
    """Return the terms of a prediction that do not depend on the path loss theta."""
    if not posterior.has_factor:
        return nearby_terms(posterior, positions_m, NEIGHBOURS_BEYOND, position_std_m)
    count, known = len(positions_m), len(posterior.measurements)
    parameters = posterior.parameters
    columns = np.column_stack([posterior.whitened_values, posterior.whitened_regressors])
    projected = np.empty((3, count))
    explained = np.empty(count)
    block = max(LEAST_BLOCK, PREDICTION_ELEMENTS // max(1, known))
    for start in range(0, count, block):
        part = slice(start, start + block)
        std_m = None if position_std_m is None else position_std_m[part]
        places = place_origins(positions_m[part], posterior.now_s, parameters, std_m)
        across = covariance_db2(posterior.origins, places, parameters)
        whitened = whiten(posterior.factor, across)
        projected[:, part] = columns.T @ whitened
        explained[part] = np.einsum("ij,ij->j", whitened, whitened)
    trend = regressors(positions_m, parameters.station) - projected[1:].T
    # Rounding errors can make the latent variance negative at a noise-free measured position.
    latent = np.maximum(parameters.shadow_std_db**2 - explained, 0.0)
    variance = latent + parameters.multipath_std_db**2
    if position_std_m is not None:
        variance += path_loss_variance_db2(
            positions_m, position_std_m, parameters.station, float(posterior.theta[1])
        )
    return KrigingTerms(projected[0], trend, variance)


def predict_noiseless(posterior: ChannelPosterior, more: Measurements) -> Prediction:
    """Predict the powers of `more` with receiver offset and position error, without multipath."""
    parameters = posterior.parameters
    origins = measured_origins(more, parameters)
    gamma = regressors(more.positions_m, parameters.station)
    if posterior.has_factor:
        whitened = whiten(posterior.factor, covariance_db2(posterior.origins, origins, parameters))
        latent = own_variance_db2(origins, parameters) - np.einsum("ij,ij->j", whitened, whitened)
        data = posterior.whitened_values @ whitened
        trend = gamma - whitened.T @ posterior.whitened_regressors
    else:
        near, _ = posterior.index.nearest(more.positions_m, EARLIER_NEIGHBOURS)
        neighbours = posterior.origins.at(near)
        covariance = own_covariance_db2(neighbours, parameters)
        np.einsum("kii->ki", covariance)[...] += posterior.noise_variance_db2[near]
        own = origins.at(np.arange(len(more))[:, None])
        across = covariance_db2(own, neighbours, parameters)
        weights = np.linalg.solve(covariance, across.swapaxes(1, 2))[:, :, 0]
        gamma_near = regressors(posterior.measurements.positions_m[near], parameters.station)
        latent = own_variance_db2(origins, parameters) - np.vecdot(weights, across[:, 0])
        data = np.vecdot(weights, posterior.values_db[near])
        trend = gamma - np.einsum("km,kmi->ki", weights, gamma_near)
    variance = np.maximum(latent, 0.0) + measured_path_loss_variance_db2(more, parameters)
    return combine(KrigingTerms(data, trend, variance), posterior.theta, posterior.theta_covariance)


NEIGHBOURS_BEYOND = 192
"""Minimum number of measurements per position without a full factor. For 50,000 measurements on a
100 m square, mean and standard deviation are within 0.005 dB and 1e-5 dB of those from 1,024."""
GROUP = 64
"""Maximum number of positions predicted from the same measurements: a path, or a grid square."""
GROUP_SHARE = 2.5
"""Maximum number of measurements for a group of positions, relative to those for one."""


@dataclass(frozen=True, eq=False)
class LocalChannel:
    """Kriging from a subset of m measurements, or from k such subsets (leading axis k)."""

    # With phi_i(q) = xi^2 exp(-sqrt(|q - position_i|^2 + blur_i) / beta), a prediction at q has
    # mean ``gamma theta + phi' (weights - trend theta)`` and variance ``xi^2 + omega^2 - phi'
    # precision phi + b' M b`` with ``b = gamma - trend' phi``. `precision`, `weights` and `trend`
    # include the age factors a_i: a_i P_ij a_j and a_i w_i.

    parameters: ChannelParameters
    origins: Origins  # (..., m) of the measurements, without receivers' offsets
    now_s: float  # Time of the prediction
    covariance_db2: Floats  # (..., m, m) U_mm without offsets
    columns: Floats  # (..., m, 3) [y, Gamma] less the receivers' mean offsets
    received: Floats  # (..., m, R) receiver indicators Z
    offsets: OffsetsGivenTheta
    theta: Floats  # (2,) (K_PL, n_PL)
    theta_covariance: Floats  # (2, 2) M

    @staticmethod
    def of(
        posterior: ChannelPosterior,
        used: Indices,  # (..., m) indices of the measurements
        offsets: OffsetsGivenTheta | None = None,
    ) -> LocalChannel:
        """Return the channel conditional on the measurements with indices `used`."""
        parameters = posterior.parameters
        offsets = offsets or offsets_given_theta(posterior)
        origins = posterior.origins.at(used).without_offsets()
        covariance = own_covariance_db2(origins, parameters)
        np.einsum("...ii->...i", covariance)[...] += posterior.noise_variance_db2[used]
        columns = np.empty((*used.shape, 3))
        columns[..., 0] = posterior.values_db[used]
        columns[..., 1:] = regressors(origins.positions_m, parameters.station)
        received = offsets.indicators(posterior.measurements.receiver[used])
        if len(offsets.receivers):
            columns -= received @ offsets.means_db
        return LocalChannel(
            parameters,
            origins,
            posterior.now_s,
            covariance,
            columns,
            received,
            offsets,
            posterior.theta,
            posterior.theta_covariance,
        )

    @staticmethod
    def around(posterior: ChannelPosterior, positions_m: Floats, count: int) -> LocalChannel:
        """Return the channel conditional on the `count` measurements nearest to a path (h, 2)."""
        return LocalChannel.of(posterior, nearest_to_path(posterior, positions_m, count))

    @staticmethod
    def around_each(posterior: ChannelPosterior, centres_m: Floats, count: int) -> LocalChannel:
        """Return k channels, each from the `count` measurements nearest to a centre (k, 2)."""
        return LocalChannel.of(posterior, posterior.index.nearest(centres_m, count)[0])

    @property
    def positions_m(self) -> Floats:
        """Positions (..., m, 2) of the measurements."""
        return self.origins.positions_m

    @cached_property
    def added_m2(self) -> Floats:
        """Increase (..., m) of squared distances due to position errors of the measurements."""
        blur = self.origins.blur_m2
        return np.zeros(self.columns.shape[:-1]) if blur is None else blur

    @cached_property
    def inverse(self) -> Floats:
        """Inverse covariance (..., m, m) with uncertain receiver offsets, without age factors."""
        # The result is P - P Z V Z' P, P the inverse for known offsets, V their covariance.
        if self.covariance_db2.ndim == 2:
            found = inverse(lower_factor(self.covariance_db2))
        else:
            found = np.asarray(np.linalg.inv(self.covariance_db2), dtype=np.float64)
        if not len(self.offsets.receivers):
            return found
        projected = found @ self.received
        return found - projected @ self.offsets.covariance_db2 @ projected.swapaxes(-1, -2)

    @cached_property
    def _weighted(self) -> Floats:
        """Inverse covariance times the columns [power, regressors] as an array (..., m, 3)."""
        if not len(self.offsets.receivers):
            return self.inverse @ self.columns
        return np.asarray(np.linalg.solve(self.covariance_db2, self.columns), dtype=np.float64)

    @cached_property
    def _aged(self) -> Floats | None:
        """Age factor (..., m) of each measurement; None for a static channel."""
        times = self.origins.time_s
        return None if times is None else ageing(times, self.now_s, self.parameters)

    @cached_property
    def precision(self) -> Floats:
        """Inverse covariance (..., m, m) of the measurements, age factors included."""
        aged = self._aged
        return self.inverse if aged is None else self.inverse * aged[..., None] * aged[..., None, :]

    @cached_property
    def single_precision(self) -> Any:
        """Inverse covariance :attr:`precision` in single precision, for ranking."""
        return self.precision.astype(np.float32)

    @cached_property
    def weights_and_trend(self) -> Floats:
        """Columns (..., m, 3) of :attr:`weights` and :attr:`trend`."""
        return np.concatenate([self.weights[..., None], self.trend], axis=-1)

    @cached_property
    def weights(self) -> Floats:
        """Kriging weights (..., m): inverse covariance times powers, times age factors."""
        weights = self._weighted[..., 0]
        return np.ascontiguousarray(weights if self._aged is None else self._aged * weights)

    @cached_property
    def trend(self) -> Floats:
        """Inverse covariance times the path loss regressors, (..., m, 2), with age factors."""
        trend = self._weighted[..., 1:]
        return np.ascontiguousarray(trend if self._aged is None else self._aged[..., None] * trend)

    def rows_db2(
        self,
        places_m: Floats,  # (..., p, 2)
        position_std_m: Floats | None = None,  # (..., p)
    ) -> Floats:
        """Return covariances (..., p, m) of powers at positions and measurements, with ageing."""
        places = place_origins(places_m, self.now_s, self.parameters, position_std_m)
        return covariance_db2(places, self.origins, self.parameters)

    def terms(
        self,
        places_m: Floats,  # (..., p, 2)
        rows_db2: Floats | None = None,  # (..., p, m) from `rows_db2`, if computed
    ) -> KrigingTerms:
        """Return kriging terms at positions (..., p, 2) for each subset of measurements."""
        rows = self.rows_db2(places_m) if rows_db2 is None else rows_db2
        latent = np.full(rows.shape[:-1], self.parameters.shadow_std_db**2)
        if rows.ndim == 2:
            right = np.concatenate([self.columns, rows.T, self.received], axis=1)
            whitened = whitened_by(self.covariance_db2.copy(), right)
            columns, half, received = np.split(whitened, [3, 3 + len(rows)], axis=1)
            projected = half.T @ columns
            latent -= np.einsum("ij,ij->j", half, half)
            if len(self.offsets.receivers):
                offset = half.T @ received
                latent += ((offset @ self.offsets.covariance_db2) * offset).sum(axis=-1)
        else:
            projected = rows @ self._weighted
            latent -= ((rows @ self.inverse) * rows).sum(axis=-1)
        trend = regressors(places_m, self.parameters.station) - projected[..., 1:]
        # Rounding errors can make the latent variance negative at a noise-free measured position.
        variance = np.maximum(latent, 0.0) + self.parameters.multipath_std_db**2
        return KrigingTerms(projected[..., 0], trend, variance)

    def predict(self, places_m: Floats) -> Prediction:
        """Predict the power at positions (..., p, 2)."""
        return combine(self.terms(places_m), self.theta, self.theta_covariance)


def nearest_to_path(posterior: ChannelPosterior, path_m: Floats, count: int) -> Indices:
    """Return indices of the `count` measurements nearest to a path (h, 2), or of all if fewer."""
    # All nearest come first, then all second nearest, so every position is represented.
    places = require_places(path_m)
    measured = posterior.measurements.positions_m
    there = min(require_count(count, "count"), len(measured))
    chosen, _ = posterior.index.nearest(places, there)
    away = np.linalg.norm(measured[chosen] - places[:, None], axis=2)
    order = np.take_along_axis(chosen, np.argsort(away, axis=1, kind="stable"), axis=1)
    by_rank, first = np.unique(order.T.ravel(), return_index=True)
    return by_rank[np.argsort(first)][:there]


@dataclass(frozen=True, eq=False)
class LocalGrid:
    """Grid positions with kriging terms precomputed from one local channel."""

    positions_m: Floats  # (g, 2)
    root_weight: Floats  # (g,) square roots of the weights
    solved: Floats  # (m, g) U_mm^-1 Phi_g
    trend: Floats  # (g, 2) varphi(g)'

    @staticmethod
    def of(channel: LocalChannel, grid_m: Floats, weight: Floats) -> LocalGrid:
        """Precompute the kriging terms of grid positions (g, 2) with weights (g,) >= 0."""
        phi = shadow_covariance_db2(
            channel.positions_m, grid_m, channel.parameters, channel.added_m2[:, None]
        )
        return LocalGrid(
            grid_m,
            np.sqrt(weight),
            channel.precision @ phi,
            regressors(grid_m, channel.parameters.station) - phi.T @ channel.trend,
        )


def predict_nearby(posterior: ChannelPosterior, positions_m: Floats, count: int) -> Prediction:
    """Predict the power at each position (n, 2) from at least its `count` nearest measurements."""
    terms = nearby_terms(posterior, positions_m, count)
    return combine(terms, posterior.theta, posterior.theta_covariance)


def nearby_terms(
    posterior: ChannelPosterior,
    positions_m: Floats,
    count: int,
    position_std_m: Floats | None = None,  # (n,) of position errors
) -> KrigingTerms:
    """Return the terms of :func:`predict_nearby` that do not depend on the path loss theta."""
    offsets = offsets_given_theta(posterior)
    places = len(positions_m)
    terms = KrigingTerms(np.empty(places), np.empty((places, 2)), np.empty(places))
    for rows, used in _groups(posterior, positions_m, count):
        std_m = None if position_std_m is None else position_std_m[rows]
        channel = LocalChannel.of(posterior, used, offsets)
        found = channel.terms(positions_m[rows], channel.rows_db2(positions_m[rows], std_m))
        terms.data_db[rows], terms.trend[rows] = found.data_db, found.trend
        terms.variance_db2[rows] = found.variance_db2
    if position_std_m is not None:
        terms.variance_db2[...] += path_loss_variance_db2(
            positions_m, position_std_m, posterior.parameters.station, float(posterior.theta[1])
        )
    return terms


def _groups(
    posterior: ChannelPosterior, positions_m: Floats, count: int
) -> Iterator[tuple[Indices, Indices]]:
    """Yield groups of positions, with the nearest measurements of all positions in each group."""
    pending = [np.arange(len(positions_m))] if len(positions_m) else []
    while pending:
        rows = pending.pop()
        if len(rows) <= GROUP:
            used = np.unique(posterior.index.nearest(positions_m[rows], count)[0])
            if len(rows) == 1 or len(used) <= GROUP_SHARE * count:
                yield rows, used
                continue
        along = positions_m[rows, int(np.ptp(positions_m[rows], axis=0).argmax())]
        middle = len(rows) // 2
        order = np.argpartition(along, middle)
        pending += [rows[order[:middle]], rows[order[middle:]]]
