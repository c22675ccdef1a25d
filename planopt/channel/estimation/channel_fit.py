"""An estimated channel: parameters, their errors, and what is in doubt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.fit_method import FitMethod
from planopt.channel.parameters import ChannelParameters
from planopt.channel.receiver_offsets import ReceiverOffset
from planopt.short_repr import short_repr


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

    __repr__ = short_repr
