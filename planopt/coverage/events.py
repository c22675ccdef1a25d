"""Events in a region: the network's estimates of them, and where agents respond to them.

Each event has a signal of its own kind, so that signals of several events do not mix. An event is
detected when an agent reads more than noise, and gone when nobody has for some steps.
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
    joined,
    locate_event,
    measure,
    pooled,
    single_readings,
)
from planopt.coverage.voronoi import ConvexRegion

LOOSE = 0.02
"""Bodies that crowd around an event keep this share of their radius more apart than they must."""


def ring_angles(count: int) -> NDArray[np.float64]:
    """Return the angles ``(count,)`` in rad at which agents have most information on an event.

    Equal angles give the same information in all directions; two agents stand 90 degrees apart,
    since opposite each other they would measure along one direction only.
    """
    turn = 0.5 * np.pi if count == 2 else 2.0 * np.pi / count
    return turn * np.arange(count, dtype=np.float64)


def ring_places(
    agents_m: NDArray[np.float64], event_m: NDArray[np.float64], radius_m: float
) -> NDArray[np.float64]:
    """Return a position on the ring for each agent, in their order around the event.

    The ring is turned so that the sum of squared angles by which agents have to turn is least.
    """
    # Shapes: agents_m (k, 2); event_m (2,).
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
    """Return a position for each agent of a team of bodies that crowds around an event.

    Positions are those of a hexagonal lattice that are nearest to the event, which is at a node, in
    the middle of two or of three, whichever leaves the farthest one nearest. The assignment has the
    least sum of squared distances, so that agents that block each other swap positions.
    """
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

    They stand on a ring around it or, without a radius, at it; bodies crowd around it.
    """
    if stand_off_m is not None:
        return ring_places(agents_m, event_m, stand_off_m)
    if body_radius_m > 0.0:
        return packed_places(agents_m, event_m, body_radius_m)
    return np.repeat(event_m[None], len(agents_m), axis=0)


GRID_READINGS = 150
"""With more readings the search starts from the last estimate alone."""


@dataclass(frozen=True)
class Event:
    """An event in the region."""

    name: str
    place_m: tuple[float, float]  # Position where it appears
    appears_s: float = 0.0
    ends_s: float = math.inf  # It is there up to before this time
    velocity_m_s: tuple[float, float] = (0.0, 0.0)

    def place_at(self, time_s: float) -> NDArray[np.float64]:
        """Return its position at a time; (2,)."""
        moved_s = max(time_s - self.appears_s, 0.0)
        return np.array(self.place_m) + moved_s * np.array(self.velocity_m_s)

    def is_there(self, time_s: float) -> bool:
        """Return whether it has appeared and not ended."""
        return self.appears_s <= time_s < self.ends_s


@dataclass(frozen=True)
class Sensing:
    """The sensor of events, and the rules of detection."""

    sensor: EventSensor
    strength_known: bool = True  # Whether agents know K; if not, they estimate it as well
    # A reading of more standard deviations of the noise than this detects an event
    detection_std: float = 5.0
    silent_steps: int = 3  # An event is gone when nobody has read so much for so many steps
    memory_s: float | None = None  # Older readings are dropped; needed where events move
    # Prior standard deviation of each component of events' velocities; None if all events stand
    speed_std_m_s: float | None = None


@dataclass(frozen=True, eq=False)
class Watch:
    """The network's knowledge of one event."""

    logs: tuple[tuple[float, Readings], ...] = ()  # Readings with the time they were taken at
    estimate: EventEstimate | None = None  # None while it is not detected
    silent: int = 0  # Number of the last steps in which nobody has read it

    @property
    def is_known(self) -> bool:
        """Return whether the network believes that the event is there."""
        return self.estimate is not None

    @property
    def place_m(self) -> NDArray[np.float64]:
        """Return the estimated position (2,); NaN while it is not detected."""
        return np.full(2, math.nan) if self.estimate is None else self.estimate.position_m

    @property
    def velocity_m_s(self) -> NDArray[np.float64]:
        """Return the estimated velocity (2,); zero while it is not detected, or if events stand."""
        return np.zeros(2) if self.estimate is None else self.estimate.velocity_m_s

    @property
    def std_m(self) -> float:
        """Return the root of the trace of the estimate's covariance; NaN while it is not detected.

        A rival position that may be the right one as well counts as a deviation of its distance.
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
    every, drift = [log for _, log in logs], None
    if sensing.speed_std_m_s is None:
        readings = pooled(every)
    else:
        # Readings of one position at several times differ for an event that moves.
        readings = joined(every)
        ages_s = np.concatenate([np.full(len(log.signal), time_s - then) for then, log in logs])
        guess = np.zeros(2) if known is None else known.velocity_m_s
        drift = Drift(ages_s, sensing.speed_std_m_s, guess)
    near = None
    if known is not None and len(readings.signal) > GRID_READINGS:
        near = np.concatenate((known.position_m[None], known.rivals_m))
    estimate = locate_event(
        sensing.sensor,
        readings,
        hull,
        strength_known=sensing.strength_known,
        near_m=near,
        drift=drift,
    )
    # Repeated readings are kept as their mean.
    kept = logs if sensing.memory_s is not None else ((time_s, readings),)
    return Watch(kept, estimate, silent)
