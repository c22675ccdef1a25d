"""Derivatives of what packets that have estimates remove (equation 4.25), by scores and sensing.

There is a filter for every step k and draw, which runs to step k. All of them go forwards together,
with the tangents of their three numbers by all inputs, and backwards once with adjoints; second
derivatives are one product of matrices. What a robot holds from before the plan becomes known by
one chance L_{1|k}, so that these steps have a single tangent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.axis_filter import Axis, criterion_of
from planopt.objectives.tracking_filter import Criterion, FilteredTracking

Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Losses:
    """Packets of one robot's path in D draws, K steps, M steps before the plan."""

    # (K, M + K, K) of 0 and 1: whose packets tell of a step
    # (:func:`planopt.objectives.tracking_estimates.counting`)
    which: Numbers
    missed: Numbers  # (D, K, M + K) chance that step s is unknown at step k
    # (D, stations, K) r, the derivative of the logarithm of the chance that a packet is lost by the
    # score of its station, and that of r
    slope: Numbers
    bend: Numbers


def estimates_derivatives(
    losses: Losses, others: Numbers, sensing: Numbers, settings: FilteredTracking
) -> tuple[Numbers, Numbers]:
    """Gradient ``(inputs, K)`` and Hessian ``(inputs, K, inputs, K)``: scores, then sensing.

    Of the mean over draws of sum_k w_k (f(P_k) without packets - f(P_k)).
    """
    # Shapes: others (D, K, M + K); sensing (K,).
    held, weight = settings.held, settings.tracking.weight
    if held is None:
        raise AssertionError("packets have measurements")
    most, (draws, stations, count) = held.steps, losses.slope.shape
    each = np.concatenate([held.sent[-1], 0.5 * sensing])[:, None, None]
    # Filters and draws last: (M + K, K, D).
    missed = losses.missed.transpose(2, 1, 0)
    received = others.transpose(2, 1, 0) + each * (1.0 - missed)
    received[:most] += held.known[:, None, None]
    steps = _Filters(received, weight, replace(settings, information=held.information))
    size = stations * count
    slope = losses.slope.transpose(1, 2, 0).reshape(size, 1, draws)
    # Whose packets tell of steps of the plan: (K, size, K, 1).
    asked = np.tile(losses.which[:, most:].transpose(1, 2, 0), (1, stations, 1))[..., None]
    held_tangent, held_bent = _by_held(steps, held.sent[-1])
    chance = missed[most] * asked[0] * slope
    hessian = np.zeros((size + count, size + count))
    hessian[:size, :size] = _summed(held_bent * chance, chance)
    now = np.zeros((3, size + count, count, draws))
    now[:, :size] = held_tangent[:, None] * chance
    along: list[Numbers] = []
    for number, rows in enumerate(steps.rows[most:]):
        now = _ahead(now, steps.step_s)
        told = np.zeros(now.shape[1:])
        unknown = missed[most + number, number:]
        told[:size] = -each[most + number] * unknown * (asked[number, :, number:] * slope)
        told[size + number] = 0.5 * (1.0 - unknown)
        along.append(np.stack([now[0], now[1], told]))
        now = steps.moved(rows, now, told)
        if settings.criterion == "determinant":
            end = now[0, :, 0]
            hessian += 2.0 * weight[number] * end @ end.T
        # The filter of this step is at its end.
        now = now[:, :, 1:]
    a, b, u = np.concatenate(along, axis=2)
    aa, ab, au, bb, bu, uu = steps.bends[:, steps.rows[most].start :]
    hessian += _summed(aa * a + ab * b + au * u, a) + _summed(ab * a + bb * b + bu * u, b)
    hessian += _summed(au * a + bu * b + uu * u, u)
    by = np.zeros((most + count, count, draws))
    for s, rows in enumerate(steps.rows):
        by[s, max(s - most, 0) :] = steps.by[rows]
    gradient = np.zeros((stations + 1, count))
    gradient[-1] = 0.5 * (by * (1.0 - missed)).sum(axis=(1, 2))[most:]
    gradient[:-1] = _by_losses(losses, -by * each * missed, hessian)
    lost = (-0.5 * by * missed)[most:].transpose(2, 1, 0)
    mixed = np.einsum("dks,ksj,dtj->tjs", lost, losses.which[:, most:], losses.slope, optimize=True)
    hessian[:size, size:] += mixed.reshape(size, count)
    hessian[size:, :size] += mixed.reshape(size, count).T
    return -gradient / draws, -hessian.reshape(*gradient.shape, *gradient.shape) / draws


def _by_losses(losses: Losses, lever: Numbers, hessian: Numbers) -> Numbers:
    """Derivative by the scores ``(stations, K)`` for levers; its own derivative added to `hessian`.

    `lever` ``(M + K, K, D)`` is the derivative by the logarithm of the chance L_{s|k}.
    """
    slope, (_, stations, count) = losses.slope, losses.slope.shape
    told_by = losses.which.transpose(1, 0, 2).reshape(-1, count)
    lever = lever.reshape(len(told_by), -1)
    each = (told_by.T @ lever).T[:, None]
    # Two packets of which either would have told of the same steps.
    both = (told_by[:, :, None] * told_by[:, None]).reshape(len(told_by), -1)
    crossed = (both.T @ lever).reshape(count, count, -1)
    for i in range(stations):
        for j in range(stations):
            rows = slice(i * count, (i + 1) * count), slice(j * count, (j + 1) * count)
            hessian[rows] += (crossed * slope[:, i].T[:, None] * slope[:, j].T).sum(axis=2)
    numbers = np.arange(int(stations) * int(count))
    hessian[numbers, numbers] += (each * losses.bend).sum(axis=0).ravel()
    return (each * slope).sum(axis=0)


