"""Tries with recourse where packets have estimates: what is sensed out of contact is told later.

A try that fails loses nothing but time: once the robot is back at a place that is known to be
connected, its packet tells all that it has measured on the way, beside the target and on the way
back (equation 4.23). Until then the station knows what packets on the way have told.

What counts is how long the station goes without. A robot that is back may go out again, so that
what it brings serves until it is back the next time, and no longer: later steps are discounted.
Otherwise the one return that is valued would be put off step by step, to bring fresher news for all
steps thereafter.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.station_filter import Axis, FilteredTracking, criterion_of
from planopt.objectives.tracking_recourse import (
    Retreats,
    at_ends,
    last_arrivals,
    stayed_steps,
)
from planopt.targets.sensor import sensing_information

DISCOUNT = 0.8
"""Factor of the weight of each step to that of the step before it."""

STEPS_OF_ESTIMATES = 10
"""Steps beyond the horizon that a try is valued over: later ones hardly count."""


def discounted(settings: FilteredTracking) -> FilteredTracking:
    """Return the settings with the weights w_k of steps k = 1, 2, .. times `DISCOUNT`^(k - 1)."""
    weight = settings.tracking.weight
    return settings.weighted(weight * DISCOUNT ** np.arange(len(weight)))


def told_later_costs(
    ways_m: NDArray[np.float64],
    chance: NDArray[np.float64],
    retreats: Retreats,
    others: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return what tries of the ends of paths leave of the covariance, m^2; ``(c,)``.

    As :func:`planopt.objectives.tracking_recourse.recourse_costs`, by equation 4.23; `settings` say
    what the robot holds.
    """
    held, tracking = settings.held, settings.tracking
    if held is None:
        raise AssertionError("packets have measurements")
    count, length, total = len(chance), chance.shape[1], len(tracking.target_m)
    arrivals, stops = last_arrivals(ways_m), ways_m[:, -1]
    ends = at_ends(ways_m, arrivals, retreats, settings)
    # Who stands, or stops with the first step, tries nothing, and stays for a while.
    leaving = np.where(arrivals > 0, arrivals, stayed_steps(ways_m) - 1)
    back_m, home = _ways_back(stops, leaving, retreats, total)
    returning = sensing_information(tracking.sensor, back_m, tracking.target_m)
    sensed = sensing_information(tracking.sensor, ways_m, tracking.target_m[:length])
    stage = np.arange(total)
    # What is known in the end: if the try succeeds, and once the robot is back.
    told = ends.copy()
    told[1] = np.where(stage < home[:, None], np.maximum(returning, ends[1]), ends[1])
    on_way = stage[:length] < arrivals[:, None]
    told[..., :length] = np.where(on_way, sensed, told[..., :length])
    # The filter of a coordinate is told half of the information of a packet.
    known_then, known_before = 0.5 * (told + others), 0.5 * (ends[1] + others)
    before = _known_on_way(0.5 * sensed, chance, 0.5 * others, settings)
    axis, full = Axis.of(settings), np.empty((3, 2, count))
    full[:] = Axis.of(replace(settings, information=held.information)).start[:, None, None]
    less = np.repeat(axis.start[:, None], count, axis=1)
    for known, sent in zip(held.known, held.sent, strict=True):
        axis.predict(full)
        axis.update(full, known + sent)
    costs, tried = np.zeros(count), chance[:, -1]
    for k in range(total):
        if 0 < k < length:
            arrived = arrivals == k
            less[:, arrived] = before[:, k - 1, arrived]
        axis.predict(full)
        axis.update(full, known_then[..., k])
        axis.predict(less)
        axis.update(less, known_before[:, k])
        failed: NDArray[np.float64] = full[0, 1]
        failed = np.where(k < home, less[0], failed)
        variance: NDArray[np.float64] = tried * full[0, 0] + (1.0 - tried) * failed
        if k < length:
            variance = np.where(on_way[:, k], before[0, k], variance)
        costs += tracking.weight[k] * criterion_of(variance, settings.criterion)
    return costs


def chance_told(chance: NDArray[np.float64], held: int) -> NDArray[np.float64]:
    """Return the chance that step s is known at step k, by packets of the way; (N, M + N, c).

    The largest chance of the packets since: as shadowing has it, they arrive or are lost together.
    Zero for steps after k.
    """
    # Shapes: chance (c, N).
    count, length = chance.shape
    found = np.zeros((length, held + length, count))
    for k in range(length):
        since = np.maximum.accumulate(chance[:, k::-1], axis=1)[:, ::-1].T
        found[k, held : held + k + 1] = since
        found[k, :held] = since[0]
    return found


def _known_on_way(
    sensed: NDArray[np.float64],  # (c, N) information per axis of each step's measurement, per m^2
    chance: NDArray[np.float64],
    others: NDArray[np.float64],  # (k,) of the others' packets
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """(a, b, c) of the station's filter after each step of the ways; ``(3, N, c)``."""
    held = settings.held
    if held is None:
        raise AssertionError("packets have measurements")
    axis, told = Axis.of(replace(settings, information=held.information)), held.steps
    known = chance_told(chance, told)
    variance = np.empty((3, chance.shape[1], len(chance)))
    variance[:] = axis.start[:, None, None]
    for s in range(known.shape[1]):
        # Filters of earlier steps are at their end.
        first = max(s - told, 0)
        now = variance[:, first:]
        axis.predict(now)
        if s < told:
            axis.update(now, held.known[s] + held.sent[s] * known[:, s])
        else:
            axis.update(now, known[first:, s] * sensed[:, first] + others[first])
    return variance


def _ways_back(
    stops_m: NDArray[np.float64], leaving: NDArray[np.intp], retreats: Retreats, total: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Straight ways to the nearest place known to be connected ``(c, k, 2)``, and the step of it.

    Until the end of step `leaving` (c,) a robot is taken for standing at its stop. The step is
    infinite where no such place is known.
    """
    home_m, steps = retreats.nearest_connected(stops_m)
    driven = np.maximum(np.arange(total) - leaving[:, None], 0.0)
    share = np.where(np.isfinite(steps)[:, None], driven / np.maximum(steps, 1.0)[:, None], 0.0)
    ways = stops_m[:, None] + np.minimum(share, 1.0)[..., None] * (home_m - stops_m)[:, None]
    return ways, leaving + steps
