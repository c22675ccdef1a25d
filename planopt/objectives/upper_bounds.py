"""Affine upper bounds of stage rewards over discs, and their sums and products."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from planopt.arrays import Floats, Indices
from planopt.channel.posterior import ChannelPosterior
from planopt.targets.information_filter import Sensor


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

    def at(self, rows: Indices | tuple[slice, ...]) -> UpperBounds:
        """Return the bounds over some of the discs, by an index of their array."""
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


Quantity = Literal["chance", "variance_db2", "tangent", "trend"]
"""Predicted quantity: probability of connection, variance of the power, difference of variances in
the tangent of the information (9.13), or trace of the information on the path loss (9.6)."""


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
            if not len(self.discs.centre_m):
                self.made[name] = constant_bounds(self.discs, 0.0)
            elif self.parent is None:
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
class Measured:
    """Information that measurements give, as a concave function of the positions' weights."""

    posterior: ChannelPosterior
    criterion: Literal["map", "D", "A", "V", "T"] = "map"  # Of the path loss, unless ``map``
    map_form: Floats = field(default_factory=lambda: np.eye(2))  # G of criterion V (equation 4.2)


@dataclass(frozen=True)
class StageBounds:
    """Upper bounds of a term that is a sum over stages, and its costs of moves."""

    # Maps a stage (from 0) and bounds of predicted quantities to bounds of the stage's reward
    reward: Callable[[int, Field], UpperBounds]
    per_metre: float = 0.0  # Cost of a metre
    per_move: float = 0.0  # Cost of a step longer than a standstill
    most_steps: int | None = None  # Maximum number of steps of a plan; None: any
    # Information that replaces the rewards of several stages
    measured: Measured | None = None


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
