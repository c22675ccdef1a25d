"""Events in a region: what a network knows of them, and where agents respond to them.

Each event has a signal of its own kind, so that signals of several events do not mix. An event is
detected when an agent reads more than noise, and gone when nobody has for some steps. A reading
informs about the event along the line to it, in proportion to the squared slope of the signal,
which is zero at the event itself: responding agents may stand on a ring around it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment  # pyright: ignore[reportUnknownVariableType]

from planopt.coverage.localisation import (
    Drift,
    EventEstimate,
    EventSensor,
    Readings,
    locate_events,
    measure,
    pooled,
    single_readings,
)
from planopt.coverage.region import ConvexRegion, positive
from planopt.errors import InputError

LOOSE = 0.02
"""Bodies that crowd around an event keep this share of their radius more apart than they must."""


def fisher_information(
    sensor: EventSensor,
    positions_m: NDArray[np.float64],  # (k, 2) where agents measure
    event_m: NDArray[np.float64],  # (2,) where the event is
    counts: NDArray[np.float64] | None = None,  # (k,) how often they measure there; once if None
) -> NDArray[np.float64]:
    """Return what measurements tell of an event of known strength, ``sum g^2 u u' / sigma^2``."""
    offset = positions_m - event_m
    distance = np.linalg.norm(offset, axis=1)
    unit = offset / np.where(distance > 0.0, distance, 1.0)[:, None]
    gain = sensor.gain(distance) / sensor.noise_std
    weight = gain**2 if counts is None else counts * gain**2
    return (unit * weight[:, None]).T @ unit


def cramer_rao_m2(information: NDArray[np.float64]) -> float:
    """Return the least mean squared distance error of unbiased estimates, trace of the inverse.

    Infinite if the information ``(2, 2)`` is singular.
    """
    determinant = float(np.linalg.det(information))
    trace = float(np.trace(information))
    if not determinant > 1e-14 * trace**2:
        return float("inf")
    return trace / determinant


def ring_angles(count: int) -> NDArray[np.float64]:
    """Return angles ``(count,)`` at which agents tell most of an event, in rad.

    Equal angles, for which the information is the same in all directions; two agents stand 90
    degrees apart, since opposite each other they would tell of one direction only.
    """
    if count < 1:
        raise InputError(f"{count} agents", key="agents")
    turn = 0.5 * np.pi if count == 2 else 2.0 * np.pi / count
    return turn * np.arange(count, dtype=np.float64)


def ring_places(
    agents_m: NDArray[np.float64], event_m: NDArray[np.float64], radius_m: float
) -> NDArray[np.float64]:
    """Return a place on the ring for each agent, in their order around the event.

    The ring is turned so that the sum of squared angles that agents have to turn is least; they do
    not cross each other's way.
    """
    # Shapes: agents_m (k, 2); event_m (2,).
    positive(radius_m, "radius_m")
    offset = agents_m - event_m
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    order = np.argsort(angle, kind="stable")
    slots = ring_angles(len(agents_m))
    best, least = slots, np.inf
    for first in range(len(slots)):
        # The gap of an uneven ring (two agents) may lie between any of them.
        turned = np.roll(slots, first) + np.where(np.arange(len(slots)) < first, -2.0 * np.pi, 0.0)
        shift = float((angle[order] - turned).mean())
        cost = float(((angle[order] - turned - shift) ** 2).sum())
        if cost < least - 1e-12:
            best, least = turned + shift, cost
    at = np.empty(len(slots))
    at[order] = best
    return event_m + radius_m * np.stack((np.cos(at), np.sin(at)), axis=1)


