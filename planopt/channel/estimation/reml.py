"""Restricted maximum likelihood of xi, omega and beta, with generalised least squares for theta.

The likelihood may have several maxima, typically two: steep path loss with a short decorrelation
distance, and flat path loss with a long one. The likelihood of a sample is therefore searched over
a range of beta, and each of its maxima is the initial guess for the likelihood of all measurements.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.estimation.channel_fit import (
    BOUND_TOLERANCE,
    CovarianceBounds,
    CovarianceFit,
    at_bound,
)
from planopt.channel.estimation.likelihood import (
    Covariance,
    Evaluation,
    LikelihoodData,
    LogNormal,
    RestrictedLikelihood,
    likelihood_data,
    profiled_log_likelihood,
)
from planopt.channel.gaussian_sites import needs_site
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, MeanModel

Objective = Callable[[Floats], tuple[float, Floats, Floats]]
"""Function that returns value, gradient (k,) and curvature (k, k) at a point (k,)."""
EXACT_ROWS = 2_000
"""Maximum number of measurements with an exact likelihood. A fit of 1,900 takes 2 s of CPU time,
8 s if 60 % are censored, and 0.8 s by blocks."""
MOST_DENSE = 800  # Maximum sample size if a dense likelihood is evaluated many times
FINE, BLOCK_FINE = 1e-5, 2e-3
"""Predicted gain in log-likelihood below which a search ends, exact and by blocks."""
SAMPLED_ROWS, SAMPLED_BLOCKS = 250, 12
"""Maximum number of exact measurements in the sample, or of blocks that form it."""
START_SHARES = (0.3, 0.7, 0.95)  # Correlated shares xi^2 / alpha of the initial guesses
START_DECORRELATIONS = 5
"""Number of values of beta of the initial guesses, spaced geometrically within its bounds."""
STARTS_FOLLOWED = 2  # Minimum number of initial guesses that are optimised, the most likely first
ROUGH = 3e-2  # Predicted gain in log-likelihood at which a search on the sample ends, as `FINE`
SAME_LOGS = 0.05  # Optima that differ by less than this in every logarithm are the same
NO_DIP = 0.1  # Maximum dip of log L halfway between two optima that belong to one ridge
FLAT = 1e-6  # Regularisation of the information matrix (in logarithms) for a flat likelihood
NEARLY_AS_LIKELY = 2.0  # Maximum difference in log L of other optima reported with the best
LITTLE_MULTIPATH = 0.03  # Share omega^2 / alpha below which multipath counts as negligible
MAX_CONDITION = 1e12
"""Maximum condition number of the information; above, the parameters are not identified."""

THINNING_SEED = 20_000


@dataclass(frozen=True, eq=False)
class Mode:
    """Local maximum of the likelihood."""

    logs: Floats  # (3,) logarithms of xi^2, omega^2 and beta
    at: Evaluation  # Likelihood at `logs`, with the mean by generalised least squares

    @property
    def covariance(self) -> Covariance:
        """Covariance parameters (xi^2, omega^2, beta)."""
        return variances(self.logs)


@dataclass(frozen=True, eq=False)
class RemlFit:
    """Result of restricted maximum likelihood."""

    covariance: CovarianceFit  # xi, omega, beta with standard errors
    best: Mode  # Global maximum, with the mean
    others: tuple[Mode, ...]  # Other maxima that are nearly as likely, the best first


def reml_fit(
    model: MeanModel,
    measurements: Measurements,
    bounds: CovarianceBounds,
    known: ChannelParameters,
    prior: LogNormal | None = None,
) -> RemlFit:
    """Maximise the restricted likelihood within `bounds`, or its product with a prior."""
    box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
    blocks = None if len(measurements) <= EXACT_ROWS else bounds.decorrelation_m
    fine = FINE if blocks is None else BLOCK_FINE
    data = likelihood_data(model, measurements, known, None, blocks)
    likelihood = RestrictedLikelihood(data, prior)
    modes = _modes(likelihood, _starts(data, prior, bounds, box), box, fine)
    further = _beyond_best(likelihood, modes[0], box)
    if further is not None:
        modes = _modes(likelihood, [further, *(mode.logs for mode in modes)], box, fine)
    as_interval = needs_site(measurements, math.exp(modes[0].logs[1]))
    if as_interval.sum() > measurements.censored.sum():
        # Chosen once, from the fit with Sheppard's correction, so that the likelihood is smooth.
        data = likelihood_data(model, measurements, known, as_interval, blocks)
        likelihood = RestrictedLikelihood(data, prior)
        modes = _modes(likelihood, [mode.logs for mode in modes], box, fine)
    return RemlFit(_covariance_fit(likelihood, modes[0], box), modes[0], tuple(modes[1:]))


def thinned(count: int, limit: int) -> Indices:
    """Return sorted indices of at most `limit` of `count` measurements, drawn with a fixed seed."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(THINNING_SEED).permutation(count)[:limit])


