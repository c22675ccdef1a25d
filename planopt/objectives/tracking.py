"""Tracking: settings of a target and its sensor, the station's filter, and plans with recourse.

The first estimate, the sensor and the process noise are alike along x and y, so that the covariance
of one axis, three numbers, describes both.

With recourse, the end of a path is probed, and left if it has no connection. If a packet arrives
from there, later ones do too, because multipath does not change; if not, the robot goes to another
place: at every later step it may be at any *retreat* that it reaches in time, a place that is known
to be connected, or one that the target is expected at, with the probability of connection there
(equation 4.22). After a successful probe it stays for some steps, and may then be at a retreat too,
because the target moves on. So a step out of the known coverage costs little if the way back is
short, and may find a place that is connected from then on.

If packets have estimates, a failed probe loses nothing but time: once the robot is back at a
place that is known to be connected, its packet contains all that it measured on the way (equation
4.23). What counts is how long the station goes without. Because a robot that is back may leave
again, later steps are discounted; otherwise the one return that is valued would be put off step by
step, to bring fresher measurements for all steps thereafter.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import require_finite, require_places
from planopt.objectives.measuring import SAME_PLACE_M
from planopt.plain_values import require_weights
from planopt.targets.information_filter import TargetModel, covariance_of, require_covariance
from planopt.targets.sensor import Sensor, sensing_information

Criterion = Literal["trace", "determinant", "norm"]
"""Criteria of the covariance of the target's position: trace (m^2), determinant (m^4), largest
eigenvalue (m^2)."""


@dataclass(frozen=True, eq=False)
class Tracking:
    """A target to be tracked over the next h steps."""

    threshold_dbm: float  # Upsilon_TH: packets below this power are dropped
    sensor: Sensor  # How well it is sensed
    target_m: NDArray[np.float64]  # (h, 2) p_hat_{t+k|t}, k = 1 .. h.
    # (h,) w_k >= 0 of the steps. Not given: all one.
    weight: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        require_finite(self.threshold_dbm, "threshold_dbm")
        count = len(require_places(self.target_m))
        if self.weight.shape == (0,):
            object.__setattr__(self, "weight", np.ones(count))
        require_weights(self.weight, count)


@dataclass(frozen=True, eq=False)
class Held:
    """The measurements of a robot that the station does not know yet, over the last M steps."""

    # (4, 4) J of the station M steps ago, from when on something is missing
    information: NDArray[np.float64]
    known: NDArray[np.float64]  # (M,) information per axis that the station has, per m^2
    sent: NDArray[np.float64]  # (M,) information per axis that only the robot has

    @property
    def steps(self) -> int:
        """M."""
        return len(self.known)


@dataclass(frozen=True, eq=False)
class FilteredTracking:
    """A target to be tracked, and the station's knowledge of it."""

    tracking: Tracking  # The target and the sensor
    model: TargetModel  # How the target moves
    information: NDArray[np.float64]  # (4, 4) J_{t|t} at the station
    criterion: Criterion = "trace"
    held: Held | None = None  # The robot's unsent measurements, where packets have estimates

    def __post_init__(self) -> None:
        require_covariance(self.information, 4, "information")

    def extended(self, beyond: int) -> FilteredTracking:
        """Return the settings with `beyond` more steps of weight one, at the last velocity.

        A single step has no velocity, and is not extended.
        """
        target = self.tracking.target_m
        if not beyond or len(target) == 1:
            return self
        ahead = target[-1] + np.arange(1, beyond + 1)[:, None] * (target[-1] - target[-2])
        weight = np.append(self.tracking.weight, np.ones(beyond))
        tracking = replace(self.tracking, target_m=np.vstack([target, ahead]), weight=weight)
        return replace(self, tracking=tracking)

    def weighted(self, weight: NDArray[np.float64]) -> FilteredTracking:
        """Return the settings with other weights of the steps."""
        return replace(self, tracking=replace(self.tracking, weight=weight))


