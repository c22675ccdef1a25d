"""Estimate the channel from power measurements, by one of five methods.

Every method reports a status, standard errors and, in words, which parameter the measurements do
not determine and what stands in for it. Nothing but an :class:`planopt.errors.InputError` leaves
here.

Which parameters the measurements hardly determine, and what is known of them, in words.

Values that no channel has, and logs that look as if a floor had been taken for powers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.estimation.channel_fit import (
    ChannelFit,
    FitMethod,
    Loss,
    OtherMode,
    require_loss,
    require_method,
)
from planopt.channel.estimation.covariance_fit import CovarianceFit
from planopt.channel.estimation.estimate import (
    Estimate,
    GivenToFit,
    by_assumption,
    by_correlation,
    by_likelihood,
    from_limits_alone,
)
from planopt.channel.estimation.identifiability import examine
from planopt.channel.estimation.reml import MOST_DENSE
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.offsets import ReceiverOffset, receiver_offsets
from planopt.channel.one_thread import one_blas_thread
from planopt.channel.parameters import (
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    ChannelParameters,
    Station,
    mean_model,
)
from planopt.channel.posterior import condition
from planopt.errors import InputError

WEAK_SHARE = 0.5
"""A deviation or distance whose standard error is more than this share of itself is hardly
determined: the ends of its 95 % interval are a factor of seven apart."""

COVARIANCE_NAMES = ("shadow_std_db", "multipath_std_db", "decorrelation_m")
"""Parameters of the covariance, as they are named in a :class:`ChannelParameters`."""

WORDS: dict[str, tuple[str, str]] = {
    "n_pl": ("path loss exponent n_PL", ""),
    "shadow_std_db": ("deviation of shadowing", "dB"),
    "decorrelation_m": ("decorrelation distance", "m"),
    "multipath_std_db": ("deviation of multipath", "dB"),
}
"""Names of parameters in messages, and their units."""


def weak_parameters(
    parameters: ChannelParameters, standard_errors: Mapping[str, float], n_pl_is_assumed: bool
) -> tuple[str, ...]:
    """Names of the parameters with a standard error that is known, but large.

    That of n_PL is where it exceeds the deviation of its prior: it is as well known without
    measurements.
    """
    weak = [
        name
        for name in COVARIANCE_NAMES
        if WEAK_SHARE * getattr(parameters, name) < standard_errors[name] < math.inf
    ]
    if not n_pl_is_assumed and PRIOR_N_PL_STD < standard_errors["n_pl"] < math.inf:
        weak.insert(0, "n_pl")
    return tuple(weak)


def weak_words(
    name: str, parameters: ChannelParameters, standard_errors: Mapping[str, float]
) -> str:
    """Say that a parameter is hardly determined."""
    called, unit = WORDS[name]
    value, error = getattr(parameters, name), standard_errors[name]
    known = f"{value:.3g} with standard error {error:.2g} {unit}".rstrip()
    return f"the {called} is hardly determined: {known}"


def mode_words(parameters: ChannelParameters, below: float) -> str:
    """Say that other parameters are nearly as likely; their log likelihood is `below` less."""
    return (
        f"another set of parameters is nearly as likely (log likelihood {below:.2f} lower): "
        f"K_PL {parameters.k_pl_db:.1f} dBm, n_PL {parameters.n_pl:.2f}, shadowing "
        f"{parameters.shadow_std_db:.2f} dB over {parameters.decorrelation_m:.3g} m, multipath "
        f"{parameters.multipath_std_db:.2f} dB"
    )


PLAUSIBLE_N_PL = (1.0, 6.0)
"""From waveguides to the densest buildings; free space is 2."""

EXTENT_SHARE = 1.0 / 3.0
"""A decorrelation distance beyond this share of the log's extent is hardly seen in it: the places
that far apart are few, and shadowing cannot be told from path loss."""

PLAUSIBLE_POWER_DBM = (-200.0, 100.0)
"""Thermal noise in 1 Hz is -174 dBm; 100 dBm are ten megawatts."""

LEAST_PILE = 5
"""Fewer equal lowest powers are no pile."""

PILE_RATIO = 2.0
"""A pile is one that is this many times as high as any other: powers that were rounded coincide
too, but most in the middle of their range."""

PILE_NEIGHBOURS = 3
PILE_CHANCE = 1e-3
"""Or it is one where its height, against the highest of the next few values, has no larger
probability than this: towards the end of a range values become rarer, not more frequent."""


def implausible_values(
    parameters: ChannelParameters, measurements: Measurements, extent_m: float
) -> tuple[str, ...]:
    """Say which values are not to be believed."""
    said: list[str] = []
    low, high = PLAUSIBLE_POWER_DBM
    for power in (measurements.power_dbm.min(), measurements.power_dbm.max()):
        if not low <= power <= high:
            said.append(
                f"a power of {power:g} dBm is implausible ({low:g} to {high:g} dBm): "
                "check the unit and the column"
            )
    low, high = PLAUSIBLE_N_PL
    n_pl = parameters.n_pl
    if n_pl < 0.0:
        said.append("n_PL is negative: power grows with the distance to the station")
    elif not low <= n_pl <= high:
        said.append(f"n_PL of {n_pl:.2f} is implausible ({low:g} to {high:g})")
    beta = parameters.decorrelation_m
    if beta > EXTENT_SHARE * extent_m:
        said.append(
            f"a decorrelation distance of {beta:.3g} m is implausible: the log spans "
            f"{extent_m:.3g} m, so that shadowing cannot be told from path loss"
        )
    return tuple(said)


def suspected_floor(measurements: Measurements) -> str | None:
    """Say that the lowest power occurs suspiciously often without being censored; None if not."""
    exact = measurements.power_dbm[~measurements.censored]
    values, counts = np.unique(exact, return_counts=True)
    if len(values) < 2 or not _is_pile(counts):
        return None
    return (
        f"the lowest power, {values[0]:g} dBm, occurs {counts[0]} times among {len(exact)}: it "
        f"looks like the receiver's floor, and biases the fit if it is; mark such powers as "
        f"censored (--floor={values[0]:g})"
    )


def _is_pile(counts: NDArray[np.intp]) -> bool:
    """Return whether the first of ascending values' counts is too high for a range's end."""
    pile, beside = int(counts[0]), int(counts[1 : 1 + PILE_NEIGHBOURS].max())
    if pile < LEAST_PILE:
        return False
    # Where values become rarer it has at most half of both.
    chance = float(bdtrc(pile - 1, pile + beside, 0.5))
    return pile > PILE_RATIO * int(counts[1:].max()) or chance < PILE_CHANCE


@one_blas_thread()
def fit_channel(
    measurements: Measurements | Table,
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
        ``lemma1``: Lemma 1 of [GM11] as printed. ``capped``: the same with
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

    Raises
    ------
    InputError
        See :func:`planopt.channel.estimation.identifiability.examine`; or `forgetting_s` is not
        positive; or there is no such method or loss, or the method has none to choose.
    """
    given = _given(measurements, station, forgetting_s)
    chosen = _chosen(method, loss)
    return _dressed(_estimate(given, chosen, loss), given, chosen)


