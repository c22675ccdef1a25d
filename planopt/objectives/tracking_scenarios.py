"""Tracking over drawn channels: the covariance that packets remove, whose losses belong together.

Powers along the paths of all robots are drawn from their joint law, always with the same numbers.
In each draw a packet of stage k counts with the probability

    p = Phi((m_k + rho z_k) / tau),    tau^2 = 1 - rho^2,

with m_k the score of the predicted power, z_k its error as drawn, in standard deviations, and rho
close to one: each draw is smooth in the path, and the probability of each packet is exact. What the
station's filter then knows after each step is found in closed form (equation 4.22).

Packets that have estimates tell of earlier steps too (equation 4.25).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.channel.joint import joint_prediction
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import score_probability
from planopt.channel.semidefinite import semidefinite_factor
from planopt.objectives.axis_filter import removed, removed_derivatives
from planopt.objectives.batch_derivatives import PathDerivatives
from planopt.objectives.estimates_derivatives import Losses, estimates_derivatives
from planopt.objectives.local_channel import factored_near
from planopt.objectives.stage_chain import chained
from planopt.objectives.tracking_estimates import counting, log_lost, missing, told_of
from planopt.objectives.tracking_filter import FilteredTracking
from planopt.targets.rounding import Derivatives
from planopt.targets.sensor import sensing_derivatives, sensing_information

DRAWS, SOLVER_DRAWS, SOLVER_DRAWS_OF_ESTIMATES = 128, 32, 16
"""Channels drawn for a value, and the first of them that a solver looks at: where packets have
estimates, with 16 plans are worth as much as with 32."""

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


def solver_draws(settings: FilteredTracking) -> int:
    """Return how many draws a solver looks at."""
    return SOLVER_DRAWS if settings.held is None else SOLVER_DRAWS_OF_ESTIMATES


def scenario_gain(
    stations: Stations,
    paths_m: Sequence[NDArray[np.float64]],  # (h, 2) each, of the robots
    settings: FilteredTracking,
) -> float:
    """Return sum_k w_k (f(P_k) without packets - E f(P_k)) of the position (equation 4.22).

    f is the criterion of `settings`: the trace in m^2 unless that says otherwise.

    A function of the set of paths: their order does not matter.
    """
    received = received_from(stations, paths_m, drawn_errors(stations, paths_m), settings)
    return float(removed(received, settings))


def scenario_gains(
    scores: NDArray[np.float64],  # (c, h) of the predicted powers that connectivity rests on
    covariance_db2: NDArray[np.float64],  # (c, h, h) of these powers
    ways_m: NDArray[np.float64],  # (c, h, 2)
    others: NDArray[np.float64],  # (draws, k)
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """:func:`scenario_gain` of many paths of one robot, for ranking them; ``(c,)``.

    The errors of its own predictions count as independent of those along the others' paths.
    """
    deviation = np.sqrt(np.diagonal(covariance_db2, axis1=1, axis2=2))
    shape = deviation[:, :, None] * deviation[:, None]
    factor = np.linalg.cholesky(covariance_db2 / shape + 1e-9 * np.eye(scores.shape[1]))
    numbers = _numbers(0, scores.shape[1])[: len(others)]
    errors = numbers @ factor.transpose(0, 2, 1)
    smoothed = _smoothed(scores[:, None], errors)
    stage = _stages(scores.shape[1], settings)
    sensing = _sensing(ways_m[:, stage], settings)
    if settings.held is not None:
        own = _told(log_lost(smoothed), sensing[:, None], settings, -1)
        return removed(others + own, settings)
    chance = score_probability(smoothed)
    return removed(others + 0.5 * chance[..., stage] * sensing[:, None], settings)


def received_from(
    stations: Stations,
    paths_m: Sequence[NDArray[np.float64]],
    errors: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Information per axis from the packets of robots in each draw, per m^2; ``(draws, k)``."""
    if settings.held is not None:
        return _estimates_from(stations, paths_m, errors, settings)
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


def _estimates_from(
    stations: Stations,
    paths_m: Sequence[NDArray[np.float64]],
    errors: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """:func:`received_from` where packets have estimates; ``(draws, k, M + k)``."""
    held, count = settings.held, len(settings.tracking.weight)
    if held is None:
        raise AssertionError("packets have measurements")
    received = np.zeros((errors.shape[2], count, held.steps + count))
    for number, path in enumerate(paths_m):
        lost = np.zeros((errors.shape[2], len(path)))
        for (posterior, threshold), error in zip(stations, errors, strict=True):
            power = factored_near(posterior, path).predict(path)
            scores = (power.mean_db - threshold) / power.deviation_db
            lost += log_lost(_smoothed(scores, error[number]))
        stage = _stages(len(path), settings)
        received += _told(lost, _sensing(path[stage], settings), settings, number)
    return received


def _told(
    lost: NDArray[np.float64],
    sensing: NDArray[np.float64],
    settings: FilteredTracking,
    number: int,
) -> NDArray[np.float64]:
    """u_{s|k} of path number `number` from its logs of losses (..., h) and sensing (..., k)."""
    held = settings.held
    if held is None:
        raise AssertionError("packets have measurements")
    steps = lost.shape[-1]
    which = counting(held.steps, _stages(steps, settings))[..., :steps]
    return told_of(missing(lost, which), sensing, held.sent[number])


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
    errors: NDArray[np.float64],  # (stations, draws, h)
    others: NDArray[np.float64],  # (draws, k) information of the packets of other robots
    path_m: NDArray[np.float64],  # (h, 2)
    settings: FilteredTracking,
) -> PathDerivatives:
    """:func:`scenario_gain` of one robot's path with derivatives, over the draws given."""
    if settings.held is not None:
        return _derivatives_of_estimates(scores, errors, others, path_m, settings)
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


def _derivatives_of_estimates(
    scores: Sequence[Derivatives],
    errors: NDArray[np.float64],
    others: NDArray[np.float64],
    path_m: NDArray[np.float64],
    settings: FilteredTracking,
) -> PathDerivatives:
    """:func:`scenario_derivatives` where packets have estimates; others ``(draws, k, M + k)``."""
    held, stage = settings.held, _stages(len(path_m), settings)
    if held is None:
        raise AssertionError("packets have measurements")
    sensing = sensing_derivatives(
        settings.tracking.sensor, path_m[stage], settings.tracking.target_m
    )
    inputs = [*(_taken(score, stage) for score in scores), sensing]
    width = np.sqrt(1.0 - RHO2)
    smoothed = [_smoothed(score.value, each) for score, each in zip(scores, errors, strict=True)]
    z = np.array(smoothed)[..., stage].transpose(1, 0, 2)
    log = log_lost(z)
    # Slopes of the logarithms by the scores, and their slopes.
    slope = -np.exp(-0.5 * z * z - log) / (np.sqrt(2.0 * np.pi) * width)
    which = counting(held.steps, stage)
    missed = missing(log.sum(axis=1), which)
    received = others + told_of(missed, sensing.value, held.sent[-1])
    losses = Losses(which, missed, slope, -z / width * slope - slope * slope)
    gradient, hessian = estimates_derivatives(losses, others, sensing.value, settings)
    value = float(removed(received, settings))
    found = chained(value, gradient.T, hessian.transpose(1, 0, 3, 2), inputs)
    return _folded(found, len(path_m))


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
