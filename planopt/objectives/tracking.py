"""Target tracking: target and sensor settings, the station's filter, and plans with recourse.

The initial estimate, the sensor and the process noise are isotropic, so the covariance of one axis,
three numbers, describes both. With recourse, the robot probes the end of its path and moves to a
*retreat* if it has no connection (equations 4.22 and 4.23). Later steps are discounted because a
robot that has returned may leave again; otherwise the plan would postpone its return step by step.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.measurements import SAME_PLACE_M
from planopt.channel.parameters import require_finite, require_places
from planopt.parts import require_weights
from planopt.targets.information_filter import (
    Sensor,
    TargetModel,
    covariance_of,
    require_covariance,
    sensing_information,
)

Criterion = Literal["trace", "determinant", "norm"]
"""Criterion of the target's covariance: trace, determinant or largest eigenvalue."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """Tracking problem over the next h steps: predicted target, sensor and step weights."""

    threshold_dbm: float  # Upsilon_TH: packets below this power are dropped
    sensor: Sensor  # Noise model of the measurements
    target_m: Floats  # (h, 2) p_hat_{t+k|t}, k = 1 .. h.
    # (h,) step weights w_k >= 0; all one by default
    weight: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        require_finite(self.threshold_dbm, "threshold_dbm")
        count = len(require_places(self.target_m))
        if self.weight.shape == (0,):
            object.__setattr__(self, "weight", np.ones(count))
        require_weights(self.weight, count)


@dataclass(frozen=True, eq=False)
class Held:
    """Target measurements of one robot in the last M steps that the station lacks."""

    information: Floats  # (4, 4) J of the station M steps ago, before the first unsent measurement
    known: Floats  # (M,) information per axis that the station has, per m^2
    sent: Floats  # (M,) information per axis that only the robot has

    @property
    def steps(self) -> int:
        """Number of steps M."""
        return len(self.known)


@dataclass(frozen=True, eq=False)
class FilteredTracking:
    """Tracking problem together with the state of the station's filter."""

    tracking: Tracking  # Target and sensor
    model: TargetModel  # Motion model of the target
    information: Floats  # (4, 4) J_{t|t} at the station
    criterion: Criterion = "trace"
    held: Held | None = None  # The robot's unsent measurements, if packets contain estimates

    def __post_init__(self) -> None:
        require_covariance(self.information, 4, "information")

    def extended(self, beyond: int) -> FilteredTracking:
        """Return the problem with `beyond` more steps of weight 1 and constant target velocity."""
        target = self.tracking.target_m
        if not beyond or len(target) == 1:
            return self
        ahead = target[-1] + np.arange(1, beyond + 1)[:, None] * (target[-1] - target[-2])
        weight = np.append(self.tracking.weight, np.ones(beyond))
        tracking = replace(self.tracking, target_m=np.vstack([target, ahead]), weight=weight)
        return replace(self, tracking=tracking)

    def weighted(self, weight: Floats) -> FilteredTracking:
        """Return the tracking problem with other step weights."""
        return replace(self, tracking=replace(self.tracking, weight=weight))


def left(received: Floats, settings: FilteredTracking) -> Floats:
    """Return the weighted sum over steps of the covariance criterion after received packets."""
    # The filter runs in place, because searches evaluate hundreds of paths over all steps.
    # Shapes: received (..., k), information of the packets per axis in 1 / m^2.
    weight, steps = settings.tracking.weight, Axis.of(settings)
    total = np.zeros(received.shape[:-1])
    variance = np.empty((3, *total.shape))
    variance[:] = steps.start.reshape(3, *[1] * total.ndim)
    for k, each in enumerate(np.moveaxis(received, -1, 0)):
        steps.predict(variance)
        steps.update(variance, each)
        total += weight[k] * criterion_of(variance[0], settings.criterion)
    return total


def criterion_of(variance_m2: Floats, criterion: Criterion) -> Floats:
    """Return the trace, determinant or norm of an isotropic covariance, from variances (...)."""
    if criterion == "determinant":
        return np.square(variance_m2)
    return variance_m2 if criterion == "norm" else 2.0 * variance_m2


