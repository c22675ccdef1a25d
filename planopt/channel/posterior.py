"""Lemma 2: the received power anywhere, given measurements, with path loss estimated on the way.

The factor of the measurements' covariance is what costs. It is kept, shared between successive
posteriors, and grows by rows, so that one more measurement costs O(n^2) and copies nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.censoring import (
    MIN_NOISE_VARIANCE_DB2,
    Sites,
    censored_sites,
    gaussian_sites,
)
from planopt.channel.cholesky import solve_rows
from planopt.channel.connectivity import connection_probability
from planopt.channel.factor import FactorBuffer, spacious, whiten
from planopt.channel.kernel import shadow_covariance_db2
from planopt.channel.measurements import Measurements, join
from planopt.channel.parameters import ChannelParameters
from planopt.channel.path_loss import regressors
from planopt.channel.prediction import KrigingTerms, Prediction, combine

WEAK_THETA_DEVIATION = (20.0, 1.0)
"""Prior deviation of K_PL (dB) and n_PL, used only where the measurements do not identify theta."""

MAX_INFORMATION_CONDITION = 1e10
"""Theta counts as identified while the condition number of its information, in units of
`WEAK_THETA_DEVIATION`, is below this."""

FACTOR_BLOCK = 512
PREDICTION_ELEMENTS = 2**21

MANY_PLACES = 1024
"""From so many places on a copy of the factor is worth its time, and they are solved for in place:
a map takes half as long."""

PLACES_AT_ONCE = 512
"""Of many places: their covariances then stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class ChannelPosterior:
    """The channel given measurements (seed, Lemma 2; universal kriging, theory 4.1).

    Attributes
    ----------
    parameters
        The channel's parameters; its theta is used where theta is known, and as the centre of
        the weak prior.
    measurements
        What was measured, kappa of them.
    values_db
        ``(kappa,)`` what the posterior is conditioned on: the measured power, and the site's
        value where it is censored.
    noise_variance_db2
        ``(kappa,)`` omega^2, and the site's variance where censored.
    whitened_values
        ``(kappa,)`` z_y = L^-1 y with U = R + diag(noise) = L L'.
    whitened_regressors
        ``(kappa, 2)`` z_Gamma = L^-1 Gamma.
    theta
        ``(2,)`` (K_PL, n_PL) in use.
    theta_covariance
        ``(2, 2)`` M, its covariance; zero where theta is known.
    theta_known
        Whether theta was given rather than estimated.
    buffer
        Where the factor is stored, shared with the posteriors that extend this one.
    """

    parameters: ChannelParameters
    measurements: Measurements
    values_db: NDArray[np.float64]
    noise_variance_db2: NDArray[np.float64]
    whitened_values: NDArray[np.float64]
    whitened_regressors: NDArray[np.float64]
    theta: NDArray[np.float64]
    theta_covariance: NDArray[np.float64]
    theta_known: bool
    buffer: FactorBuffer = field(repr=False)

    @property
    def factor(self) -> NDArray[np.float64]:
        """Lower Cholesky factor L of U, ``(kappa, kappa)``; a view, not to be written to."""
        count = len(self.measurements)
        return self.buffer.lower[:count, :count]

    def predict(self, positions_m: NDArray[np.float64]) -> Prediction:
        """See :func:`predict`."""
        return predict(self, positions_m)

    def extend(self, more: Measurements) -> ChannelPosterior:
        """See :func:`extend`."""
        return extend(self, more)

    def connectivity(
        self, positions_m: NDArray[np.float64], threshold_dbm: float
    ) -> NDArray[np.float64]:
        """P(power >= `threshold_dbm`) at each of `positions_m` (n, 2); ``(n,)``."""
        prediction = predict(self, positions_m)
        return connection_probability(prediction.mean_db, prediction.deviation_db, threshold_dbm)


def condition(
    parameters: ChannelParameters,
    measurements: Measurements,
    *,
    theta: Literal["estimated", "known"] = "estimated",
) -> ChannelPosterior:
    """Condition the channel model on measurements (seed, Lemma 2).

    Parameters
    ----------
    parameters
        The channel's parameters.
    measurements
        Any number, none included. Censored ones enter as Gaussian sites.
    theta
        ``estimated``: path loss by generalised least squares, its uncertainty counted (theory
        4.1); ``known``: `parameters` has it exactly.
    """
    sites = gaussian_sites(parameters, measurements)
    nothing = Measurements(np.zeros((0, 2)), np.zeros(0), np.zeros(0, dtype=bool))
    empty = _assemble(
        parameters,
        nothing,
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 3)),
        theta == "known",
        FactorBuffer(spacious(len(measurements))),
    )
    return _append(empty, measurements, sites)


def extend(posterior: ChannelPosterior, more: Measurements) -> ChannelPosterior:
    """Condition on more measurements without refitting, O(kappa^2) for each.

    A censored one becomes a Gaussian site by matching the first two moments of its own prediction
    truncated from above, and stays that site. `posterior` remains valid.
    """
    start = 0
    while start < len(more):
        stop = start + 1
        if not more.censored[start]:
            while stop < len(more) and not more.censored[stop]:
                stop += 1
        part = more.take(slice(start, stop))
        sites = (
            _censored_site(posterior, part)
            if part.censored[0]
            else gaussian_sites(posterior.parameters, part)
        )
        posterior = _append(posterior, part, sites)
        start = stop
    return posterior


