"""Joint prediction of power at several places: mean, covariance, samples, and further readings.

Errors of a prediction are correlated along a path, so that joint events (all connected, none
connected, longest outage) need their covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.cholesky import semidefinite_factor, whiten
from planopt.channel.gaussian_sites import rounded_variance_db2
from planopt.channel.kriging import predict_noiseless
from planopt.channel.measurement_covariance import shadow_covariance_db2
from planopt.channel.measurements import Measurements
from planopt.channel.parameter_uncertainty import MarginalPosterior, mixture
from planopt.channel.parameters import regressors, require_count, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction
from planopt.errors import InputError
from planopt.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class JointPrediction:
    """Jointly Gaussian powers at h places.

    Attributes
    ----------
    mean_db
        ``(h,)`` mu, dBm.
    covariance_db2
        ``(h, h)`` S + B M B', symmetric.

    Raises
    ------
    InputError
        There is no place, shapes differ, or a number is not finite.
    """

    mean_db: NDArray[np.float64]
    covariance_db2: NDArray[np.float64]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        count = len(self.mean_db)
        if count == 0 or self.covariance_db2.shape != (count, count):
            raise InputError(
                f"a mean of shape {self.mean_db.shape} and a covariance of shape "
                f"{self.covariance_db2.shape} are not a prediction",
                remedy="give (h,) and (h, h) with h at least 1",
            )
        if not (np.isfinite(self.mean_db).all() and np.isfinite(self.covariance_db2).all()):
            raise InputError("a predicted mean or covariance is not finite")

    def __len__(self) -> int:
        return len(self.mean_db)

    @property
    def deviation_db(self) -> NDArray[np.float64]:
        """``(h,)`` standard deviation at each place."""
        return np.sqrt(np.diag(self.covariance_db2))


def joint_prediction(
    posterior: ChannelPosterior, positions_m: ArrayLike, *, latent: bool = False
) -> JointPrediction:
    """Return mean and covariance of the powers at `positions_m`, from all measurements.

    mu, and S + B M B' with S = K + omega^2 I - Phi' U^-1 Phi and B = Gamma_h - Phi' U^-1 Gamma
    (equations 1.11 and 1.12; M is zero where theta is known). The diagonal is what
    :func:`planopt.channel.kriging.predict` gives. Memory grows with h (kappa + h).

    Parameters
    ----------
    posterior
        The channel conditional on measurements.
    positions_m
        ``(h, 2)`` metres. Multipath is independent, even at a repeated place.
    latent
        Path loss and shadowing without multipath.

    Raises
    ------
    InputError
        `positions_m` is not a path.
    """
    terms = joint_terms(posterior, require_places(positions_m))
    covariance = terms.latent_db2
    if not latent:
        covariance[np.diag_indices_from(covariance)] += posterior.parameters.multipath_std_db**2
    covariance += terms.trend @ posterior.theta_covariance @ terms.trend.T
    return JointPrediction(
        terms.data_db + terms.trend @ posterior.theta, 0.5 * (covariance + covariance.T)
    )


@dataclass(frozen=True, eq=False)
class JointTerms:
    """The parts of a joint prediction that do not depend on theta."""

    data_db: NDArray[np.float64]  # (h,) Phi' U^-1 Y
    trend: NDArray[np.float64]  # (h, 2) B
    latent_db2: NDArray[np.float64]  # (h, h) S without multipath


def joint_terms(posterior: ChannelPosterior, places_m: NDArray[np.float64]) -> JointTerms:
    """Return the terms at `places_m` (h, 2)."""
    parameters = posterior.parameters
    across = whiten(posterior.factor, posterior.covariance_with_db2(places_m))
    covariance = shadow_covariance_db2(places_m, places_m, parameters) - across.T @ across
    own = np.diag_indices_from(covariance)
    # Rounding can make the latent variance negative at a place that is known exactly.
    covariance[own] = np.maximum(covariance[own], 0.0)
    return JointTerms(
        across.T @ posterior.whitened_values,
        regressors(places_m, parameters.station) - across.T @ posterior.whitened_regressors,
        covariance,
    )


def sample_power(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    count: int,
    generator: np.random.Generator,
    *,
    latent: bool = False,
) -> NDArray[np.float64]:
    """Draw powers at `positions_m` from the posterior, dBm; ``(count, h)``.

    Parameters
    ----------
    posterior
        The channel conditional on measurements.
    positions_m
        ``(h, 2)`` metres.
    count
        Number of draws.
    generator
        Source of randomness.
    latent
        Without multipath.

    Raises
    ------
    InputError
        `positions_m` is not a path, or `count` is below one.
    """
    prediction = joint_prediction(posterior, positions_m, latent=latent)
    lower = semidefinite_factor(prediction.covariance_db2)
    draws = generator.standard_normal((require_count(count, "count"), len(prediction)))
    return prediction.mean_db + draws @ lower.T


def predict_readings(
    posterior: ChannelPosterior | MarginalPosterior, readings: Measurements
) -> Prediction:
    """Predict the values of further measurements.

    Parameters
    ----------
    posterior
        The channel conditional on other measurements.
    readings
        n measurements: their times, receivers, resolution and position errors are used, their
        powers are not.

    Returns
    -------
    Prediction
        In their order; for plain measurements, and without forgetting, that of the posterior at
        their positions.
    """
    if isinstance(posterior, MarginalPosterior):
        parts = [predict_readings(component, readings) for component in posterior.components]
        return mixture(posterior.weights, parts)
    found = predict_noiseless(posterior, readings)
    variance = found.deviation_db**2 + posterior.parameters.multipath_std_db**2
    variance += rounded_variance_db2(readings.resolution_db)
    return Prediction(found.mean_db, np.sqrt(variance))
