"""Power at many places at once: joint mean and covariance, samples, and further readings.

Along a path the errors of the prediction belong together; whoever asks for more than one place
at a time (all connected, none connected, longest outage) needs their covariance.
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
        There is no place, shapes do not agree, or a number is not finite.
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
        """``(h,)`` deviation at each place."""
        return np.sqrt(np.diag(self.covariance_db2))


def joint_prediction(
    posterior: ChannelPosterior, positions_m: ArrayLike, *, latent: bool = False
) -> JointPrediction:
    """Mean and covariance of the powers at `positions_m`, from all measurements.

    mu, and S + B M B' with S = K + omega^2 I - Phi' U^-1 Phi and B = Gamma_h - Phi' U^-1 Gamma
    (equations 1.11 and 1.12; M is zero where theta is known). The diagonal is what
    :func:`planopt.channel.kriging.predict` gives. Memory grows with h (kappa + h).

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(h, 2)`` metres. Multipath is drawn anew for each, also where a place repeats.
    latent
        Leave multipath out: path loss and shadowing alone.

    Raises
    ------
    InputError
        `positions_m` is no path.
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
    """The terms at `places_m` (h, 2); whitening their covariances is all that takes time."""
    parameters = posterior.parameters
    across = whiten(posterior.factor, posterior.covariance_with_db2(places_m))
    covariance = shadow_covariance_db2(places_m, places_m, parameters) - across.T @ across
    own = np.diag_indices_from(covariance)
    # Rounding alone can make the latent variance negative, at a place that is known exactly.
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
    """Powers at `positions_m` drawn given the measurements, dBm; ``(count, h)``.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(h, 2)`` metres.
    count
        How many draws.
    generator
        Source of randomness.
    latent
        Leave multipath out.

    Raises
    ------
    InputError
        `positions_m` is no path, or `count` is below one.
    """
    prediction = joint_prediction(posterior, positions_m, latent=latent)
    lower = semidefinite_factor(prediction.covariance_db2)
    draws = generator.standard_normal((require_count(count, "count"), len(prediction)))
    return prediction.mean_db + draws @ lower.T


def predict_readings(
    posterior: ChannelPosterior | MarginalPosterior, readings: Measurements
) -> Prediction:
    """Predict what measurements read that `posterior` has not seen.

    Parameters
    ----------
    posterior
        The channel given other measurements.
    readings
        n measurements. Their powers are not looked at; their times, receivers, resolution and
        position errors are.

    Returns
    -------
    Prediction
        In their order. Where `readings` are plain measurements, and the channel does not forget,
        that of the posterior at their positions.
    """
    if isinstance(posterior, MarginalPosterior):
        parts = [predict_readings(component, readings) for component in posterior.components]
        return mixture(posterior.weights, parts)
    found = predict_noiseless(posterior, readings)
    variance = found.deviation_db**2 + posterior.parameters.multipath_std_db**2
    variance += rounded_variance_db2(readings.resolution_db)
    return Prediction(found.mean_db, np.sqrt(variance))
