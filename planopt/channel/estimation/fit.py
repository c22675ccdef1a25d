"""Estimation of the channel from power measurements by one of several methods."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc

from planopt.arrays import Floats, Indices
from planopt.channel.cholesky import one_blas_thread
from planopt.channel.estimation.channel_fit import (
    FALLBACK_TOTAL_VARIANCE_DB2,
    ChannelFit,
    CovarianceFit,
    FitMethod,
    Loss,
    OtherMode,
    covariance_bounds,
    fallback_fit,
    require_loss,
    require_method,
)
from planopt.channel.estimation.correlation_fit import empirical_correlation, fit_correlation
from planopt.channel.estimation.lasting import lasting_multipath
from planopt.channel.estimation.least_squares import (
    Identifiability,
    coefficient_covariance,
    examine,
    least_squares,
)
from planopt.channel.estimation.likelihood import Covariance, LogNormal
from planopt.channel.estimation.reml import EXACT_ROWS, RemlFit, reml_fit
from planopt.channel.long_logs import receiver_offsets
from planopt.channel.measurements import Measurements, Table, as_measurements
from planopt.channel.parameters import (
    PRIOR_N_PL,
    PRIOR_N_PL_STD,
    ChannelParameters,
    Lasting,
    MeanModel,
    Station,
    mean_model,
)
from planopt.channel.posterior import condition
from planopt.errors import InputError

PRIOR_K_PL_STD_DB = 20.0  # Standard deviation of K_PL if every measurement is censored


@dataclass(frozen=True)
class _FitInput:
    """Measurements sorted by position, with the model of their mean."""

    model: MeanModel
    measurements: Measurements
    station: Station
    allows: Identifiability
    forgetting_s: float
    n_pl_prior: tuple[float, float] | None = None
    lasting: Lasting | None = None

    def parameters(self, coefficients: Floats, covariance: Covariance) -> ChannelParameters:
        """Return the channel parameters of an estimate."""
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
            n_pl_prior=self.n_pl_prior,
            lasting=self.lasting,
        )


@dataclass(frozen=True)
class _Estimate:
    """Estimated covariance and mean, with notes for the user."""

    covariance: CovarianceFit
    coefficients: Floats
    coefficient_covariance: Floats
    notes: tuple[str, ...] = ()
    reml: RemlFit | None = None


MAP_N_PL = (2.0, 1.0)  # Prior mean and standard deviation of n_PL for ``map``


def _by_likelihood(data: _FitInput, *, has_prior: bool) -> _Estimate:
    """Estimate the channel by restricted maximum likelihood, or by maximum posterior density."""
    line = least_squares(data.model, data.measurements)
    beta_bounds = data.allows.decorrelation_bounds_m
    bounds = covariance_bounds(line.variance_db2, beta_bounds)
    # The path loss variance of position errors uses n_PL of the least-squares line.
    rough = fallback_fit(line.variance_db2, beta_bounds, "a first guess")
    known = data.parameters(line.coefficients, rough.values)
    prior = LogNormal.for_extent(data.allows.rotated_extent_m) if has_prior else None
    found = reml_fit(data.model, data.measurements, bounds, known, prior)
    at = found.best.at
    return _Estimate(found.covariance, at.coefficients, at.coefficient_covariance, reml=found)


def _by_correlation(data: _FitInput, method: FitMethod, loss: Loss) -> _Estimate:
    """Fit a least-squares line, then xi and beta to the correlation of its residuals."""
    measurements, allows = data.measurements, data.allows
    line = least_squares(data.model, measurements)
    alpha = line.variance_db2
    bounds = covariance_bounds(alpha, allows.decorrelation_bounds_m)
    correlation = empirical_correlation(measurements.positions_m, line.residual_db, allows.extent_m)
    covariance = fit_correlation(
        correlation, alpha, len(line.residual_db), allows.extent_m, bounds, method, loss
    )
    notes: list[str] = []
    if measurements.censored.any():
        notes.append(
            "censored powers were replaced by their expected values; reml and map need not do this"
        )
    if math.isfinite(data.forgetting_s) and np.ptp(measurements.time_s) > 0.0:
        notes.append("xi, beta and omega were fitted without regard to age; reml regards it")
    if measurements.position_std_m.any():
        notes.append(
            "xi, beta and omega were fitted without regard to errors of position; reml regards them"
        )
    return _with_line(line.coefficients, data, covariance, tuple(notes))


def _by_assumption(data: _FitInput, reason: str) -> _Estimate:
    """Fit a line to few measurements; the covariance is assumed."""
    beta_bounds = data.allows.decorrelation_bounds_m
    covariance = fallback_fit(FALLBACK_TOTAL_VARIANCE_DB2, beta_bounds, reason)
    if not data.measurements.censored.all():
        line = least_squares(data.model, data.measurements)
        return _with_line(line.coefficients, data, covariance)
    # The highest path loss line of slope `PRIOR_N_PL` that satisfies every upper limit.
    highest = float((data.measurements.power_dbm - data.model.offset_db).min())
    return _Estimate(covariance, np.array([highest]), np.array([[PRIOR_K_PL_STD_DB**2]]))


def _with_line(
    coefficients: Floats, data: _FitInput, covariance: CovarianceFit, notes: tuple[str, ...] = ()
) -> _Estimate:
    """Return the estimate from a line's `coefficients` and the `covariance` of its residuals."""
    parameters = data.parameters(coefficients, covariance.values)
    spread = coefficient_covariance(data.model, data.measurements, parameters)
    return _Estimate(covariance, coefficients, spread, notes)


