"""P(connected) at a place with the exact distribution of multipath, not its Gaussian in dB.

Path loss and shadowing stay Gaussian in dB; :mod:`planopt.channel.multipath.multipath_models` has
the rest.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planopt.channel.kriging import predict
from planopt.channel.multipath.multipath_models import Lognormal, Multipath, multipath_survival
from planopt.channel.places import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import connection_probability
from planopt.errors import InputError

REACH = 8.5
"""The sum runs over this many deviations of shadowing on both sides; the rest weighs 1e-17."""

WIDEST_STEP = 0.5
"""Step in deviations of shadowing: sums of a Gaussian are then exact to rounding."""

STEPS_PER_MULTIPATH = 3.0
"""Steps in multipath's deviation omega, which is taken as at most `SLOWEST_DB`."""

SLOWEST_DB = 4.0
"""Strong fading has a sharper upper edge than its deviation says."""

BLOCK_ELEMENTS = 2**20


def multipath_connection_probability(
    mean_db: NDArray[np.float64],  # (n,) predicted power, dBm
    latent_deviation_db: NDArray[np.float64],  # (n,) its deviation without multipath, at least 0
    threshold_dbm: float,
    multipath: Multipath,
) -> NDArray[np.float64]:
    """P(power >= threshold) = int N(s; mean, latent^2) P(fading >= threshold - s) ds; ``(n,)``.

    Equation 3.3 by equally spaced sums, not Gauss and Hermite's nodes: for weak multipath the
    second factor is nearly a step, which the former resolve to rounding with nodes in proportion
    to latent deviation over omega, the latter only slowly. Error below 1e-9.
    """
    threshold = require_finite(threshold_dbm, "threshold_dbm")
    mean, deviation = _array(mean_db), _array(latent_deviation_db)
    if mean.ndim != 1 or mean.shape != deviation.shape:
        raise InputError(
            f"means of shape {mean.shape} and deviations of shape {deviation.shape} do not agree"
        )
    if not (np.isfinite(mean).all() and np.isfinite(deviation).all() and (deviation >= 0.0).all()):
        raise InputError("a mean or deviation is not finite, or a deviation is negative")
    if isinstance(multipath, Lognormal):
        return connection_probability(mean, np.hypot(deviation, multipath.std_db), threshold)
    nodes, weights = _nodes(float(deviation.max(initial=0.0)), multipath.std_db)
    found = np.empty(len(mean))
    block = max(1, BLOCK_ELEMENTS // len(nodes))
    for start in range(0, len(mean), block):
        part = slice(start, start + block)
        power = mean[part, None] + deviation[part, None] * nodes
        found[part] = multipath_survival(multipath, threshold - power) @ weights
    return np.clip(found, 0.0, 1.0)


def multipath_connectivity(
    posterior: ChannelPosterior,
    positions_m: ArrayLike,
    threshold_dbm: float,
    multipath: Multipath,
) -> NDArray[np.float64]:
    """P(connected) at each of `positions_m` (n, 2), multipath of the given distribution; ``(n,)``.

    The posterior of the shadowing uses the posterior's own omega, as equation 1.8 does;
    `multipath` is what the next packet meets.

    Raises
    ------
    InputError
        The positions or the threshold cannot be used.
    """
    prediction = predict(posterior, require_places(positions_m))
    latent = prediction.deviation_db**2 - posterior.parameters.multipath_std_db**2
    return multipath_connection_probability(
        prediction.mean_db, np.sqrt(np.maximum(latent, 0.0)), threshold_dbm, multipath
    )


def _nodes(
    latent_deviation_db: float, multipath_std_db: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard normal scores, equally spaced, and their weights of sum one."""
    fine = min(multipath_std_db, SLOWEST_DB) / STEPS_PER_MULTIPATH
    step = min(WIDEST_STEP, fine / max(latent_deviation_db, fine))
    half = math.ceil(REACH / step)
    scores = np.arange(-half, half + 1.0) * (REACH / half)
    weights = np.exp(-0.5 * scores * scores)
    return scores, weights / weights.sum()


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)
