"""Maximise the restricted likelihood: climbs in a box, and starts that miss no maximum.

Climbs run in logarithms, so that no variance can become negative, steps do not depend on units, and
the ridge along which xi^2 and beta grow together is straight. They are damped Newton steps
(Levenberg and Marquardt) on the free variables, with the active set of the box found by clipping.
The curvature is the likelihood's average information, corrected so that it explains the differences
of the last gradients (BFGS): a climb needs half the evaluations of a quasi-Newton method, which has
to learn the curvature first.

The likelihood may have several maxima, above all two: a steep path loss with a short decorrelation
distance, and a flat one with a long distance, in whose slow shadowing the slope is hidden. It is
beta that tells their basins apart, so the starts come from a sample of the measurements, over a
range of decorrelation distances.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.channel_fit import CovarianceBounds
from planopt.channel.estimation.likelihood import (
    Covariance,
    Evaluation,
    LikelihoodData,
    RestrictedLikelihood,
    profiled_log_likelihood,
)

Vector = NDArray[np.float64]
Objective = Callable[[Vector], tuple[float, Vector, Vector]]

MAX_EVALUATIONS = 60

MAX_STEP = 1.5
"""No variable moves farther at once: the curvature says nothing beyond."""

CURVATURE_FLOOR = 1e-3
"""Added to the damping's diagonal, for directions in which the objective is flat."""

LEAST_SHARE = 1e-8
"""A move whose curvature is less is no use for an update."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-8, 1e8


def minimise_damped(
    objective: Objective, start: Vector, lower: Vector, upper: Vector, tolerance: float
) -> tuple[float, Vector]:
    """The least value found and where."""
    # Shapes: start (k,); lower, upper (k,).
    point = np.clip(start, lower, upper)
    value, gradient, curvature = objective(point)
    moves: deque[tuple[Vector, Vector]] = deque(maxlen=len(point))
    damping = FIRST_DAMPING
    for _ in range(MAX_EVALUATIONS - 1):
        model = _explaining(moves, curvature)
        low, high = np.maximum(lower - point, -MAX_STEP), np.minimum(upper - point, MAX_STEP)
        free = ~(((low >= 0.0) & (gradient > 0.0)) | ((high <= 0.0) & (gradient < 0.0)))
        if _gain(gradient, model, free) < tolerance or damping > MOST_DAMPING:
            break
        floored = np.diag(model) + CURVATURE_FLOOR
        step = _step(gradient, model + damping * np.diag(floored), free, low, high)
        promised = -float(gradient @ step) - 0.5 * float(step @ model @ step)
        if promised <= 0.0:
            # Clipping several variables at once can turn a step uphill; a shorter one is not.
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


def _explaining(moves: Iterable[tuple[Vector, Vector]], curvature: Vector) -> Vector:
    """`curvature` updated by the moves (step, change of the gradient) along which it is positive.

    The formula of Broyden, Fletcher, Goldfarb and Shanno.
    """
    for step, change in moves:
        along = curvature @ step
        observed, expected = float(step @ change), float(step @ along)
        if min(observed, expected) > LEAST_SHARE * float(step @ step):
            curvature = (
                curvature - np.outer(along, along) / expected + np.outer(change, change) / observed
            )
    return curvature


def _gain(gradient: Vector, curvature: Vector, free: NDArray[np.bool_]) -> float:
    """Return the gain that a Newton step on the free variables promises."""
    if not free.any():
        return 0.0
    part = curvature[np.ix_(free, free)] + CURVATURE_FLOOR * np.eye(int(free.sum()))
    return 0.5 * float(gradient[free] @ np.linalg.solve(part, gradient[free]))


def _step(
    gradient: Vector, damped: Vector, free: NDArray[np.bool_], low: Vector, high: Vector
) -> Vector:
    """The damped Newton step between `low` and `high`; variables it leaves the box with stop there.

    Each round fixes at least one variable, so there are at most k.
    """
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


ROUGH, FINE = 3e-2, 1e-5
"""What a step may still promise in log L where starts are compared, and at the end."""

SAME_LOGS = 0.05
"""Optima nearer than this in every logarithm are one."""

NO_DIP = 0.1
"""Optima are on one ridge where halfway between them log L is lower than at either by no more."""

FLAT = 1e-6
"""Information of a logarithm below which the likelihood counts as flat."""

NEARLY_AS_LIKELY = 2.0
"""Optima whose log L is lower by no more than this are kept beside the best."""

Top = tuple[NDArray[np.float64], Evaluation]
"""A point in logarithms, and the likelihood there."""


class LikelihoodClimb:
    """Climbs of one likelihood, to its optima within `fine`."""

    def __init__(self, likelihood: RestrictedLikelihood, fine: float = FINE) -> None:
        self._likelihood = likelihood
        self._fine = fine
        self._top: Top | None = None
        self._tolerance = 0.0

    def to_top(self, start: NDArray[np.float64], box: NDArray[np.float64], tolerance: float) -> Top:
        """The optimum reached from `start` (3,) within `box` (3, 2), all in logarithms."""
        self._top, self._tolerance = None, tolerance
        minimise_damped(self._objective, start, box[:, 0], box[:, 1], tolerance)
        if self._top is None:
            raise AssertionError("the start is evaluated")
        return self._top

    def log_likelihood(self, logs: NDArray[np.float64]) -> float:
        """Return the log-likelihood at a point (3,) in logarithms."""
        return self._likelihood.at(variances(logs)).log_likelihood

    def rise(self, logs: NDArray[np.float64], axis: int) -> float:
        """Slope of log L over one logarithm along the ridge that passes near a point (3,)."""
        values = np.exp(logs)
        at = self._likelihood.at(variances(logs), ROUGH)
        gradient = at.gradient * values
        information = values[:, None] * at.information * values + FLAT * np.eye(3)
        others = np.delete(np.arange(3), axis)
        onto = np.linalg.solve(information[np.ix_(others, others)], gradient[others])
        return float(gradient[axis] - information[axis, others] @ onto)

    def distinct(self, tops: Iterable[Top]) -> list[Top]:
        """Return those `tops` that share no ridge with a better one, the best first."""
        kept: list[Top] = []
        for top in sorted(tops, key=lambda one: -one[1].log_likelihood):
            if not any(self._on_one_ridge(better[0], top) for better in kept):
                kept.append(top)
        return kept

    def modes(self, starts: Iterable[NDArray[np.float64]], box: NDArray[np.float64]) -> list[Top]:
        """The optima reached from `starts`, the best first, none that is far less likely."""
        tops = self.distinct(self.to_top(start, box, ROUGH) for start in starts)
        least = tops[0][1].log_likelihood - NEARLY_AS_LIKELY - ROUGH
        likely = [logs for logs, at in tops if at.log_likelihood > least]
        found = self.distinct(self.to_top(logs, box, self._fine) for logs in likely)
        # A rough climb may end short of its top: only the fine ones tell which are likely.
        least = found[0][1].log_likelihood - NEARLY_AS_LIKELY
        return [top for top in found if top[1].log_likelihood >= least]

    def _on_one_ridge(self, better: NDArray[np.float64], top: Top) -> bool:
        logs, at = top
        if np.abs(logs - better).max() < SAME_LOGS:
            return True
        return self.log_likelihood(0.5 * (logs + better)) > at.log_likelihood - NO_DIP

    def _objective(
        self, logs: NDArray[np.float64]
    ) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Minus log L, its gradient and information, by the logarithms."""
        at = self._likelihood.at(variances(logs), self._tolerance)
        values = np.exp(logs)
        if self._top is None or at.log_likelihood > self._top[1].log_likelihood:
            self._top = logs, at
        return (
            -at.log_likelihood,
            -at.gradient * values,
            values[:, None] * at.information * values,
        )