def variances(logs: Floats) -> Covariance:
    """Return (xi^2, omega^2, beta), given their logarithms."""
    shadow, nugget, beta = np.exp(logs)
    return float(shadow), float(nugget), float(beta)


def _starts(
    data: LikelihoodData, prior: LogNormal | None, bounds: CovarianceBounds, box: Floats
) -> list[Floats]:
    """Return initial guesses: the optima for a sample of the measurements."""
    taken = data.gaussian.copy()
    if data.is_whole:
        rows = np.flatnonzero(taken)
        taken[np.delete(rows, thinned(len(rows), SAMPLED_ROWS))] = False
    else:
        first = np.concatenate([window.own for window in data.windows[:SAMPLED_BLOCKS]])
        taken[np.delete(np.arange(len(taken)), first)] = False
    sample = data.part(taken)
    likelihood = RestrictedLikelihood(sample, prior)
    tops = [_climbed(likelihood, start, box, ROUGH) for start in _grid_starts(sample, bounds)]
    return [mode.logs for mode in _distinct(likelihood, tops)]


def _grid_starts(sample: LikelihoodData, bounds: CovarianceBounds) -> list[Floats]:
    """Return the logarithms (3,) of local maxima over beta and of the best grid points."""
    low, high = bounds.decorrelation_m
    # The ends of the range are poor initial guesses, because the likelihood is flat there.
    betas = np.geomspace(low, high, START_DECORRELATIONS + 2)[1:-1]
    values = np.empty((len(betas), len(START_SHARES)))
    logs = np.empty((*values.shape, 3))
    for row, beta in enumerate(betas):
        for column, share in enumerate(START_SHARES):
            values[row, column], total = profiled_log_likelihood(sample, share, float(beta))
            logs[row, column] = np.log([share * total, (1.0 - share) * total, beta])
    walled = np.pad(values.max(axis=1), 1, constant_values=-math.inf)
    peaks = np.flatnonzero((walled[1:-1] >= walled[:-2]) & (walled[1:-1] > walled[2:]))
    peaks = peaks[np.argsort(-values[peaks].max(axis=1), kind="stable")]
    best = np.argsort(-values, axis=None, kind="stable")[:STARTS_FOLLOWED]
    chosen = [len(START_SHARES) * peaks + values[peaks].argmax(axis=1), best]
    return [logs.reshape(-1, 3)[place] for place in dict.fromkeys(np.concatenate(chosen).tolist())]


def _modes(
    likelihood: RestrictedLikelihood, starts: Iterable[Floats], box: Floats, fine: float
) -> list[Mode]:
    """Return the distinct optima reached from `starts` that are nearly as likely as the best."""
    found = _distinct(likelihood, [_climbed(likelihood, start, box, fine) for start in starts])
    least = found[0].at.log_likelihood - NEARLY_AS_LIKELY
    return [mode for mode in found if mode.at.log_likelihood >= least]


