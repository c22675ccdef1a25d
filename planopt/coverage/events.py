"""Events in a region, and what a network knows of them: detected, located, gone.

Each event has a signal of its own kind, so that signals of several events do not mix. An event is
detected when an agent reads more than noise, and gone when nobody has for some steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.localisation.estimate import Drift, EventEstimate, locate_events
from planopt.coverage.localisation.readings import (
    Readings,
    pooled,
    single_readings,
)
from planopt.coverage.localisation.sensor import EventSensor, measure
from planopt.coverage.region import ConvexRegion

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
