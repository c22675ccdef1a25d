"""The station's filter along one axis, and what packets lessen its covariance by.

The station's estimate and the sensor are alike along x and y, and so is the process noise: the
filter's covariance is that of one axis, three numbers, for both (equations 4.22 and 4.25).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.tracking_filter import Criterion, FilteredTracking
from planopt.targets.information_filter import TargetModel, covariance_of


def removed(received: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """sum_k w_k (f(P_k) without packets - mean f(P_k)) of the position; ``(...)``."""
    # Shapes: received (..., draws, k).
    if settings.held is not None:
        return _removed_by_estimates(received, settings)
    nothing = np.zeros(received.shape[-1])
    return left(nothing, settings) - left(received, settings).mean(axis=-1)


def left(received: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """sum_k w_k f(P_k) of the position; ``(...)``. Arguments as :func:`removed`, of one draw each.

    In place: searches ask for hundreds of paths over all steps.
    """
    weight, steps = settings.tracking.weight, Axis.of(settings)
    total = np.zeros(received.shape[:-1])
    variance = np.empty((3, *total.shape))
    variance[:] = steps.start.reshape(3, *[1] * total.ndim)
    for k, each in enumerate(np.moveaxis(received, -1, 0)):
        steps.predict(variance)
        steps.update(variance, each)
        total += weight[k] * criterion_of(variance[0], settings.criterion)
    return total


def _removed_by_estimates(
    received: NDArray[np.float64], settings: FilteredTracking
) -> NDArray[np.float64]:
    """:func:`removed` of information ``(..., draws, k, M + k)``: a filter for every step k."""
    held, weight = settings.held, settings.tracking.weight
    if held is None:
        raise AssertionError("packets have measurements")
    steps, most = Axis.of(replace(settings, information=held.information)), held.steps
    total = np.zeros(received.shape[:-2])
    shape = received.shape[:-1]
    variance = np.broadcast_to(steps.start.reshape(3, *[1] * len(shape)), (3, *shape))
    alone, idle = steps.start, 0.0
    for s in range(received.shape[-1]):
        k = s - most
        # Filters of earlier steps are at their end.
        variance = steps.predicted(variance[..., 1:] if k > 0 else variance)
        alone = steps.predicted(alone)
        told = received[..., max(k, 0) :, s]
        if k < 0:
            told = told + held.known[s]
            alone = steps.updated(alone, np.asarray(held.known[s]))
        variance = steps.updated(variance, told)
        if k >= 0:
            total += weight[k] * criterion_of(variance[0][..., 0], settings.criterion)
            idle += weight[k] * float(criterion_of(alone[0], settings.criterion))
    return idle - total.mean(axis=-1)


def criterion_of(variance_m2: NDArray[np.float64], criterion: Criterion) -> NDArray[np.float64]:
    """Return the trace, determinant or norm of a I_2, a the variance of a coordinate; ``(...)``."""
    if criterion == "determinant":
        return np.square(variance_m2)
    return variance_m2 if criterion == "norm" else 2.0 * variance_m2


def removed_derivatives(
    received: NDArray[np.float64], settings: FilteredTracking
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """:func:`removed` with derivatives, in each draw, by the information of each step.

    The value, ``(draws, k)`` and ``(draws, k, k)``; derivatives are not averaged yet.
    """
    weight = settings.tracking.weight
    total, by, hessian = _cost_derivatives(received, settings)
    steps, idle = Axis.of(settings), 0.0
    alone = steps.start
    for each in weight:
        alone = steps.predicted(alone)
        idle += each * float(criterion_of(alone[0], settings.criterion))
    return idle - float(total.mean()), -by, -hessian


def _cost_derivatives(
    received: NDArray[np.float64], settings: FilteredTracking
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """sum_k w_k f(P_k) of each draw (draws,) with derivatives, of information (draws, k)."""
    (draws, count), criterion = received.shape, settings.criterion
    weight = settings.tracking.weight
    steps = Axis.of(settings)
    predicted = np.empty((count, 3, draws))
    known = np.empty((count, draws))
    variance = np.broadcast_to(steps.start[:, None], (3, draws))
    total = np.zeros(draws)
    for k in range(count):
        predicted[k] = steps.predicted(variance)
        variance = steps.updated(predicted[k], received[:, k])
        known[k] = variance[0]
        total += weight[k] * criterion_of(variance[0], criterion)
    slope = _slopes(predicted, received.T)
    # Adjoints of (a, b, c) after each update, backwards.
    squares = criterion == "determinant"
    slope_of_criterion = 1.0 if criterion == "norm" else 2.0
    after, ahead = np.empty((count, draws, 3)), np.zeros((draws, 3))
    by = np.empty((draws, count))
    for k in range(count - 1, -1, -1):
        after[k] = ahead
        after[k, :, 0] += weight[k] * (2.0 * known[k] if squares else slope_of_criterion)
        pulled = (after[k, :, None] @ slope[k])[:, 0]
        by[:, k] = pulled[:, 3]
        ahead = pulled[:, :3] @ steps.transition.T
    bent = _bends(after, predicted, received.T)
    hessian = np.zeros((draws, count, count))
    tangent = np.zeros((draws, count, 3))
    for k in range(count):
        now = tangent[:, :k] @ steps.transition
        moved = now[..., :2]
        turned = moved @ bent[k, :, :2]
        hessian[:, :k, :k] += turned[..., :2] @ moved.transpose(0, 2, 1)
        hessian[:, :k, k] = hessian[:, k, :k] = turned[..., 2]
        hessian[:, k, k] = bent[k, :, 2, 2]
        tangent[:, :k] = now @ slope[k, :, :, :3].transpose(0, 2, 1)
        tangent[:, k] = slope[k, :, :, 3]
        if squares:
            moved = tangent[:, : k + 1, 0]
            factor = 2.0 * weight[k]
            hessian[:, : k + 1, : k + 1] += factor * moved[:, :, None] * moved[:, None]
    return total, by, hessian


def _slopes(now: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes of (a, b, c) after updates by a, b, c before and the information; (k, draws, 3, 4)."""
    # Shapes: now (k, 3, draws); u (k, draws).
    a, b = now[:, 0], now[:, 1]
    r = 1.0 / (1.0 + a * u)
    r2, bu = r * r, b * u
    slope = np.zeros((*u.shape, 3, 4))
    slope[..., 0, 0], slope[..., 0, 3] = r2, -a * a * r2
    slope[..., 1, 0], slope[..., 1, 1], slope[..., 1, 3] = -bu * r2, r, -a * b * r2
    slope[..., 2, 0], slope[..., 2, 1] = bu * bu * r2, -2.0 * bu * r
    slope[..., 2, 2], slope[..., 2, 3] = 1.0, -b * b * r2
    return slope


