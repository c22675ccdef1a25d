"""Affine upper bounds of stage rewards over discs, and their sums and products."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.parameters import MIN_DISTANCE_M
from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.moments import posterior_moments
from planopt.targets.information_filter import Sensor

ASSUMED = 3.0
"""Assumed information on the path loss, in units of what the plan tells of it (equation 9.14)."""
DECIBELS = 10.0 / np.log(10.0)
"""Change of the path loss by a unit of the natural logarithm of the distance."""


@dataclass(frozen=True, eq=False)
class Discs:
    """Discs with n centres and a common radius."""

    centre_m: Floats  # (n, 2)
    radius_m: float


@dataclass(frozen=True, eq=False)
class UpperBounds:
    """Upper bounds of one function over n discs of a common radius."""

    value: Floats  # (n,) of the tangent at the centre
    slope: Floats  # (n, 2)
    most: Floats  # (n,) over the whole disc
    radius_m: float

    def at(self, rows: Indices) -> UpperBounds:
        """Return the bounds over some of the discs."""
        return UpperBounds(self.value[rows], self.slope[rows], self.most[rows], self.radius_m)

    def scaled(self, factor: float) -> UpperBounds:
        """Return the bounds of the function multiplied by `factor`, which must be >= 0."""
        value, slope, most = factor * self.value, factor * self.slope, factor * self.most
        return UpperBounds(value, slope, most, self.radius_m)

    def plus(self, other: UpperBounds) -> UpperBounds:
        """Return bounds of the sum of two functions."""
        value, slope = self.value + other.value, self.slope + other.slope
        return UpperBounds(value, slope, self.most + other.most, self.radius_m)

    def positive_part(self) -> UpperBounds:
        """Return bounds of max(0, f)."""
        # If the tangent may be negative within the disc, only the constant bound remains.
        most = np.maximum(self.most, 0.0)
        holds = self.value >= self.radius_m * np.hypot(*self.slope.T)
        slope = np.where(holds[:, None], self.slope, 0.0)
        return UpperBounds(np.where(holds, self.value, most), slope, most, self.radius_m)

    def times(self, other: UpperBounds) -> UpperBounds:
        """Return bounds of the product of two functions >= 0 (equation 9.4)."""
        # The product of both linear parts is a quadratic form with this largest eigenvalue.
        along = np.einsum("nd,nd->n", self.slope, other.slope)
        across = np.hypot(*self.slope.T) * np.hypot(*other.slope.T)
        return UpperBounds(
            self.value * other.value + 0.5 * self.radius_m**2 * (along + across),
            self.value[:, None] * other.slope + other.value[:, None] * self.slope,
            self.most * other.most,
            self.radius_m,
        )


Quantity = Literal["chance", "variance_db2", "minus_variance_db2", "trend"]
"""Predicted quantity: probability of connection, variance of the power, minus the variance, or the
trace of the information on the path loss (equation 9.6)."""


Makers = Mapping[Quantity, Callable[[Discs], UpperBounds]]
"""Functions that bound predicted quantities over discs."""


@dataclass(frozen=True, eq=False)
class Field:
    """Bounds of predicted quantities over discs; each bound is computed on first use."""

    discs: Discs
    makers: Makers
    parent: tuple[Field, Indices] | None = None  # Larger set of discs, and rows in it
    made: dict[Quantity, UpperBounds] = field(default_factory=dict[Quantity, UpperBounds])

    def __getitem__(self, name: Quantity) -> UpperBounds:
        """Return the bounds of a quantity."""
        if name not in self.made:
            if self.parent is None:
                self.made[name] = self.makers[name](self.discs)
            else:
                larger, rows = self.parent
                self.made[name] = larger[name].at(rows)
        return self.made[name]

    def at(self, rows: Indices) -> Field:
        """Return the bounds over some of the discs."""
        discs = Discs(self.discs.centre_m[rows], self.discs.radius_m)
        return Field(discs, self.makers, (self, rows))


@dataclass(frozen=True, eq=False)
class PairedInformation:
    """Information that a measurement loses because the preceding position is measured too."""

    posterior: ChannelPosterior
    weight: float = 1.0
    given_nats: float = 0.0  # Information of what the posterior is assumed to know of the path loss

    def informed(self, path_m: Floats | None) -> PairedInformation:
        """Return the bound if the path loss is known at least as well as after `path_m`."""
        if path_m is None:
            return self
        moments, spread = posterior_moments(self.posterior, path_m), self.posterior.theta_covariance
        trend = moments.whole_trend
        information = trend.T @ np.linalg.solve(moments.whole_covariance, trend)
        gain = np.eye(2) + ASSUMED * spread @ information
        left = np.linalg.solve(gain, spread)
        posterior = replace(self.posterior, theta_covariance=0.5 * (left + left.T))
        return replace(self, posterior=posterior, given_nats=0.5 * np.linalg.slogdet(gain)[1])

    def nearest_m(self, discs: Discs) -> Floats:
        """Return the distance (n,) from the station to the nearest point of each disc."""
        station = self.posterior.parameters.station
        across = np.hypot(*(discs.centre_m - np.asarray(station.position_m)).T) - discs.radius_m
        return np.maximum(np.hypot(np.maximum(across, 0.0), station.height_m), MIN_DISTANCE_M)

    def lost(
        self, before_db2: Floats, after_db2: Floats, distance_m: float, nearest_m: Floats
    ) -> Floats:
        """Return least losses in nats of positions at most `distance_m` apart (equation 9.13)."""
        parameters, spread = self.posterior.parameters, self.posterior.theta_covariance
        noise = parameters.multipath_std_db**2
        shadow = -np.expm1(-distance_m / parameters.decorrelation_m)
        apart = np.sqrt(2.0 * shadow) * parameters.shadow_std_db
        trend = np.sqrt(spread[1, 1]) * DECIBELS * np.log1p(distance_m / nearest_m)
        apart = noise + 0.5 * (apart + trend) ** 2
        after = np.minimum(after_db2, before_db2 + 2.0 * apart)
        shared = np.maximum(0.5 * (before_db2 + after) - apart, 0.0)
        left = np.maximum(after - shared**2 / before_db2, noise)
        return 0.5 * self.weight * np.log(np.maximum(after_db2, left) / left)


@dataclass(frozen=True)
class StageBounds:
    """Upper bounds of a term that is a sum over stages, and its costs of moves."""

    # Maps a stage (from 0) and bounds of predicted quantities to bounds of the stage's reward
    reward: Callable[[int, Field], UpperBounds]
    per_metre: float = 0.0  # Cost of a metre
    per_move: float = 0.0  # Cost of a step longer than a standstill
    most_steps: int | None = None  # Maximum number of steps of a plan; None: any
    # What a stage loses by the previous position; its reward is then a constant on each disc
    paired: PairedInformation | None = None


def no_reward(stage: int, field: Field) -> UpperBounds:
    """Return the bounds of a term without stage rewards."""
    return constant_bounds(field.discs, 0.0)


def constant_bounds(discs: Discs, value: float) -> UpperBounds:
    """Return the bounds of a constant."""
    values = np.full(len(discs.centre_m), value)
    return UpperBounds(values, np.zeros_like(discs.centre_m), values, discs.radius_m)


def information_bounds(variance: UpperBounds, noise_db2: float) -> UpperBounds:
    """Return upper bounds of a measurement's information, ``log(variance / noise) / 2`` nats."""
    value = 0.5 * np.log(variance.value / noise_db2)
    slope = variance.slope / (2.0 * variance.value)[:, None]
    return UpperBounds(value, slope, 0.5 * np.log(variance.most / noise_db2), variance.radius_m)


