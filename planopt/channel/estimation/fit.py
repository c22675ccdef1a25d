"""Estimate the channel from power measurements, by one of five methods.

Every method reports a status, standard errors and, in words, which parameter the measurements do
not determine and what stands in for it. Only :class:`planopt.errors.InputError` is raised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import (
    FALLBACK_TOTAL_VARIANCE_DB2,
    ChannelFit,
    CovarianceBounds,
    CovarianceFit,
    FitMethod,
    Loss,
    OtherMode,
    covariance_bounds,
    fallback_fit,
    require_loss,
    require_method,
)
from planopt.channel.estimation.correlation_solvers import convex_fit, nls_fit
from planopt.channel.estimation.least_squares import (
    Identifiability,
    LeastSquares,
    coefficient_covariance,
    examine,
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
from planopt.channel.estimation.likelihood import Covariance
from planopt.channel.estimation.reml import EXACT_ROWS, RemlFit, reml_fit
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.parameters import (
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    ChannelParameters,
    MeanModel,
    Station,
    mean_model,
)
from planopt.channel.posterior import condition
from planopt.channel.vecchia import ReceiverOffset, receiver_offsets
from planopt.errors import InputError

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
        :data:`planopt.channel.estimation.reml.EXACT_ROWS` measurements by blocks. The first
        four complete censored powers by their expected values and ignore what that hides of the
        correlation; only ``reml`` has them as a term of the likelihood.
    forgetting_s
        T: shadowing at two times has correlation ``exp(-|t - t'| / T)``. Given, not estimated;
        ``math.inf`` for a channel that does not drift.
    loss
        What ``convex`` makes of the scatter about its line
        (:func:`planopt.channel.estimation.correlation_solvers.convex_fit`); others have squares.

    Raises
    ------
    InputError
        There are too few measurements or positions for the parameters, `forgetting_s` is not
        positive, or the method or loss does not exist.

    Examples
    --------
    >>> import numpy as np
    >>> from planopt.channel import Station, fit_channel
    >>> rng = np.random.default_rng(1)
    >>> x, y = rng.uniform(5.0, 100.0, (2, 200))
    >>> power = -40.0 - 20.0 * np.log10(np.hypot(x, y)) + rng.normal(0.0, 1.0, 200)
    >>> found = fit_channel({"x_m": x, "y_m": y, "power_dbm": power}, Station((0.0, 0.0)))
    >>> print(round(found.parameters.n_pl, 1))
    2.0
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
    return receiver_offsets(condition(parameters, measurements, exact_limit=EXACT_ROWS))
