"""Inputs of objective terms: the step context, a batch of paths, a solver's path, or a lattice."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from planopt.arrays import Floats, Indices, Mask
from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.measuring import Gates, MeasuringRule
from planopt.objectives.moments import LocalPaths, Moments, Region
from planopt.objectives.path_derivatives import LocalPath, PathDerivatives
from planopt.objectives.stage_power import StagePower
from planopt.objectives.tracking import Held
from planopt.targets.information_filter import TargetModel
from planopt.targets.rounding import Derivatives

Made = TypeVar("Made")

Part = Derivatives | PathDerivatives
"""Value of a term with derivatives: per stage for sums over stages, else of the whole path."""

LENGTH_ROUNDING_SHARE = 0.01
"""Smoothing width of lengths near zero, as a share of the longest step."""


class SteeredPath(Protocol):
    """Protocol of the route along which a robot is steered beyond its horizon."""

    @property
    def turns_m(self) -> Floats:
        """``(m, 2)`` start, turns and end of the steering route."""
        ...

    @property
    def end_m(self) -> Floats:
        """``(2,)`` end of the route."""
        ...

    @property
    def rest_m(self) -> Floats:
        """``(m,)`` remaining route length from each turn."""
        ...

    @property
    def lattice_m(self) -> Floats | None:
        """``(ny, nx)`` shortest path length from each lattice node to the end; None if unknown."""
        ...

    def next_turns(self, places_m: Floats) -> Indices:
        """Return the index of the route's turn that each position (n, 2) heads for next."""
        ...

    def distance_m(self, places_m: Floats) -> Floats:
        """Return the path length from each position (n, 2) to the end; ``(n,)``."""
        ...

    def gained_m(self, paths_m: Floats) -> Floats:
        """Return the progress towards the end, summed over the positions of paths (..., N, 2)."""
        ...


class TermContext(Protocol):
    """Step context: the data from which a robot plans one step."""

    @property
    def position_m(self) -> Floats:
        """``(2,)`` position of the robot."""
        ...

    @property
    def step_s(self) -> float:
        """Duration of a step."""
        ...

    @property
    def step_length_m(self) -> float:
        """Length of the longest step."""
        ...

    @property
    def standstill_m(self) -> float:
        """Maximum length of the step of a stationary robot."""
        ...

    @property
    def stations(self) -> tuple[ChannelPosterior, ...]:
        """Channel posterior of each station."""
        ...

    @property
    def anticipated(self) -> tuple[ChannelPosterior, ...]:
        """Channel posterior of each station after the other robots' planned measurements."""
        ...

    @property
    def others_m(self) -> tuple[Floats, ...]:
        """``(N, 2)`` each: planned positions of the other robots after each step."""
        ...

    @property
    def thresholds_dbm(self) -> tuple[float, ...]:
        """Minimum power of a connection to each station."""
        ...

    @property
    def target_m(self) -> Floats | None:
        """``(N, 2)`` expected target position after each step; None without a target."""
        ...

    @property
    def information(self) -> Floats | None:
        """``(4, 4)`` information matrix of the station's filter; None without a target."""
        ...

    @property
    def held(self) -> Held | None:
        """Target measurements of the robot that the station lacks, if packets carry estimates."""
        ...

    @property
    def target_motion(self) -> TargetModel:
        """Motion model of the target."""
        ...

    @property
    def steering(self) -> SteeredPath | None:
        """Route that the robot is steered along, if any."""
        ...

    @property
    def region(self) -> Region:
        """Region of the channel map to be learnt, as weighted grid positions."""
        ...

    @property
    def near_region(self) -> Region:
        """Region of the channel map, with a finer grid where a plan can change the map."""
        ...

    @property
    def measuring(self) -> MeasuringRule:
        """Rule that decides at which positions of a path a measurement is taken."""
        ...

    @property
    def near_measuring(self) -> MeasuringRule:
        """Measuring rule for positions that a plan can reach, which is faster to evaluate."""
        ...

    @property
    def probing(self) -> MeasuringRule:
        """Rule that decides which positions of a path are probed for connection."""
        ...

    @property
    def connected_m(self) -> Floats:
        """``(k, 2)`` positions known to be connected."""
        ...

    @property
    def workspace_diagonal_m(self) -> float:
        """Length of the diagonal of the workspace bounds."""
        ...

    @property
    def decorrelation_m(self) -> float:
        """Largest decorrelation distance of the stations' shadowing."""
        ...

    def power(self, places_m: Floats) -> Prediction:
        """Return the serving power at positions (n, 2): measured if known, otherwise predicted."""
        ...

    def predicted(self, places_m: Floats) -> Prediction:
        """Return the predicted serving power at positions (n, 2), with unknown multipath."""
        ...

    def combined(self, powers: Sequence[Prediction]) -> Prediction:
        """Return the serving power that results from the powers of all stations."""
        ...

    def chance(self, place_m: Floats) -> float:
        """Return the probability of connection at a position (2,), including known links."""
        ...

    def probed(self, places_m: Floats, predicted: Floats) -> Floats:
        """Return the probabilities (...) that probes at positions (..., 2) find a connection."""
        ...

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of `make`, cached by key for the current step."""
        ...


@dataclass(frozen=True, eq=False)
class Paths:
    """Batch of c paths in one step context, with predictions along them."""

    at: TermContext
    paths_m: Floats  # (c, N, 2) positions after each step
    stations: Sequence[LocalPaths]  # Power prediction of each station along the paths
    moments: Sequence[Moments]  # Moments of measurements of each anticipated channel

    @property
    def shape(self) -> tuple[int, int]:
        """Number of paths c and of steps N."""
        return self.stations[0].shape

    @cached_property
    def each(self) -> list[Prediction]:
        """Predicted power of each station at every position, path by path; ``(c N,)``."""
        return [batch.power for batch in self.stations]

    @cached_property
    def power(self) -> Prediction:
        """Predicted serving power at every position, path by path; ``(c N,)``."""
        return self.at.combined(self.each)

    @cached_property
    def chance(self) -> Floats:
        """Probability of connection after every step; ``(c, N)``."""
        found = connection_probability(
            self.power.mean_db, self.power.deviation_db, self.at.thresholds_dbm[0]
        )
        return found.reshape(self.shape)

    @cached_property
    def legs_m(self) -> Floats:
        """Step lengths of every path, ``(c, N)``."""
        return legs_m(self.at, self.paths_m)


def legs_m(at: TermContext, paths_m: Floats) -> Floats:
    """Return the step lengths of paths (c, N, 2) from the robot's position; ``(c, N)``."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(paths_m), 1, 2)), paths_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)


