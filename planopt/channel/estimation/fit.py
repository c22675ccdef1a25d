"""Estimate the channel from power measurements, by any of five methods, with what is in doubt.

Every method reports a status, standard errors and, in words, which parameter the measurements do
not determine and what stands in for it. Nothing but an :class:`planopt.errors.InputError` leaves
here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.convex_fit import Loss, convex_fit
from planopt.channel.estimation.covariance_fit import (
    FALLBACK_TOTAL_VARIANCE_DB2,
    CovarianceBounds,
    CovarianceFit,
    covariance_bounds,
    fallback_fit,
)
from planopt.channel.estimation.empirical_correlation import (
    EmpiricalCorrelation,
    empirical_correlation,
)
from planopt.channel.estimation.identifiability import Identifiability, examine
from planopt.channel.estimation.least_squares import (
    LeastSquares,
    coefficient_covariance,
    least_squares,
)
from planopt.channel.estimation.lemma1 import capped_bins, enough, lemma1_fit, seed_bins
from planopt.channel.estimation.nls_fit import nls_fit
from planopt.channel.estimation.reml import MAX_MEASUREMENTS, reml_fit, thinned
from planopt.channel.mean_model import PRIOR_N_PL, MeanModel, mean_model
from planopt.channel.measurements import Measurements
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.channel.receiver_offsets import ReceiverOffset, receiver_offsets
from planopt.errors import InputError

FitMethod = Literal["seed", "capped", "convex", "nls", "reml"]

PRIOR_K_PL_STD_DB = 20.0
"""Deviation of K_PL where every measurement is censored."""

OFFSET_MEASUREMENTS = 50
"""Of each receiver at least so many, where there are, serve to estimate its offset."""


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
    receiver_offsets
        How much more each receiver but number 0 reads; empty where all measurements are by that.
    station_covariance_m2
        ``(2, 2)`` covariance of the station's x and y where its position is estimated, ``inf`` on
        the diagonal where it is not determined; None where it was given.
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
    receiver_offsets: tuple[ReceiverOffset, ...] = ()
    station_covariance_m2: NDArray[np.float64] | None = None


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
    measurements: Measurements,
    station: Station,
    method: FitMethod = "reml",
    forgetting_s: float = math.inf,
    *,
    loss: Loss = "squares",
) -> ChannelFit:
    """Estimate path loss, shadowing and multipath.

    Errors of position and the age of measurements are terms of the likelihood of ``reml``; the
    other methods leave them out, and say so. Offsets of receivers are estimated with any method.

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
    forgetting_s
        T: shadowing at two times has correlation ``exp(-|t - t'| / T)``. Given, not estimated;
        ``math.inf`` for a channel that does not drift.
    loss
        What ``convex`` makes of the scatter about its line
        (:func:`planopt.channel.estimation.convex_fit.convex_fit`); others have squares.

    Raises
    ------
    InputError
        See :func:`planopt.channel.estimation.identifiability.examine`; or `forgetting_s` is not
        positive; or there is no such method or loss, or the method has none to choose.
    """
    require_method(method, "method")
    require_loss(loss, method, "loss")
    if not forgetting_s > 0.0:
        raise InputError(
            f"{forgetting_s!r} s is no forgetting time",
            key="forgetting_s",
            remedy="give more than 0, or inf for a channel that does not drift",
        )
    allows = examine(measurements, station)
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
    given = _Given(model, measurements, station, allows, forgetting_s)
    if not exact.any():
        estimate = _all_censored(given)
    elif allows.covariance_reason is not None:
        estimate = _assumed_covariance(given, allows.covariance_reason)
    elif method == "reml":
        estimate = _by_likelihood(given)
    else:
        estimate = _by_correlation(given, method, loss)
    return _dressed(estimate, given, method)


def require_method(method: str, key: str) -> None:
    """Refuse a method that does not exist; `key` is what it was given by."""
    if method not in get_args(FitMethod):
        remedy = f"use {', '.join(get_args(FitMethod))}"
        raise InputError(f"{method!r} is no method", key=key, remedy=remedy)


def require_loss(loss: str, method: FitMethod, key: str) -> None:
    """Refuse a loss that does not exist, or is not the method's; `key` is what it was given by."""
    if loss not in get_args(Loss):
        raise InputError(f"{loss!r} is no loss", key=key, remedy=f"use {', '.join(get_args(Loss))}")
    if loss != "squares" and method != "convex":
        raise InputError(
            f"{method} has no choice of loss", key=key, remedy="use it with method convex"
        )


@dataclass(frozen=True)
class _Given:
    """What a fit starts from."""

    model: MeanModel
    measurements: Measurements
    station: Station
    allows: Identifiability
    forgetting_s: float

    def parameters(
        self, coefficients: NDArray[np.float64], covariance: CovarianceFit
    ) -> ChannelParameters:
        """An estimate as parameters."""
        k_pl, n_pl = self.model.theta(coefficients)
        return ChannelParameters(
            k_pl_db=k_pl,
            n_pl=n_pl,
            shadow_std_db=math.sqrt(covariance.shadow_variance_db2),
            decorrelation_m=covariance.decorrelation_m,
            multipath_std_db=math.sqrt(covariance.multipath_variance_db2),
            station=self.station,
            forgetting_s=self.forgetting_s,
        )


def _by_likelihood(given: _Given) -> _Estimate:
    """Restricted maximum likelihood, on a thinned set where there are many."""
    model, measurements, allows = given.model, given.measurements, given.allows
    line = least_squares(model, measurements)
    bounds = covariance_bounds(line.variance_db2, allows.decorrelation_bounds_m)
    # Errors of path loss need n_PL before it is known: that of the least-squares line.
    rough = fallback_fit(line.variance_db2, allows.decorrelation_bounds_m, "a first guess")
    known = given.parameters(line.coefficients, rough)
    rows = thinned(len(measurements), MAX_MEASUREMENTS)
    notes: tuple[str, ...] = ()
    if len(rows) < len(measurements):
        notes = (f"fitted on {MAX_MEASUREMENTS} of {len(measurements)} measurements",)
        model = MeanModel(model.columns[rows], model.offset_db[rows], model.regressor_mean)
        measurements = measurements.take(rows)
    found = reml_fit(model, measurements, bounds, known)
    return _Estimate(
        found.covariance,
        found.coefficients,
        found.coefficient_covariance,
        notes,
        found.log_likelihood,
    )


def _by_correlation(given: _Given, method: FitMethod, loss: Loss) -> _Estimate:
    """Least-squares line, then xi and beta from the empirical correlation of what it leaves."""
    measurements, allows = given.measurements, given.allows
    line = least_squares(given.model, measurements)
    bounds = covariance_bounds(line.variance_db2, allows.decorrelation_bounds_m)
    correlation = empirical_correlation(measurements.positions_m, line.residual_db, allows.extent_m)
    covariance = _from_bins(correlation, line, allows, bounds, method, loss)
    notes: list[str] = []
    if measurements.censored.any():
        notes.append(
            "censored powers were replaced by their expected values; reml treats them better"
        )
    if math.isfinite(given.forgetting_s) and np.ptp(measurements.time_s) > 0.0:
        notes.append("xi, beta and omega were fitted without regard to age; reml regards it")
    if measurements.position_std_m.any():
        notes.append(
            "xi, beta and omega were fitted without regard to errors of position; reml regards them"
        )
    return _with_line(line, given, covariance, tuple(notes))


def _from_bins(
    correlation: EmpiricalCorrelation,
    line: LeastSquares,
    allows: Identifiability,
    bounds: CovarianceBounds,
    method: FitMethod,
    loss: Loss,
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
    if method == "convex":
        return convex_fit(bins, alpha, count, bounds, loss)
    return lemma1_fit(bins, alpha, count, bounds)


def _assumed_covariance(given: _Given, reason: str) -> _Estimate:
    """A line through few measurements, with a covariance that is assumed."""
    covariance = fallback_fit(
        FALLBACK_TOTAL_VARIANCE_DB2, given.allows.decorrelation_bounds_m, reason
    )
    return _with_line(least_squares(given.model, given.measurements), given, covariance, ())


def _with_line(
    line: LeastSquares, given: _Given, covariance: CovarianceFit, notes: tuple[str, ...]
) -> _Estimate:
    """A least-squares line, with its covariance under `covariance`."""
    spread = coefficient_covariance(
        given.model, given.measurements, given.parameters(line.coefficients, covariance)
    )
    return _Estimate(covariance, line.coefficients, spread, notes)


def _all_censored(given: _Given) -> _Estimate:
    """The highest path loss line of slope `PRIOR_N_PL` that no limit contradicts."""
    highest = float((given.measurements.power_dbm - given.model.offset_db).min())
    return _Estimate(
        fallback_fit(
            FALLBACK_TOTAL_VARIANCE_DB2,
            given.allows.decorrelation_bounds_m,
            "every measurement is censored",
        ),
        np.array([highest]),
        np.array([[PRIOR_K_PL_STD_DB**2]]),
    )


def _offsets(
    measurements: Measurements, parameters: ChannelParameters
) -> tuple[ReceiverOffset, ...]:
    """Offsets of receivers under fitted parameters, from `MAX_MEASUREMENTS` or few more."""
    if not measurements.receiver.any():
        return ()
    rows = [thinned(len(measurements), MAX_MEASUREMENTS)]
    for receiver in np.unique(measurements.receiver):
        own = np.flatnonzero(measurements.receiver == receiver)
        rows.append(own[thinned(len(own), OFFSET_MEASUREMENTS)])
    some = measurements.take(np.unique(np.concatenate(rows)))
    return receiver_offsets(condition(parameters, some))


def _dressed(estimate: _Estimate, given: _Given, method: FitMethod) -> ChannelFit:
    """Everything as the user gets it."""
    covariance, allows, measurements = estimate.covariance, given.allows, given.measurements
    parameters = given.parameters(estimate.coefficients, covariance)
    theta_covariance = given.model.theta_covariance(estimate.coefficient_covariance)
    doubts = list(covariance.warnings)
    if allows.n_pl_reason is not None:
        doubts.insert(0, f"n_PL is assumed {PRIOR_N_PL:g}, not estimated: {allows.n_pl_reason}")
    notes = list(estimate.notes)
    if parameters.n_pl < 0.0:
        notes.append("n_PL is negative: power grows with the distance to the station")
    if (measurements.receiver != 0).all():
        notes.append(
            "receiver 0, for which powers are predicted, measured nothing: K_PL is known no better "
            "than the offsets"
        )
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    shadow_error, multipath_error, beta_error = covariance.standard_errors
    return ChannelFit(
        method=method,
        status="degenerate" if doubts else "ok",
        parameters=parameters,
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
        receiver_offsets=_offsets(measurements, parameters),
    )
