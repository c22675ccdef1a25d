"""Restricted maximum likelihood of xi, omega and beta, with generalised least squares for theta.

The default fit: unlike Lemma 1 of [GM11] it has no selection bias, weighs every pair rightly, and
takes censored measurements for what they are. Up to `EXACT_ROWS` measurements the likelihood is
exact, from one factor; beyond, it is that of blocks
(:mod:`planopt.channel.estimation.likelihood`), whose cost is proportional to their number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import (
    BOUND_TOLERANCE,
    CovarianceBounds,
    CovarianceFit,
    at_bound,
)
from planopt.channel.estimation.likelihood import (
    Covariance,
    RestrictedLikelihood,
    likelihood_data,
)
from planopt.channel.estimation.likelihood_climb import (
    FINE,
    LikelihoodClimb,
    Top,
    beyond_best,
    block_starts,
    dense_starts,
    variances,
)
from planopt.channel.gaussian_sites import needs_site
from planopt.channel.measurements import Measurements
from planopt.channel.parameters import ChannelParameters, MeanModel

EXACT_ROWS = 2_000
"""Up to so many measurements the likelihood is exact. A fit of 1,900 takes 2 s of CPU, 8 s if 60 %
are censored; by blocks it takes 0.8 s."""

MOST_DENSE = 800
"""Measurements of a sample that stands for all where a fit is repeated: in the search for the
station, and for the weights of covariances."""

BLOCK_FINE = 2e-3
"""What a step to the optimum of blocks may still promise in log L: a sixteenth of a standard error,
no more than what blocks leave out."""

MAX_CONDITION = 1e12
"""Of the information of three logarithms: beyond, they are not told apart."""


@dataclass(frozen=True, eq=False)
class Mode:
    """One maximum of the likelihood."""

    covariance: Covariance  # xi^2, omega^2 and beta
    coefficients: NDArray[np.float64]  # Of the mean model, by generalised least squares
    coefficient_covariance: NDArray[np.float64]
    log_likelihood: float  # Restricted


@dataclass(frozen=True, eq=False)
class RemlFit:
    """A covariance with the mean that goes with it."""

    covariance: CovarianceFit  # xi, omega, beta
    best: Mode  # The same with the mean, as a maximum of the likelihood
    others: tuple[Mode, ...]  # Other maxima that are nearly as likely, the best first


def reml_fit(
    model: MeanModel,
    measurements: Measurements,
    bounds: CovarianceBounds,
    known: ChannelParameters,
    *,
    errors: bool = True,
) -> RemlFit:
    """Maximise the restricted likelihood within `bounds`."""
    box = np.log([bounds.shadow_db2, bounds.multipath_db2, bounds.decorrelation_m])
    whole = len(measurements) <= EXACT_ROWS
    blocks, fine = (None, FINE) if whole else (bounds.decorrelation_m, BLOCK_FINE)
    data = likelihood_data(model, measurements, known, None, blocks)
    likelihood = RestrictedLikelihood(data)
    starts = dense_starts(data, bounds, box) if whole else block_starts(likelihood, box)
    climb = LikelihoodClimb(likelihood, fine)
    modes = climb.modes(starts, box)
    further = beyond_best(climb, modes[0], box)
    if further:
        modes = climb.modes([*further, *(logs for logs, _ in modes)], box)
    as_interval = needs_site(measurements, math.exp(modes[0][0][1]))
    if as_interval.sum() > measurements.censored.sum():
        # Chosen once, from the fit with Sheppard's correction: the likelihood stays smooth.
        data = likelihood_data(model, measurements, known, as_interval, blocks)
        likelihood = RestrictedLikelihood(data)
        climb = LikelihoodClimb(likelihood, fine)
        modes = climb.modes([logs for logs, _ in modes], box)
    best, *others = (_mode(top) for top in modes)
    covariance = (
        _covariance_fit(likelihood, modes[0], box)
        if errors
        else CovarianceFit(*best.covariance, (math.inf, math.inf, math.inf), ())
    )
    return RemlFit(
        covariance,
        best,
        tuple(others),
    )


def _mode(top: Top) -> Mode:
    logs, at = top
    return Mode(variances(logs), at.coefficients, at.coefficient_covariance, at.log_likelihood)


def _covariance_fit(
    likelihood: RestrictedLikelihood, top: Top, box: NDArray[np.float64]
) -> CovarianceFit:
    """Standard errors and warnings at the optimum."""
    logs, at = top
    shadow, nugget, beta = covariance = variances(logs)
    bound = (logs - box[:, 0] < BOUND_TOLERANCE) | (box[:, 1] - logs < BOUND_TOLERANCE)
    errors = _standard_errors(likelihood.information(covariance, at), covariance, ~bound)
    roots = math.sqrt(shadow), math.sqrt(nugget)
    names = zip(
        bound,
        ("xi", "omega", "beta"),
        (*roots, beta),
        ("dB", "dB", "m"),
        strict=True,
    )
    return CovarianceFit(
        shadow,
        nugget,
        beta,
        (errors[0] / (2.0 * roots[0]), errors[1] / (2.0 * roots[1]), errors[2]),
        (
            *(at_bound(name, value, unit) for hit, name, value, unit in names if hit),
            *_not_told_apart(errors, ~bound),
        ),
    )


def _not_told_apart(errors: tuple[float, float, float], free: NDArray[np.bool_]) -> tuple[str, ...]:
    """The warning that parameters inside their range have no finite errors."""
    unknown = free & np.isinf(errors)
    if not unknown.any():
        return ()
    names = [name for name, own in zip(("xi", "omega", "beta"), unknown, strict=True) if own]
    return (f"the measurements do not tell {', '.join(names)} apart: they are not determined",)


def _standard_errors(
    information: NDArray[np.float64], covariance: Covariance, free: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Errors of xi^2, omega^2 and beta; ``inf`` for those at a bound, which are held fixed."""
    errors = np.full(3, math.inf)
    # In logarithms, so that the condition of the information does not depend on units.
    scale = np.asarray(covariance)[free]
    information = information[np.ix_(free, free)] * np.outer(scale, scale)
    spread = np.linalg.eigvalsh(information)
    if free.any() and spread[0] * MAX_CONDITION > spread[-1]:
        errors[free] = scale * np.sqrt(np.diag(np.linalg.inv(information)))
    return float(errors[0]), float(errors[1]), float(errors[2])
