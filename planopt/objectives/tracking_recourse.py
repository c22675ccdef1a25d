"""Tracking with recourse: a robot tries a place, and goes elsewhere if it has no connection there.

A path is taken for a try of the place where it ends. If a packet arrives from there, later ones do
too, for multipath stays what it is; if not, the robot goes to another place: at every later step it
may be at any *retreat* that it comes to in time, a place that is known to be connected, or one that
the target is expected at, with the chance of connection there (equation 4.22). After a try that
succeeds it stays for some steps, and may then be at a retreat too, for the target moves on.

So a step out of what is known to be covered costs little where the way back is short, and may bring
a place that is connected from then on. Forms that take a path for driven to its end whatever comes
of it see the loss alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.measuring import SAME_PLACE_M
from planopt.objectives.station_filter import FilteredTracking, left
from planopt.targets.sensor import sensing_information

RECOURSE_STEPS = 20
"""Steps beyond the horizon that a try is valued over."""

STAYED_STEPS = 10
"""Steps of a plan at most that who stands, or has tried with success, is taken for staying."""

MOST_CONNECTED = 80
"""Of the places known to be connected so many are retreats, those that sense the target best."""

WHOLE_STEPS = 1e-9
"""A distance that is longer than whole steps by less than this share of one takes no further."""


@dataclass(frozen=True, eq=False)
class Retreats:
    """Places where a robot may be instead of where its path ends (equation 4.21)."""

    places_m: NDArray[np.float64]  # (m, 2)
    # (m, k) expected information of a packet from there at every step, per m^2
    information: NDArray[np.float64]
    longest_m: float  # Length of the longest step
    connected: int  # So many of the places, the first ones, are known to be connected

    def nearest_connected(
        self, stops_m: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest other place known to be connected, and how many steps it is away.

        ``(c, 2)`` and ``(c,)`` for stops (c, 2); the stop itself, infinitely far, if there is none.
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
        """Return the largest information that can be had at every step, ``(c, k)``."""
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
    told = sensing_information(tracking.sensor, connected_m[:, None], target)
    if len(told) > MOST_CONNECTED:
        kept = np.sort(np.argsort(-told.sum(axis=1), kind="stable")[:MOST_CONNECTED])
        connected_m, told = connected_m[kept], told[kept]
    beside = target_chance[:, None] * sensing_information(tracking.sensor, target[:, None], target)
    return Retreats(
        np.vstack([connected_m, target]), np.vstack([told, beside]), longest_m, len(connected_m)
    )


def recourse_costs(
    ways_m: NDArray[np.float64],  # (c, N, 2)
    chance: NDArray[np.float64],  # (c, N) chance of connection after every step
    retreats: Retreats,
    others: NDArray[np.float64],  # (k,) expected information of the other robots' packets, per m^2
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return what tries of the ends of paths leave of the covariance, m^2; ``(c,)``.

    Equation 4.22 has what they remove: this is less than what is left without them.
    """
    steps, tracking = chance.shape[1], settings.tracking
    arrivals = last_arrivals(ways_m)
    at_stop = np.arange(len(tracking.target_m)) >= arrivals[:, None]
    told = np.zeros(at_stop.shape)
    told[:, :steps] = chance * sensing_information(
        tracking.sensor, ways_m, tracking.target_m[:steps]
    )
    ends = np.where(at_stop, at_ends(ways_m, arrivals, retreats, settings), told)
    # The filter of a coordinate is told half of the information of a packet.
    costs = left(0.5 * (ends + others), settings)
    tried = chance[:, -1]
    return tried * costs[0] + (1.0 - tried) * costs[1]


def last_arrivals(ways_m: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the step, from 0 on, at whose end paths (c, N, 2) come to where they end; ``(c,)``."""
    count, steps, _ = ways_m.shape
    moving = np.linalg.norm(ways_m - ways_m[:, -1:], axis=2) > SAME_PLACE_M
    return steps - np.argmax(np.hstack([moving[:, ::-1], np.ones((count, 1), bool)]), axis=1)


def stayed_steps(ways_m: NDArray[np.float64]) -> int:
    """Return M of equation 4.21, for how many steps of paths (c, N, 2) ends are stayed at."""
    return min(ways_m.shape[1], STAYED_STEPS)


def at_ends(
    ways_m: NDArray[np.float64],  # (c, N, 2)
    arrivals: NDArray[np.intp],
    retreats: Retreats,
    settings: FilteredTracking,
) -> NDArray[np.float64]:
    """Return s_k and e_k of equation 4.21, from the ends of paths on; ``(2, c, k)``.

    In the first `STAYED_STEPS` steps a try that succeeds is stayed at, and a path that ends with
    its first step tries nothing. Otherwise a robot that stands would be worth as much as one that
    drives: the model lets it leave at any step, without the obstacles and robots that real paths
    keep from.
    """
    tracking, stops = settings.tracking, ways_m[:, -1]
    staying = sensing_information(tracking.sensor, stops[:, None], tracking.target_m)
    later = np.arange(len(tracking.target_m)) >= stayed_steps(ways_m)
    failed = np.where(later | (arrivals > 0)[:, None], retreats.best(stops, arrivals), 0.0)
    return np.stack([np.where(later, np.maximum(staying, failed), staying), failed])