def left(received: NDArray[np.float64], settings: FilteredTracking) -> NDArray[np.float64]:
    """Return sum_k w_k f(P_k) of the position for the information of packets per axis; ``(...)``.

    In place, because searches ask for hundreds of paths over all steps.
    """
    # Shapes: received (..., k), in 1 / m^2.
    weight, steps = settings.tracking.weight, Axis.of(settings)
    total = np.zeros(received.shape[:-1])
    variance = np.empty((3, *total.shape))
    variance[:] = steps.start.reshape(3, *[1] * total.ndim)
    for k, each in enumerate(np.moveaxis(received, -1, 0)):
        steps.predict(variance)
        steps.update(variance, each)
        total += weight[k] * criterion_of(variance[0], settings.criterion)
    return total


def criterion_of(variance_m2: NDArray[np.float64], criterion: Criterion) -> NDArray[np.float64]:
    """Return the trace, determinant or norm of a I_2, a the variance of a coordinate; ``(...)``."""
    if criterion == "determinant":
        return np.square(variance_m2)
    return variance_m2 if criterion == "norm" else 2.0 * variance_m2


@dataclass(frozen=True, eq=False)
class Axis:
    """The filter along one axis: P = [[a, b], [b, c]] as (a, b, c)."""

    start: NDArray[np.float64]  # (3,)
    step_s: float
    noise: NDArray[np.float64]  # (3,) process noise of a step

    @classmethod
    def of(cls, settings: FilteredTracking) -> Axis:
        """Return the mean over the axes of the station's covariance and of the process noise."""
        model = settings.model
        start = _axis(covariance_of(settings.information))
        return cls(start, model.step_s, _axis(model.process_covariance))

    def predict(self, now: NDArray[np.float64]) -> None:
        """Predict (a, b, c) ``(3, ...)`` by one step, in place."""
        e = self.step_s
        now[0] += (2.0 * e) * now[1] + (e * e) * now[2] + self.noise[0]
        now[1] += e * now[2] + self.noise[1]
        now[2] += self.noise[2]

    def update(self, now: NDArray[np.float64], information: NDArray[np.float64]) -> None:
        """Update (a, b, c) ``(3, ...)`` by packets with `information` (...), in place."""
        divisor = 1.0 + now[0] * information
        now[2] -= now[1] * now[1] * information / divisor
        now[:2] /= divisor


