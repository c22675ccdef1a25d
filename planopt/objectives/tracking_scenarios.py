"""Tracking over drawn channels: the covariance that packets remove, whose losses belong together.

Powers along the paths of all robots are drawn from their joint law, always with the same numbers.
In each draw a packet of stage k counts with the probability

    p = Phi((m_k + rho z_k) / tau),    tau^2 = 1 - rho^2,

with m_k the score of the predicted power, z_k its error as drawn, in standard deviations, and rho
close to one: each draw is smooth in the path, and the probability of each packet is exact. What the
station's filter then knows after each step is found in closed form (equation 4.22).

The station's estimate and the sensor are alike along x and y, and so is the process noise: the
filter's covariance is that of one axis, three numbers, for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.joint import joint_prediction
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import score_probability
from planopt.channel.semidefinite import semidefinite_factor
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.local_channel import factored_near
from planopt.objectives.stage_chain import chained
from planopt.objectives.tracking_filter import Criterion, FilteredTracking
from planopt.targets.information_filter import TargetModel, covariance_of
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import sensing_derivatives, sensing_information

DRAWS, SOLVER_DRAWS = 128, 32
"""Channels drawn for a value, and the first of them that a solver looks at."""

SEED = 0
"""Of all draws: the same numbers for every path, so that paths are compared by the same luck."""

RHO2 = 0.9
"""Share of the variance of a predicted power that is drawn; the rest smooths each draw."""

Stations = Sequence[tuple[ChannelPosterior, float]]
"""The channel of each station, and the power from which on it is connected."""


def extended(settings: FilteredTracking, beyond: int) -> FilteredTracking:
    """Return the settings with `beyond` more steps, the target at its last velocity.

    Nothing is added to a single step, which has no velocity.
    """
    tracking = settings.tracking
    if not beyond or len(tracking.weight) == 1:
        return settings
    move = tracking.target_m[-1] - tracking.target_m[-2]
    ahead = tracking.target_m[-1] + np.arange(1, beyond + 1)[:, None] * move
    weight = np.concatenate([tracking.weight, np.full(beyond, tracking.weight[-1])])
    more = replace(tracking, target_m=np.vstack([tracking.target_m, ahead]), weight=weight)
    return replace(settings, tracking=more)


def scenario_gain(
    stations: Stations,
    paths_m: Sequence[NDArray[np.float64]],
    settings: FilteredTracking,
) -> float:
    """Return sum_k w_k (f(P_k) without packets - E f(P_k)) of the position (equation 4.22).

    f is the criterion of `settings`: the trace in m^2 unless that says otherwise.

    A function of the set of paths: their order does not matter.

    Parameters
    ----------
    stations
        A packet arrives where the power of any reaches its threshold.
    paths_m
        ``(h, 2)`` each, of the robots.
    settings
        The target for h steps or more: for these every robot stands at the end of its path.
    """
    received = received_from(stations, paths_m, drawn_errors(stations, paths_m), settings)
    return float(removed(received, settings))


def scenario_gains(
    scores: NDArray[np.float64],
    covariance_db2: NDArray[np.float64],
    ways_m: NDArray[np.float64],
    others: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """:func:`scenario_gain` of many paths of one robot, for ranking them; ``(c,)``.

    The errors of its own predictions count as independent of those along the others' paths.

    Parameters
    ----------
    scores
        ``(c, h)`` of the predicted powers that connectivity rests on.
    covariance_db2
        ``(c, h, h)`` of these powers.
    ways_m
        ``(c, h, 2)``.
    others
        ``(draws, k)`` information of the packets of other robots (:func:`received_from`).
    settings
        As there.
    """
    deviation = np.sqrt(np.diagonal(covariance_db2, axis1=1, axis2=2))
    shape = deviation[:, :, None] * deviation[:, None]
    factor = np.linalg.cholesky(covariance_db2 / shape + 1e-9 * np.eye(scores.shape[1]))
    numbers = _numbers(0, scores.shape[1])[: len(others)]
    errors = numbers @ factor.transpose(0, 2, 1)
    chance = score_probability(_smoothed(scores[:, None], errors))
    stage = _stages(scores.shape[1], settings)
    sensing = _sensing(ways_m[:, stage], settings)
    return removed(others + 0.5 * chance[..., stage] * sensing[:, None], settings)


def received_from(
    stations: Stations,
    paths_m: Sequence[NDArray[np.float64]],
    errors: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Information per axis from the packets of robots in each draw, per m^2; ``(draws, k)``.

    Parameters
    ----------
    stations, paths_m, settings
        As :func:`scenario_gain`.
    errors
        Of :func:`drawn_errors`, or of the first draws alone.
    """
    lost = np.ones_like(errors[0])
    received = np.zeros((errors.shape[2], len(settings.tracking.weight)))
    for (posterior, threshold), error in zip(stations, errors, strict=True):
        for number, path in enumerate(paths_m):
            power = factored_near(posterior, path).predict(path)
            scores = (power.mean_db - threshold) / power.deviation_db
            lost[number] *= score_probability(-_smoothed(scores, error[number]))
    for path, each in zip(paths_m, lost, strict=True):
        stage = _stages(len(path), settings)
        received += 0.5 * (1.0 - each)[:, stage] * _sensing(path[stage], settings)
    return received