def closeness_bounds(decay_per_m: float, here_m: Floats, discs: Discs) -> UpperBounds:
    """Return upper bounds over discs of the closeness exp(-zeta |q - here|) (equation 9.7)."""
    offset = discs.centre_m - here_m
    distance = np.hypot(*offset.T)
    value = np.exp(-decay_per_m * distance)
    reach = decay_per_m * discs.radius_m
    slope = (-decay_per_m * value / np.maximum(distance, 1e-300))[:, None] * offset
    most = np.exp(-decay_per_m * np.maximum(distance - discs.radius_m, 0.0))
    return UpperBounds(value * (1.0 + 0.5 * reach**2 * np.exp(reach)), slope, most, discs.radius_m)


def sensing_bounds(sensor: Sensor, target_m: Floats, discs: Discs) -> UpperBounds:
    """Return upper bounds over discs of a packet's information on the target (equation 9.3)."""
    growth, floor, radius = sensor.growth, sensor.least_noise_m2, discs.radius_m
    offset = discs.centre_m - target_m
    distance = np.hypot(*offset.T)
    off = distance - sensor.sweet_spot_m
    low = np.maximum(distance - radius, 0.0) - sensor.sweet_spot_m
    high = off + radius
    noise = growth * off**2 + floor
    steep = -2.0 * growth * off / noise**2
    # The distance exceeds its tangent by at most this much.
    beyond = radius**2 / (2.0 * np.maximum(distance - radius, 1e-300))
    beyond = np.minimum(2.0 * radius, beyond) if radius else np.zeros_like(distance)

    def bend(at: Floats) -> Floats:
        noise = growth * at**2 + floor
        return 2.0 * growth * (3.0 * growth * at**2 - floor) / noise**3

    peak = np.sqrt(floor / growth)
    largest = np.maximum(bend(low), bend(high))
    for each in (-peak, peak):
        largest = np.where((low <= each) & (each <= high), 0.5 * growth / floor**2, largest)
    widest = np.maximum(off - low, high - off)
    value = 1.0 / noise + np.maximum(steep, 0.0) * beyond
    value += 0.5 * np.maximum(largest, 0.0) * widest**2
    nearest = np.where((low <= 0.0) & (high >= 0.0), 0.0, np.minimum(np.abs(low), np.abs(high)))
    slope = (steep / np.maximum(distance, 1e-300))[:, None] * offset
    return UpperBounds(value, slope, 1.0 / (growth * nearest**2 + floor), radius)