def _climbed(
    likelihood: RestrictedLikelihood, start: Floats, box: Floats, tolerance: float
) -> Mode:
    """Return the optimum reached from `start` (3,) within `box` (3, 2), all in logarithms."""
    best: Mode | None = None

    def objective(logs: Floats) -> tuple[float, Floats, Floats]:
        nonlocal best
        at, values = likelihood.at(variances(logs)), np.exp(logs)
        if best is None or at.log_likelihood > best.at.log_likelihood:
            best = Mode(logs, at)
        information = values[:, None] * at.information * values
        return -at.log_likelihood, -at.gradient * values, information

    minimise_damped(objective, start, box[:, 0], box[:, 1], tolerance)
    if best is None:
        raise AssertionError("the start is evaluated")
    return best


def _distinct(likelihood: RestrictedLikelihood, modes: Iterable[Mode]) -> list[Mode]:
    """Return the modes, best first, without those on the same ridge as a better mode."""
    kept: list[Mode] = []

    def is_on_ridge_of(better: Mode, mode: Mode) -> bool:
        if np.abs(mode.logs - better.logs).max() < SAME_LOGS:
            return True
        halfway = likelihood.at(variances(0.5 * (mode.logs + better.logs)))
        return halfway.log_likelihood > mode.at.log_likelihood - NO_DIP

    for mode in sorted(modes, key=lambda one: -one.at.log_likelihood):
        if not any(is_on_ridge_of(better, mode) for better in kept):
            kept.append(mode)
    return kept


def _beyond_best(likelihood: RestrictedLikelihood, best: Mode, box: Floats) -> Floats | None:
    """Return a guess with little multipath if `best` has much multipath, or vice versa."""
    # Returns None unless the likelihood there increases away from `best`.
    shadow, nugget, beta = best.covariance
    total = shadow + nugget
    much = nugget > LITTLE_MULTIPATH * total
    there = (
        (total, LITTLE_MULTIPATH * total, beta * shadow / total)
        if much
        else (0.5 * total, 0.5 * total, 2.0 * beta)
    )
    logs = np.clip(np.log(there), *box.T)
    # d log L / d log omega^2 along the ridge near this point.
    at, values = likelihood.at(variances(logs)), np.exp(logs)
    gradient = at.gradient * values
    information = values[:, None] * at.information * values + FLAT * np.eye(3)
    onto = np.linalg.solve(information[np.ix_([0, 2], [0, 2])], gradient[[0, 2]])
    slope = float(gradient[1] - information[1, [0, 2]] @ onto)
    return logs if (slope < 0.0) == much else None


def _covariance_fit(likelihood: RestrictedLikelihood, mode: Mode, box: Floats) -> CovarianceFit:
    """Return the covariance parameters at an optimum, with standard errors and warnings."""
    shadow, nugget, beta = mode.covariance
    free = (mode.logs - box[:, 0] >= BOUND_TOLERANCE) & (box[:, 1] - mode.logs >= BOUND_TOLERANCE)
    errors = np.full(3, math.inf)
    # In logarithms, so that the condition number does not depend on units.
    scale = np.array(mode.covariance)[free]
    information = likelihood.information(mode.covariance, mode.at)[np.ix_(free, free)]
    information = information * np.outer(scale, scale)
    spread = np.linalg.eigvalsh(information)
    if free.any() and spread[0] * MAX_CONDITION > spread[-1]:
        errors[free] = scale * np.sqrt(np.diag(np.linalg.inv(information)))
    deviations = np.array([math.sqrt(shadow), math.sqrt(nugget), beta])
    errors[:2] /= 2.0 * deviations[:2]
    names = np.array(["shadow_std_db", "multipath_std_db", "decorrelation_m"])
    units = ("dB", "dB", "m")
    warnings = [
        at_bound(str(name), float(value), unit)
        for name, value, unit, is_free in zip(names, deviations, units, free, strict=True)
        if not is_free
    ]
    unknown = free & np.isinf(errors)
    if unknown.any():
        warnings.append(
            f"the measurements do not determine {', '.join(names[unknown])}: other values fit too"
        )
    xi_error, omega_error, beta_error = errors.tolist()
    return CovarianceFit(shadow, nugget, beta, (xi_error, omega_error, beta_error), tuple(warnings))


