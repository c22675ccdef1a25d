"""Path loss by least squares (equation 2.1), and identifiability of the channel parameters.

The number and geometry of the positions decide which parameters can be identified; this is checked
before any estimation. Censored powers are handled by the EM algorithm of Tobit regression.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from scipy.special import log_ndtr

from planopt.arrays import Floats
from planopt.channel.gaussian_sites import rounded_variance_db2
from planopt.channel.measurements import (
    Measurements,
    covariance_db2,
    measured_origins,
    measured_path_loss_variance_db2,
    own_variance_db2,
)
from planopt.channel.neighbours import PlaceTree
from planopt.channel.parameters import ChannelParameters, MeanModel, Station, regressors
from planopt.errors import InputError

MIN_MEASUREMENTS_THETA = 3
"""Minimum number of measurements for theta; a line through two points has no residuals."""
MIN_MEASUREMENTS_COVARIANCE = 6
"""Minimum number of measurements for xi, beta and omega, one more than there are parameters."""
MIN_REGRESSOR_SPREAD_DB = 0.2
"""Minimum range of 10 log10 d for n_PL to be identifiable (distances vary by 5 %)."""
LEAST_EXTENT_M = 1e-6  # Extent below which positions count as one, because of rounding
FALLBACK_DECORRELATION_M = 10.0  # Assumed beta with fewer than two distinct positions


@dataclass(frozen=True)
class Identifiability:
    """Identifiability of the parameters, with extent of the positions and range of beta."""

    n_pl_reason: str | None  # Reason why n_PL cannot be estimated, or None
    covariance_reason: str | None  # Reason why xi, beta and omega cannot be estimated, or None
    extent_m: float  # Diagonal of the bounding box of all positions
    rotated_extent_m: float  # Least diagonal of a bounding rectangle in any direction
    # Range of beta: a third of the smallest useful spacing to the extent
    decorrelation_bounds_m: tuple[float, float]


def examine(measurements: Measurements, station: Station) -> Identifiability:
    """Return the identifiability of the channel parameters, with reasons."""
    require_usable(measurements, station)
    exact = ~measurements.censored
    positions = measurements.positions_m[exact]
    count = len(positions)
    distinct = np.unique(measurements.positions_m, axis=0)
    extent = float(np.hypot(*np.ptp(distinct, axis=0)))
    return Identifiability(
        _n_pl_reason(positions, station, count),
        _covariance_reason(positions, count),
        extent,
        _rotated_extent_m(distinct),
        _decorrelation_bounds_m(distinct, extent),
    )


def require_usable(measurements: Measurements, station: Station | None) -> None:
    """Raise an error if nothing can be estimated from the measurements."""
    count = len(measurements)
    if count == 0:
        raise InputError(
            "there are no measurements to fit", remedy="give at least three measurements"
        )
    if station is not None:
        offset = measurements.positions_m - np.asarray(station.position_m)
        at_station = np.flatnonzero((offset**2).sum(axis=1) + station.height_m**2 == 0.0)
        if len(at_station):
            index = int(at_station[0])
            raise InputError(
                f"measurement {index} (counted from 0) is exactly at the station, where the "
                "path loss is undefined",
                row=index,
                remedy="correct the position, or give the station's height",
            )
    if count > 1 and np.ptp(measurements.positions_m, axis=0).max() < LEAST_EXTENT_M:
        raise InputError(
            f"all {count} measurements are at the same position",
            remedy="measure at different distances from the station",
        )


def _n_pl_reason(positions: Floats, station: Station, count: int) -> str | None:
    """Return the reason why n_PL cannot be estimated, or None."""
    if count < MIN_MEASUREMENTS_THETA:
        return f"{count} uncensored measurements are fewer than {MIN_MEASUREMENTS_THETA}"
    if float(np.ptp(regressors(positions, station)[:, 1])) < MIN_REGRESSOR_SPREAD_DB:
        return "all uncensored measurements are at one distance from the station"
    return None


def _covariance_reason(positions: Floats, count: int) -> str | None:
    """Return the reason why xi, beta and omega cannot be estimated, or None."""
    if count < MIN_MEASUREMENTS_COVARIANCE:
        return f"{count} uncensored measurements are fewer than {MIN_MEASUREMENTS_COVARIANCE}"
    if len(np.unique(positions, axis=0)) < MIN_MEASUREMENTS_THETA:
        return "the uncensored measurements are in fewer than three places"
    return None


def _rotated_extent_m(positions_m: Floats) -> float:
    """Return the least diagonal of bounding rectangles with a side along the convex hull."""
    hull = shapely.get_coordinates(shapely.convex_hull(shapely.MultiPoint(positions_m)))
    edges = np.diff(hull, axis=0)
    lengths_m = np.hypot(edges[:, 0], edges[:, 1])
    along = edges[lengths_m > 0.0] / lengths_m[lengths_m > 0.0, None]
    across = along[:, ::-1] * np.array([-1.0, 1.0])
    sides_m = (np.ptp(hull @ axes.T, axis=0) for axes in (along, across))
    return float(np.hypot(*sides_m).min()) if len(along) else 0.0


def _decorrelation_bounds_m(distinct: Floats, extent_m: float) -> tuple[float, float]:
    """Return bounds of beta from distinct positions (n, 2)."""
    if len(distinct) < 2:
        return FALLBACK_DECORRELATION_M, FALLBACK_DECORRELATION_M
    # A quantile is robust against two positions that happen to be a centimetre apart.
    spacing = max(float(np.quantile(nearest_distance_m(distinct), 0.05)), LEAST_EXTENT_M)
    return min(spacing, extent_m) / 3.0, extent_m


def nearest_distance_m(positions_m: Floats) -> Floats:
    """Return the distance (n,) of each position (n, 2) from its nearest neighbour."""
    return PlaceTree(positions_m).nearest(positions_m, 2)[1][:, 1]


MAX_SWEEPS = 500
OFFSET_RIDGE = 1e-6  # Ridge weight of receiver offsets, which fixes unidentifiable combinations
TOLERANCE_DB = 1e-6  # Maximum change of a fitted value at convergence
ROWS = 512  # Number of rows of the covariance in memory at once


@dataclass(frozen=True)
class LeastSquares:
    """Least-squares fit of the mean model."""

    coefficients: Floats  # (p,) of the mean model (theta-hat for p = 2)
    residual_db: Floats  # (n,) completed power minus the line, Y_c of equation 2.1
    # Mean squared residual, plus variance of censored powers, less that of rounding
    variance_db2: float


def least_squares(model: MeanModel, measurements: Measurements) -> LeastSquares:
    """Fit the path loss line to the measurements; at least one must be uncensored."""
    power = measurements.power_dbm - model.offset_db
    columns = np.column_stack([model.columns, receiver_columns(measurements)])
    inverse = _ridged_inverse(columns, model.columns.shape[1])
    censored = measurements.censored
    exact = ~censored
    limit = power[censored]
    # The initial guess uses uncensored powers, so that floors do not flatten the slope.
    coefficients = _ridged_inverse(columns[exact], model.columns.shape[1]) @ power[exact]
    variance = float(np.mean((power[exact] - columns[exact] @ coefficients) ** 2))
    completed = power.copy()
    hidden = 0.0
    for _ in range(MAX_SWEEPS):
        before = columns @ coefficients
        completed[censored], variances = _expected_below(limit, before[censored], variance)
        hidden = float(variances.sum())
        coefficients = inverse @ completed
        fitted = columns @ coefficients
        variance = float((((completed - fitted) ** 2).sum() + hidden) / len(power))
        if np.abs(fitted - before).max() < TOLERANCE_DB:
            break
    rounding = float(rounded_variance_db2(measurements.resolution_db[exact]).sum()) / len(power)
    return LeastSquares(
        coefficients[: model.columns.shape[1]],
        completed - columns @ coefficients,
        max(variance - rounding, 0.0),
    )


def coefficient_covariance(
    model: MeanModel, measurements: Measurements, parameters: ChannelParameters
) -> Floats:
    """Return the covariance (p, p) of least-squares coefficients under correlated shadowing."""
    # The result is (G'G)^-1 G' U G (G'G)^-1, U the power covariance. The usual alpha (G'G)^-1
    # is several times too small if beta spans many measurements.
    columns = np.column_stack([model.columns, receiver_columns(measurements)])
    count = model.columns.shape[1]
    origins = measured_origins(measurements, parameters)
    noise = parameters.multipath_std_db**2 + rounded_variance_db2(measurements.resolution_db)
    noise += measured_path_loss_variance_db2(measurements, parameters)
    inverse = _ridged_inverse(columns, count)[:count]
    spread = (inverse * noise) @ inverse.T
    for first in range(0, len(columns), ROWS):
        rows = slice(first, first + ROWS)
        some = origins.at(rows)
        block = covariance_db2(some, origins, parameters)
        own = np.arange(len(block))
        block[own, first + own] = own_variance_db2(some, parameters)
        spread += inverse[:, rows] @ block @ inverse.T
    return 0.5 * (spread + spread.T)


def receiver_columns(measurements: Measurements) -> Floats:
    """Return indicator columns (n, R) of the R receivers other than number 0."""
    numbers = np.unique(measurements.receiver)
    return (measurements.receiver[:, None] == numbers[numbers != 0]).astype(np.float64)


def _ridged_inverse(columns: Floats, free: int) -> Floats:
    """Return the pseudoinverse (q, n) of `columns`, with a ridge for columns from index `free`."""
    if columns.shape[1] == free:
        return np.asarray(np.linalg.pinv(columns), dtype=np.float64)
    ridge = np.sqrt(OFFSET_RIDGE) * np.eye(columns.shape[1])[free:]
    whole = np.asarray(np.linalg.pinv(np.vstack([columns, ridge])), dtype=np.float64)
    return whole[:, : len(columns)]


def _expected_below(limit: Floats, mean: Floats, variance: float) -> tuple[Floats, Floats]:
    """Return means (m,) and variances (m,) of normal variables truncated above at `limit`."""
    deviation = np.sqrt(max(variance, 1e-12))
    z = (limit - mean) / deviation
    log_below = np.asarray(log_ndtr(z), dtype=np.float64)
    hazard = np.exp(-0.5 * z * z - 0.5 * np.log(2.0 * np.pi) - log_below)
    shrink = np.clip(hazard * (z + hazard), 0.0, 1.0)
    # The minimum keeps the mean below its limit where the hazard loses precision.
    return np.minimum(mean - deviation * hazard, limit), deviation**2 * (1.0 - shrink)
