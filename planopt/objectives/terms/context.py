"""The inputs of a term: the planning step, many paths at once, one path of a solver, a lattice."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.kriging import LocalChannel, LocalGrid
from planopt.channel.posterior import ChannelPosterior
from planopt.channel.prediction import Prediction, connection_probability
from planopt.objectives.measuring import Gates, KnownLinks, MeasuringRule
from planopt.objectives.moments import LocalPaths, Moments, Region
from planopt.objectives.path_derivatives import LocalPath, PathDerivatives
from planopt.objectives.stage_power import StagePower
from planopt.objectives.tracking import Held
from planopt.targets.information_filter import TargetModel
from planopt.targets.rounding import Derivatives

Made = TypeVar("Made")

Part = Derivatives | PathDerivatives
"""A value with derivatives: by stage where it adds up over them, else of the whole path."""

LENGTH_ROUNDING_SHARE = 0.01
"""Width of the rounding of a length at zero, as a share of the longest step."""


class SteeredPath(Protocol):
    """The path that a robot is steered along."""

    @property
    def turns_m(self) -> NDArray[np.float64]:
        """``(m, 2)`` its start, its turns and its end."""
        ...

    @property
    def end_m(self) -> NDArray[np.float64]:
        """``(2,)`` its end."""
        ...

    @property
    def rest_m(self) -> NDArray[np.float64]:
        """``(m,)`` its length from each turn on."""
        ...

    @property
    def lattice_m(self) -> NDArray[np.float64] | None:
        """``(ny, nx)`` length of the shortest path to its end from each node, where known."""
        ...

    def next_turns(self, places_m: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the number of the turn that each place (n, 2) goes straight to."""
        ...

    def distance_m(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the length of the path from each place (n, 2) to the end; (n,)."""
        ...

    def gained_m(self, paths_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much the places of paths (..., N, 2) are nearer than the start, summed."""
        ...


class TermContext(Protocol):
    """The context in which a robot plans one step."""

    @property
    def position_m(self) -> NDArray[np.float64]:
        """``(2,)`` where the robot is."""
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
        """Belief of each station's channel."""
        ...

    @property
    def anticipated(self) -> tuple[ChannelPosterior, ...]:
        """Beliefs after the other robots of a team have measured along their plans."""
        ...

    @property
    def others_m(self) -> tuple[NDArray[np.float64], ...]:
        """``(N, 2)`` each: places after each step of the plans of other robots."""
        ...

    @property
    def thresholds_dbm(self) -> tuple[float, ...]:
        """Least power of a connection to each station."""
        ...

    @property
    def target_m(self) -> NDArray[np.float64] | None:
        """``(N, 2)`` expected position of the target after each step; None without target."""
        ...

    @property
    def information(self) -> NDArray[np.float64] | None:
        """``(4, 4)`` information matrix of the station's filter; None without target."""
        ...

    @property
    def held(self) -> Held | None:
        """The robot's unsent target measurements; None where packets have no estimates."""
        ...

    @property
    def target_motion(self) -> TargetModel:
        """Return how the target moves."""
        ...

    @property
    def steering(self) -> SteeredPath | None:
        """The path that the robot is steered along, if any."""
        ...

    @property
    def region(self) -> Region:
        """Return the region whose map is wanted."""
        ...

    @property
    def near_region(self) -> Region:
        """The same, finer where a plan can change it."""
        ...

    @property
    def measuring(self) -> MeasuringRule:
        """Return the rule by which places of a path bring a measurement."""
        ...

    @property
    def near_measuring(self) -> MeasuringRule:
        """The same rule for places that a plan can reach."""
        ...

    @property
    def probing(self) -> MeasuringRule:
        """Return the rule by which places of a path are probed for connection."""
        ...

    @property
    def links(self) -> KnownLinks:
        """Places whose connection is known."""
        ...

    @property
    def workspace_diagonal_m(self) -> float:
        """Length from corner to corner of the bounds."""
        ...

    @property
    def decorrelation_m(self) -> float:
        """The longest decorrelation distance of the stations' shadowing."""
        ...

    def power(self, places_m: NDArray[np.float64]) -> Prediction:
        """Return the serving power at places (n, 2)."""
        ...

    def combined(self, powers: Sequence[Prediction]) -> Prediction:
        """Return the serving power from each station's power."""
        ...

    def chance(self, place_m: NDArray[np.float64]) -> float:
        """Return the probability of connection at one place (2,), known links included."""
        ...

    def once(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return the result of `make`, called once a step for each key."""
        ...


@dataclass(frozen=True, eq=False)
class Paths:
    """Many paths of one step, with predictions along them."""

    at: TermContext
    paths_m: NDArray[np.float64]  # (c, N, 2) places after each step
    stations: Sequence[LocalPaths]  # Each station's power along all of them
    moments: Sequence[Moments]  # Of measuring each station's anticipated channel along them

    @property
    def shape(self) -> tuple[int, int]:
        """Number of paths, and of steps."""
        return self.stations[0].shape

    @cached_property
    def each(self) -> list[Prediction]:
        """Each station's power at every place, those of a path together; ``(c N,)``."""
        return [batch.power for batch in self.stations]

    @cached_property
    def power(self) -> Prediction:
        """Serving power at every place; ``(c N,)``."""
        return self.at.combined(self.each)

    @cached_property
    def chance(self) -> NDArray[np.float64]:
        """Probability of a connection after every step; ``(c, N)``."""
        found = connection_probability(
            self.power.mean_db, self.power.deviation_db, self.at.thresholds_dbm[0]
        )
        return found.reshape(self.shape)

    @cached_property
    def legs_m(self) -> NDArray[np.float64]:
        """Lengths of the steps of every path, ``(c, N)``."""
        return legs_m(self.at, self.paths_m)


def legs_m(at: TermContext, paths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the lengths of the steps of paths ``(c, N, 2)`` from where the robot is; (c, N)."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(paths_m), 1, 2)), paths_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)


@dataclass(frozen=True, eq=False)
class NearPath:
    """One path of a solver, near the path that it began from."""

    at: TermContext
    places_m: NDArray[np.float64]  # (N, 2) places after each step
    predicted: Callable[[], StagePower]  # Predicts the serving power
    # Each station's channel near the path, if terms couple its places
    channels: Sequence[LocalChannel]
    # Anticipated channels near the path, and the map that is averaged, if any
    anticipated: Sequence[tuple[LocalChannel, LocalGrid | None]]
    gates: Gates | None  # How much of a measurement each place brings; None where no term measures
    # (N,) number of the turn of the steered path that each place goes to; None if nothing steers
    ahead: NDArray[np.intp] | None
    # (N,) which places are tries for connection; None where no term tries
    probed: NDArray[np.bool_] | None

    @cached_property
    def stage_power(self) -> StagePower:
        """Serving power at every stage."""
        return self.predicted()

    @cached_property
    def measured(self) -> list[LocalPath]:
        """Moments of measuring each station's anticipated channel along the path."""
        return [
            LocalPath(channel, self.places_m, self.gates, grid)
            for channel, grid in self.anticipated
        ]

    @property
    def rounding_m(self) -> float:
        """Lengths are rounded within this of zero."""
        return LENGTH_ROUNDING_SHARE * self.at.step_length_m


class NodeChannel(Protocol):
    """Predictions of one station's power at the nodes of a lattice."""

    @property
    def mean_db(self) -> NDArray[np.float64]:
        """``(ny, nx)``."""
        ...

    @property
    def deviation_db(self) -> NDArray[np.float64]:
        """``(ny, nx)``."""
        ...

    @property
    def trend(self) -> NDArray[np.float64]:
        """``(ny, nx, 2)`` regressors of the path loss less what measurements say of them."""
        ...


class Nodes(Protocol):
    """Predictions at the nodes of a lattice."""

    @property
    def grid_m(self) -> NDArray[np.float64]:
        """``(ny, nx, 2)`` positions of the nodes."""
        ...

    @property
    def stations(self) -> Sequence[NodeChannel]:
        """Each station's own predictions at the nodes."""
        ...

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the nodes within reach."""
        ...
