"""Where to begin climbing the likelihood, so that no maximum of it is missed.

From a sample of the measurements, over a range of decorrelation distances: between a steep path
loss with short shadowing and a flat one with long shadowing it is beta that tells the basins apart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.block_data import BlockData, exact_part
from planopt.channel.estimation.block_likelihood import BlockLikelihood
from planopt.channel.estimation.covariance_fit import CovarianceBounds
from planopt.channel.estimation.likelihood_climb import ROUGH, LikelihoodClimb, Top, variances
from planopt.channel.estimation.likelihood_data import Likelihood, LikelihoodData
from planopt.channel.estimation.restricted_likelihood import (
    DenseLikelihood,
    profiled_log_likelihood,
)

START_SHARES = (0.3, 0.7, 0.95)
"""Correlated shares xi^2 / alpha of the starts."""

START_DECORRELATIONS = 5
"""Values of beta of the starts, spaced geometrically within its bounds."""

STARTS_FOLLOWED = 2
"""Of all starts so many are followed to their optimum at least, the best by the likelihood."""

START_MEASUREMENTS = 250
"""Starts are ranked, and followed first, on at most this many exact measurements,"""

START_BLOCKS = 24
"""and of blocks on those of so many, which are spread over all places."""

SCANNED_DECORRELATIONS = 8
"""Values of beta at which those of blocks are compared,"""

SCAN_TOLERANCE = 0.3
"""and what a step may still promise in log L there."""

LITTLE_MULTIPATH = 0.03
"""omega^2 / alpha of a point that is to all intents without multipath."""

FAR_LOGS = 0.5
"""An end of the box nearer than this, in its logarithm, is one with the best point."""

THINNING_SEED = 20_000

Logs = NDArray[np.float64]
"""``(3,)`` logarithms of xi^2, omega^2 and beta."""


def thinned(count: int, limit: int) -> NDArray[np.intp]:
    """Indices of at most `limit` of `count` measurements, a fixed uniform draw in order."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(THINNING_SEED).permutation(count)[:limit])