def variances(logs: NDArray[np.float64]) -> Covariance:
    """(xi^2, omega^2, beta) from their logarithms."""
    shadow, nugget, beta = np.exp(logs)
    return float(shadow), float(nugget), float(beta)


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
    rows = np.flatnonzero(data.gaussian)
    taken = np.zeros(len(data.values_db), dtype=np.bool_)
    taken[rows[thinned(len(rows), START_MEASUREMENTS)]] = True
    sample = data.part(taken)
    starts = _grid_starts(sample, bounds)
    if len(data.values_db) <= START_MEASUREMENTS:
        return starts
    # Basins are told apart on the sample: the whole is climbed once for each.
    climb = LikelihoodClimb(RestrictedLikelihood(sample))
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
    likelihood: RestrictedLikelihood, box: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Local maxima over beta of a sample's likelihood, the other two maximised at each beta.

    A maximum of the whole need not be one of the sample: to either side of the best one the whole
    is asked which way it rises, and where that is away from there, that is a start too.
    """
    data, whole = likelihood.data, LikelihoodClimb(likelihood)
    taken = np.zeros(len(data.values_db), dtype=np.bool_)
    # The first blocks are spread over all places.
    for window in data.windows[:START_BLOCKS]:
        taken[window.own] = True
    sample = data.part(taken & data.gaussian)
    climb = LikelihoodClimb(RestrictedLikelihood(sample))
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


def _peaks(values: NDArray[np.float64]) -> list[int]:
    """Numbers of the local maxima, the highest first."""
    walled = np.concatenate([[-math.inf], values, [-math.inf]])
    peaks = np.flatnonzero((walled[1:-1] >= walled[:-2]) & (walled[1:-1] > walled[2:]))
    return sorted((int(number) for number in peaks), key=lambda number: -values[number])
