"""Covariance and mean of a channel by one of the methods, or by assumption where none can."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import FitMethod, Loss
from planopt.channel.estimation.convex_fit import convex_fit
from planopt.channel.estimation.covariance_fit import (
    FALLBACK_TOTAL_VARIANCE_DB2,
    CovarianceBounds,
    CovarianceFit,
    covariance_bounds,
    fallback_fit,
)
from planopt.channel.estimation.identifiability import Identifiability
from planopt.channel.estimation.least_squares import (
    LeastSquares,
    coefficient_covariance,
    least_squares,
)
from planopt.channel.estimation.lemma1 import (
    EmpiricalCorrelation,
    capped_bins,
    empirical_correlation,
    enough,
    lemma1_fit,
    printed_bins,
)
from planopt.channel.estimation.likelihood_data import Covariance
from planopt.channel.estimation.nls_fit import nls_fit
from planopt.channel.estimation.reml import RemlFit, reml_fit
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, MeanModel, Station

PRIOR_K_PL_STD_DB = 20.0
"""Deviation of K_PL where every measurement is censored."""


@dataclass(frozen=True)
class GivenToFit:
    """The input of a fit."""

    model: MeanModel
    measurements: Measurements
    station: Station
    allows: Identifiability
    forgetting_s: float

    def parameters(
        self, coefficients: NDArray[np.float64], covariance: Covariance
    ) -> ChannelParameters:
        """An estimate as parameters."""
        k_pl, n_pl = self.model.theta(coefficients)
        shadow, nugget, beta = covariance
        return ChannelParameters(
            k_pl_db=k_pl,
            n_pl=n_pl,
            shadow_std_db=math.sqrt(shadow),
            decorrelation_m=beta,
            multipath_std_db=math.sqrt(nugget),
            station=self.station,
            forgetting_s=self.forgetting_s,
        )


@dataclass(frozen=True)
class Estimate:
    """Covariance and mean before they are dressed as a `ChannelFit`."""

    covariance: CovarianceFit
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    notes: tuple[str, ...] = ()
    reml: RemlFit | None = None


def by_likelihood(given: GivenToFit, *, errors: bool = True) -> Estimate:
    """Restricted maximum likelihood of all measurements; `errors` as in :func:`reml_fit`."""
    model, measurements, allows = given.model, given.measurements, given.allows
    line = least_squares(model, measurements)
    bounds = covariance_bounds(line.variance_db2, allows.decorrelation_bounds_m)
    # Errors of path loss need n_PL before it is known: that of the least-squares line.
    rough = fallback_fit(line.variance_db2, allows.decorrelation_bounds_m, "a first guess")
    known = given.parameters(line.coefficients, rough.values)
    found = reml_fit(model, measurements, bounds, known, errors=errors)
    return Estimate(
        found.covariance,
        found.best.coefficients,
        found.best.coefficient_covariance,
        reml=found,
    )


def by_correlation(given: GivenToFit, method: FitMethod, loss: Loss) -> Estimate:
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
        printed_bins(correlation, alpha)
        if method == "lemma1"
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


def by_assumption(given: GivenToFit, reason: str) -> Estimate:
    """A line through few measurements, with a covariance that is assumed."""
    covariance = fallback_fit(
        FALLBACK_TOTAL_VARIANCE_DB2, given.allows.decorrelation_bounds_m, reason
    )
    return _with_line(least_squares(given.model, given.measurements), given, covariance, ())


def _with_line(
    line: LeastSquares, given: GivenToFit, covariance: CovarianceFit, notes: tuple[str, ...]
) -> Estimate:
    """A least-squares line, with its covariance under `covariance`."""
    spread = coefficient_covariance(
        given.model, given.measurements, given.parameters(line.coefficients, covariance.values)
    )
    return Estimate(covariance, line.coefficients, spread, notes)


def from_limits_alone(given: GivenToFit) -> Estimate:
    """The highest path loss line of slope `PRIOR_N_PL` that no limit contradicts."""
    highest = float((given.measurements.power_dbm - given.model.offset_db).min())
    return Estimate(
        fallback_fit(
            FALLBACK_TOTAL_VARIANCE_DB2,
            given.allows.decorrelation_bounds_m,
            "every measurement is censored",
        ),
        np.array([highest]),
        np.array([[PRIOR_K_PL_STD_DB**2]]),
    )
