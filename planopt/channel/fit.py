"""Estimate the channel from power measurements, by any of five methods, with what is in doubt.

Every method reports a status, standard errors and, in words, which parameter the measurements do
not determine and what stands in for it. Nothing but an :class:`planopt.errors.InputError` leaves
here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.convex_fit import convex_fit
from planopt.channel.covariance_fit import (
    FALLBACK_TOTAL_VARIANCE_DB2,
    CovarianceBounds,
    CovarianceFit,
    covariance_bounds,
    fallback_fit,
)
from planopt.channel.empirical_correlation import EmpiricalCorrelation, empirical_correlation
from planopt.channel.identifiability import Identifiability, examine
from planopt.channel.least_squares import LeastSquares, coefficient_covariance, least_squares
from planopt.channel.lemma1 import capped_bins, enough, lemma1_fit, seed_bins
from planopt.channel.mean_model import PRIOR_N_PL, MeanModel, mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.nls_fit import nls_fit
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.reml import MAX_MEASUREMENTS, reml_fit, thinned

FitMethod = Literal["seed", "capped", "convex", "nls", "reml"]

PRIOR_K_PL_STD_DB = 20.0
"""Deviation of K_PL where every measurement is censored."""


@dataclass(frozen=True)
class ChannelFit:
    """Estimated channel parameters.

    Attributes
    ----------
    method
        How they were estimated.
    status
        ``"ok"``, or ``"degenerate"`` when a parameter is not determined by the measurements (it
        is at a bound of its range, or a prior stands in); `warnings` say which and why.
    parameters
        The estimate; always usable: finite, with xi, omega and beta positive.
    standard_errors
        Of ``k_pl_db, n_pl, shadow_std_db, decorrelation_m, multipath_std_db``; ``math.inf`` where
        unknown, never NaN.
    theta_covariance
        ``(2, 2)`` covariance of (K_PL, n_PL), finite.
    measurements, censored
        How many were given, and how many of these only as upper limits.
    warnings
        What the user should know.
    log_likelihood
        Restricted log likelihood, for ``reml`` only.
    """

    method: FitMethod
    status: Literal["ok", "degenerate"]
    parameters: ChannelParameters
    standard_errors: dict[str, float]
    theta_covariance: NDArray[np.float64]
    measurements: int
    censored: int
    warnings: tuple[str, ...]
    log_likelihood: float | None


@dataclass(frozen=True)
class _Estimate:
    """Covariance and mean before they are dressed as a `ChannelFit`."""

    covariance: CovarianceFit
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    notes: tuple[str, ...] = ()
    log_likelihood: float | None = None


@one_blas_thread()
def fit_channel(
    measurements: Measurements, station: Station, method: FitMethod = "reml"
) -> ChannelFit:
    """Estimate path loss, shadowing and multipath.

    Parameters
    ----------
    measurements
        Where, how much, and which are only upper limits. Repeated positions are data.
    station
        The fixed station.
    method
        ``seed``: Lemma 1 as printed. ``capped``: the same with a lag cap and weights n r^2.
        ``convex``: that as a convex programme with xi^2 <= alpha and beta bounded. ``nls``: the
        exponential fitted without logarithm to all bins. ``reml``: restricted maximum likelihood
        (default), on a fixed random draw of `MAX_MEASUREMENTS` where there are more. The first
        four complete censored powers by their expected values and ignore what that hides of the
        correlation; only ``reml`` has them as a term of the likelihood.

    Raises
    ------
    InputError
        See :func:`planopt.channel.identifiability.examine`.
    """
    allows = examine(measurements, station)
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
    if not exact.any():
        estimate = _all_censored(model, measurements, allows)
    elif allows.covariance_reason is not None:
        estimate = _assumed_covariance(model, measurements, allows, allows.covariance_reason)
    elif method == "reml":
        estimate = _by_likelihood(model, measurements, allows)
    else:
        estimate = _by_correlation(model, measurements, allows, method)
    return _dressed(estimate, model, measurements, station, allows, method)


def _by_likelihood(
    model: MeanModel, measurements: Measurements, allows: Identifiability
) -> _Estimate:
    """Restricted maximum likelihood, on a thinned set where there are many."""
    bounds = covariance_bounds(
        least_squares(model, measurements).variance_db2, allows.decorrelation_bounds_m
    )
    rows = thinned(len(measurements), MAX_MEASUREMENTS)
    notes: tuple[str, ...] = ()
    if len(rows) < len(measurements):
        notes = (f"fitted on {MAX_MEASUREMENTS} of {len(measurements)} measurements",)
        model = MeanModel(model.columns[rows], model.offset_db[rows], model.regressor_mean)
        measurements = measurements.take(rows)
    found = reml_fit(model, measurements, bounds)
    return _Estimate(
        found.covariance,
        found.coefficients,
        found.coefficient_covariance,
        notes,
        found.log_likelihood,
    )


def _by_correlation(
    model: MeanModel, measurements: Measurements, allows: Identifiability, method: FitMethod
) -> _Estimate:
    """Least-squares line, then xi and beta from the empirical correlation of what it leaves."""
    line = least_squares(model, measurements)
    bounds = covariance_bounds(line.variance_db2, allows.decorrelation_bounds_m)
    correlation = empirical_correlation(measurements.positions_m, line.residual_db, allows.extent_m)
    covariance = _from_bins(correlation, line, allows, bounds, method)
    notes: tuple[str, ...] = ()
    if measurements.censored.any():
        notes = ("censored powers were replaced by their expected values; reml treats them better",)
    return _with_line(line, model, measurements, covariance, notes)


def _from_bins(
    correlation: EmpiricalCorrelation,
    line: LeastSquares,
    allows: Identifiability,
    bounds: CovarianceBounds,
    method: FitMethod,
) -> CovarianceFit:
    """xi, beta and omega by one of the methods on binned correlations."""
    alpha, count = line.variance_db2, len(line.residual_db)
    if alpha < bounds.shadow_db2[0]:
        return fallback_fit(alpha, allows.decorrelation_bounds_m, "the powers lie on the line")
    if method == "nls":
        return nls_fit(correlation, alpha, count, bounds)
    bins = (
        seed_bins(correlation, alpha)
        if method == "seed"
        else capped_bins(correlation, alpha, allows.extent_m)
    )
    if not enough(bins):
        return fallback_fit(
            alpha,
            allows.decorrelation_bounds_m,
            "fewer than two lags have a correlation between 0 and alpha",
        )
    fit = convex_fit if method == "convex" else lemma1_fit
    return fit(bins, alpha, count, bounds)


def _assumed_covariance(
    model: MeanModel, measurements: Measurements, allows: Identifiability, reason: str
) -> _Estimate:
    """A line through few measurements, with a covariance that is assumed."""
    covariance = fallback_fit(FALLBACK_TOTAL_VARIANCE_DB2, allows.decorrelation_bounds_m, reason)
    return _with_line(least_squares(model, measurements), model, measurements, covariance, ())


def _with_line(
    line: LeastSquares,
    model: MeanModel,
    measurements: Measurements,
    covariance: CovarianceFit,
    notes: tuple[str, ...],
) -> _Estimate:
    """A least-squares line, with its covariance under `covariance`."""
    spread = coefficient_covariance(
        model,
        measurements.positions_m,
        covariance.shadow_variance_db2,
        covariance.decorrelation_m,
        covariance.multipath_variance_db2,
    )
    return _Estimate(covariance, line.coefficients, spread, notes)


def _all_censored(
    model: MeanModel, measurements: Measurements, allows: Identifiability
) -> _Estimate:
    """The highest path loss line of slope `PRIOR_N_PL` that no limit contradicts."""
    highest = float((measurements.power_dbm - model.offset_db).min())
    return _Estimate(
        fallback_fit(
            FALLBACK_TOTAL_VARIANCE_DB2,
            allows.decorrelation_bounds_m,
            "every measurement is censored",
        ),
        np.array([highest]),
        np.array([[PRIOR_K_PL_STD_DB**2]]),
    )


def _dressed(
    estimate: _Estimate,
    model: MeanModel,
    measurements: Measurements,
    station: Station,
    allows: Identifiability,
    method: FitMethod,
) -> ChannelFit:
    """Everything as the user gets it."""
    covariance = estimate.covariance
    k_pl, n_pl = model.theta(estimate.coefficients)
    theta_covariance = model.theta_covariance(estimate.coefficient_covariance)
    doubts = list(covariance.warnings)
    if allows.n_pl_reason is not None:
        doubts.insert(0, f"n_PL is assumed {PRIOR_N_PL:g}, not estimated: {allows.n_pl_reason}")
    notes = list(estimate.notes)
    if n_pl < 0.0:
        notes.append("n_PL is negative: power grows with the distance to the station")
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    shadow_error, multipath_error, beta_error = covariance.standard_errors
    return ChannelFit(
        method=method,
        status="degenerate" if doubts else "ok",
        parameters=ChannelParameters(
            k_pl_db=k_pl,
            n_pl=n_pl,
            shadow_std_db=math.sqrt(covariance.shadow_variance_db2),
            decorrelation_m=covariance.decorrelation_m,
            multipath_std_db=math.sqrt(covariance.multipath_variance_db2),
            station=station,
        ),
        standard_errors={
            "k_pl_db": float(k_error),
            "n_pl": float(n_error),
            "shadow_std_db": shadow_error,
            "decorrelation_m": beta_error,
            "multipath_std_db": multipath_error,
        },
        theta_covariance=theta_covariance,
        measurements=len(measurements),
        censored=int(measurements.censored.sum()),
        warnings=(*doubts, *notes),
        log_likelihood=estimate.log_likelihood,
    )