@dataclass(frozen=True, eq=False)
class Axis:
    """Kalman filter of one axis, whose covariance [[a, b], [b, c]] is stored as (a, b, c)."""

    start: Floats  # (3,)
    step_s: float
    noise: Floats  # (3,) process noise per step

    @classmethod
    def of(cls, settings: FilteredTracking) -> Axis:
        """Return the filter with the station's covariance and process noise, averaged over axes."""
        model = settings.model
        start = _axis(covariance_of(settings.information))
        return cls(start, model.step_s, _axis(model.process_covariance))

    def predict(self, now: Floats) -> None:
        """Predict covariances ``(3, ...)`` one step ahead, in place."""
        e = self.step_s
        now[0] += (2.0 * e) * now[1] + (e * e) * now[2] + self.noise[0]
        now[1] += e * now[2] + self.noise[1]
        now[2] += self.noise[2]

    def update(self, now: Floats, information: Floats) -> None:
        """Update covariances ``(3, ...)`` with packets of `information` (...), in place."""
        divisor = 1.0 + now[0] * information
        now[2] -= now[1] * now[1] * information / divisor
        now[:2] /= divisor


def _axis(covariance: Floats) -> Floats:
    """Return entries (3,) of a one-axis covariance: the average over the axes of `covariance`."""
    blocks = covariance.reshape(2, 2, 2, 2).trace(axis1=1, axis2=3) / 2.0
    return np.array([blocks[0, 0], blocks[0, 1], blocks[1, 1]])


RECOURSE_STEPS = 20
"""Number of steps beyond the horizon over which the effect of a probe is evaluated."""
STAYED_STEPS = 10
"""Maximum number of steps that a plan assumes a stationary robot or a successful probe to stay."""
MOST_CONNECTED = 80
"""Maximum number of known connected positions that are alternatives to a path's end."""
WHOLE_STEPS = 1e-9  # Tolerance, as a share of a step, when distances are rounded up to whole steps
DISCOUNT = 0.8  # Discount factor per step if packets contain estimates
STEPS_OF_ESTIMATES = 10  # Number of such steps if packets contain estimates


@dataclass(frozen=True, eq=False)
class Retreats:
    """Positions to which a robot may move after the end of its path (equation 4.21)."""

    places_m: Floats  # (m, 2)
    # (m, k) expected information of a packet from each retreat at each step, per m^2
    information: Floats
    longest_m: float  # Length of the longest step
    connected: int  # Number of known connected retreats; they come first

    def nearest_connected(self, stops_m: Floats) -> tuple[Floats, Floats]:
        """Return the connected positions (c, 2) nearest to stops, and distances in steps."""
        # A stop itself does not count. If there is none, return the stop at infinite distance.
        if not self.connected:
            return stops_m, np.full(len(stops_m), np.inf)
        places = self.places_m[: self.connected]
        away = np.linalg.norm(stops_m[:, None] - places, axis=2)
        away[away <= SAME_PLACE_M] = np.inf
        nearest = away.argmin(axis=1)
        steps = np.ceil(away.min(axis=1) / self.longest_m - WHOLE_STEPS)
        return np.where(np.isfinite(steps)[:, None], places[nearest], stops_m), steps

    def best(self, stops_m: Floats, arrivals: Indices) -> Floats:
        """Return the largest information (c, k) of a packet from a retreat reached by each step."""
        # Shapes: stops_m (c, 2); arrivals (c,).
        found = np.zeros((len(stops_m), self.information.shape[1]))
        away = np.linalg.norm(stops_m[:, None] - self.places_m, axis=2)
        away[away <= SAME_PLACE_M] = np.inf
        steps = arrivals[:, None] + np.ceil(away / self.longest_m - WHOLE_STEPS)
        for k in range(found.shape[1]):
            reached = np.where(steps <= k, self.information[:, k], 0.0)
            found[:, k] = reached.max(axis=1, initial=0.0)
        return found


