"""Estimate the channel from power measurements, by any of five methods, with what is in doubt.

Every method reports a status, standard errors and, in words, which parameter the measurements do
not determine and what stands in for it. Nothing but an :class:`planopt.errors.InputError` leaves
here.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import ChannelFit, OtherMode
from planopt.channel.estimation.covariance_fit import CovarianceFit
from planopt.channel.estimation.determination import (
    bounded_words,
    mode_words,
    normal_interval,
    profile_intervals,
    weak_parameters,
    weak_words,
)
from planopt.channel.estimation.estimate import (
    Estimate,
    GivenToFit,
    by_assumption,
    by_correlation,
    by_likelihood,
    from_limits_alone,
)
from planopt.channel.estimation.fit_method import (
    FitMethod,
    GivenMethod,
    Loss,
    require_loss,
    require_method,
)
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.plausibility import implausible_values, suspected_floor
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.estimation.ridge import AXES
from planopt.channel.mean_model import PRIOR_N_PL, mean_model
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.offsets import ReceiverOffset, receiver_offsets
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import ChannelParameters, Station
from planopt.channel.posterior import condition
from planopt.errors import InputError


@one_blas_thread()
def fit_channel(
    measurements: Measurements | Table,
    station: Station,
    method: GivenMethod = "reml",
    forgetting_s: float = math.inf,
    *,
    loss: Loss = "squares",
    intervals: bool = True,
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
        ``lemma1``: Lemma 1 of [GM11] as printed (once ``seed``). ``capped``: the same with
        a lag cap and weights n r^2. ``convex``: that as a convex programme with xi^2 <= alpha and
        beta bounded. ``nls``: the exponential fitted without logarithm to all bins. ``reml``:
        restricted maximum likelihood (default); of more than
        :data:`planopt.channel.estimation.reml.MOST_DENSE` measurements by blocks. The first
        four complete censored powers by their expected values and ignore what that hides of the
        correlation; only ``reml`` has them as a term of the likelihood.
    forgetting_s
        T: shadowing at two times has correlation ``exp(-|t - t'| / T)``. Given, not estimated;
        ``math.inf`` for a channel that does not drift.
    loss
        What ``convex`` makes of the scatter about its line
        (:func:`planopt.channel.estimation.convex_fit.convex_fit`); others have squares.
    intervals
        Whether to look into what is in doubt, for ``reml``: intervals of what is hardly determined,
        each end of which costs some ten to thirty evaluations of the likelihood, and other maxima
        at the ends of the parameters' ranges. The estimate is the same without.

    Raises
    ------
    InputError
        See :func:`planopt.channel.estimation.identifiability.examine`; or `forgetting_s` is not
        positive; or there is no such method or loss, or the method has none to choose.
    """
    measurements = as_measurements(measurements)
    chosen = require_method(method, "method")
    require_loss(loss, chosen, "loss")
    if not forgetting_s > 0.0:
        raise InputError(
            f"{forgetting_s!r} s is no forgetting time",
            key="forgetting_s",
            remedy="give more than 0, or inf for a channel that does not drift",
        )
    # Errors name a row as it was given; the rest does not depend on the order of rows.
    allows = examine(measurements, station)
    measurements = measurements.by_place()
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
    given = GivenToFit(model, measurements, station, allows, forgetting_s)
    if not exact.any():
        estimate = from_limits_alone(given)
    elif allows.covariance_reason is not None:
        estimate = by_assumption(given, allows.covariance_reason)
    elif chosen == "reml":
        estimate = by_likelihood(given, ends=intervals)
    else:
        estimate = by_correlation(given, chosen, loss)
    return _dressed(estimate, given, chosen, intervals)


def _dressed(
    estimate: Estimate, given: GivenToFit, method: FitMethod, intervals: bool
) -> ChannelFit:
    """Everything as the user gets it."""
    covariance, allows, measurements = estimate.covariance, given.allows, given.measurements
    parameters = given.parameters(estimate.coefficients, covariance.values)
    theta_covariance = given.model.theta_covariance(estimate.coefficient_covariance)
    errors = _standard_errors(covariance, theta_covariance)
    doubts = list(covariance.warnings)
    if allows.n_pl_reason is not None:
        doubts.insert(0, f"n_PL is assumed {PRIOR_N_PL:g}, not estimated: {allows.n_pl_reason}")
    weak = weak_parameters(parameters, errors, allows.n_pl_reason is not None)
    known: dict[str, tuple[float, float]] = {}
    found = estimate.reml
    if intervals and found is not None:
        unknown = [name for name in AXES if math.isinf(errors[name])]
        known = profile_intervals(found.ridge, [*weak, *unknown])
        doubts += bounded_words(unknown, known)
        if "n_pl" in weak:
            known["n_pl"] = normal_interval(parameters.n_pl, errors["n_pl"])
    modes = () if found is None else found.others
    others = tuple(
        OtherMode(given.parameters(mode.coefficients, mode.covariance), mode.log_likelihood)
        for mode in modes
    )
    floor = suspected_floor(measurements)
    faults = [
        *(weak_words(name, parameters, errors, known) for name in weak),
        *(
            mode_words(other.parameters, found.best.log_likelihood - other.log_likelihood)
            for other in others
            if found is not None
        ),
        *implausible_values(parameters, measurements, allows.extent_m),
        *([] if floor is None else [floor]),
    ]
    notes = list(estimate.notes)
    if (measurements.receiver != 0).all():
        notes.append(
            "receiver 0, for which powers are predicted, measured nothing: K_PL is known no better "
            "than the offsets"
        )
    return ChannelFit(
        method=method,
        status="degenerate" if doubts else "weak" if faults else "ok",
        parameters=parameters,
        standard_errors=errors,
        theta_covariance=theta_covariance,
        measurements=len(measurements),
        censored=int(measurements.censored.sum()),
        warnings=(*doubts, *faults, *notes),
        log_likelihood=None if found is None else found.best.log_likelihood,
        receiver_offsets=_offsets(measurements, parameters),
        intervals_95=known,
        other_modes=others,
    )


def _standard_errors(
    covariance: CovarianceFit, theta_covariance: NDArray[np.float64]
) -> dict[str, float]:
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0))
    shadow_error, multipath_error, beta_error = covariance.standard_errors
    return {
        "k_pl_db": float(k_error),
        "n_pl": float(n_error),
        "shadow_std_db": shadow_error,
        "decorrelation_m": beta_error,
        "multipath_std_db": multipath_error,
    }


def _offsets(
    measurements: Measurements, parameters: ChannelParameters
) -> tuple[ReceiverOffset, ...]:
    """Offsets of receivers under fitted parameters."""
    if not measurements.receiver.any():
        return ()
    return receiver_offsets(condition(parameters, measurements, exact_limit=MOST_DENSE))
