"""The value of a path for the map of the channel (equations 4.3 to 4.6).

`universal` says which variance counts: that as if theta were known (Lemma 2 of [GM11]), or that
with the uncertainty of theta (exact). Where theta is known they are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.cholesky import solve_lower
from planopt.channel.kriging import kriging_terms
from planopt.channel.places import leg_lengths_m, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import combine
from planopt.channel.semidefinite import semidefinite_factor
from planopt.errors import InputError
from planopt.objectives.batch import (
    KnownPlaces,
    batch_factor,
    batch_of,
    cross_covariance_db2,
    known_places,
)
from planopt.objectives.near_posterior import factored_near
from planopt.objectives.weights import require_weights


@dataclass(frozen=True)
class Uncertainty:
    """Settings of J_CH (equation 4.3): where variance counts, and how much nearness does.

    Attributes
    ----------
    threshold_db2
        sigma_TH^2: variance up to this counts as known.
    decay_per_m
        zeta >= 0 of psi(d) = exp(-zeta d).
    start_m
        Where the robot stands; of the path form only.
    universal
        Count what is not known of theta.
    """

    threshold_db2: float
    decay_per_m: float
    start_m: tuple[float, float] = (0.0, 0.0)
    universal: bool = True


@dataclass(frozen=True, eq=False)
class Region:
    """Where the map is wanted (equation 4.6; footnote 3 of [GM11]).

    Attributes
    ----------
    grid_m
        ``(g, 2)`` places.
    weight
        ``(g,)`` w_g >= 0; 1 / g each for the spatial average.
    universal
        Count what is not known of theta.

    Raises
    ------
    InputError
        Places are none, or weights do not fit them.
    """

    grid_m: NDArray[np.float64]
    weight: NDArray[np.float64]
    universal: bool = True

    def __post_init__(self) -> None:
        require_weights(self.weight, len(require_places(self.grid_m)))


def channel_uncertainty(
    posterior: ChannelPosterior,
    positions_m: NDArray[np.float64],
    distance_m: NDArray[np.float64],
    settings: Uncertainty,
) -> NDArray[np.float64]:
    """Return J_CH(q) = max{0, sigma^2(q) - sigma_TH^2} psi(d), dB^2 (equation 4.3); ``(n,)``.

    Parameters
    ----------
    posterior
        The channel given measurements.
    positions_m
        ``(n, 2)`` q, none of them measured: there the power is known.
    distance_m
        ``(n,)`` from the robot to each, straight as in [GM11] or around obstacles.
    settings
        Threshold and decay.
    """
    terms = kriging_terms(posterior, require_places(positions_m))
    spread = posterior.theta_covariance if settings.universal else np.zeros((2, 2))
    variance = combine(terms, posterior.theta, spread).deviation_db ** 2
    return _above(variance, settings) * np.exp(-settings.decay_per_m * distance_m)


def uncertainty_target(
    posterior: ChannelPosterior,
    allowed_m: NDArray[np.float64],
    distance_m: NDArray[np.float64],
    settings: Uncertainty,
) -> int | None:
    """Return the index of q* = argmax J_CH (equation 4.3) among the allowed places.

    None where no place is above the threshold: the map is good enough. Arguments as
    :func:`channel_uncertainty`; the caller leaves out obstacles and measured places. Of equals the
    first.
    """
    worth = channel_uncertainty(posterior, allowed_m, distance_m, settings)
    best = int(worth.argmax())
    return best if worth[best] > 0.0 else None


def path_uncertainty(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    settings: Uncertainty,
    measured: NDArray[np.bool_] | None = None,
) -> float:
    """Return sum_i max{0, L_ii^2 - sigma_TH^2} psi(l_i), dB^2 (equation 4.4).

    L_ii^2 is the variance at q_i after the earlier places of the path, l_i the length of the path
    up to it from `settings.start_m`. The sum is over the measured places.

    Parameters
    ----------
    posterior
        The channel given measurements.
    path_m
        ``(h, 2)`` q_1 .. q_h; a place that repeats counts multipath's variance again.
    settings
        Threshold, decay and start.
    measured
        ``(h,)`` which places are measured; all unless given.
    """
    places = require_places(path_m)
    length = np.cumsum(leg_lengths_m(np.vstack([np.asarray(settings.start_m), places])))
    if measured is not None:
        places, length = places[measured], length[measured]
    if not len(places):
        return 0.0
    factor = semidefinite_factor(batch_of(posterior, places).covariance(settings.universal))
    return float(_above(np.diag(factor) ** 2, settings) @ np.exp(-settings.decay_per_m * length))


def path_information(
    posterior: ChannelPosterior, path_m: NDArray[np.float64], universal: bool = True
) -> float:
    """Return 1/2 log det S - h/2 log omega^2, the information on the channel in nats.

    Monotone and submodular in the set of places (equation 4.5). For h = 1 it has the maximiser of
    J_CH with psi = 1 and sigma_TH = 0.

    Raises
    ------
    InputError
        There is no multipath: the information is then infinite.
    """
    factor = batch_factor(batch_of(posterior, path_m).covariance(universal))
    return float(np.log(np.diag(factor) / require_multipath_db(posterior)).sum())


def average_reduction(
    posterior: ChannelPosterior,
    path_m: NDArray[np.float64],
    settings: Region,
    known: KnownPlaces | None = None,
) -> float:
    """Return sum_g w_g (sigma_t^2(g) - sigma_{t+h}^2(g)) in dB^2 (equation 4.6).

    Parameters
    ----------
    posterior
        The channel given measurements.
    path_m
        ``(h, 2)``.
    settings
        Where the map is wanted.
    known
        The same places prepared for `posterior`, for many paths. Not read where it has no factor.

    Raises
    ------
    InputError
        `path_m` is no path, or see :func:`planopt.objectives.batch.batch_factor`.
    """
    near = factored_near(posterior, path_m)
    if known is None or near is not posterior:
        known = known_places(near, settings.grid_m)
    factor = batch_factor(batch_of(posterior, path_m).covariance(settings.universal))
    across = cross_covariance_db2(near, path_m, known, settings.universal)
    return float((solve_lower(factor, across) ** 2).sum(axis=0) @ settings.weight)


def require_multipath_db(posterior: ChannelPosterior) -> float:
    """The deviation omega > 0 of multipath, or an InputError."""
    omega = posterior.parameters.multipath_std_db
    if omega <= 0.0:
        raise InputError(
            "without multipath a measurement is exact, and its information infinite",
            key="multipath_std_db",
            remedy="use the path form or the spatial average",
        )
    return omega


def _above(variance_db2: NDArray[np.float64], settings: Uncertainty) -> NDArray[np.float64]:
    return np.maximum(0.0, variance_db2 - settings.threshold_db2)