@dataclass(frozen=True, eq=False)
class NearPath:
    """Path near an initial guess, with the local models that a solver evaluates."""

    at: TermContext
    places_m: Floats  # (N, 2) positions after each step
    predicted: Callable[[], StagePower]  # Predictor of the serving power
    # Local channel of each station, if a term couples positions
    channels: Sequence[LocalChannel]
    # Anticipated local channels, each with the grid of the averaged map, if any
    anticipated: Sequence[tuple[LocalChannel, LocalGrid | None]]
    gates: Gates | None  # Gates of the measurements; None if no term measures
    # (N,) index of the route turn that each position heads for; None without a route
    ahead: Indices | None
    # (N,) True where connection is probed; None if no term probes
    probed: Mask | None

    @cached_property
    def stage_power(self) -> StagePower:
        """Predicted serving power at every stage."""
        return self.predicted()

    @cached_property
    def measured(self) -> list[LocalPath]:
        """Moments of measurements along the path, for each station's anticipated channel."""
        return [
            LocalPath(channel, self.places_m, self.gates, grid)
            for channel, grid in self.anticipated
        ]

    @property
    def rounding_m(self) -> float:
        """Smoothing width of lengths near zero, in metres."""
        return LENGTH_ROUNDING_SHARE * self.at.step_length_m


class NodeChannel(Protocol):
    """Predictions of one station's power at the nodes of a lattice."""

    @property
    def mean_db(self) -> Floats:
        """``(ny, nx)`` predicted mean power."""
        ...

    @property
    def deviation_db(self) -> Floats:
        """``(ny, nx)`` predictive standard deviation of the power."""
        ...

    @property
    def trend(self) -> Floats:
        """``(ny, nx, 2)`` path-loss regressors less the part predicted from measurements."""
        ...


class Nodes(Protocol):
    """Channel predictions of all stations at the nodes of a lattice."""

    @property
    def grid_m(self) -> Floats:
        """``(ny, nx, 2)`` positions of the nodes."""
        ...

    @property
    def stations(self) -> Sequence[NodeChannel]:
        """Channel predictions of each station at the lattice nodes."""
        ...

    @property
    def window(self) -> tuple[slice, slice]:
        """Row and column slices of the reachable nodes."""
        ...