def retreats_of(
    connected_m: Floats, target_chance: Floats, settings: FilteredTracking, longest_m: float
) -> Retreats:
    """Return retreats from a path's end: connected positions and expected target positions."""
    # Shapes: connected_m (n, 2); target_chance (k,).
    tracking = settings.tracking
    target = tracking.target_m
    certain = sensing_information(tracking.sensor, connected_m[:, None], target)
    if len(certain) > MOST_CONNECTED:
        kept = np.sort(np.argsort(-certain.sum(axis=1), kind="stable")[:MOST_CONNECTED])
        connected_m, certain = connected_m[kept], certain[kept]
    near = target_chance[:, None] * sensing_information(tracking.sensor, target[:, None], target)
    return Retreats(
        np.vstack([connected_m, target]), np.vstack([certain, near]), longest_m, len(connected_m)
    )


def recourse_costs(
    paths_m: Floats, chance: Floats, retreats: Retreats, others: Floats, settings: FilteredTracking
) -> Floats:
    """Return the expected costs ``(c,)`` of paths with probed ends (equation 4.22)."""
    # Shapes: paths_m (c, N, 2); chance (c, N), probability of connection after each step; others
    # (k,), expected information of the other robots' packets, per m^2.
    steps, tracking = chance.shape[1], settings.tracking
    arrivals = last_arrivals(paths_m)
    at_stop = np.arange(len(tracking.target_m)) >= arrivals[:, None]
    sent = np.zeros(at_stop.shape)
    sent[:, :steps] = chance * sensing_information(
        tracking.sensor, paths_m, tracking.target_m[:steps]
    )
    ends = np.where(at_stop, at_ends(paths_m, arrivals, retreats, settings), sent)
    # Each axis receives half of a packet's information.
    costs = left(0.5 * (ends + others), settings)
    probed = chance[:, -1]
    return probed * costs[0] + (1.0 - probed) * costs[1]


def last_arrivals(paths_m: Floats) -> Indices:
    """Return the index (c,) of the step that reaches the end of each path (c, N, 2)."""
    count, steps, _ = paths_m.shape
    moving = np.linalg.norm(paths_m - paths_m[:, -1:], axis=2) > SAME_PLACE_M
    return steps - np.argmax(np.hstack([moving[:, ::-1], np.ones((count, 1), bool)]), axis=1)


def stayed_steps(paths_m: Floats) -> int:
    """Return the number of steps that robots stay at path ends (M in equation 4.21)."""
    return min(paths_m.shape[1], STAYED_STEPS)


def at_ends(
    paths_m: Floats, arrivals: Indices, retreats: Retreats, settings: FilteredTracking
) -> Floats:
    """Return the information per step after a successful and a failed probe (equation 4.21)."""
    # Shapes: paths_m (c, N, 2).
    # Shape (2, c, k). After a successful probe the robot stays during the first `STAYED_STEPS`
    # steps. A path that ends with its first step probes nothing. Without these two rules, a robot
    # at rest would score like one that moves, because in the model it may leave at any step.
    tracking, stops = settings.tracking, paths_m[:, -1]
    staying = sensing_information(tracking.sensor, stops[:, None], tracking.target_m)
    later = np.arange(len(tracking.target_m)) >= stayed_steps(paths_m)
    failed = np.where(later | (arrivals > 0)[:, None], retreats.best(stops, arrivals), 0.0)
    return np.stack([np.where(later, np.maximum(staying, failed), staying), failed])


def discounted(settings: FilteredTracking) -> FilteredTracking:
    """Return the problem with the weight of step k = 1, 2, .. multiplied by DISCOUNT^(k - 1)."""
    weight = settings.tracking.weight
    return settings.weighted(weight * DISCOUNT ** np.arange(len(weight)))