MAX_EVALUATIONS = 60

MAX_STEP = 1.5  # Maximum change of a variable in one step, a trust region for the quadratic model
CURVATURE_FLOOR = 1e-3
"""Addition to the damping's diagonal, for directions in which the objective is flat."""
LEAST_SHARE = 1e-8  # Minimum curvature along a step for a BFGS update

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-8, 1e8


def minimise_damped(
    objective: Objective, start: Floats, lower: Floats, upper: Floats, tolerance: float
) -> tuple[float, Floats]:
    """Return the minimum of `objective` in a box and its location, by damped Newton steps."""
    # BFGS updates from the latest steps correct the objective's curvature.
    point = np.clip(start, lower, upper)
    value, gradient, curvature = objective(point)
    moves: deque[tuple[Floats, Floats]] = deque(maxlen=len(point))
    damping = FIRST_DAMPING
    for _ in range(MAX_EVALUATIONS - 1):
        model = _updated(curvature, moves)
        low, high = np.maximum(lower - point, -MAX_STEP), np.minimum(upper - point, MAX_STEP)
        free = ~(((low >= 0.0) & (gradient > 0.0)) | ((high <= 0.0) & (gradient < 0.0)))
        if _gain(gradient, model, free) < tolerance or damping > MOST_DAMPING:
            break
        floored = np.diag(model) + CURVATURE_FLOOR
        step = _step(gradient, model + damping * np.diag(floored), free, low, high)
        promised = -float(gradient @ step) - 0.5 * float(step @ model @ step)
        if promised <= 0.0:
            # Clipping several variables at once can make a step ascend; more damping prevents it.
            damping *= 10.0
            continue
        trial = objective(point + step)
        moves.append((step, trial[1] - gradient))
        gained = value - trial[0]
        if gained > 0.75 * promised:
            damping = max(0.1 * damping, LEAST_DAMPING)
        elif gained < 0.25 * promised:
            damping *= 10.0
        if gained > 0.0:
            point = point + step
            value, gradient, curvature = trial
    return value, point


def _updated(curvature: Floats, moves: Iterable[tuple[Floats, Floats]]) -> Floats:
    """Return `curvature` after BFGS updates by pairs (step, change of gradient)."""
    for step, change in moves:
        along = curvature @ step
        observed, expected = float(step @ change), float(step @ along)
        if min(observed, expected) > LEAST_SHARE * float(step @ step):
            curvature = (
                curvature - np.outer(along, along) / expected + np.outer(change, change) / observed
            )
    return curvature


def _gain(gradient: Floats, curvature: Floats, free: Mask) -> float:
    """Return the predicted decrease of the objective in a Newton step on the free variables."""
    if not free.any():
        return 0.0
    part = curvature[np.ix_(free, free)] + CURVATURE_FLOOR * np.eye(int(free.sum()))
    return 0.5 * float(gradient[free] @ np.linalg.solve(part, gradient[free]))


def _step(gradient: Floats, damped: Floats, free: Mask, low: Floats, high: Floats) -> Floats:
    """Return the damped Newton step, with variables fixed at bounds that the step would cross."""
    step = np.zeros_like(gradient)
    free = free.copy()
    while free.any():
        fixed = ~free
        pull = gradient[free] + damped[np.ix_(free, fixed)] @ step[fixed]
        step[free] = -np.linalg.solve(damped[np.ix_(free, free)], pull)
        outside = free & ((step < low) | (step > high))
        if not outside.any():
            break
        step = np.where(free, np.clip(step, low, high), step)
        free &= ~outside
    return step