WEAK_SHARE = 0.5  # Relative standard error above which a parameter is poorly determined
WORDS: dict[str, tuple[str, str]] = {
    "n_pl": ("path loss exponent n_PL", ""),
    "shadow_std_db": ("deviation of shadowing", "dB"),
    "multipath_std_db": ("deviation of multipath", "dB"),
    "decorrelation_m": ("decorrelation distance", "m"),
}
"""Names of parameters in messages, and their units."""


def poor_words(name: str, value: float, standard_error: float) -> str:
    """Return a warning about a parameter with a large standard error; empty for a small one."""
    called, unit = WORDS[name]
    most = PRIOR_N_PL_STD if name == "n_pl" else WEAK_SHARE * value
    if not most < standard_error < math.inf:
        return ""
    known = f"{value:.3g} with standard error {standard_error:.2g} {unit}".rstrip()
    return f"the {called} is poorly determined: {known}"


def _mode_words(parameters: ChannelParameters, below: float) -> str:
    """Return the warning about another likelihood mode, lower in log-likelihood by `below`."""
    return (
        f"another set of parameters is nearly as likely (log likelihood {below:.2f} lower): "
        f"K_PL {parameters.k_pl_db:.1f} dBm, n_PL {parameters.n_pl:.2f}, shadowing "
        f"{parameters.shadow_std_db:.2f} dB over {parameters.decorrelation_m:.3g} m, multipath "
        f"{parameters.multipath_std_db:.2f} dB"
    )


REVERSED_ERRORS = 2.0  # Standard errors below zero from which on n_PL contradicts the model
PLAUSIBLE_N_PL = (1.0, 6.0)
"""Plausible range of n_PL, from waveguides to the densest buildings; free space is 2."""
LARGEST_MULTIPATH_DB = 6.0  # Maximum plausible omega; Rayleigh fading has 5.6 dB
EXTENT_SHARE = 1.0 / 3.0  # Maximum plausible decorrelation distance as a share of the log's extent
PLAUSIBLE_POWER_DBM = (-200.0, 100.0)
"""Plausible range of powers; thermal noise in 1 Hz is -174 dBm, and 100 dBm are ten megawatts."""
LEAST_PILE = 5  # Minimum number of readings at the lowest power for a suspected receiver floor
PILE_RATIO = 2.0  # A floor is suspected if the lowest power's count exceeds any other by this ratio

PILE_NEIGHBOURS = 3
PILE_CHANCE = 1e-3
"""Significance level for the lowest power's count against the largest of the next few."""


