"""Ground truth: the simulated received power at all positions, with small-scale fading.

Each fading law (lognormal, Nakagami-m, Rician) has unit mean power. Its mean in dB is subtracted,
so that the predicted mean remains path loss plus shadowing (equation 1.5).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, psi, zeta

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.measurements import MAX_POWER_DB, Measurements
from planopt.channel.neighbours import PlaceTree
from planopt.channel.parameters import ChannelParameters, regressors, require_places
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.shadow_fields import conditional_field, shadow_field_db
from planopt.errors import InputError
from planopt.short_repr import short_repr
from planopt.world.raster import Raster, cell_centres_m, checked_raster, nearest_cells

DB_PER_NEPER = 10.0 / math.log(10.0)

SERIES_DEVIATIONS = 12.0
"""Half-width of the Rician series in standard deviations of its Poisson variable."""
MIN_M = 0.5  # Minimum m of the Nakagami distribution; 1 is Rayleigh fading
STRONGEST = 1e8  # Upper end of the search for Nakagami m and Rician K; omega is then below 0.001 dB

BISECTIONS = 60


@dataclass(frozen=True)
class Lognormal:
    """Lognormal fading: Gaussian in dB.

    Attributes
    ----------
    std_db
        Standard deviation omega in dB, at least 0.
    """

    std_db: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.std_db < math.inf:
            raise InputError(
                f"is {self.std_db!r}, should be a standard deviation in dB of at least 0",
                key="std_db",
            )


@dataclass(frozen=True)
class Nakagami:
    """Nakagami-m fading: gamma-distributed power.

    Attributes
    ----------
    m
        Shape parameter, at least 0.5.
    """

    m: float

    def __post_init__(self) -> None:
        if not MIN_M <= self.m < math.inf:
            raise InputError(
                f"is {self.m!r}, should be a Nakagami shape parameter of at least {MIN_M}",
                key="m",
                remedy="give a larger m",
            )

    @property
    def mean_db(self) -> float:
        """Mean in dB at unit mean power, (10 / ln 10) (psi(m) - ln m)."""
        return DB_PER_NEPER * (float(psi(self.m)) - math.log(self.m))

    @property
    def std_db(self) -> float:
        """Exact standard deviation omega in dB, (10 / ln 10) sqrt(psi'(m))."""
        return DB_PER_NEPER * math.sqrt(float(zeta(2.0, self.m)))


@dataclass(frozen=True)
class Rician:
    """Rician fading: a constant (line-of-sight) amplitude plus scatter.

    Attributes
    ----------
    k_factor
        Ratio K >= 0 of constant to scattered power; 0 is Rayleigh fading.
    """

    k_factor: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.k_factor < math.inf:
            raise InputError(
                f"is {self.k_factor!r}, should be a Rician factor K of at least 0",
                key="k_factor",
                remedy="give K as a power ratio, not in dB",
            )

    @property
    def mean_db(self) -> float:
        """Mean in dB at unit mean power."""
        return self._moments()[0]

    @property
    def std_db(self) -> float:
        """Exact standard deviation omega in dB."""
        return self._moments()[1]

    def _moments(self) -> tuple[float, float]:
        """Return mean and standard deviation in dB by a series over Poisson probabilities."""
        # With J Poisson of mean K, the power times K + 1 is Gamma(1 + J).
        k_factor = self.k_factor
        reach = SERIES_DEVIATIONS * math.sqrt(k_factor)
        orders = np.arange(max(0.0, math.floor(k_factor - reach)), k_factor + reach + 40.0)
        weights = np.where(orders == 0.0, 1.0, 0.0)
        if k_factor > 0.0:
            log_factorial = np.asarray(gammaln(orders + 1.0), dtype=np.float64)
            weights = np.exp(orders * math.log(k_factor) - k_factor - log_factorial)
        means = np.asarray(psi(orders + 1.0), dtype=np.float64)
        variances = np.asarray(zeta(2.0, orders + 1.0), dtype=np.float64)
        mean = float(weights @ means)
        variance = float(weights @ (variances + (means - mean) ** 2))
        return DB_PER_NEPER * (mean - math.log1p(k_factor)), DB_PER_NEPER * math.sqrt(variance)


Multipath = Lognormal | Nakagami | Rician

MultipathKind = Literal["nakagami", "rician", "rayleigh", "lognormal"]


def multipath_of(
    kind: MultipathKind,
    *,
    m: float | None = None,
    k: float | None = None,
    std_db: float | None = None,
) -> Multipath:
    """Return the fading law of a kind from exactly one of m, K and omega.

    Parameters
    ----------
    kind
        Kind of fading; ``rayleigh`` takes no parameter.
    m
        Nakagami m. For ``rician`` it is converted to the K with the same power variance, for
        ``lognormal`` to the standard deviation of Nakagami fading.
    k
        Rician K, linear. For ``nakagami`` it is converted to the m with the same power variance,
        for ``lognormal`` to the standard deviation of Rician fading.
    std_db
        Standard deviation omega in dB; exact for every kind.

    Raises
    ------
    InputError
        Not exactly one parameter is given, or the kind cannot have this value.
    """
    numbers = {"m": m, "k": k, "std_db": std_db}
    present = [name for name, value in numbers.items() if value is not None]
    if len(present) != (0 if kind == "rayleigh" else 1):
        wanted = "no parameter" if kind == "rayleigh" else "exactly one of m, k and std_db"
        raise InputError(
            f"{kind} multipath needs {wanted}, but has {' and '.join(present) or 'none'}",
            key="multipath",
            remedy="leave m, k and std_db out"
            if kind == "rayleigh"
            else "give one of m, k and std_db, e.g. std_db=5",
        )
    if kind == "rayleigh":
        return Rician(0.0)
    if m is not None:
        source = Nakagami(m)
    else:
        source = Lognormal(std_db or 0.0) if k is None else Rician(k)
    if kind == "lognormal":
        return Lognormal(source.std_db)
    if kind == "nakagami":
        return _as_nakagami(source)
    return _as_rician(source)


def _as_nakagami(source: Multipath) -> Nakagami:
    """Return Nakagami fading of equal power variance, or equal omega for a lognormal `source`."""
    if isinstance(source, Lognormal):
        return Nakagami(_with_std(lambda m: Nakagami(m).std_db, MIN_M, source.std_db))
    if isinstance(source, Nakagami):
        return source
    # (K + 1)^2 / (2 K + 1), in a form that rounding cannot bring below 1.
    return Nakagami(1.0 + source.k_factor**2 / (2.0 * source.k_factor + 1.0))


def _as_rician(source: Multipath) -> Rician:
    """Return Rician fading of equal power variance, or of equal omega for a lognormal `source`."""
    if isinstance(source, Lognormal):
        return Rician(_with_std(lambda k: Rician(k).std_db, 0.0, source.std_db))
    if isinstance(source, Rician):
        return source
    if source.m < 1.0:
        raise InputError(
            f"is {source.m!r}: no Rician factor K has the same power variance",
            key="m",
            remedy="give m of at least 1",
        )
    return Rician(source.m - 1.0 + math.sqrt(source.m * (source.m - 1.0)))


def _with_std(std_db: Callable[[float], float], least: float, wanted_db: float) -> float:
    """Return the parameter m or K whose fading has standard deviation `wanted_db`."""
    most_db, least_db = std_db(least), std_db(STRONGEST)
    if not least_db <= wanted_db <= most_db:
        raise InputError(
            f"is {wanted_db!r} dB, which this kind of multipath cannot have",
            key="multipath_std_db",
            remedy=f"give a standard deviation from {least_db:.2g} to {most_db:.4g} dB",
        )
    low, high = math.log1p(least), math.log1p(STRONGEST)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if std_db(math.expm1(middle)) > wanted_db:
            low = middle
        else:
            high = middle
    return max(least, math.expm1(0.5 * (low + high)))


def multipath_field_db(
    shape: tuple[int, ...], multipath: Multipath, generator: np.random.Generator
) -> Floats:
    """Draw independent fading in dB, with mean zero and standard deviation ``multipath.std_db``."""
    if isinstance(multipath, Lognormal):
        return multipath.std_db * generator.standard_normal(shape)
    if isinstance(multipath, Nakagami):
        power = generator.standard_gamma(multipath.m, shape) / multipath.m
    else:
        scatter = math.sqrt(0.5 / (multipath.k_factor + 1.0))
        constant = math.sqrt(multipath.k_factor / (multipath.k_factor + 1.0))
        real = constant + scatter * generator.standard_normal(shape)
        imaginary = scatter * generator.standard_normal(shape)
        power = real * real + imaginary * imaginary
    return 10.0 * np.log10(power) - multipath.mean_db


@dataclass(frozen=True, eq=False)
class Readings:
    """Ground truth from measurements: the nearest power within `within_m`."""

    measured: Measurements
    within_m: float

    @cached_property
    def _tree(self) -> PlaceTree:
        return PlaceTree(self.measured.positions_m)

    def nearest(self, places_m: Floats) -> tuple[Indices, Mask]:
        """Return the index of the reading nearest to each position, and whether it is in reach."""
        rows, away_m = self._tree.nearest(places_m, 1)
        return rows[:, 0], away_m[:, 0] <= self.within_m

    def power_dbm(self, places_m: Floats) -> Floats:
        """Return the power (n,) of the nearest reading, NaN where no reading is in reach."""
        rows, near = self.nearest(places_m)
        return np.where(near, self.measured.power_dbm[rows], np.nan)


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of the received power, with fading fixed in each cell.

    Attributes
    ----------
    raster
        Power in dBm at cell centres; a measurement reads the nearest cell.
    floor_dbm
        Sensitivity floor of the receiver, a lower bound of all values; None without a floor.
    mean_dbm
        ``[iy, ix]`` power without small-scale fading in the same cells.
    readings
        Readings of a measured ground truth (:func:`measured_truth`); None if it is simulated. Each
        position has the power of the nearest reading, or NaN if none is in reach.
    """

    raster: Raster
    floor_dbm: float | None
    mean_dbm: Floats
    readings: Readings | None = None

    __repr__ = short_repr


def raster_truth(
    path_gain: Raster,
    transmit_power_dbm: float,
    floor_gain_db: float,
    multipath: Multipath | None,
    generator: np.random.Generator,
) -> Truth:
    """Return the ground truth from a map of path gains, such as the output of a ray tracer.

    Parameters
    ----------
    path_gain
        Path gains in dB; NaN where there is no signal.
    transmit_power_dbm
        Transmit power, added to the gains.
    floor_gain_db
        Sensitivity floor of the receiver as a gain; gains with fading are clipped to it.
    multipath
        Fading law of each cell; None for no fading.
    generator
        Random number generator of the fading.
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
    """Draw the ground truth from the channel model (equation 1.1).

    Parameters
    ----------
    parameters
        Parameters of path loss, shadowing and multipath; one value is drawn per cell.
    bounds_m
        ``(x_min, y_min, x_max, y_max)``, covered by whole cells from the lower left corner.
    cell_m
        Cell side in metres.
    floor_dbm
        Sensitivity floor of the receiver; None without a floor.
    generator
        Random number generator of shadowing and multipath.
    multipath
        Fading law; None for lognormal fading with the standard deviation of `parameters`.
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
    """Draw the ground truth from a posterior; see :func:`model_truth` for the other parameters."""
    mean = conditional_field(posterior, bounds_m, cell_m, generator)
    return _faded(mean, Lognormal(posterior.parameters.multipath_std_db), floor_dbm, generator)


def _faded(
    mean: Raster, law: Multipath, floor_dbm: float | None, generator: np.random.Generator
) -> Truth:
    """Add multipath to a raster of powers and apply the receiver's floor."""
    power = mean.values
    faded = power + multipath_field_db(power.shape, law, generator)
    if floor_dbm is not None:
        power, faded = np.maximum(power, floor_dbm), np.maximum(faded, floor_dbm)
    return Truth(Raster(mean.x_m, mean.y_m, faded), floor_dbm, power)


def power_truth(
    x_m: Floats,
    y_m: Floats,
    power_dbm: Floats,  # (ny, nx), NaN where there is no signal
    floor_dbm: float | None = None,
) -> Truth:
    """Return the ground truth from a grid of received power, with or without small-scale fading."""
    # Shapes: x_m, y_m (nx,).
    raster = checked_raster(x_m, y_m, power_dbm, "power_dbm")
    if floor_dbm is not None and not abs(floor_dbm) <= MAX_POWER_DB:
        raise InputError(f"is {floor_dbm!r}, should be a power", key="floor_dbm", remedy="give dBm")
    if floor_dbm is None and np.isnan(raster.values).any():
        raise InputError(
            "has cells without a value, and floor_dbm is missing",
            key="power_dbm",
            remedy="give floor_dbm, the weakest power that the receiver reports",
        )
    power = raster.values if floor_dbm is None else np.fmax(raster.values, floor_dbm)
    if not (np.abs(power) <= MAX_POWER_DB).all():
        raise InputError(
            f"has values outside -{MAX_POWER_DB:g} to {MAX_POWER_DB:g} dBm",
            key="power_dbm",
            remedy="give dBm",
        )
    return Truth(Raster(raster.x_m, raster.y_m, power), floor_dbm, power)


def measured_truth(
    readings: Measurements,
    bounds_m: tuple[float, float, float, float],
    cell_m: float,
    within_m: float,
) -> Truth:
    """Return a measured ground truth: the nearest reading within `within_m`, else NaN."""
    _, first = np.unique(readings.positions_m, axis=0, return_index=True)
    known = Readings(readings.take(np.sort(first)), within_m)
    x, y = (cell_centres_m(bounds_m[axis], bounds_m[2 + axis], cell_m) for axis in range(2))
    centres = np.stack(np.meshgrid(x, y), axis=-1)
    power = known.power_dbm(centres.reshape(-1, 2)).reshape(len(y), len(x))
    return Truth(Raster(x, y, power), None, power, known)


def true_power_dbm(truth: Truth, positions_m: ArrayLike) -> Floats:
    """Return the received power (n,) in dBm at `positions_m` (n, 2), at least the floor."""
    places = require_places(positions_m, at_least=0)
    if truth.readings is not None:
        return truth.readings.power_dbm(places)
    iy, ix = nearest_cells(truth.raster, places)
    return truth.raster.values[iy, ix]


def mean_power_dbm(truth: Truth, positions_m: ArrayLike) -> Floats:
    """Return the power (n,) in dBm without small-scale fading at `positions_m` (n, 2)."""
    if truth.readings is not None:
        return true_power_dbm(truth, positions_m)
    iy, ix = nearest_cells(truth.raster, require_places(positions_m, at_least=0))
    return truth.mean_dbm[iy, ix]


def measure(truth: Truth, positions_m: ArrayLike) -> Measurements:
    """Measure the power at `positions_m` (n, 2); values at the floor are censored.

    Positions where a measured ground truth has no reading in reach are left out.
    """
    if truth.readings is not None:
        places = require_places(positions_m, at_least=0)
        rows, near = truth.readings.nearest(places)
        taken = truth.readings.measured.take(rows[near])
        return Measurements(places[near], taken.power_dbm, taken.censored)
    power = true_power_dbm(truth, positions_m)
    censored = np.zeros(len(power), dtype=bool)
    if truth.floor_dbm is not None:
        censored = power <= truth.floor_dbm
    return Measurements(np.array(positions_m, dtype=np.float64), power, censored)
