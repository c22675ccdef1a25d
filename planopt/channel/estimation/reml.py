"""Restricted maximum likelihood of xi, omega and beta, with generalised least squares for theta.

The default fit: unlike Lemma 1 it has no selection bias, weighs every pair rightly, and takes
censored measurements for what they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.covariance_fit import (
    BOUND_TOLERANCE,
    CovarianceBounds,
    CovarianceFit,
    at_bound,
)
from planopt.channel.estimation.likelihood_climb import FINE, ROUGH, LikelihoodClimb, variances
from planopt.channel.estimation.likelihood_data import LikelihoodData, likelihood_data
from planopt.channel.estimation.restricted_likelihood import (
    Evaluation,
    expected_information,
    profiled_log_likelihood,
)
from planopt.channel.intervals.censoring import needs_site
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters

START_SHARES = (0.3, 0.7, 0.95)
"""Correlated shares xi^2 / alpha of the starts."""

START_DECORRELATIONS = 5
"""Values of beta of the starts, spaced geometrically within its bounds."""

STARTS_FOLLOWED = 2
"""Of all starts the best few by the profiled likelihood are followed to their optimum."""

MAX_MEASUREMENTS = 800
"""More than these are thinned: the cost of a step grows with the cube of the number."""

THINNING_SEED = 20_000

START_MEASUREMENTS = 250
"""Starts are ranked, and followed first, on at most this many exact measurements."""


MAX_RELATIVE_ERROR = 10.0
"""A variance or distance whose standard error is more than this many times itself is not known."""


@dataclass(frozen=True)
class RemlFit:
    """A covariance with the mean that goes with it.

    Attributes
    ----------
    covariance
        xi, omega, beta.
    coefficients, coefficient_covariance
        Of the mean model, by generalised least squares.
    log_likelihood
        Restricted, at the optimum.
    measurements
        Number of measurements used, after thinning.
    """

    covariance: CovarianceFit
    coefficients: NDArray[np.float64]
    coefficient_covariance: NDArray[np.float64]
    log_likelihood: float
    measurements: int


def thinned(count: int, limit: int) -> NDArray[np.intp]:
    """Indices of at most `limit` of `count` measurements, a fixed uniform draw in order."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(THINNING_SEED).permutation(count)[:limit])


def reml_fit(
    model: MeanModel,
    measurements: Measurements,
    bounds: CovarianceBounds,
    known: ChannelParameters,
) -> RemlFit:
    """Maximise the restricted likelihood within `bounds` (theory 4.7).

    Parameters
    ----------
    model
        Mean model at the same positions.
    measurements
        At least three more uncensored ones than the mean has coefficients.
    bounds
        Of xi^2, omega^2 and beta.
    known
        What is not estimated here, as in :func:`likelihood_data`.
    """
    data = likelihood_data(model, measurements, known)
    box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
    sample = _exact_sample(data)
    # Basins are told apart on the sample where it is smaller: the whole is climbed but once.
    large = len(data.power_db) > START_MEASUREMENTS
    rough = LikelihoodClimb(sample if large else data)
    tops = [rough.to_top(start, box, ROUGH) for start in _starts(sample, bounds)]
    best, _ = max(tops, key=lambda top: top[1].log_likelihood)
    logs, at = (LikelihoodClimb(data) if large else rough).to_top(best, box, FINE)
    as_interval = needs_site(measurements, math.exp(logs[1]))
    if as_interval.sum() > measurements.censored.sum():
        # Chosen once, from the fit with Sheppard's correction: the likelihood stays smooth.
        data = likelihood_data(model, measurements, known, as_interval)
        logs, at = LikelihoodClimb(data).to_top(logs, box, FINE)
    return _result(data, logs, at, box)


def _exact_sample(data: LikelihoodData) -> LikelihoodData:
    """At most `START_MEASUREMENTS` of the exact measurements."""
    return data.gaussian(thinned(data.exact, START_MEASUREMENTS))


def _starts(sample: LikelihoodData, bounds: CovarianceBounds) -> list[NDArray[np.float64]]:
    """Logarithms of the most likely of a grid over (xi^2 / alpha, beta), alpha profiled out."""
    low, high = bounds.decorrelation_m
    # Ends of the range are no use as starts: the gradient there is nearly flat.
    betas = np.geomspace(low, high, START_DECORRELATIONS + 2)[1:-1]
    ranked: list[tuple[float, NDArray[np.float64]]] = []
    for share, beta in product(START_SHARES, betas):
        value, total = profiled_log_likelihood(sample, share, float(beta))
        ranked.append((value, np.log([share * total, (1.0 - share) * total, beta])))
    ranked.sort(key=lambda entry: -entry[0])
    return [start for _, start in ranked[:STARTS_FOLLOWED]]


def _result(
    data: LikelihoodData, logs: NDArray[np.float64], at: Evaluation, box: NDArray[np.float64]
) -> RemlFit:
    """Standard errors, warnings and the mean at the optimum."""
    shadow, nugget, beta = covariance = variances(logs)
    bound = (logs - box[:, 0] < BOUND_TOLERANCE) | (box[:, 1] - logs < BOUND_TOLERANCE)
    errors = _standard_errors(data, covariance, at, ~bound)
    roots = math.sqrt(shadow), math.sqrt(nugget)
    names = zip(
        bound,
        ("xi", "omega", "beta"),
        (*roots, beta),
        ("dB", "dB", "m"),
        strict=True,
    )
    return RemlFit(
        CovarianceFit(
            shadow,
            nugget,
            beta,
            (errors[0] / (2.0 * roots[0]), errors[1] / (2.0 * roots[1]), errors[2]),
            (
                *(at_bound(name, value, unit) for hit, name, value, unit in names if hit),
                *_not_told_apart(errors, covariance, ~bound),
            ),
        ),
        at.coefficients,
        at.coefficient_covariance,
        at.log_likelihood,
        len(data.power_db),
    )


def _not_told_apart(
    errors: tuple[float, float, float],
    covariance: tuple[float, float, float],
    free: NDArray[np.bool_],
) -> tuple[str, ...]:
    """The warning that parameters inside their range have errors far larger than themselves."""
    unknown = free & ~(np.asarray(errors) <= MAX_RELATIVE_ERROR * np.asarray(covariance))
    if not unknown.any():
        return ()
    names = [name for name, own in zip(("xi", "omega", "beta"), unknown, strict=True) if own]
    return (f"the measurements do not tell {', '.join(names)} apart: they are not determined",)


def _standard_errors(
    data: LikelihoodData,
    covariance: tuple[float, float, float],
    at: Evaluation,
    free: NDArray[np.bool_],
) -> tuple[float, float, float]:
    """Errors of xi^2, omega^2 and beta; ``inf`` for those at a bound, which are held fixed."""
    errors = np.full(3, math.inf)
    # In logarithms, so that the condition of the information does not depend on units.
    scale = np.asarray(covariance)[free]
    information = expected_information(data, covariance, at)[np.ix_(free, free)]
    information = information * np.outer(scale, scale)
    if free.any() and np.linalg.cond(information) < 1e12:
        variances = np.diag(np.linalg.inv(information))
        errors[free] = scale * np.sqrt(variances)
    return float(errors[0]), float(errors[1]), float(errors[2])
