"""Parameters of the channel model, path loss, and validation of positions and numbers.

If the distances to the station hardly differ, n_PL is fixed at a prior value, whose uncertainty is
part of the covariance of theta.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planopt.arrays import Floats, Mask
from planopt.errors import InputError

MAX_COORDINATE_M = 1e12
"""Maximum magnitude of a coordinate, so that squared distances do not overflow."""
MIN_DISTANCE_M = 0.1  # Minimum distance to the station, so that its logarithm is finite
PARAMETER_WORDS = {
    "k_pl_db": ("power at 1 m", "dBm"),
    "n_pl": ("path loss exponent", ""),
    "shadow_std_db": ("standard deviation of shadowing", "dB"),
    "decorrelation_m": ("decorrelation distance", "m"),
    "multipath_std_db": ("standard deviation of multipath", "dB"),
}
"""Meaning and unit of each estimated parameter."""
PRIOR_N_PL = 3.0  # Prior mean of n_PL, between free space and dense streets
PRIOR_N_PL_STD = 1.0  # Prior standard deviation of n_PL


def require_places(positions_m: ArrayLike, at_least: int = 1) -> Floats:
    """Return `positions_m` (h, 2) as floats; raise an error if they are invalid."""
    remedy = f"give an array (h, 2) of x and y in metres, with h at least {at_least}"
    try:
        places = np.asarray(positions_m, dtype=np.float64)
    except (ValueError, TypeError):
        raise InputError("is not an array of numbers", key="positions_m", remedy=remedy) from None
    if places.ndim != 2 or places.shape[1] != 2 or len(places) < at_least:
        raise InputError(
            f"has shape {places.shape}, should have shape (h, 2)", key="positions_m", remedy=remedy
        )
    if not np.isfinite(places).all():
        raise InputError(
            "has a position that is NaN or infinite",
            key="positions_m",
            remedy="leave this position out",
        )
    if (np.abs(places) > MAX_COORDINATE_M).any():
        raise InputError(
            "has a position too far from the origin",
            key="positions_m",
            remedy=f"give coordinates within {MAX_COORDINATE_M:g} m",
        )
    return places


def require_finite(value: float, key: str) -> float:
    """Return `value` as a float, or raise an error if it is not finite."""
    if not math.isfinite(value):
        raise InputError(f"is {value!r}, should be finite", key=key, remedy="give a number")
    return float(value)


def require_shadowing(shadow_std_db: float, decorrelation_m: float) -> None:
    """Raise an error if xi or beta is invalid."""
    if not (math.isfinite(shadow_std_db) and shadow_std_db >= 0.0):
        raise InputError(
            f"is {shadow_std_db!r}, should be a standard deviation of at least 0 dB",
            key="shadow_std_db",
            remedy="give a value of at least 0, e.g. 8",
        )
    if not (math.isfinite(decorrelation_m) and decorrelation_m > 0.0):
        raise InputError(
            f"is {decorrelation_m!r}, should be a distance above 0 m",
            key="decorrelation_m",
            remedy="give a value above 0, e.g. 10",
        )


def require_count(count: int, key: str) -> int:
    """Return `count`, or raise an error if it is below 1."""
    if count < 1:
        raise InputError(
            f"is {count!r}, should be at least 1", key=key, remedy="give a larger number"
        )
    return count


def leg_lengths_m(positions_m: Floats) -> Floats:
    """Return the lengths (h - 1,) of the legs between h successive positions."""
    step = np.diff(positions_m, axis=0)
    return np.hypot(step[:, 0], step[:, 1])


@dataclass(frozen=True)
class Station:
    """Fixed base station, access point or gateway.

    Attributes
    ----------
    position_m
        Position ``(x, y)`` in metres.
    height_m
        Height of the station's antenna above the robots' antennas; distances are three-dimensional.

    Raises
    ------
    InputError
        A coordinate is not finite or exceeds `MAX_COORDINATE_M`.
    """

    position_m: tuple[float, float]
    height_m: float = 0.0

    def __post_init__(self) -> None:
        for value in (*self.position_m, self.height_m):
            if not abs(value) <= MAX_COORDINATE_M:
                raise InputError(
                    f"has the coordinate {value!r} m, which is out of range",
                    key="station",
                    remedy=f"give metres of at most {MAX_COORDINATE_M:g} in magnitude",
                )


@dataclass(frozen=True)
class Lasting:
    """Part of multipath that has the correlation exp(-|t - t'| / time_s) at one receiver."""

    share: float  # Of omega^2
    time_s: float


@dataclass(frozen=True)
class ChannelParameters:
    """Parameters of the received power in dBm (equations 1.1 and 1.2).

    ``power(q) = k_pl_db - 10 n_pl log10 d(q) + shadowing(q) + multipath(q)``, with shadowing of
    covariance ``shadow_std_db**2 exp(-distance / decorrelation_m)`` and white multipath of standard
    deviation ``multipath_std_db``.

    Attributes
    ----------
    k_pl_db
        Received power K_PL at one metre in dBm, transmit power included.
    n_pl
        Path loss exponent n_PL.
    shadow_std_db
        Standard deviation xi of shadowing in dB.
    decorrelation_m
        Decorrelation distance beta in metres.
    multipath_std_db
        Standard deviation omega of multipath fading in dB.
    station
        Fixed base station.
    forgetting_s
        Time scale of a time-varying channel, whose shadowing covariance has the additional factor
        ``exp(-age / forgetting_s)``. Infinite for a static channel.
    n_pl_prior
        Mean and standard deviation of the normal prior on n_PL that estimates of the path loss use;
        None for a flat prior.
    lasting
        Part of multipath that lasts for some time wherever the receiver is (equation 2.15).
        Readings at close times have it in common; predictions without a time are for a later drive.

    Raises
    ------
    InputError
        A number is NaN, a number other than `forgetting_s` is infinite, a standard deviation is
        negative, or a distance or time scale is not positive.
    """

    k_pl_db: float
    n_pl: float
    shadow_std_db: float
    decorrelation_m: float
    multipath_std_db: float
    station: Station
    forgetting_s: float = math.inf
    n_pl_prior: tuple[float, float] | None = None
    lasting: Lasting | None = None

    def __post_init__(self) -> None:
        for name in ("k_pl_db", "n_pl", "shadow_std_db", "decorrelation_m", "multipath_std_db"):
            require_finite(getattr(self, name), name)
        for name in ("shadow_std_db", "multipath_std_db"):
            if getattr(self, name) < 0.0:
                raise InputError(
                    f"is {getattr(self, name)!r}, should be a standard deviation of at least 0 dB",
                    key=name,
                    remedy="give a value of at least 0, e.g. 8",
                )
        for name in ("decorrelation_m", "forgetting_s"):
            if not getattr(self, name) > 0.0:
                raise InputError(
                    f"is {getattr(self, name)!r}, should be above 0",
                    key=name,
                    remedy="give a value above 0, e.g. 10",
                )
        if self.n_pl_prior is not None and not 0.0 < self.n_pl_prior[1] < math.inf:
            raise InputError(
                f"is {self.n_pl_prior!r}, should have a standard deviation above 0",
                key="n_pl_prior",
                remedy="give a mean and a standard deviation, e.g. (2.0, 1.0)",
            )

    @property
    def white_variance_db2(self) -> float:
        """Variance in dB^2 of the white part of multipath."""
        return (1.0 - (self.lasting.share if self.lasting else 0.0)) * self.multipath_std_db**2


def station_distance_m(positions_m: Floats, station: Station) -> Floats:
    """Return the 3D distance (n,) of positions to the station, at least `MIN_DISTANCE_M`."""
    offset = positions_m - np.asarray(station.position_m)
    square = np.einsum("...i,...i->...", offset, offset)
    return np.sqrt(np.maximum(square + station.height_m**2, MIN_DISTANCE_M**2))


def regressors(positions_m: Floats, station: Station) -> Floats:
    """Return the regressors (n, 2) of path loss, 1 and -10 log10 of the distance (equation 1.1)."""
    rows = np.ones(np.shape(positions_m))
    rows[..., 1] = -10.0 * np.log10(station_distance_m(positions_m, station))
    return rows


@dataclass(frozen=True)
class MeanModel:
    """Linear model of the mean power: offset + columns @ coefficients."""

    columns: Floats  # (n, p); p = 2: the regressors gamma; p = 1: ones, for K_PL alone
    offset_db: Floats  # (n,); zero for p = 2; the contribution of `PRIOR_N_PL` for p = 1
    # Mean of -10 log10 d over the exact measurements, the sensitivity of K_PL to n_PL
    regressor_mean: float

    def theta(self, coefficients: Floats) -> tuple[float, float]:
        """Return path loss theta, (K_PL, n_PL), from the coefficients (p,)."""
        if len(coefficients) == 2:
            return float(coefficients[0]), float(coefficients[1])
        return float(coefficients[0]), PRIOR_N_PL

    def theta_covariance(self, covariance: Floats) -> Floats:
        """Return the covariance (2, 2) of theta, given the coefficients' covariance."""
        if len(covariance) == 2:
            return covariance
        slope = PRIOR_N_PL_STD * np.array([-self.regressor_mean, 1.0])
        whole = np.outer(slope, slope)
        whole[0, 0] += covariance[0, 0]
        return whole


def mean_model(
    positions_m: Floats, exact: Mask, station: Station, n_pl_identifiable: bool
) -> MeanModel:
    """Return the mean model at `positions_m` (n, 2); `exact` (n,) marks uncensored measurements."""
    gamma = regressors(positions_m, station)
    regressor_mean = float(gamma[exact if exact.any() else slice(None), 1].mean())
    if n_pl_identifiable:
        return MeanModel(gamma, np.zeros(len(gamma)), regressor_mean)
    return MeanModel(gamma[:, :1], PRIOR_N_PL * gamma[:, 1], regressor_mean)