def implausible_values(
    parameters: ChannelParameters, measurements: Measurements, extent_m: float
) -> tuple[str, ...]:
    """Return warnings about implausible powers and parameters."""
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
        said.append(
            "n_PL is negative: power grows with the distance to the station "
            "(check the sign of the powers and the station's position)"
        )
    elif not low <= n_pl <= high:
        said.append(f"n_PL of {n_pl:.2f} is implausible ({low:g} to {high:g})")
    omega = parameters.multipath_std_db
    if omega > LARGEST_MULTIPATH_DB:
        said.append(
            f"multipath of {omega:.2g} dB is stronger than Rayleigh fading (5.6 dB): the log may "
            "mix several transmitters (select one by its name, see --where and "
            "--transmitter-column)"
        )
    beta = parameters.decorrelation_m
    if beta > EXTENT_SHARE * extent_m:
        said.append(
            f"a decorrelation distance of {beta:.3g} m is implausible: the log spans "
            f"{extent_m:.3g} m, so shadowing and path loss cannot be distinguished"
        )
    return tuple(said)


def suspected_floor(measurements: Measurements) -> str | None:
    """Return a warning if the lowest uncensored power looks like a receiver's floor, else None."""
    exact = measurements.power_dbm[~measurements.censored]
    floor = floor_pile_dbm(exact)
    if floor is None:
        return None
    return (
        f"{(exact == floor).sum()} of {len(exact)} powers equal the lowest, {floor:g} dBm, which "
        "is probably the receiver's floor; if so, the fit is biased: mark these powers as censored "
        f"(--floor={floor:g}, or the key floor_dbm)"
    )


def floor_pile_dbm(power_dbm: Floats) -> float | None:
    """Return the lowest power if its frequency suggests a receiver's floor, else None."""
    values, counts = np.unique(power_dbm, return_counts=True)
    return float(values[0]) if len(values) > 1 and _is_pile(counts) else None


def _is_pile(counts: Indices) -> bool:
    """Return True if the count of the lowest power, `counts[0]`, suggests a receiver's floor."""
    pile, adjacent = int(counts[0]), int(counts[1 : 1 + PILE_NEIGHBOURS].max())
    if pile < LEAST_PILE:
        return False
    # Without a floor the lowest value has at most half of the two counts.
    chance = float(bdtrc(pile - 1, pile + adjacent, 0.5))
    return pile > PILE_RATIO * int(counts[1:].max()) or chance < PILE_CHANCE