def predict(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> Prediction:
    """Mean and deviation of the power that would be measured (theory 4.1), from all measurements.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(n, 2)``; memory stays bounded whatever n.
    """
    return combine(
        kriging_terms(posterior, positions_m), posterior.theta, posterior.theta_covariance
    )


def kriging_terms(posterior: ChannelPosterior, positions_m: NDArray[np.float64]) -> KrigingTerms:
    """The parts of a prediction at `positions_m` (n, 2) that do not depend on theta."""
    count = len(positions_m)
    data = np.zeros(count)
    trend = regressors(positions_m, posterior.parameters.station)
    variance = np.empty(count)
    prior = posterior.parameters.shadow_std_db**2
    measured = posterior.measurements.positions_m
    many = count >= MANY_PLACES and len(measured) > 0
    lower = np.asfortranarray(posterior.factor) if many else posterior.factor
    block = PLACES_AT_ONCE if many else max(1, PREDICTION_ELEMENTS // max(1, len(measured)))
    for start in range(0, count, block):
        part = slice(start, start + block)
        if many:
            rows = shadow_covariance_db2(positions_m[part], measured, posterior.parameters)
            solve_rows(lower, rows)
            whitened = rows.T
        else:
            whitened = whiten(
                lower, shadow_covariance_db2(measured, positions_m[part], posterior.parameters)
            )
        data[part] = posterior.whitened_values @ whitened
        trend[part] -= whitened.T @ posterior.whitened_regressors
        variance[part] = prior - np.einsum("ij,ij->j", whitened, whitened)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
    variance = np.maximum(variance, 0.0) + posterior.parameters.multipath_std_db**2
    return KrigingTerms(data, trend, variance)


def _append(
    posterior: ChannelPosterior,
    more: Measurements,
    sites: Sites,
) -> ChannelPosterior:
    """Add rows to the factor and to the whitened columns."""
    parameters = posterior.parameters
    noise = np.maximum(sites.noise_variance_db2, MIN_NOISE_VARIANCE_DB2)
    old = len(posterior.measurements)
    count = old + len(more)
    buffer = posterior.buffer
    if buffer.used != old or len(buffer.lower) < count:
        grown = FactorBuffer(spacious(count))
        grown.lower[:old, :old] = posterior.factor
        grown.used = old
        buffer = grown
    joined = join(posterior.measurements, more)
    positions = joined.positions_m
    whitened = np.empty((count, 3))
    whitened[:old, 0] = posterior.whitened_values
    whitened[:old, 1:] = posterior.whitened_regressors
    whitened[old:, 0] = sites.values_db
    whitened[old:, 1:] = regressors(more.positions_m, parameters.station)
    lower = buffer.lower
    for start in range(old, count, FACTOR_BLOCK):
        stop = min(start + FACTOR_BLOCK, count)
        across = whiten(
            lower[:start, :start],
            shadow_covariance_db2(positions[:start], positions[start:stop], parameters),
        )
        within = shadow_covariance_db2(positions[start:stop], positions[start:stop], parameters)
        within[np.diag_indices_from(within)] += noise[start - old : stop - old]
        lower[start:stop, :start] = across.T
        lower[start:stop, start:stop] = np.linalg.cholesky(within - across.T @ across)
        whitened[start:stop] = whiten(
            lower[start:stop, start:stop],
            whitened[start:stop] - across.T @ whitened[:start],
        )
    buffer.used = count
    return _assemble(
        parameters,
        joined,
        np.concatenate([posterior.values_db, sites.values_db]),
        np.concatenate([posterior.noise_variance_db2, noise]),
        whitened,
        posterior.theta_known,
        buffer,
    )


def _assemble(
    parameters: ChannelParameters,
    measurements: Measurements,
    values_db: NDArray[np.float64],
    noise_variance_db2: NDArray[np.float64],
    whitened: NDArray[np.float64],
    theta_known: bool,
    buffer: FactorBuffer,
) -> ChannelPosterior:
    """Estimate theta from the whitened columns (seed, section III) and freeze everything."""
    theta = np.array([parameters.k_pl_db, parameters.n_pl])
    covariance = np.zeros((2, 2))
    if not theta_known:
        # In units of the weak prior, and about its centre, where the digits are.
        unit = np.array(WEAK_THETA_DEVIATION)
        scaled = whitened[:, 1:] * unit
        information: NDArray[np.float64] = scaled.T @ scaled
        spread = np.linalg.eigvalsh(information)
        if spread[0] * MAX_INFORMATION_CONDITION <= spread[1]:
            information += np.eye(2)
        scaled_covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
        residual = whitened[:, 0] - whitened[:, 1:] @ theta
        theta = theta + unit * (scaled_covariance @ (scaled.T @ residual))
        covariance = unit[:, None] * scaled_covariance * unit
    return ChannelPosterior(
        parameters,
        measurements,
        values_db,
        noise_variance_db2,
        np.ascontiguousarray(whitened[:, 0]),
        np.ascontiguousarray(whitened[:, 1:]),
        theta,
        covariance,
        theta_known,
        buffer,
    )


def _censored_site(posterior: ChannelPosterior, limit: Measurements) -> Sites:
    """One new measurement known to be at most its value, as a Gaussian one.

    Moment matching against its own prediction: the one-site case of expectation propagation.
    """
    noise = max(posterior.parameters.multipath_std_db**2, MIN_NOISE_VARIANCE_DB2)
    prediction = predict(posterior, limit.positions_m)
    latent = prediction.deviation_db**2 - posterior.parameters.multipath_std_db**2
    sites = censored_sites(prediction.mean_db, np.diag(latent), limit.power_dbm, noise)
    return sites.as_measurements(prediction.mean_db)
