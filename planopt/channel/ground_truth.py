"""The distributions of multipath (lognormal, Nakagami-m, Rician): parameters and draws.

Every law has unit mean power in the linear domain, and its mean in dB is then subtracted, so that
path loss and shadowing keep their meaning and the predicted mean stays what it is (equation 1.5).

Rician fading is a constant amplitude plus a complex Gaussian; K is the ratio of their powers. Given
a Poisson variable J of mean K the power times K + 1 is Gamma(1 + J), which gives the moments of its
logarithm as a series.

Conversions between Nakagami's m, Rician K and omega in dB are exact. The pairs (m, omega) of [GM11]
are those of Rician K = 5, 10, 30: their omega is near the Rician one and is not the Nakagami one,
so a problem that gives m or omega must say which law is meant.

The channel as it is. Only the simulator touches it; planners know a posterior.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import (  # pyright: ignore[reportUnknownVariableType]  # pyright: ignore[reportUnknownVariableType]
    gammaln,
    psi,
    zeta,  # pyright: ignore[reportUnknownVariableType]
)

from planopt.channel.measurements import MAX_POWER_DB, Measurements
from planopt.channel.parameters import ChannelParameters, regressors, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.shadow_fields import conditional_field, shadow_field_db
from planopt.errors import InputError
from planopt.short_repr import short_repr
from planopt.world.raster import Raster, cell_centres_m, checked_raster, nearest_cells

DB_PER_NEPER = 10.0 / math.log(10.0)

SERIES_DEVIATIONS = 12.0
"""The series runs over this many standard deviations of J on both sides, and 40 terms more."""


def rician_field_db(
    shape: tuple[int, ...], k_factor: float, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Independent fading values in dB, of mean zero and deviation :func:`rician_std_db`."""
    constant = math.sqrt(k_factor / (k_factor + 1.0))
    scatter = math.sqrt(0.5 / (k_factor + 1.0))
    real = constant + scatter * generator.standard_normal(shape)
    imaginary = scatter * generator.standard_normal(shape)
    power = real * real + imaginary * imaginary
    return 10.0 * np.log10(power) - rician_mean_db(k_factor)


def rician_mean_db(k_factor: float) -> float:
    """Mean in dB of fading whose mean power is one; negative."""
    return _log_moments(k_factor)[0]


def rician_std_db(k_factor: float) -> float:
    """Deviation omega in dB of fading of factor K = `k_factor`."""
    return _log_moments(k_factor)[1]


def _log_moments(k_factor: float) -> tuple[float, float]:
    """Mean and deviation in dB by the Poisson mixture of gamma variables."""
    spread = SERIES_DEVIATIONS * math.sqrt(k_factor)
    orders = np.arange(max(0.0, math.floor(k_factor - spread)), k_factor + spread + 40.0)
    if k_factor > 0.0:
        log_weights = orders * math.log(k_factor) - k_factor - _array(gammaln(orders + 1.0))
        weights = np.exp(log_weights)
    else:
        weights = np.where(orders == 0.0, 1.0, 0.0)
    means = _array(psi(orders + 1.0))
    mean = float(weights @ means)
    variance = float(weights @ (_array(zeta(2.0, orders + 1.0)) + (means - mean) ** 2))
    return DB_PER_NEPER * (mean - math.log1p(k_factor)), DB_PER_NEPER * math.sqrt(variance)


MIN_M = 0.5
"""Nakagami's distribution is defined from here on; 1 is Rayleigh fading."""

STRONGEST = 1e8
"""K and m are sought up to here; omega is then below 0.001 dB."""

HALVINGS = 60
"""Of the bracket of a sought m or K, to the last digit."""


def nakagami_m_of_rician(k_factor: float) -> float:
    """Nakagami's m = (K + 1)^2 / (2 K + 1), of equal amount of fading."""
    require_k_factor(k_factor)
    # Written so, no rounding takes it below 1, where there is no Rician channel.
    return 1.0 + k_factor**2 / (2.0 * k_factor + 1.0)