def dense_starts(
    data: LikelihoodData, bounds: CovarianceBounds, box: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Points in logarithms to climb from: the best of a grid, followed on a sample of many."""
    sample = data.gaussian(thinned(data.exact, START_MEASUREMENTS))
    starts = _grid_starts(sample, bounds)
    if len(data.power_db) <= START_MEASUREMENTS:
        return starts
    # Basins are told apart on the sample: the whole is climbed once for each.
    climb = LikelihoodClimb(DenseLikelihood(sample))
    tops = climb.distinct(climb.to_top(start, box, ROUGH) for start in starts)
    return [logs for logs, _ in tops]


def _grid_starts(sample: LikelihoodData, bounds: CovarianceBounds) -> list[NDArray[np.float64]]:
    """The most likely of a grid over (xi^2 / alpha, beta), alpha profiled out, and local maxima.

    The maxima are over beta, of the best share at each.
    """
    low, high = bounds.decorrelation_m
    # Ends of the range are no use as starts: the gradient there is nearly flat.
    betas = np.geomspace(low, high, START_DECORRELATIONS + 2)[1:-1]
    values = np.empty((len(betas), len(START_SHARES)))
    logs = np.empty((*values.shape, 3))
    for row, beta in enumerate(betas):
        for column, share in enumerate(START_SHARES):
            values[row, column], total = profiled_log_likelihood(sample, share, float(beta))
            logs[row, column] = np.log([share * total, (1.0 - share) * total, beta])
    chosen = [(row, int(values[row].argmax())) for row in _peaks(values.max(axis=1))]
    for flat in np.argsort(-values, axis=None, kind="stable")[:STARTS_FOLLOWED]:
        place = divmod(int(flat), len(START_SHARES))
        if place not in chosen:
            chosen.append(place)
    return [logs[place] for place in chosen]


def block_starts(
    data: BlockData, likelihood: Likelihood, box: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Local maxima over beta of a sample's likelihood, the other two maximised at each beta.

    A maximum of the whole need not be one of the sample: to either side of the best one the whole
    is asked which way it rises, and where that is away from there, that is a start too.
    """
    whole = LikelihoodClimb(likelihood)
    sample = exact_part(data, START_BLOCKS)
    climb = LikelihoodClimb(BlockLikelihood(sample))
    fitted, *_ = np.linalg.lstsq(sample.columns, sample.values_db, rcond=None)
    variance = float(np.mean((sample.values_db - sample.columns @ fitted) ** 2))
    low, high = (float(end) for end in box[2])
    betas = np.linspace(low, high, SCANNED_DECORRELATIONS + 2, dtype=np.float64)[1:-1]
    tops: dict[int, Top] = {}
    near = np.log([0.5 * variance, 0.5 * variance, 1.0])
    # From the middle outwards, each from the one before it.
    for number in sorted(range(len(betas)), key=lambda one: abs(2 * one - len(betas))):
        inner = tops.get(number + 1, tops.get(number - 1))
        start = (near if inner is None else inner[0]).copy()
        fixed = box.copy()
        fixed[2] = start[2] = betas[number]
        tops[number] = climb.to_top(np.clip(start, *box.T), fixed, SCAN_TOLERANCE)
    values = np.array([tops[number][1].log_likelihood for number in range(len(betas))])
    chosen = _peaks(values)
    best = chosen[0]
    for side in (range(best - 1), range(best + 2, len(betas))):
        if side:
            number = max(side, key=lambda one: values[one])
            if (whole.rise(tops[number][0], 2) > 0.0) == (number > best):
                chosen.append(number)
    return [tops[number][0] for number in dict.fromkeys(chosen)]


def beyond_best(climb: LikelihoodClimb, best: Top, box: NDArray[np.float64]) -> list[Logs]:
    """A point on the other side of the multipath, if the likelihood rises from there to beyond.

    What looks like multipath may be shadowing over a short distance, and the other way round.
    """
    shadow, nugget, beta = variances(best[0])
    total = shadow + nugget
    much = nugget > LITTLE_MULTIPATH * total
    there = (
        (total, LITTLE_MULTIPATH * total, beta * shadow / total)
        if much
        else (0.5 * total, 0.5 * total, 2.0 * beta)
    )
    logs = np.clip(np.log(there), *box.T)
    return [logs] if (climb.rise(logs, 1) < 0.0) == much else []


def at_ends(climb: LikelihoodClimb, best: Top, box: NDArray[np.float64]) -> list[Logs]:
    """Tops of three ends of the box, far from the best one, where the likelihood rises to the end.

    There shadowing takes the place of multipath, or is as good as endless, or as good as none.
    """
    shadow, nugget, beta = variances(best[0])
    total = shadow + nugget
    least, low, high = (math.exp(float(end)) for end in (box[1, 0], *box[2]))
    found: list[Logs] = []
    for there, axis, way in (
        ((total, least, beta * shadow / total), 1, -1.0),
        ((shadow, nugget, high), 2, 1.0),
        ((0.5 * total, 0.5 * total, low), 2, -1.0),
    ):
        start = np.clip(np.log(there), *box.T)
        if abs(float(start[axis] - best[0][axis])) > FAR_LOGS:
            fixed = box.copy()
            fixed[axis] = start[axis]
            logs, at = climb.to_top(start, fixed, ROUGH)
            if way * float(at.gradient[axis]) > 0.0:
                found.append(logs)
    return found


def _peaks(values: NDArray[np.float64]) -> list[int]:
    """Numbers of the local maxima, the highest first."""
    walled = np.concatenate([[-math.inf], values, [-math.inf]])
    peaks = np.flatnonzero((walled[1:-1] >= walled[:-2]) & (walled[1:-1] > walled[2:]))
    return sorted((int(number) for number in peaks), key=lambda number: -values[number])
