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

from planopt.channel.censoring import CensoredSites
from planopt.channel.covariance_fit import (
    BOUND_TOLERANCE,
    CovarianceBounds,
    CovarianceFit,
    at_bound,
)
from planopt.channel.mean_model import MeanModel
from planopt.channel.measurements import Measurements
from planopt.channel.minimise import minimise_in_box
from planopt.channel.restricted_likelihood import (
    Evaluation,
    LikelihoodData,
    evaluate,
    expected_information,
    likelihood_data,
    profiled_log_likelihood,
)

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
"""Starts are ranked on at most this many exact measurements; sets larger than that are climbed from
the optimum of this sample."""


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


def reml_fit(model: MeanModel, measurements: Measurements, bounds: CovarianceBounds) -> RemlFit:
    """Maximise the restricted likelihood within `bounds` (theory 4.7).

    Parameters
    ----------
    model
        Mean model at the same positions.
    measurements
        At least three more uncensored ones than the mean has coefficients.
    bounds
        Of xi^2, omega^2 and beta.
    """
    data = likelihood_data(model, measurements)
    box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
    sample = _exact_sample(data)
    starts = _starts(sample, bounds)
    if len(data.power_db) > START_MEASUREMENTS:
        # Basins are told apart on the sample, so that the whole is climbed but once.
        starts = [_climbed(_Climb(sample), starts, box)]
    climb = _Climb(data)
    return _result(data, _climbed(climb, starts, box), box, climb.sites)


class _Climb:
    """The objective in log-parameters; keeps the last sites, so that EP starts warm."""

    def __init__(self, data: LikelihoodData) -> None:
        self.data = data
        self.sites: CensoredSites | None = None

    def objective(self, logs: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Minus log L and its gradient by the logarithms."""
        values = np.exp(logs)
        at = evaluate(self.data, _covariance(values), self.sites)
        self.sites = at.sites
        return -at.log_likelihood, -at.gradient * values


def _climbed(
    climb: _Climb, starts: list[NDArray[np.float64]], box: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The best optimum, in logarithms, reached from `starts`, in logarithms, within `box`."""
    climbs = [minimise_in_box(climb.objective, start, box[:, 0], box[:, 1]) for start in starts]
    return min(climbs, key=lambda climbed: climbed[0])[1]


def _exact_sample(data: LikelihoodData) -> LikelihoodData:
    """At most `START_MEASUREMENTS` of the exact measurements."""
    rows = thinned(data.exact, START_MEASUREMENTS)
    distance = data.distance_m[np.ix_(rows, rows)]
    return LikelihoodData(distance, data.columns[rows], data.power_db[rows], len(rows))


def _covariance(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


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
    data: LikelihoodData,
    logs: NDArray[np.float64],
    box: NDArray[np.float64],
    sites: CensoredSites | None,
) -> RemlFit:
    """Standard errors, warnings and the mean at the optimum."""
    shadow, nugget, beta = covariance = _covariance(np.exp(logs))
    at = evaluate(data, covariance, sites)
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
            tuple(at_bound(name, value, unit) for hit, name, value, unit in names if hit),
        ),
        at.coefficients,
        at.coefficient_covariance,
        at.log_likelihood,
        len(data.power_db),
    )


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
