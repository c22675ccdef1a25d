"""Tracking: the settings of a target and its sensor, and the station's Kalman filter.

The first estimate, the sensor and the process noise are alike along x and y, so that the covariance
of one axis, three numbers, describes both.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planopt.channel.parameters import require_finite, require_places
from planopt.plain_values import require_weights
from planopt.targets.information_filter import TargetModel, covariance_of, require_covariance
from planopt.targets.sensor import Sensor

Criterion = Literal["trace", "determinant", "norm"]
"""Of the covariance of the target's position: m^2, m^4, and its largest eigenvalue in m^2."""


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
    sent: NDArray[np.float64]  # (M,) the same of what the robot holds and the station does not

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
    """(a, b, c) of a covariance (4, 4) of place and velocity, the mean over the axes."""
    blocks = covariance.reshape(2, 2, 2, 2).trace(axis1=1, axis2=3) / 2.0
    return np.array([blocks[0, 0], blocks[0, 1], blocks[1, 1]])