def rician_k_of_nakagami(m: float) -> float:
    """Rician K = m - 1 + sqrt(m (m - 1)), the inverse of :func:`nakagami_m_of_rician`."""
    if not 1.0 <= m < math.inf:
        raise InputError(f"m = {m!r} has no Rician factor", key="m", remedy="m is at least 1")
    return m - 1.0 + math.sqrt(m * (m - 1.0))


def nakagami_mean_db(m: float) -> float:
    """Mean in dB of Nakagami fading of unit mean power: (10 / ln 10) (psi(m) - ln m); negative."""
    require_m(m)
    return DB_PER_NEPER * (float(_array(psi(m))) - math.log(m))


def nakagami_std_db(m: float) -> float:
    """Deviation omega in dB of Nakagami fading: (10 / ln 10) sqrt(psi'(m)).

    psi'(m) is Hurwitz's zeta(2, m).
    """
    require_m(m)
    return DB_PER_NEPER * math.sqrt(float(_array(zeta(2.0, m))))


def nakagami_m_of_std(multipath_std_db: float) -> float:
    """The m whose exact deviation is omega = `multipath_std_db`."""
    return _sought(nakagami_std_db, MIN_M, multipath_std_db)


def rician_k_of_std(multipath_std_db: float) -> float:
    """The K whose exact deviation is omega = `multipath_std_db`."""
    return _sought(rician_std_db, 0.0, multipath_std_db)


def require_k_factor(k_factor: float) -> None:
    """Refuse a K that is negative or not finite."""
    if not 0.0 <= k_factor < math.inf:
        raise InputError(f"K = {k_factor!r} is no Rician factor", key="k_factor", remedy="K >= 0")


def require_m(m: float) -> None:
    """Refuse an m that is below `MIN_M` or not finite."""
    if not MIN_M <= m < math.inf:
        raise InputError(f"m = {m!r} is none of Nakagami's", key="m", remedy=f"m >= {MIN_M}")


