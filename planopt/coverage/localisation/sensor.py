"""An agent's measurement of an event: a signal that falls with distance, plus noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.coverage.region import positive
from planopt.errors import InputError

Profile = Callable[[NDArray[np.float64]], NDArray[np.float64]]

SCAN = 400
"""Distances that are tried, evenly and on a logarithmic scale, for the steepest point."""

ZOOMS, ZOOMED = 12, 21
"""How often the best distance's surroundings are looked at again, at how many distances: each time
they are a tenth as wide."""


@dataclass(frozen=True)
class EventSensor:
    """The measurement ``S = K F(d) + noise`` at a distance d from the event."""

    # Standard deviation sigma of the Gaussian noise, in the signal's unit; more than 0
    noise_std: float
    strength: float  # K: factor of the profile, more than 0. Estimators may treat it as unknown.
    profile: Profile  # F: decreasing function of the distance in metres; takes and returns arrays
    slope: Profile  # Its derivative by distance
    # Beyond this distance the signal is of no use; used to look for the best distance
    reach_m: float

    def __post_init__(self) -> None:
        positive(self.noise_std, "sensor.noise_std")
        positive(self.strength, "sensor.strength")
        positive(self.reach_m, "sensor.reach_m")
        distances = np.linspace(0.0, self.reach_m, SCAN)
        values, slopes = self.profile(distances), self.slope(distances)
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            raise InputError("the profile is not finite", key="sensor.profile")
        if (slopes > 0.0).any() or (np.diff(values) > 0.0).any():
            raise InputError(
                "the signal grows with distance", key="sensor.profile", remedy="F has to decrease"
            )

    def signal(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signal without noise at distances; of the same shape."""
        return self.strength * self.profile(distance_m)

    def gain(self, distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``K F'(d)`` at distances: change of the signal per metre; of the same shape."""
        return self.strength * self.slope(distance_m)


def diffusion_sensor(
    noise_std: float, strength: float, scale_m: float = 1.0, reach_m: float = 100.0
) -> EventSensor:
    """Return the sensor of a diffusing source, ``S = K / ((d / scale)^2 + 1) + noise``."""
    positive(scale_m, "sensor.scale_m")

    def profile(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1.0 / ((distance_m / scale_m) ** 2 + 1.0)

    def slope(distance_m: NDArray[np.float64]) -> NDArray[np.float64]:
        ratio = distance_m / scale_m
        return -2.0 * ratio / scale_m / (ratio**2 + 1.0) ** 2

    return EventSensor(noise_std, strength, profile, slope, reach_m)


def measure(
    sensor: EventSensor,
    positions_m: NDArray[np.float64],  # (k, 2) where agents measure
    event_m: NDArray[np.float64],  # (2,) where the event is
    generator: np.random.Generator,
) -> NDArray[np.float64]:
    """Draw one measurement at each position."""
    distance = np.linalg.norm(positions_m - event_m, axis=1)
    noise = generator.standard_normal(len(positions_m))
    return sensor.signal(distance) + sensor.noise_std * noise


def sensitivity(sensor: EventSensor, distance_m: float) -> float:
    """Return g: how much the signal changes per metre at a distance, at least 0."""
    return float(-sensor.gain(np.array([distance_m]))[0])


def best_distance_m(sensor: EventSensor) -> float:
    """Return the distance at which a measurement tells most of where the event is.

    That is where the signal is steepest: ``scale / sqrt(3)`` for a diffusing source. At the source
    itself the slope is zero, and a measurement tells nothing.
    """
    # A source that is small against its reach is between the first distances of an even grid.
    even = np.linspace(0.0, sensor.reach_m, SCAN)
    fine = np.geomspace(1e-6 * sensor.reach_m, sensor.reach_m, SCAN)
    distances = np.sort(np.concatenate((even, fine)))
    best = int(sensor.gain(distances).argmin())
    for _ in range(ZOOMS):
        low, high = distances[max(best - 1, 0)], distances[min(best + 1, len(distances) - 1)]
        distances = np.linspace(float(low), float(high), ZOOMED)
        best = int(sensor.gain(distances).argmin())
    return float(distances[best])
