"""A minimiser in a box for a few variables whose gradient and approximate curvature are cheap.

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