def _sought(deviation_db: Callable[[float], float], weakest: float, wanted_db: float) -> float:
    """Find where a falling deviation has a value, halving in the logarithm of 1 + argument."""
    most, least = deviation_db(weakest), deviation_db(STRONGEST)
    if not least <= wanted_db <= most:
        raise InputError(
            f"no such fading has a deviation of {wanted_db!r} dB",
            key="multipath_std_db",
            remedy=f"it is from {least:.2g} to {most:.4g} dB",
        )
    low, high = math.log1p(weakest), math.log1p(STRONGEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if deviation_db(math.expm1(middle)) > wanted_db:
            low = middle
        else:
            high = middle
    return max(weakest, math.expm1(0.5 * (low + high)))


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


def _array(values: object) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


MultipathKind = Literal["nakagami", "rician", "rayleigh", "lognormal"]


def multipath_of(
    kind: MultipathKind,
    *,
    m: float | None = None,
    k: float | None = None,
    std_db: float | None = None,
) -> Multipath:
    """The multipath of one kind, given by exactly one of m, K and omega.

    Parameters
    ----------
    kind
        ``rayleigh``, which takes no number, or one of the others.
    m
        Nakagami's m. For ``rician`` the K of the same variance of the power, for ``lognormal`` the
        exact deviation of Nakagami fading.
    k
        Rician K, linear. For ``nakagami`` the m of the same variance of the power, for
        ``lognormal`` the exact deviation of Rician fading.
    std_db
        omega, the deviation in dB; exact for every kind.

    Raises
    ------
    InputError
        Not exactly one of them, or one for which there is no such multipath.
    """
    given = [name for name, value in (("m", m), ("k", k), ("std_db", std_db)) if value is not None]
    wanted = 0 if kind == "rayleigh" else 1
    if len(given) != wanted:
        raise InputError(
            f"{kind} multipath is given by {' and '.join(given) or 'nothing'}",
            key="multipath",
            remedy="give the kind alone" if wanted == 0 else "give one of m, k and std_db",
        )
    if kind == "nakagami":
        return Nakagami(_nakagami_m(m, k, std_db))
    if kind == "rician":
        return Rician(_rician_k(m, k, std_db))
    if kind == "lognormal":
        return Lognormal(_std_db(m, k, std_db))
    return Rician(0.0)


def multipath_field_db(
    shape: tuple[int, ...], multipath: Multipath, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Independent values in dB, of mean zero and deviation ``multipath.std_db``."""
    if isinstance(multipath, Lognormal):
        return multipath.std_db * generator.standard_normal(shape)
    if isinstance(multipath, Rician):
        return rician_field_db(shape, multipath.k_factor, generator)
    # The power is Gamma(m) / m (equation 1.5).
    power = generator.standard_gamma(multipath.m, shape) / multipath.m
    return 10.0 * np.log10(power) - nakagami_mean_db(multipath.m)


def _nakagami_m(m: float | None, k: float | None, std_db: float | None) -> float:
    if m is not None:
        return m
    return nakagami_m_of_std(std_db or 0.0) if k is None else nakagami_m_of_rician(k)


def _rician_k(m: float | None, k: float | None, std_db: float | None) -> float:
    if k is not None:
        return k
    return rician_k_of_std(std_db or 0.0) if m is None else rician_k_of_nakagami(m)


def _std_db(m: float | None, k: float | None, std_db: float | None) -> float:
    if std_db is not None:
        return std_db
    return rician_std_db(k or 0.0) if m is None else nakagami_std_db(m)


@dataclass(frozen=True, eq=False)
class Truth:
    """Received power everywhere, fading included, so that a place keeps its value.

    Attributes
    ----------
    raster
        Power in dBm at cell centres; read at the nearest cell.
    floor_dbm
        The receiver's floor: no value is below it. None for none.
    mean_dbm
        ``[iy, ix]`` the power without small-scale fading, in the same cells.
    """

    raster: Raster
    floor_dbm: float | None
    mean_dbm: NDArray[np.float64]

    __repr__ = short_repr


def raster_truth(
    path_gain: Raster,
    transmit_power_dbm: float,
    floor_gain_db: float,
    multipath: Multipath | None,
    generator: np.random.Generator,
) -> Truth:
    """Truth from a map of path gains, such as a ray tracer's.

    Parameters
    ----------
    path_gain
        Gains in dB; NaN where nothing arrives.
    transmit_power_dbm
        Added to the gains.
    floor_gain_db
        The receiver's floor as a gain; smaller ones, fading included, are clipped to it.
    multipath
        The fading drawn for each cell, or None for none.
    generator
        Source of the fading.
    """
    gain = np.asarray(path_gain.values, dtype=np.float64)
    # fmax prefers the floor to NaN.
    mean = np.fmax(gain, floor_gain_db) + transmit_power_dbm
    if multipath is not None:
        gain = gain + multipath_field_db(gain.shape, multipath, generator)
    power = np.fmax(gain, floor_gain_db) + transmit_power_dbm
    floor_dbm = floor_gain_db + transmit_power_dbm
    return Truth(Raster(path_gain.x_m, path_gain.y_m, power), floor_dbm, mean)


def model_truth(
    parameters: ChannelParameters,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    floor_dbm: float | None,
    generator: np.random.Generator,
    multipath: Multipath | None = None,
) -> Truth:
    """Truth drawn from the channel model itself (equation 1.1).

    Parameters
    ----------
    parameters
        Path loss, shadowing and multipath, one value a cell.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left.
    cell_m
        Cell side.
    floor_dbm
        The receiver's floor, or None for none.
    generator
        Source of shadowing and multipath.
    multipath
        Its law; None for one that is Gaussian in dB, with the parameters' deviation.
    """
    x_min, y_min, x_max, y_max = bounds_m
    x, y = cell_centres_m(x_min, x_max, cell_m), cell_centres_m(y_min, y_max, cell_m)
    shape = (len(y), len(x))
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    power = regressors(centres, parameters.station) @ np.array(
        [parameters.k_pl_db, parameters.n_pl]
    )
    power += shadow_field_db(
        shape, cell_m, parameters.shadow_std_db, parameters.decorrelation_m, generator
    ).values_db
    law = Lognormal(parameters.multipath_std_db) if multipath is None else multipath
    return _faded(Raster(x, y, power), law, floor_dbm, generator)


def fitted_truth(
    posterior: ChannelPosterior,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    floor_dbm: float | None,
    generator: np.random.Generator,
) -> Truth:
    """Draw the truth from the posterior of measurements; parameters as of :func:`model_truth`."""
    mean = conditional_field(posterior, bounds_m, cell_m, generator)
    return _faded(mean, Lognormal(posterior.parameters.multipath_std_db), floor_dbm, generator)


def _faded(
    mean: Raster, law: Multipath, floor_dbm: float | None, generator: np.random.Generator
) -> Truth:
    """Add multipath to a raster of powers, and apply the receiver's floor."""
    power = mean.values
    faded = power + multipath_field_db(power.shape, law, generator)
    if floor_dbm is not None:
        power, faded = np.maximum(power, floor_dbm), np.maximum(faded, floor_dbm)
    return Truth(Raster(mean.x_m, mean.y_m, faded), floor_dbm, power)


def power_truth(
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    power_dbm: NDArray[np.float64],  # (ny, nx), NaN where nothing arrives
    floor_dbm: float | None = None,
) -> Truth:
    """Truth from arrays of received power, small-scale fading included or not."""
    # Shapes: x_m, y_m (nx,).
    raster = checked_raster(x_m, y_m, power_dbm, None, "power_dbm")
    if floor_dbm is not None and not abs(floor_dbm) <= MAX_POWER_DB:
        raise InputError(f"is {floor_dbm!r}, which is no power", key="floor_dbm", remedy="give dBm")
    if floor_dbm is None and np.isnan(raster.values).any():
        raise InputError(
            "is not finite somewhere",
            key="power_dbm",
            remedy="give floor_dbm, the least power that the receiver reports",
        )
    power = raster.values if floor_dbm is None else np.fmax(raster.values, floor_dbm)
    if not (np.abs(power) <= MAX_POWER_DB).all():
        raise InputError("is no power in dBm somewhere", key="power_dbm", remedy="give dBm")
    return Truth(Raster(raster.x_m, raster.y_m, power), floor_dbm, power)


def true_power_dbm(truth: Truth, positions_m: ArrayLike) -> NDArray[np.float64]:
    """Received power at `positions_m` (n, 2), in dBm, at least the floor; ``(n,)``."""
    iy, ix = nearest_cells(truth.raster, require_places(positions_m, at_least=0))
    return truth.raster.values[iy, ix]


def mean_power_dbm(truth: Truth, positions_m: ArrayLike) -> NDArray[np.float64]:
    """Received power without small-scale fading at `positions_m` (n, 2), in dBm; ``(n,)``."""
    iy, ix = nearest_cells(truth.raster, require_places(positions_m, at_least=0))
    return truth.mean_dbm[iy, ix]


def measure(truth: Truth, positions_m: ArrayLike) -> Measurements:
    """Measure the true power at `positions_m` (n, 2); values at the floor are censored."""
    power = true_power_dbm(truth, positions_m)
    censored = np.zeros(len(power), dtype=bool)
    if truth.floor_dbm is not None:
        censored = power <= truth.floor_dbm
    return Measurements(np.array(positions_m, dtype=np.float64), power, censored)
