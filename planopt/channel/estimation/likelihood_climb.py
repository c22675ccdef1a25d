"""Climbing the restricted likelihood in the logarithms of xi^2, omega^2 and beta.

In logarithms, so that none can become negative, that steps do not depend on units, and that the
ridge along which xi^2 and beta grow together is straight. The likelihood may have several maxima,
above all two: a steep path loss with a short decorrelation distance, and a flat one with a long
distance, in whose slow shadowing the slope is hidden.

A minimiser in a box for a few variables whose gradient and approximate curvature are cheap.

Damped Newton steps (Levenberg and Marquardt) on the free variables, with the active set of the box
found by clipping. The curvature is the one given, corrected so that it explains the differences of
the last gradients (BFGS): with the likelihood's average information for it a climb needs half the
evaluations of a quasi-Newton method, which has to learn the curvature first.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from planopt.channel.estimation.likelihood_data import Covariance, Evaluated, Likelihood

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
    """The least value found and where.

    Parameters
    ----------
    objective
        Value, gradient (k,) and a positive semidefinite approximation (k, k) of the curvature.
    start
        ``(k,)``; moved into the box.
    lower, upper
        ``(k,)`` corners of the box.
    tolerance
        It ends when a Newton step on the free variables promises less than this.
    """
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
    """What a Newton step on the free variables promises."""
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

Top = tuple[NDArray[np.float64], Evaluated]
"""A point in logarithms, and the likelihood there."""


class LikelihoodClimb:
    """Climbs of one likelihood, to its optima within `fine`."""

    def __init__(self, likelihood: Likelihood, fine: float = FINE) -> None:
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
        """At a point (3,) in logarithms."""
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
        """Those of `tops` that are not on one ridge with a better one, the best first."""
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