def packed_places(
    agents_m: NDArray[np.float64], event_m: NDArray[np.float64], body_radius_m: float
) -> NDArray[np.float64]:
    """Return a place for each agent of a team of bodies that crowds around an event.

    Places are those of a hexagonal lattice that are nearest to the event, which is at a place, in
    the middle of two or of three, whichever leaves the farthest one nearest. The sum of squared
    distances from agents to places is least, so that agents that block each other swap places.
    """
    # Shapes: agents_m (k, 2); event_m (2,).
    count, side = len(agents_m), 2.0 * (1.0 + LOOSE) * positive(body_radius_m, "body_radius_m")
    shells = np.arange(-count, count + 1)
    steps = np.stack(np.meshgrid(shells, shells), axis=-1).reshape(-1, 2)
    lattice = side * steps @ np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    middles = side * np.array([[0.0, 0.0], [0.5, 0.0], [0.5, np.sqrt(0.75) / 3.0]])
    away = np.linalg.norm(lattice - middles[:, None], axis=2)
    order = np.argsort(away, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(away, order, axis=1)
    best = min(range(3), key=lambda one: (round(float(kept[one, -1] / side), 9), kept[one].sum()))
    places = event_m + lattice[order[best]] - middles[best]
    squares = ((agents_m[:, None] - places) ** 2).sum(axis=2)
    slots = cast("NDArray[np.intp]", linear_sum_assignment(squares)[1])
    return places[slots]


def event_places(
    agents_m: NDArray[np.float64],
    event_m: NDArray[np.float64],
    stand_off_m: float | None,
    body_radius_m: float,
) -> NDArray[np.float64]:
    """Return where agents ``(k, 2)`` that respond to an event should stand.

    They stand on a ring around it or, if none is asked for, at it; bodies crowd around it.
    """
    if stand_off_m is not None:
        return ring_places(agents_m, event_m, stand_off_m)
    if body_radius_m > 0.0:
        return packed_places(agents_m, event_m, body_radius_m)
    return np.repeat(event_m[None], len(agents_m), axis=0)


GRID_READINGS = 150
"""Up to so many readings the whole region is searched; then the last estimate's surroundings."""


@dataclass(frozen=True)
class Event:
    """Something that appears in the region."""

    name: str  # What outputs call it
    place_m: tuple[float, float]  # Where it appears
    # When it appears and ends; it is there from the first up to before the second
    appears_s: float = 0.0
    ends_s: float = math.inf
    velocity_m_s: tuple[float, float] = (0.0, 0.0)  # It moves with this velocity

    def place_at(self, time_s: float) -> NDArray[np.float64]:
        """Return where it is; (2,)."""
        moved_s = max(time_s - self.appears_s, 0.0)
        return np.array(self.place_m) + moved_s * np.array(self.velocity_m_s)

    def is_there(self, time_s: float) -> bool:
        """Return whether it has appeared and not ended."""
        return self.appears_s <= time_s < self.ends_s


@dataclass(frozen=True)
class Sensing:
    """The sensor and rate by which agents measure events."""

    sensor: EventSensor  # The signal of an event and the noise
    strength_known: bool = True  # Whether agents know K; if not, they estimate it as well
    # A reading of more standard deviations of the noise than this says that there is an event
    detection_std: float = 5.0
    silent_steps: int = 3  # An event is gone when nobody has read so much for so many steps
    # Older readings are forgotten; None for none. Needed where events move.
    memory_s: float | None = None
    # Where events may move, the standard deviation of each component of their velocities before
    # anything is read; None where all events are known to stand
    speed_std_m_s: float | None = None


@dataclass(frozen=True, eq=False)
class Watch:
    """The network's knowledge of one event."""

    logs: tuple[tuple[float, Readings], ...] = ()  # Readings with the time they were taken at
    estimate: EventEstimate | None = None  # Where it most likely is; None while it is not detected
    silent: int = 0  # For how many steps nobody has read it

    @property
    def is_known(self) -> bool:
        """Return whether the network believes that the event is there."""
        return self.estimate is not None

    @property
    def place_m(self) -> NDArray[np.float64]:
        """The estimated place (2,); NaN while it is not detected."""
        return np.full(2, math.nan) if self.estimate is None else self.estimate.positions_m[0]

    @property
    def velocity_m_s(self) -> NDArray[np.float64]:
        """The estimated velocity (2,); zero while it is not detected, or if events stand."""
        return np.zeros(2) if self.estimate is None else self.estimate.velocity_m_s

    @property
    def std_m(self) -> float:
        """Root of the trace of the estimate's covariance; NaN while it is not detected.

        A rival place that may be the right one as well counts as a deviation of its distance.
        """
        if self.estimate is None:
            return math.nan
        rivals_m = np.linalg.norm(self.estimate.rivals_m - self.place_m, axis=1)
        spread_m = float(rivals_m.max(initial=0.0))
        return math.hypot(math.sqrt(float(np.trace(self.estimate.covariance_m2))), spread_m)


def signals(
    event: Event,
    sensing: Sensing,
    agents_m: NDArray[np.float64],
    time_s: float,
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw what agents ``(n, 2)`` read in an event's channel; noise alone if it is not there."""
    if event.is_there(time_s):
        return measure(sensing.sensor, agents_m, event.place_at(time_s), generator)
    return sensing.sensor.noise_std * generator.standard_normal(len(agents_m))


def watched(
    watch: Watch,
    sensing: Sensing,
    hull: ConvexRegion,
    agents_m: NDArray[np.float64],
    signal: NDArray[np.float64],
    shared: NDArray[np.bool_],  # (n,) whose readings reach those that estimate
    time_s: float,
) -> Watch:
    """Return what the network knows of an event after the readings of one step."""
    # Shapes: agents_m, signal (n, 2).
    heard = bool((signal > sensing.detection_std * sensing.sensor.noise_std).any())
    silent = 0 if heard else watch.silent + 1
    if not heard and (not watch.is_known or silent >= sensing.silent_steps):
        return Watch()
    logs, known, moves = watch.logs, watch.estimate, sensing.speed_std_m_s is not None
    if heard and shared.any():
        logs = (*logs, (time_s, single_readings(agents_m[shared], signal[shared])))
    elif not moves:
        # A step without the signal, when the event may just have ended, would mislead.
        return replace(watch, silent=silent)
    if sensing.memory_s is not None:
        logs = tuple(each for each in logs if each[0] > time_s - sensing.memory_s)
    if not logs:
        return replace(watch, silent=silent)
    readings, drift = pooled(log for _, log in logs), None
    if sensing.speed_std_m_s is not None:
        # Readings of one place at several times tell different things of an event that moves.
        readings = Readings(
            np.concatenate([log.positions_m for _, log in logs]),
            np.concatenate([log.signal for _, log in logs]),
            np.concatenate([log.counts for _, log in logs]),
        )
        ages_s = np.concatenate([np.full(len(log.signal), time_s - then) for then, log in logs])
        guess = np.zeros(2) if known is None else known.velocity_m_s
        drift = Drift(ages_s, sensing.speed_std_m_s, guess)
    near = None
    if known is not None and len(readings.signal) > GRID_READINGS:
        near = np.concatenate((known.positions_m, known.rivals_m))
    estimate = locate_events(
        sensing.sensor,
        readings,
        hull,
        strength_known=sensing.strength_known,
        near_m=near,
        drift=drift,
    )
    # Readings at the very same places are kept as their mean.
    kept = logs if sensing.memory_s is not None else ((time_s, readings),)
    return Watch(kept, estimate, silent)
