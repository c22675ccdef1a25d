"""P(connected) at a place with the exact distribution of multipath, not its Gaussian in dB.

Path loss and shadowing stay Gaussian in dB. Multipath is lognormal, Nakagami-m or Rician (Rayleigh
at K = 0), of unit mean power, its mean in dB subtracted as the field does (theory, errata), so that
the predicted mean stays what it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]
    chndtr,
    gammaincc,
    ndtr,
)

from planopt.channel.fading import rician_mean_db, rician_std_db
from planopt.channel.multipath_conversions import (
    nakagami_mean_db,
    nakagami_std_db,
    require_k_factor,
    require_m,
)
from planopt.channel.places import require_finite, require_places
from planopt.channel.posterior import ChannelPosterior, predict
from planopt.errors import InputError

REACH = 8.5
"""The sum runs over this many deviations of shadowing on both sides; the rest weighs 1e-17."""

WIDEST_STEP = 0.5
"""Step in deviations of shadowing: sums of a Gaussian are then exact to rounding."""

STEPS_PER_MULTIPATH = 4.0
"""Steps in multipath's deviation omega, which is taken as at most `SLOWEST_DB`."""

SLOWEST_DB = 4.0
"""Strong fading has a sharper upper edge than its deviation says."""

BLOCK_ELEMENTS = 2**20


@dataclass(frozen=True)
class Lognormal:
    """Gaussian in dB.

    Attributes
    ----------
    std_db
        omega, at least 0.
    """

    std_db: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.std_db < math.inf:
            raise InputError(f"{self.std_db!r} is no deviation", key="std_db")


@dataclass(frozen=True)
class Nakagami:
    """Gamma distributed power.

    Attributes
    ----------
    m
        At least 0.5.
    """

    m: float

    def __post_init__(self) -> None:
        require_m(self.m)

    @property
    def std_db(self) -> float:
        """Exact omega."""
        return nakagami_std_db(self.m)


@dataclass(frozen=True)
class Rician:
    """A constant amplitude plus scatter.

    Attributes
    ----------
    k_factor
        K >= 0, ratio of their powers; 0 is Rayleigh fading.
    """

    k_factor: float

    def __post_init__(self) -> None:
        require_k_factor(self.k_factor)

    @property
    def std_db(self) -> float:
        """Exact omega."""
        return rician_std_db(self.k_factor)


Multipath = Lognormal | Nakagami | Rician


def multipath_survival(multipath: Multipath, level_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """P(fading >= level), fading in dB with its mean subtracted; shape of `level_db`."""
    # Above 300 dB a power's chance is nil, and its square would overflow.
    level = np.minimum(level_db, 300.0)
    match multipath:
        case Lognormal(0.0):
            return np.where(level <= 0.0, 1.0, 0.0)
        case Lognormal(std_db):
            return _array(ndtr(-level / std_db))
        case Nakagami(m):
            power = 10.0 ** ((level + nakagami_mean_db(m)) / 10.0)
            return _array(gammaincc(m, m * power))
        case Rician(k_factor):
            # Twice (K + 1) times the power is noncentral chi-square of two degrees of freedom.
            power = 10.0 ** ((level + rician_mean_db(k_factor)) / 10.0)
            return 1.0 - _array(chndtr(2.0 * (k_factor + 1.0) * power, 2.0, 2.0 * k_factor))


def multipath_connection_probability(
    mean_db: NDArray[np.float64],
    latent_deviation_db: NDArray[np.float64],
    threshold_dbm: float,
    multipath: Multipath,
) -> NDArray[np.float64]:
    """P(power >= threshold) = int N(s; mean, latent^2) P(fading >= threshold - s) ds; ``(n,)``.

    Theory 4.1, by equally spaced sums rather than Gauss and Hermite's nodes: for weak multipath the
    second factor is nearly a step, which the former resolve to rounding with nodes in proportion
    to latent deviation over omega, the latter only slowly. Error about 1e-12.

    Parameters
    ----------
    mean_db
        ``(n,)`` predicted power, dBm.
    latent_deviation_db
        ``(n,)`` its deviation without multipath, at least 0.
    threshold_dbm
        Power from which on a place is connected.
    multipath
        Distribution of multipath.

    Raises
    ------
    InputError
        Shapes do not agree, a deviation is negative, or a number is not finite.
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
        # Gaussian and Gaussian: in closed form, also where one of both is zero.
        total = Lognormal(1.0)
        whole = np.hypot(deviation, multipath.std_db)
        certain = np.where(threshold > mean, np.inf, -np.inf)
        score = np.divide(threshold - mean, whole, out=certain, where=whole > 0.0)
        return multipath_survival(total, score)
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
    positions_m: NDArray[np.float64],
    threshold_dbm: float,
    multipath: Multipath,
) -> NDArray[np.float64]:
    """P(connected) at each of `positions_m` (n, 2), multipath of the given distribution; ``(n,)``.

    What the measurements tell of the shadowing uses the posterior's own omega, as Lemma 2 does;
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