@one_blas_thread()
def fitted_parameters(
    measurements: Measurements | Table,
    station: Station,
    method: FitMethod = "reml",
    forgetting_s: float = math.inf,
    *,
    loss: Loss = "squares",
) -> ChannelParameters:
    """Return the parameters of :func:`fit_channel` alone, in less time than it takes.

    How well they are known is not looked at, nor whether they are plausible. Parameters and errors
    as there.
    """
    given = _given(measurements, station, forgetting_s)
    estimate = _estimate(given, _chosen(method, loss), loss, errors=False)
    return given.parameters(estimate.coefficients, estimate.covariance.values)


def _chosen(method: FitMethod, loss: Loss) -> FitMethod:
    """Return the method that is meant, which must have the loss."""
    chosen = require_method(method, "method")
    require_loss(loss, chosen, "loss")
    return chosen


def _given(measurements: Measurements | Table, station: Station, forgetting_s: float) -> GivenToFit:
    """Return what a fit starts from: measurements by place, and the model of their mean."""
    measurements = as_measurements(measurements)
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
    return GivenToFit(model, measurements, station, allows, forgetting_s)


def _estimate(given: GivenToFit, method: FitMethod, loss: Loss, *, errors: bool = True) -> Estimate:
    """Estimate by the method, or by assumption; `errors` is for ``reml``."""
    if given.measurements.censored.all():
        return from_limits_alone(given)
    if given.allows.covariance_reason is not None:
        return by_assumption(given, given.allows.covariance_reason)
    if method == "reml":
        return by_likelihood(given, errors=errors)
    return by_correlation(given, method, loss)


def _dressed(estimate: Estimate, given: GivenToFit, method: FitMethod) -> ChannelFit:
    """Everything as the user gets it."""
    covariance, allows, measurements = estimate.covariance, given.allows, given.measurements
    parameters = given.parameters(estimate.coefficients, covariance.values)
    theta_covariance = given.model.theta_covariance(estimate.coefficient_covariance)
    errors = _standard_errors(covariance, theta_covariance)
    doubts = list(covariance.warnings)
    if allows.n_pl_reason is not None:
        doubts.insert(0, f"n_PL is assumed {PRIOR_N_PL:g}, not estimated: {allows.n_pl_reason}")
    weak = weak_parameters(parameters, errors, allows.n_pl_reason is not None)
    found = estimate.reml
    modes = () if found is None else found.others
    others = tuple(
        OtherMode(given.parameters(mode.coefficients, mode.covariance), mode.log_likelihood)
        for mode in modes
    )
    floor = suspected_floor(measurements)
    faults = [
        *(weak_words(name, parameters, errors) for name in weak),
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
