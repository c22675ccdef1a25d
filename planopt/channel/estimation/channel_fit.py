"""Estimated channel with standard errors and warnings, and parameter bounds of all methods."""

import math
from dataclasses import dataclass
from importlib import import_module
from typing import Literal, cast, get_args

import numpy as np

from planopt.arrays import Floats
from planopt.channel.long_logs import ReceiverOffset
from planopt.channel.parameters import ChannelParameters
from planopt.errors import InputError
from planopt.short_repr import short_repr

FALLBACK_TOTAL_VARIANCE_DB2 = 45.0
"""Assumed alpha = xi^2 + omega^2 if it cannot be estimated: xi = 6 dB, omega = 3 dB."""
FALLBACK_CORRELATED_SHARE = 0.8  # Assumed xi^2 / alpha if the two cannot be separated
MIN_VARIANCE_DB2 = 0.01  # Lower bound of xi^2 and omega^2
MIN_NUGGET_SHARE = 0.01
"""Lower bound of omega^2 / alpha: with omega = 0, kriging would interpolate noise."""
MAX_SHADOW_RATIO = 25.0
"""Upper bound of xi^2 / residual variance; the line absorbs part of slow shadowing."""
BOUND_TOLERANCE = 1e-3
"""Relative distance within which a value counts as at a bound, because solvers stop short of it."""


@dataclass(frozen=True)
class CovarianceBounds:
    """Bounds of xi^2 (dB^2), omega^2 (dB^2) and beta (m)."""

    shadow_db2: tuple[float, float]
    multipath_db2: tuple[float, float]
    decorrelation_m: tuple[float, float]


@dataclass(frozen=True)
class CovarianceFit:
    """Estimated covariance parameters xi^2, omega^2 and beta with standard errors."""

    shadow_variance_db2: float
    multipath_variance_db2: float
    decorrelation_m: float
    # Standard errors of xi (dB), omega (dB) and beta (m); math.inf if unknown
    standard_errors: tuple[float, float, float]
    warnings: tuple[str, ...]  # Warnings about parameters that the measurements do not determine

    @property
    def values(self) -> tuple[float, float, float]:
        """Estimates (xi^2, omega^2, beta)."""
        return self.shadow_variance_db2, self.multipath_variance_db2, self.decorrelation_m


def covariance_bounds(
    residual_variance_db2: float, decorrelation_bounds_m: tuple[float, float]
) -> CovarianceBounds:
    """Return bounds of xi^2 and omega^2 from the residual variance, and the bounds of beta."""
    floor = max(MIN_VARIANCE_DB2, MIN_NUGGET_SHARE * residual_variance_db2)
    high = max(MAX_SHADOW_RATIO * residual_variance_db2, 100.0 * MIN_VARIANCE_DB2)
    return CovarianceBounds((MIN_VARIANCE_DB2, high), (floor, high), decorrelation_bounds_m)


def fallback_fit(
    total_variance_db2: float, decorrelation_bounds_m: tuple[float, float], reason: str
) -> CovarianceFit:
    """Return assumed covariance parameters; beta is a quarter of its upper bound."""
    low, high = decorrelation_bounds_m
    total = max(total_variance_db2, 2.0 * MIN_VARIANCE_DB2)
    return CovarianceFit(
        FALLBACK_CORRELATED_SHARE * total,
        (1.0 - FALLBACK_CORRELATED_SHARE) * total,
        max(high / 4.0, low),
        (math.inf, math.inf, math.inf),
        (f"xi, beta and omega are assumed, not estimated: {reason}",),
    )


def from_correlation(
    shadow_variance_db2: float,
    rate_per_m: float,
    errors: tuple[float, float],
    residual_variance_db2: float,
    count: int,
    bounds: CovarianceBounds,
) -> CovarianceFit:
    """Return the fit clipped to `bounds`; omega^2 = residual variance - xi^2 (equation 2.3)."""
    warnings: list[str] = []
    shadow = float(np.clip(shadow_variance_db2, *bounds.shadow_db2))
    shadow_error = errors[0] / (2.0 * math.sqrt(shadow))
    if not bounds.shadow_db2[0] < shadow_variance_db2 < bounds.shadow_db2[1]:
        warnings.append(at_bound("shadow_std_db", math.sqrt(shadow), "dB"))
        shadow_error = math.inf
    low, high = bounds.decorrelation_m
    rate = float(np.clip(rate_per_m, 1.0 / high, 1.0 / low))
    beta_error = errors[1] / rate**2
    if rate <= (1.0 + BOUND_TOLERANCE) / high or rate >= (1.0 - BOUND_TOLERANCE) / low:
        warnings.append(at_bound("decorrelation_m", 1.0 / rate, "m"))
        beta_error = math.inf
    left = residual_variance_db2 - shadow
    floor = bounds.multipath_db2[0]
    multipath = max(left, floor)
    multipath_error = math.hypot(residual_variance_db2 * math.sqrt(2.0 / count), errors[0]) / (
        2.0 * math.sqrt(multipath)
    )
    if left <= (1.0 + BOUND_TOLERANCE) * floor:
        warnings.append(
            f"multipath_std_db is set to {math.sqrt(multipath):.3g} dB, as the estimated multipath "
            f"variance is only {left:.3g} dB^2"
        )
        multipath_error = math.inf
    return CovarianceFit(
        shadow,
        multipath,
        float(np.clip(1.0 / rate, low, high)),
        (shadow_error, multipath_error, beta_error),
        tuple(warnings),
    )