def _axis(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (a, b, c) of a covariance (4, 4) of place and velocity, the mean over the axes."""
    blocks = covariance.reshape(2, 2, 2, 2).trace(axis1=1, axis2=3) / 2.0
    return np.array([blocks[0, 0], blocks[0, 1], blocks[1, 1]])


RECOURSE_STEPS = 20
"""Steps beyond the horizon over which a probe is valued."""

STAYED_STEPS = 10
"""Maximum number of steps that a stationary robot, or one after a successful probe, stays."""

MOST_CONNECTED = 80
"""Maximum number of places known to be connected that are retreats, those with the best sensing."""

WHOLE_STEPS = 1e-9
"""A distance longer than whole steps by less than this share of one takes no further step."""

DISCOUNT = 0.8
"""Factor of the weight of each step to that of the step before it."""

STEPS_OF_ESTIMATES = 10
"""Steps beyond the horizon over which a probe is valued if packets have estimates."""


@dataclass(frozen=True, eq=False)
class Retreats:
    """Places where a robot may be instead of the end of its path (equation 4.21)."""

    places_m: NDArray[np.float64]  # (m, 2)
    # (m, k) expected information of a packet from there at every step, per m^2
    information: NDArray[np.float64]
    longest_m: float  # Length of the longest step
    connected: int  # So many of the places, the first ones, are known to be connected

    def nearest_connected(
        self, stops_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest other place known to be connected (c, 2), and its distance in steps.

        The stop itself, infinitely far, if there is none.
        """
        if not self.connected:
            return stops_m, np.full(len(stops_m), np.inf)
        places = self.places_m[: self.connected]
        away = np.linalg.norm(stops_m[:, None] - places, axis=2)
        away[away <= SAME_PLACE_M] = np.inf
        nearest = away.argmin(axis=1)
        steps = np.ceil(away.min(axis=1) / self.longest_m - WHOLE_STEPS)
        return np.where(np.isfinite(steps)[:, None], places[nearest], stops_m), steps

    def best(self, stops_m: NDArray[np.float64], arrivals: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the largest information that can be reached at every step, ``(c, k)``."""
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
    connected_m: NDArray[np.float64],  # (n, 2)
    target_chance: NDArray[np.float64],  # (k,)
    settings: FilteredTracking,
    longest_m: float,
) -> Retreats:
    """Return the places known to be connected, and those where the target is expected."""
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
    paths_m: NDArray[np.float64],  # (c, N, 2)
    chance: NDArray[np.float64],  # (c, N) chance of connection after every step
    retreats: Retreats,
    others: NDArray[np.float64],  # (k,) expected information of the other robots' packets, per m^2
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return the expected criterion after probes of the ends of paths (equation 4.22); ``(c,)``."""
    steps, tracking = chance.shape[1], settings.tracking
    arrivals = last_arrivals(paths_m)
    at_stop = np.arange(len(tracking.target_m)) >= arrivals[:, None]
    sent = np.zeros(at_stop.shape)
    sent[:, :steps] = chance * sensing_information(
        tracking.sensor, paths_m, tracking.target_m[:steps]
    )
    ends = np.where(at_stop, at_ends(paths_m, arrivals, retreats, settings), sent)
    # The filter of a coordinate receives half of the information of a packet.
    costs = left(0.5 * (ends + others), settings)
    probed = chance[:, -1]
    return probed * costs[0] + (1.0 - probed) * costs[1]


def last_arrivals(paths_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the step, from 0 on, after which paths (c, N, 2) are at their ends; ``(c,)``."""
    count, steps, _ = paths_m.shape
    moving = np.linalg.norm(paths_m - paths_m[:, -1:], axis=2) > SAME_PLACE_M
    return steps - np.argmax(np.hstack([moving[:, ::-1], np.ones((count, 1), bool)]), axis=1)


def stayed_steps(paths_m: NDArray[np.float64]) -> int:
    """Return M of equation 4.21, the steps for which robots stay at the ends of paths (c, N, 2)."""
    return min(paths_m.shape[1], STAYED_STEPS)


def at_ends(
    paths_m: NDArray[np.float64],  # (c, N, 2)
    arrivals: NDArray[np.intp],
    retreats: Retreats,
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return s_k and e_k of equation 4.21, from the ends of paths on; ``(2, c, k)``.

    In the first `STAYED_STEPS` steps the robot stays after a successful probe, and a path that ends
    with its first step probes nothing. Otherwise a stationary robot would be valued like a moving
    one: the model lets it leave at any step, without obstacles and other robots.
    """
    tracking, stops = settings.tracking, paths_m[:, -1]
    staying = sensing_information(tracking.sensor, stops[:, None], tracking.target_m)
    later = np.arange(len(tracking.target_m)) >= stayed_steps(paths_m)
    failed = np.where(later | (arrivals > 0)[:, None], retreats.best(stops, arrivals), 0.0)
    return np.stack([np.where(later, np.maximum(staying, failed), staying), failed])


def discounted(settings: FilteredTracking) -> FilteredTracking:
    """Return the settings with the weights w_k of steps k = 1, 2, .. times `DISCOUNT`^(k - 1)."""
    weight = settings.tracking.weight
    return settings.weighted(weight * DISCOUNT ** np.arange(len(weight)))


def delayed_costs(
    paths_m: NDArray[np.float64],
    chance: NDArray[np.float64],
    retreats: Retreats,
    others: NDArray[np.float64],
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return :func:`recourse_costs` if packets have estimates (equation 4.23); ``(c,)``."""
    held, tracking = settings.held, settings.tracking
    if held is None:
        raise AssertionError("packets have measurements")
    count, length, total = len(chance), chance.shape[1], len(tracking.target_m)
    arrivals, stops = last_arrivals(paths_m), paths_m[:, -1]
    ends = at_ends(paths_m, arrivals, retreats, settings)
    # A robot that is stationary, or stops with the first step, probes nothing, and stays.
    leaving = np.where(arrivals > 0, arrivals, stayed_steps(paths_m) - 1)
    back_m, home = _return_paths(stops, leaving, retreats, total)
    returning = sensing_information(tracking.sensor, back_m, tracking.target_m)
    sensed = sensing_information(tracking.sensor, paths_m, tracking.target_m[:length])
    stage = np.arange(total)
    # The information in the end: if the probe succeeds, and once the robot is back.
    sent = ends.copy()
    sent[1] = np.where(stage < home[:, None], np.maximum(returning, ends[1]), ends[1])
    on_path = stage[:length] < arrivals[:, None]
    sent[..., :length] = np.where(on_path, sensed, sent[..., :length])
    # The filter of a coordinate receives half of the information of a packet.
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
        failed: NDArray[np.float64] = full[0, 1]
        failed = np.where(k < home, less[0], failed)
        variance: NDArray[np.float64] = probed * full[0, 0] + (1.0 - probed) * failed
        if k < length:
            variance = np.where(on_path[:, k], before[0, k], variance)
        costs += tracking.weight[k] * criterion_of(variance, settings.criterion)
    return costs


def arrival_chance(chance: NDArray[np.float64], held: int) -> NDArray[np.float64]:
    """Return the probability that step s is known at step k, by packets of the path; (N, M + N, c).

    The largest probability of the packets since: because of shadowing they arrive or are lost
    together. Zero for steps after k.
    """
    # Shapes: chance (c, N).
    count, length = chance.shape
    found = np.zeros((length, held + length, count))
    for k in range(length):
        since = np.maximum.accumulate(chance[:, k::-1], axis=1)[:, ::-1].T
        found[k, held : held + k + 1] = since
        found[k, :held] = since[0]
    return found


def _variance_on_path(
    sensed: NDArray[np.float64],  # (c, N) information per axis of each step's measurement, per m^2
    chance: NDArray[np.float64],
    others: NDArray[np.float64],  # (k,) of the others' packets
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return (a, b, c) of the station's filter after each step of the paths; ``(3, N, c)``."""
    held = settings.held
    if held is None:
        raise AssertionError("packets have measurements")
    axis, missing = Axis.of(replace(settings, information=held.information)), held.steps
    known = arrival_chance(chance, missing)
    variance = np.empty((3, chance.shape[1], len(chance)))
    variance[:] = axis.start[:, None, None]
    for s in range(known.shape[1]):
        # Filters of earlier steps are at their end.
        first = max(s - missing, 0)
        now = variance[:, first:]
        axis.predict(now)
        if s < missing:
            axis.update(now, held.known[s] + held.sent[s] * known[:, s])
        else:
            axis.update(now, known[first:, s] * sensed[:, first] + others[first])
    return variance


def _return_paths(
    stops_m: NDArray[np.float64], leaving: NDArray[np.intp], retreats: Retreats, total: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return straight paths to the nearest connected place ``(c, k, 2)``, and the step of arrival.

    Until the end of step `leaving` (c,) a robot stays at its stop. The step is infinite if no such
    place is known.
    """
    home_m, steps = retreats.nearest_connected(stops_m)
    driven = np.maximum(np.arange(total) - leaving[:, None], 0.0)
    share = np.where(np.isfinite(steps)[:, None], driven / np.maximum(steps, 1.0)[:, None], 0.0)
    paths = stops_m[:, None] + np.minimum(share, 1.0)[..., None] * (home_m - stops_m)[:, None]
    return paths, leaving + steps
