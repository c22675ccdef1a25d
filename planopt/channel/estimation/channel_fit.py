"""An estimated channel: parameters, their errors, and what is in doubt.

Names of the methods of estimation and of their losses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from planopt.channel.offsets import ReceiverOffset
from planopt.channel.parameters import ChannelParameters
from planopt.errors import InputError
from planopt.short_repr import short_repr

FitMethod = Literal["lemma1", "capped", "convex", "nls", "reml"]

Loss = Literal["squares", "huber", "absolute"]


def require_method(method: str, key: str) -> FitMethod:
    """Return the method of that name, or refuse; `key` is what it was given by."""
    if method not in get_args(FitMethod):
        remedy = f"use {', '.join(get_args(FitMethod))}"
        raise InputError(f"{method!r} is no method", key=key, remedy=remedy)
    return cast(FitMethod, method)


def require_loss(loss: str, method: FitMethod, key: str) -> None:
    """Refuse a loss that does not exist, or is not the method's; `key` is what it was given by."""
    if loss not in get_args(Loss):
        raise InputError(f"{loss!r} is no loss", key=key, remedy=f"use {', '.join(get_args(Loss))}")
    if loss != "squares" and method != "convex":
        raise InputError(
            f"{method} has no choice of loss", key=key, remedy="use it with method convex"
        )


@dataclass(frozen=True)
class OtherMode:
    """Parameters at a maximum of the likelihood that is not the highest."""

    parameters: ChannelParameters  # There
    log_likelihood: float  # Restricted


@dataclass(frozen=True)
class ChannelFit:
    """Estimated channel parameters.

    Attributes
    ----------
    method
        How they were estimated; ``given`` where all but path loss, or all, were known.
    status
        ``"ok"``; ``"weak"`` when a parameter is hardly determined, another set of parameters is
        nearly as likely, or a value is not to be believed; ``"degenerate"`` when a parameter is not
        determined at all (it is at a bound of its range, or a prior stands in). `warnings` say
        which and why.
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
    other_modes
        Other maxima of the likelihood, for ``reml``, that are lower by no more than
        :data:`planopt.channel.estimation.likelihood_climb.NEARLY_AS_LIKELY`; the best first.
    """

    method: FitMethod | Literal["given"]
    status: Literal["ok", "weak", "degenerate"]
    parameters: ChannelParameters
    standard_errors: dict[str, float]
    theta_covariance: NDArray[np.float64]
    measurements: int
    censored: int
    warnings: tuple[str, ...]
    log_likelihood: float | None
    receiver_offsets: tuple[ReceiverOffset, ...] = ()
    station_covariance_m2: NDArray[np.float64] | None = None
    other_modes: tuple[OtherMode, ...] = ()

    __repr__ = short_repr