def _summed(a: Numbers, b: Numbers) -> Numbers:
    """Sum of a_i b_j over filters and draws; ``(i, j)``."""
    return a.reshape(len(a), -1) @ b.reshape(len(b), -1).T


def _ahead(tangent: Numbers, step_s: float) -> Numbers:
    """Tangents of (a, b, c) ``(3, ...)`` a step later, without packets."""
    found = tangent.copy()
    found[1] += step_s * tangent[2]
    found[0] += step_s * (tangent[1] + found[1])
    return found


class _Filters:
    """Updates of all filters, those of a step together, as rows ``(n, D)``."""

    def __init__(self, received: Numbers, weight: Numbers, settings: FilteredTracking) -> None:
        axis, most = Axis.of(settings), len(received) - len(weight)
        self.step_s = float(axis.transition[2, 1])
        first = [max(s - most, 0) for s in range(len(received))]
        ends = np.cumsum([len(weight) - k for k in first])
        self.rows = [slice(end - len(weight) + k, end) for k, end in zip(first, ends, strict=True)]
        u = np.concatenate([each[k:] for k, each in zip(first, received, strict=True)])
        a, b, ended = np.empty_like(u), np.empty_like(u), np.empty(received.shape[1:])
        variance = np.broadcast_to(axis.start.reshape(3, 1, 1), (3, *ended.shape))
        for s, rows in enumerate(self.rows):
            variance = axis.predicted(variance[:, 1:] if s > most else variance)
            a[rows], b[rows] = variance[0], variance[1]
            variance = axis.updated(variance, u[rows])
            ended[first[s]] = variance[0, 0]
        r = 1.0 / (1.0 + a * u)
        self._a, self._b, self._u, self._r = a, b, u, r
        self._ar, self._ur, self._br = a * r, u * r, b * r
        A, B, C = self._adjoints(_slope_of(ended, settings.criterion) * weight[:, None], most)
        r2, bu, ar = r * r, b * u, self._ar
        self.by = -r2 * (A * a * a + B * a * b + C * b * b)
        self.bends = np.stack(
            [
                2.0 * u * r2 * r * (-A + bu * B - bu * bu * C),
                u * r2 * (2.0 * bu * C - B),
                r2 * r * (-2.0 * a * A + b * (a * u - 1.0) * B + 2.0 * b * bu * C),
                -2.0 * u * r * C,
                -r2 * (a * B + 2.0 * b * C),
                2.0 * ar * r2 * (a * a * A + a * b * B + b * b * C),
            ]
        )

    def _adjoints(self, ends: Numbers, most: int) -> Numbers:
        """Derivatives ``(3, n, D)`` of the cost by (a, b, c) after updates; `ends` (K, D) by a."""
        found = np.zeros((3, *self._u.shape))
        e, last, bu = self.step_s, len(self.rows) - 1, self._b * self._u
        for s in range(last, -1, -1):
            rows = self.rows[s]
            if s >= most:
                found[0, rows.start] = ends[s - most]
            if s == last:
                continue
            # From the update of the next step, and the prediction before it.
            ahead = self.rows[s + 1]
            (A, B, C), r, x = found[:, ahead], self._r[ahead], bu[ahead]
            by_a = r * r * (A - x * B + x * x * C)
            by_b = r * (B - 2.0 * x * C) + e * by_a
            going = slice(rows.stop - (ahead.stop - ahead.start), rows.stop)
            found[:, going] = by_a, by_b + e * by_a, C + e * by_b
        return found

    def moved(self, rows: slice, now: Numbers, told: Numbers) -> Numbers:
        """Tangents after updates, of those before (3, ...) and of the information."""
        a, b, c = now
        r, ar, ur, br, own = (
            each[rows] for each in (self._r, self._ar, self._ur, self._br, self._b)
        )
        inner = ur * a + ar * told
        found = np.empty_like(now)
        found[0] = r * a - ar * inner
        found[1] = r * b - br * inner
        found[2] = c - own * (2.0 * ur * b + br * told - own * ur * inner)
        return found


def _slope_of(variance_m2: Numbers, criterion: Criterion) -> Numbers:
    """Derivative of the criterion by the variance of a coordinate."""
    if criterion == "determinant":
        return 2.0 * variance_m2
    return np.full_like(variance_m2, float(criterion_of(np.ones(1), criterion)[0]))


def _by_held(steps: _Filters, sent: Numbers) -> tuple[Numbers, Numbers]:
    """Tangents ``(3, K, D)`` of (a, b, c) by L_{1|k}, and the second derivative of the cost.

    Zero where nothing is held.
    """
    shape = steps.by[steps.rows[len(sent)]].shape
    tangent, bent = np.zeros((3, *shape)), np.zeros(shape)
    for rows, each in zip(steps.rows, sent, strict=False):
        now, told = _ahead(tangent, steps.step_s), np.full(shape, -each)
        aa, ab, au, bb, bu, uu = steps.bends[:, rows]
        a, b, _ = now
        bent += a * (aa * a + 2.0 * (ab * b + au * told))
        bent += bb * b * b + uu * told * told + 2.0 * bu * b * told
        tangent = steps.moved(rows, now, told)
    return tangent, bent