def delayed_costs(
    paths_m: Floats, chance: Floats, retreats: Retreats, others: Floats, settings: FilteredTracking
) -> Floats:
    """Return :func:`recourse_costs` ``(c,)`` for packets with estimates (equation 4.23)."""
    held, tracking = settings.held, settings.tracking
    if held is None:
        raise AssertionError("packets have measurements")
    count, length, total = len(chance), chance.shape[1], len(tracking.target_m)
    arrivals, stops = last_arrivals(paths_m), paths_m[:, -1]
    ends = at_ends(paths_m, arrivals, retreats, settings)
    # A robot that is stationary or stops with the first step stays there and does not probe.
    leaving = np.where(arrivals > 0, arrivals, stayed_steps(paths_m) - 1)
    # Straight paths to the nearest connected position; the arrival is infinite if none is known.
    home_m, steps = retreats.nearest_connected(stops)
    driven = np.maximum(np.arange(total) - leaving[:, None], 0.0)
    share = np.where(np.isfinite(steps)[:, None], driven / np.maximum(steps, 1.0)[:, None], 0.0)
    back_m = stops[:, None] + np.minimum(share, 1.0)[..., None] * (home_m - stops)[:, None]
    home = leaving + steps
    returning = sensing_information(tracking.sensor, back_m, tracking.target_m)
    sensed = sensing_information(tracking.sensor, paths_m, tracking.target_m[:length])
    stage = np.arange(total)
    # Final information per step: probe successful (0), robot back after a failed probe (1).
    sent = ends.copy()
    sent[1] = np.where(stage < home[:, None], np.maximum(returning, ends[1]), ends[1])
    on_path = stage[:length] < arrivals[:, None]
    sent[..., :length] = np.where(on_path, sensed, sent[..., :length])
    # Each axis receives half of a packet's information.
    known_then, known_before = 0.5 * (sent + others), 0.5 * (ends[1] + others)
    before = _variance_on_path(0.5 * sensed, chance, 0.5 * others, settings)
    axis, full = Axis.of(settings), np.empty((3, 2, count))
    full[:] = Axis.of(replace(settings, information=held.information)).start[:, None, None]
    less = np.repeat(axis.start[:, None], count, axis=1)
    for known, sent in zip(held.known, held.sent, strict=True):
        axis.predict(full)
        axis.update(full, known + sent)
    costs, probed = np.zeros(count), chance[:, -1]
    for k in range(total):
        if 0 < k < length:
            arrived = arrivals == k
            less[:, arrived] = before[:, k - 1, arrived]
        axis.predict(full)
        axis.update(full, known_then[..., k])
        axis.predict(less)
        axis.update(less, known_before[:, k])
        failed: Floats = full[0, 1]
        failed = np.where(k < home, less[0], failed)
        variance: Floats = probed * full[0, 0] + (1.0 - probed) * failed
        if k < length:
            variance = np.where(on_path[:, k], before[0, k], variance)
        costs += tracking.weight[k] * criterion_of(variance, settings.criterion)
    return costs


def arrival_chance(chance: Floats, held: int) -> Floats:
    """Return probabilities (N, M + N, c) that the station has each measurement by each step."""
    # Correlated shadowing makes packets arrive or fail together. The result is therefore the
    # largest probability of the packets sent from step s to k; it is zero for s > k.
    # Shapes: chance (c, N).
    count, length = chance.shape
    found = np.zeros((length, held + length, count))
    for k in range(length):
        since = np.maximum.accumulate(chance[:, k::-1], axis=1)[:, ::-1].T
        found[k, held : held + k + 1] = since
        found[k, :held] = since[0]
    return found


def _variance_on_path(
    sensed: Floats,  # (c, N) information per axis of each step's measurement, per m^2
    chance: Floats,
    others: Floats,  # (k,) information of the others' packets
    settings: FilteredTracking,
) -> Floats:
    """Return the station's covariance entries ``(3, N, c)`` after each step of each path."""
    held = settings.held
    if held is None:
        raise AssertionError("packets have measurements")
    axis, missing = Axis.of(replace(settings, information=held.information)), held.steps
    known = arrival_chance(chance, missing)
    variance = np.empty((3, chance.shape[1], len(chance)))
    variance[:] = axis.start[:, None, None]
    for s in range(known.shape[1]):
        # Filters of earlier steps have finished.
        first = max(s - missing, 0)
        now = variance[:, first:]
        axis.predict(now)
        if s < missing:
            axis.update(now, held.known[s] + held.sent[s] * known[:, s])
        else:
            axis.update(now, known[first:, s] * sensed[:, first] + others[first])
    return variance