def drawn_errors(stations: Stations, paths_m: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Draw the errors of predicted powers along paths, ``(stations, paths, draws, h)``.

    In standard deviations. Of the same set of paths, in whatever order, the same numbers.
    """
    if not paths_m:
        return np.zeros((len(stations), 0, DRAWS, 0))
    order = sorted(range(len(paths_m)), key=lambda number: paths_m[number].tobytes())
    places = np.concatenate([paths_m[number] for number in order])
    found = np.empty((len(stations), len(paths_m), DRAWS, len(paths_m[0])))
    for station, (posterior, _) in enumerate(stations):
        joint = joint_prediction(factored_near(posterior, places), places)
        deviation = joint.deviation_db
        factor = semidefinite_factor(joint.covariance_db2 / np.outer(deviation, deviation))
        errors = _numbers(station, len(places)) @ factor.T
        found[station, order] = errors.reshape(DRAWS, len(order), -1).transpose(1, 0, 2)
    return found


def scenario_derivatives(
    scores: Sequence[Derivatives],
    errors: NDArray[np.float64],
    others: NDArray[np.float64],
    path_m: NDArray[np.float64],
    settings: FilteredTracking,
) -> PathDerivatives:
    """:func:`scenario_gain` of one robot's path with derivatives, over the draws given.

    Parameters
    ----------
    scores
        Of each station's predicted power at the h places, with derivatives by the place.
    errors
        ``(stations, draws, h)`` as drawn along the path that the solver began from: they stay with
        their stage as it moves.
    others
        ``(draws, k)`` information of the packets of other robots.
    path_m
        ``(h, 2)``.
    settings
        As there.
    """
    steps, draws = len(path_m), errors.shape[1]
    stage = _stages(steps, settings)
    sensing = sensing_derivatives(
        settings.tracking.sensor, path_m[stage], settings.tracking.target_m
    )
    width = np.sqrt(1.0 - RHO2)
    scaled = [_smoothed(score.value, error) for score, error in zip(scores, errors, strict=True)]
    lost = np.array([score_probability(-each) for each in scaled])
    density = np.exp(-0.5 * np.square(scaled)) / (np.sqrt(2.0 * np.pi) * width)
    # Slopes and bends of 1 - product of the stations' losses by each score.
    without = np.array([np.prod(np.delete(lost, i, axis=0), axis=0) for i in range(len(lost))])
    slopes = (density * without)[..., stage]
    bends = (-density * np.array(scaled) / width * without)[..., stage]
    chance = (1.0 - lost.prod(axis=0))[:, stage]
    half = 0.5 * sensing.value
    value, by, bent = removed_derivatives(others + half * chance, settings)
    inputs = [*(_taken(score, stage) for score in scores), sensing]
    count, numbers = len(inputs), len(stage)
    first = np.empty((count, draws, numbers))
    first[:-1], first[-1] = half * slopes, 0.5 * chance
    hessian = np.einsum("sjk,csj,dsk->jckd", bent, first, first, optimize=True) / draws
    own = np.arange(numbers)
    for i in range(count - 1):
        hessian[own, i, own, i] += (by * half * bends[i]).mean(axis=0)
        crossed = (0.5 * by * slopes[i]).mean(axis=0)
        hessian[own, i, own, -1] += crossed
        hessian[own, -1, own, i] += crossed
        for j in range(i):
            both = np.prod(np.delete(lost, [i, j], axis=0), axis=0) * density[i] * density[j]
            crossed = -(by * half * both[:, stage]).mean(axis=0)
            hessian[own, i, own, j] += crossed
            hessian[own, j, own, i] += crossed
    gradient = (by * first).mean(axis=1).T
    return _folded(chained(value, gradient, hessian, inputs), steps)


def removed(received: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """sum_k w_k (f(P_k) without packets - mean f(P_k)) of the position; ``(...)``.

    Parameters
    ----------
    received
        ``(..., draws, k)`` information per axis that arrives in each draw, per m^2.
    settings
        The target and what is known of it; f is its criterion.
    """
    weight = settings.tracking.weight
    steps = _Axis.of(settings)
    total = np.zeros(received.shape[:-1])
    variance = np.broadcast_to(steps.start.reshape(3, *[1] * total.ndim), (3, *total.shape))
    alone, idle = steps.start, 0.0
    for k in range(len(weight)):
        variance, alone = steps.predicted(variance), steps.predicted(alone)
        variance = steps.updated(variance, received[..., k])
        total += weight[k] * criterion_of(variance[0], settings.criterion)
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
    draws, count = received.shape
    weight, criterion = settings.tracking.weight, settings.criterion
    steps = _Axis.of(settings)
    predicted = np.empty((count, 3, draws))
    known = np.empty((count, draws))
    variance = np.broadcast_to(steps.start[:, None], (3, draws))
    total, idle, alone = np.zeros(draws), 0.0, steps.start
    for k in range(count):
        alone = steps.predicted(alone)
        predicted[k] = steps.predicted(variance)
        variance = steps.updated(predicted[k], received[:, k])
        known[k] = variance[0]
        total += weight[k] * criterion_of(variance[0], criterion)
        idle += weight[k] * float(criterion_of(alone[0], criterion))
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
            hessian[:, : k + 1, : k + 1] += 2.0 * weight[k] * moved[:, :, None] * moved[:, None]
    return idle - float(total.mean()), -by, -hessian


def _slopes(now: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes of (a, b, c) after updates by a, b, c before and the information; (k, draws, 3, 4).

    Parameters
    ----------
    now
        ``(k, 3, draws)`` a, b and c before each update.
    u
        ``(k, draws)`` information of each.
    """
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
    """Second derivatives by (a, b, u) before each update, ``(k, draws, 3, 3)``; c is linear.

    Parameters
    ----------
    after
        ``(k, draws, 3)`` derivatives of the total by a, b and c after each update.
    now, u
        As :func:`_slopes`.
    """
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
class _Axis:
    """The filter along one axis: P = [[a, b], [b, c]] as (a, b, c)."""

    start: NDArray[np.float64]
    transition: NDArray[np.float64]
    noise: NDArray[np.float64]

    @classmethod
    def of(cls, settings: FilteredTracking) -> _Axis:
        """Return the mean over the axes of what the station knows, and of the process noise."""
        model: TargetModel = settings.model
        e = model.step_s
        # Rows are (a, b, c) before, columns after.
        transition = np.array([[1.0, 0.0, 0.0], [2.0 * e, 1.0, 0.0], [e * e, e, 1.0]])
        start = _axis(covariance_of(settings.information))
        return cls(start, transition, _axis(model.process_covariance))

    def predicted(self, now: NDArray[np.float64]) -> NDArray[np.float64]:
        """(a, b, c) ``(3, ...)`` a step later, without packets."""
        e, (a, b, c) = self.transition[2, 1], now
        found = np.empty_like(now)
        found[0] = a + (2.0 * e) * b + (e * e) * c + self.noise[0]
        found[1] = b + e * c + self.noise[1]
        found[2] = c + self.noise[2]
        return found

    def updated(
        self, now: NDArray[np.float64], information: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(a, b, c) after packets with `information` (...)."""
        a, b, c = now[0], now[1], now[2]
        divisor = 1.0 + a * information
        found = np.empty((3, *divisor.shape))
        found[0], found[1], found[2] = a / divisor, b / divisor, c - b * b * information / divisor
        return found


def _axis(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(a, b, c) of a covariance (4, 4) of place and velocity, the mean over the axes."""
    blocks = covariance.reshape(2, 2, 2, 2).trace(axis1=1, axis2=3) / 2.0
    return np.array([blocks[0, 0], blocks[0, 1], blocks[1, 1]])


def _numbers(station: int, count: int) -> NDArray[np.float64]:
    """``(DRAWS, count)`` normal numbers, and the same with the other sign."""
    half = np.random.default_rng([SEED, station]).standard_normal((count, DRAWS // 2)).T
    # Pairs next to each other: the first few draws are as well balanced as all.
    return np.stack([half, -half], axis=1).reshape(DRAWS, count)


def _smoothed(scores: NDArray[np.float64], errors: NDArray[np.float64]) -> NDArray[np.float64]:
    return (scores + np.sqrt(RHO2) * errors) / np.sqrt(1.0 - RHO2)


def _stages(steps: int, settings: FilteredTracking) -> NDArray[np.intp]:
    """The stage of a path that each step of the settings is spent at: beyond it, the last."""
    return np.minimum(np.arange(len(settings.tracking.weight)), steps - 1)


def _sensing(places_m: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    return sensing_information(settings.tracking.sensor, places_m, settings.tracking.target_m)


def _taken(numbers: Derivatives, stage: NDArray[np.intp]) -> Derivatives:
    return Derivatives.of(numbers.rows[stage])


def _folded(found: PathDerivatives, steps: int) -> PathDerivatives:
    """Derivatives by the h places, those of steps beyond added to the last's."""
    count = len(found.gradient) // 2
    starts = np.arange(steps)
    gradient = np.add.reduceat(found.gradient.reshape(count, 2), starts, axis=0)
    hessian = np.add.reduceat(found.hessian.reshape(count, 2, count, 2), starts, axis=0)
    hessian = np.add.reduceat(hessian, starts, axis=2)
    return PathDerivatives(found.value, gradient.ravel(), hessian.reshape(2 * steps, 2 * steps))