@one_blas_thread()
def fit_channel(
    measurements: Measurements | Table,
    station: Station,
    method: FitMethod = "map",
    forgetting_s: float = math.inf,
    *,
    loss: Loss = "squares",
) -> ChannelFit:
    """Estimate path loss, shadowing and multipath.

    Position errors and the age of measurements enter the likelihood of ``map`` and ``reml``; the
    other methods ignore them and warn. All methods estimate receivers' offsets.

    Parameters
    ----------
    measurements
        Measured positions and powers, censored ones included. Repeated positions are allowed.
    station
        Fixed base station.
    method
        ``map`` (default): maximum of the restricted likelihood times priors on n_PL and beta
        (equation 2.13), by blocks for more than
        :data:`planopt.channel.estimation.reml.EXACT_ROWS` measurements. ``reml``: the same without
        priors. ``lemma1``: Lemma 1 of [GM11] as printed. ``capped``: Lemma 1 with a lag cap and
        weights n r^2. ``convex``: ``capped`` as a convex programme with xi^2 <= alpha and bounds on
        beta. ``nls``: nonlinear least squares of the exponential on all bins. Censored powers enter
        the likelihood of ``map`` and ``reml``; the other methods replace them by expected values
        and so lose their contribution to the correlation.
    forgetting_s
        Known time scale T: shadowing at two times has correlation ``exp(-|t - t'| / T)``;
        ``math.inf`` for a static channel.
    loss
        Loss of ``convex`` on the residuals of its line
        (:func:`planopt.channel.estimation.correlation_fit.convex_fit`); others use squares.

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
    measurements = as_measurements(measurements)
    chosen = require_method(method, "method")
    require_loss(loss, chosen, "loss")
    if not forgetting_s > 0.0:
        raise InputError(
            f"is {forgetting_s!r} s, should be above 0",
            key="forgetting_s",
            remedy="give a time constant in seconds, or inf for a channel that does not change",
        )
    # Errors name a row of the input, so check before sorting.
    allows = examine(measurements, station)
    measurements = measurements.by_place()
    exact = ~measurements.censored
    model = mean_model(measurements.positions_m, exact, station, allows.n_pl_reason is None)
    prior = MAP_N_PL if chosen == "map" else None
    data = _FitInput(model, measurements, station, allows, forgetting_s, prior)
    if not exact.any():
        return _channel_fit(_by_assumption(data, "every measurement is censored"), data, chosen)
    if allows.covariance_reason is not None:
        return _channel_fit(_by_assumption(data, allows.covariance_reason), data, chosen)
    if chosen == "map":
        line = least_squares(model, measurements)
        rough = data.parameters(line.coefficients, (1.0, 1.0, 1.0))
        data = replace(data, lasting=lasting_multipath(measurements, rough, allows))
    if chosen in ("reml", "map"):
        return _channel_fit(_by_likelihood(data, has_prior=chosen == "map"), data, chosen)
    return _channel_fit(_by_correlation(data, chosen, loss), data, chosen)


def _channel_fit(estimate: _Estimate, data: _FitInput, method: FitMethod) -> ChannelFit:
    """Return the fit: the estimate with standard errors, status, warnings and receiver offsets."""
    covariance, allows, measurements = estimate.covariance, data.allows, data.measurements
    parameters = data.parameters(estimate.coefficients, covariance.values)
    theta_covariance = data.model.theta_covariance(estimate.coefficient_covariance)
    k_error, n_error = np.sqrt(np.maximum(np.diag(theta_covariance), 0.0)).tolist()
    shadow_error, multipath_error, beta_error = covariance.standard_errors
    errors = {
        "k_pl_db": k_error,
        "n_pl": n_error,
        "shadow_std_db": shadow_error,
        "decorrelation_m": beta_error,
        "multipath_std_db": multipath_error,
    }
    doubts = list(covariance.warnings)
    if allows.n_pl_reason is not None:
        doubts.insert(0, f"n_PL is assumed {PRIOR_N_PL:g}, not estimated: {allows.n_pl_reason}")
    tested = [name for name in WORDS if name != "n_pl" or allows.n_pl_reason is None]
    poor = [poor_words(name, getattr(parameters, name), errors[name]) for name in tested]
    faults = [words for words in poor if words]
    log_likelihood, others = None, tuple[OtherMode, ...]()
    if estimate.reml is not None:
        log_likelihood = estimate.reml.best.at.log_likelihood
        others = tuple(
            OtherMode(
                data.parameters(mode.at.coefficients, mode.covariance), mode.at.log_likelihood
            )
            for mode in estimate.reml.others
        )
        faults += [
            _mode_words(other.parameters, log_likelihood - other.log_likelihood) for other in others
        ]
    faults += implausible_values(parameters, measurements, allows.rotated_extent_m)
    floor = suspected_floor(measurements)
    if floor is not None:
        faults.append(floor)
    notes = list(estimate.notes)
    if data.lasting is not None:
        notes.append(
            f"{data.lasting.share:.0%} of the multipath variance lasts for about "
            f"{data.lasting.time_s:.2g} s at the receiver, wherever it is"
        )
    if (measurements.receiver != 0).all():
        notes.append(
            "receiver 0, for which powers are predicted, measured nothing: K_PL is known no better "
            "than the offsets"
        )
    offsets = ()
    if measurements.receiver.any():
        offsets = receiver_offsets(condition(parameters, measurements, exact_limit=EXACT_ROWS))
    is_reversed = parameters.n_pl < -REVERSED_ERRORS * n_error
    return ChannelFit(
        method=method,
        status="degenerate" if doubts or is_reversed else "weak" if faults else "ok",
        parameters=parameters,
        standard_errors=errors,
        theta_covariance=theta_covariance,
        measurements=len(measurements),
        censored=int(measurements.censored.sum()),
        warnings=(*doubts, *faults, *notes),
        log_likelihood=log_likelihood,
        receiver_offsets=offsets,
        other_modes=others,
    )