def at_bound(name: str, value: float, unit: str) -> str:
    """Return the warning that the fitted value of a parameter is at its lower or upper bound."""
    return f"{name} is at a bound of its range ({value:.3g} {unit}): the log does not determine it"


FitMethod = Literal["lemma1", "capped", "convex", "nls", "reml", "map"]

Loss = Literal["squares", "huber", "absolute"]


def require_method(method: str, key: str) -> FitMethod:
    """Return `method`; if it is unknown, raise an error that names the option `key`."""
    if method not in get_args(FitMethod):
        remedy = f"use {', '.join(get_args(FitMethod))}"
        raise InputError(
            f"is {method!r}, which is not an estimation method", key=key, remedy=remedy
        )
    return cast(FitMethod, method)


def require_loss(loss: str, method: FitMethod, key: str) -> None:
    """Raise an error about the option `key` if `method` does not support `loss`."""
    if loss not in get_args(Loss):
        raise InputError(
            f"is {loss!r}, which is not a loss function",
            key=key,
            remedy=f"use {', '.join(get_args(Loss))}",
        )
    if loss != "squares" and method != "convex":
        raise InputError(
            f"is {loss!r}, which only the estimation method convex supports; the method is "
            f"{method}",
            key=key,
            remedy="leave it out, or use the method convex",
        )


@dataclass(frozen=True)
class OtherMode:
    """Parameters at a local maximum of the likelihood other than the global one."""

    parameters: ChannelParameters
    log_likelihood: float  # Restricted log-likelihood


@dataclass(frozen=True)
class ChannelFit:
    """Estimated channel parameters with standard errors, status and warnings.

    Attributes
    ----------
    method
        Estimation method; ``given`` if all parameters, or all except path loss, were known.
    status
        ``"ok"``, ``"weak"`` or ``"degenerate"``. It is weak if a parameter is poorly determined,
        a different set of values is nearly as likely, or a value is implausible. It is degenerate
        if a parameter is not determined (it is at a bound, or an assumed value is used), or if
        n_PL is below zero by more than two standard errors.
    parameters
        Estimated parameters; always finite, with positive xi, omega and beta.
    standard_errors
        Standard errors of ``k_pl_db, n_pl, shadow_std_db, decorrelation_m, multipath_std_db``;
        ``math.inf`` if unknown, never NaN.
    theta_covariance
        ``(2, 2)`` covariance of (K_PL, n_PL), finite.
    measurements, censored
        Number of measurements, and of censored ones among them.
    warnings
        Messages for the user, with the reasons for the status.
    log_likelihood
        Restricted log-likelihood of ``reml``; for ``map`` the logarithm of the prior is added. None
        for other methods.
    receiver_offsets
        Offsets of all receivers except number 0; empty if all measurements are from receiver 0.
    station_covariance_m2
        ``(2, 2)`` covariance of the estimated station position, with ``inf`` on the diagonal if it
        is not determined; None for a known position.
    other_modes
        Other maxima of ``reml`` and ``map`` whose log-likelihood is lower by at most
        :data:`planopt.channel.estimation.reml.NEARLY_AS_LIKELY`, the best first.
    """

    method: FitMethod | Literal["given"]
    status: Literal["ok", "weak", "degenerate"]
    parameters: ChannelParameters
    standard_errors: dict[str, float]
    theta_covariance: Floats
    measurements: int
    censored: int
    warnings: tuple[str, ...]
    log_likelihood: float | None
    receiver_offsets: tuple[ReceiverOffset, ...] = ()
    station_covariance_m2: Floats | None = None
    other_modes: tuple[OtherMode, ...] = ()

    __repr__ = short_repr

    def _repr_html_(self) -> str:
        """Return an HTML view for notebooks: fitted curves and parameters."""
        return import_module("planopt.report.page_content").fit_html(self)