def _bends(
    after: NDArray[np.float64], now: NDArray[np.float64], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Second derivatives by (a, b, u) before each update, ``(k, draws, 3, 3)``; c is linear."""
    # Shapes: after (k, draws, 3).
    a, b = now[:, 0], now[:, 1]
    A, B, C = after[..., 0], after[..., 1], after[..., 2]
    r = 1.0 / (1.0 + a * u)
    r2, r3, bu = r * r, r * r * r, b * u
    bent = np.empty((*u.shape, 3, 3))
    bent[..., 0, 0] = 2.0 * u * (-A + bu * B - bu * bu * C) * r3
    bent[..., 0, 1] = bent[..., 1, 0] = u * (2.0 * bu * C - B) * r2
    bent[..., 0, 2] = (-2.0 * a * A + b * (a * u - 1.0) * B + 2.0 * b * bu * C) * r3
    bent[..., 1, 1] = -2.0 * u * r * C
    bent[..., 1, 2] = -(a * B + 2.0 * b * C) * r2
    bent[..., 2, 2] = 2.0 * a * (a * a * A + a * b * B + b * b * C) * r3
    bent[..., 2, 0], bent[..., 2, 1] = bent[..., 0, 2], bent[..., 1, 2]
    return bent


@dataclass(frozen=True, eq=False)
class Axis:
    """The filter along one axis: P = [[a, b], [b, c]] as (a, b, c)."""

    start: NDArray[np.float64]
    transition: NDArray[np.float64]
    noise: NDArray[np.float64]

    @classmethod
    def of(cls, settings: FilteredTracking) -> Axis:
        """Return the mean over the axes of what the station knows, and of the process noise."""
        model: TargetModel = settings.model
        e = model.step_s
        # Rows are (a, b, c) before, columns after.
        transition = np.array([[1.0, 0.0, 0.0], [2.0 * e, 1.0, 0.0], [e * e, e, 1.0]])
        start = _axis(covariance_of(settings.information))
        return cls(start, transition, _axis(model.process_covariance))

    def predicted(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        """(a, b, c) ``(3, ...)`` a step later, without packets."""
        found = now.copy()
        self.predict(found)
        return found

    def predict(self, now: NDArray[np.float64]) -> None:
        """Predict (a, b, c) ``(3, ...)`` by one step, in place."""
        e = self.transition[2, 1]
        now[0] += (2.0 * e) * now[1] + (e * e) * now[2] + self.noise[0]
        now[1] += e * now[2] + self.noise[1]
        now[2] += self.noise[2]

    def updated(
        self, now: NDArray[np.float64], information: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(a, b, c) after packets with `information` (...)."""
        found = np.empty((3, *np.broadcast_shapes(now.shape[1:], information.shape)))
        found[:] = now.reshape(3, *[1] * (found.ndim - now.ndim), *now.shape[1:])
        self.update(found, information)
        return found

    def update(self, now: NDArray[np.float64], information: NDArray[np.float64]) -> None:
        """Update (a, b, c) ``(3, ...)`` by packets with `information` (...), in place."""
        divisor = 1.0 + now[0] * information
        now[2] -= now[1] * now[1] * information / divisor
        now[:2] /= divisor


def _axis(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(a, b, c) of a covariance (4, 4) of place and velocity, the mean over the axes."""
    blocks = covariance.reshape(2, 2, 2, 2).trace(axis1=1, axis2=3) / 2.0
    return np.array([blocks[0, 0], blocks[0, 1], blocks[1, 1]])
