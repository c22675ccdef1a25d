"""Events in a region: signals, rules of detection, and the positions of responding agents."""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import linear_sum_assignment

from planopt.arrays import Floats, Indices
from planopt.coverage.geodesic import Ground
from planopt.coverage.localisation import SINGULAR, EventSensor, measure

BEARINGS = 72  # Number of candidate bearings on a partly blocked ring
EXCHANGES = 20  # Maximum number of rounds in which every bearing is exchanged
LOOSE = 0.02  # Extra separation of bodies packed around an event, as a share of the minimum


def ring_angles(count: int) -> Floats:
    """Return the most informative bearings (count,) in rad of agents around an event."""
    # Opposite agents would measure along one direction only.
    turn = 0.5 * np.pi if count == 2 else 2.0 * np.pi / count
    return turn * np.arange(count, dtype=np.float64)


def ring_places(agents_m: Floats, event_m: Floats, radius_m: float) -> Floats:
    """Return a position (k, 2) on the ring per agent, in the agents' order around the event."""
    # Shapes: agents_m (k, 2); event_m (2,).
    offset = agents_m - event_m
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(angle, kind="stable")
    slots = ring_angles(len(agents_m))
    best, least = slots, np.inf
    for first in range(len(slots)):
        # On an uneven ring (two agents) the wide gap may follow either agent.
        turned = np.roll(slots, first) + np.where(np.arange(len(slots)) < first, -2.0 * np.pi, 0.0)
        shift = float((angle[order] - turned).mean())
        cost = float(((angle[order] - turned - shift) ** 2).sum())
        if cost < least - 1e-12:
            best, least = turned + shift, cost
    at = np.empty(len(slots))
    at[order] = best
    return event_m + radius_m * np.stack((np.cos(at), np.sin(at)), axis=1)


def free_ring_places(
    agents_m: Floats, event_m: Floats, radius_m: float, ground: Ground, strength_known: bool
) -> Floats:
    """Return the most informative positions (k, 2) on the allowed part of a ring.

    Exchanging one bearing at a time minimises the trace of the position covariance; an unknown
    strength is estimated too. If the ring is entirely free, or too short for the agents, the result
    equals :func:`ring_places`.
    """
    count, bearings = len(agents_m), ring_angles(BEARINGS)
    units = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
    free = np.flatnonzero(ground.allows(event_m + radius_m * units))
    if not count <= len(free) < BEARINGS:
        return ring_places(agents_m, event_m, radius_m)
    # Rows are derivatives of a reading; position and strength are scaled to equal slopes.
    rows = units if strength_known else np.column_stack((units, np.ones(BEARINGS)))
    prior = SINGULAR * np.eye(rows.shape[1])  # Keeps the matrices of too few agents invertible
    each = rows[:, :, None] * rows[:, None, :]
    chosen = free[np.linspace(0, len(free) - 1, count).round().astype(np.intp)]
    best = np.inf
    for _ in range(EXCHANGES):
        for slot in range(count):
            rest = chosen[np.arange(count) != slot]
            others, left = each[rest].sum(axis=0), free[~np.isin(free, rest)]
            chosen[slot] = left[_errors(prior + others + each[left]).argmin()]
        value = float(_errors(prior + each[chosen].sum(axis=0)))
        if value >= best * (1.0 - 1e-9):
            break
        best = value
    return _nearest_slots(agents_m, event_m + radius_m * units[chosen])


def _errors(information: Floats) -> Floats:
    """Return the traces (...) of position covariances, given information matrices (..., d, d)."""
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return np.asarray(covariance[..., 0, 0] + covariance[..., 1, 1], dtype=np.float64)


def _nearest_slots(agents_m: Floats, places_m: Floats) -> Floats:
    """Return the positions (k, 2) in the order of the agents that are matched to them."""
    squares = ((agents_m[:, None] - places_m) ** 2).sum(axis=2)
    return places_m[cast("Indices", linear_sum_assignment(squares)[1])]


def packed_places(agents_m: Floats, event_m: Floats, body_radius_m: float) -> Floats:
    """Return densely packed positions (k, 2) around an event, one for each agent."""
    # Positions are the nodes of a hexagonal lattice nearest to the event. The event is at a node or
    # midway between two or three nodes, whichever minimises the largest distance. The assignment
    # minimises the sum of squared distances, so agents that block each other swap positions.
    # Shapes: agents_m (k, 2); event_m (2,).
    count, side = len(agents_m), 2.0 * (1.0 + LOOSE) * body_radius_m
    shells = np.arange(-count, count + 1)
    steps = np.stack(np.meshgrid(shells, shells), axis=-1).reshape(-1, 2)
    lattice = side * steps @ np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    middles = side * np.array([[0.0, 0.0], [0.5, 0.0], [0.5, np.sqrt(0.75) / 3.0]])
    away = np.linalg.norm(lattice - middles[:, None], axis=2)
    order = np.argsort(away, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(away, order, axis=1)
    best = min(range(3), key=lambda one: (round(float(kept[one, -1] / side), 9), kept[one].sum()))
    places = event_m + lattice[order[best]] - middles[best]
    return _nearest_slots(agents_m, places)


@dataclass(frozen=True)
class Event:
    """Event in the region, static or moving at a constant velocity."""

    name: str
    place_m: tuple[float, float]  # Position at the time of appearance
    appears_s: float = 0.0
    ends_s: float = math.inf  # End of the event; it is active for appears_s <= time < ends_s
    velocity_m_s: tuple[float, float] = (0.0, 0.0)

    def place_at(self, time_s: float) -> Floats:
        """Return the event's position at a time as an array (2,)."""
        moved_s = max(time_s - self.appears_s, 0.0)
        return np.array(self.place_m) + moved_s * np.array(self.velocity_m_s)

    def is_there(self, time_s: float) -> bool:
        """Return True if the event is active at a time."""
        return self.appears_s <= time_s < self.ends_s


@dataclass(frozen=True)
class Sensing:
    """Event sensor and detection rules."""

    sensor: EventSensor
    strength_known: bool = True  # Whether agents know K; otherwise they estimate it as well
    detection_std: float = 5.0  # Detection threshold in standard deviations of the noise
    silent_steps: int = 3  # Number of steps without detection after which an event has ended
    memory_s: float | None = None  # Age limit of readings; required for moving events
    # Prior standard deviation of each velocity component of events; None for static events
    speed_std_m_s: float | None = None


def signals(
    event: Event, sensing: Sensing, agents_m: Floats, time_s: float, generator: np.random.Generator
) -> Floats:
    """Draw readings of an event by agents ``(n, 2)``; pure noise if the event is inactive."""
    if event.is_there(time_s):
        return measure(sensing.sensor, agents_m, event.place_at(time_s), generator)
    return sensing.sensor.noise_std * generator.standard_normal(len(agents_m))
