"""Objective terms: base class, registry of all kinds, and inputs.

The inputs are the step context, a batch of paths, a solver's path, or a lattice.
"""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Protocol, TypeVar

import numpy as np
from pydantic import Field

import planopt.objectives.terms as own_terms
from planopt.arrays import Derivatives, Floats, Indices, Mask
from planopt.channel.connectivity_law import ConnectivityLaw
from planopt.channel.kriging import LocalChannel, LocalGrid, Prediction, connection_probability
from planopt.channel.posterior import ChannelPosterior
from planopt.errors import InputError, listed
from planopt.objectives.measuring import Gates, MeasuringRule
from planopt.objectives.moments import Region
from planopt.objectives.path_derivatives import LocalPaths, PathDerivatives
from planopt.objectives.stage_power import StagePower
from planopt.objectives.tracking import Held
from planopt.parts import class_name, require_name
from planopt.targets.information_filter import Sensor, TargetModel
from planopt.world.clearance import ObstacleIndex, segments_clear

if TYPE_CHECKING:
    from planopt.objectives.upper_bounds import StageBounds

Weight = Annotated[
    float,
    Field(default=1.0, ge=0, le=1e9, description="Weight in the sum of terms.", title="Weight"),
]

Structure = Literal["stagewise", "chain", "full"]
"""Sparsity of a term's Hessian: blocks per stage, between successive stages as well, or dense."""
Steers = Literal["variance", "connection", "goal"]
"""Position that a robot is steered to: largest variance, probed for connection, or the goal."""


@dataclass(frozen=True)
class TermSetting:
    """Properties of a problem that decide whether it supports a term."""

    horizon: int  # N, the number of steps of a plan
    stations: int  # Number of base stations
    has_target: bool  # Whether there is a target
    has_dynamics: bool = False  # Whether any robot has dynamics (inertia or a heading)
    is_free: bool = False  # True if there are no other terms and no chance constraint
    has_estimates: bool = False  # Whether packets contain target estimates


@dataclass(frozen=True)
class Term:
    """Summand of an objective to be maximised.

    Attributes
    ----------
    weight
        Factor of the term in the sum.
    """

    weight: Weight = field(default=1.0, kw_only=True)

    kind: ClassVar[str]
    """Name of the term in problem files."""
    summary: ClassVar[str] = "User-defined term."
    """One-sentence description in the schema."""
    task: ClassVar[str | None] = "custom"
    """Task of a problem whose first term has this kind; None if the kind implies no task."""

    def __init_subclass__(cls) -> None:
        """Register a subclass that defines a kind."""
        super().__init_subclass__()
        if "kind" in cls.__dict__:
            register(cls)

    def at_horizon(self, steps: int) -> Term:
        """Return the term adapted to plans of `steps` steps."""
        return self

    @classmethod
    def table_fault(cls, given: frozenset[str], term: Term) -> str | None:
        """Return text on a conflict of the keys `given` with others; None without conflict."""
        return None

    @property
    def left_out(self) -> frozenset[str]:
        """Return the fields to omit from a saved table."""
        return frozenset()

    def planned(self, setting: TermSetting) -> Term:
        """Return the term with automatic choices resolved for a problem with this `setting`."""
        return self

    @property
    def structure(self) -> Structure:
        """Return the sparsity of the Hessian w.r.t. the positions of a path."""
        return "full"

    @property
    def probes_end(self) -> bool:
        """Return whether the term probes the end of a path and thus defines :meth:`probe_values`.

        Values with a probe are not smooth functions of the path's end.
        """
        return False

    @property
    def is_measured(self) -> bool:
        """Return whether the value is a gain by measurements along the path."""
        return False

    @property
    def averages_map(self) -> bool:
        """Return whether the value is an average over the workspace."""
        return False

    @property
    def variance_threshold(self) -> float | None:
        """Return the variance in dB^2 up to which a position is known; None without a threshold."""
        return None

    @property
    def sensor(self) -> Sensor | None:
        """Return the sensor that tracks the target; None for terms without a target."""
        return None

    @property
    def steers(self) -> Steers | None:
        """Return the kind of steering point chosen before planning; None without steering."""
        return None

    def check(self, setting: TermSetting) -> None:
        """Raise an error if the problem does not support the term.

        Raises
        ------
        InputError
            The key names the invalid field.
        """

    def _without(self, method: str) -> InputError:
        """Return the InputError for a class that lacks `method`."""
        return InputError(
            f"{class_name(self)} does not define the method {method}",
            remedy="define it, or derive the class from planopt.extend.OwnTerm and define "
            "expression",
        )

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the term's value of one path (N, 2), from all measurements, as reported."""
        raise self._without("value")

    def values(self, paths: Paths) -> Floats:
        """Return approximate values ``(c,)`` of c paths, for ranking in searches."""
        raise self._without("values")

    def probe_values(self, at: TermContext, paths_m: Floats, chance: Floats) -> Floats:
        """Return the values ``(c,)`` of paths (c, N, 2) for approximate P(connected) (c, N).

        Searches use these values to rank hundreds of paths if the term probes path ends.
        """
        raise self._without("probe_values")

    def derivatives(self, path: NearPath) -> Part:
        """Return the term's value for one path, with derivatives, for solvers."""
        raise self._without("derivatives")

    def slope(self, paths: Paths) -> Floats:
        """Return the gradients ``(c, N, 2)`` of :meth:`values` w.r.t. the positions of paths."""
        raise self._without("slope")

    def node_reward(self, at: TermContext, nodes: Nodes) -> Floats | None:
        """Return the reward of ending a step at each node, for any stage as an array (ny, nx).

        The lattice search maximises these rewards in place of the value. They are exact for terms
        that are sums over steps; for other terms the resulting path is only an initial guess.
        """
        return None

    def stage_reward(
        self, at: TermContext, places_m: Floats, stage: int | Indices, chance: Floats
    ) -> Floats | None:
        """Return the reward of ending step `stage` (from 0) at positions (..., 2)."""
        return None

    def largest_stage_reward(self, at: TermContext) -> float:
        """Return an upper bound of :meth:`stage_reward`."""
        return 0.0

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return upper bounds of the term's stage rewards, or the reason why there are none."""
        return "without a proven bound"

    def move_reward(self, lengths_m: Floats, step_s: float) -> Floats:
        """Return the part of the reward of moves that depends on their lengths alone."""
        return np.zeros(len(lengths_m))


_kinds: dict[str, type[Term]] = {}


def register(term: type[Term]) -> None:
    """Register a term class by its kind, for problem files."""
    kind = require_name(term.kind, f"the term {class_name(term)}")
    known = _kinds.get(kind)
    if known is not None and class_name(known) != class_name(term):
        raise InputError(
            f"the kind {kind!r} of {class_name(term)} is already used by {class_name(known)}",
            remedy="choose another kind",
        )
    _kinds[kind] = term


def require_kind(term: Term, key: str) -> None:
    """Raise an InputError for a term whose class cannot be saved in a problem file."""
    made = type(term)
    if not hasattr(made, "kind"):
        raise InputError(
            f"the class {class_name(made)} has no attribute kind",
            key=key,
            remedy='add kind: ClassVar[str] = "...", the name of the term in problem files',
        )
    known = {each.name for each in fields(term)} | {*inspect.get_annotations(Term)}
    stray = [name for name in inspect.get_annotations(made) if name not in known]
    if (stray or "__init__" in vars(made)) and "__dataclass_params__" not in vars(made):
        raise InputError(
            f"the class {class_name(made)} is not a dataclass: {listed(stray or ['__init__'])} "
            "would not be saved",
            key=key,
            remedy="write @dataclass(frozen=True) above the class",
        )


def registered_terms() -> tuple[type[Term], ...]:
    """Return all registered term classes, sorted by kind."""
    for module in pkgutil.iter_modules(own_terms.__path__):
        importlib.import_module(f"{own_terms.__name__}.{module.name}")
    return tuple(_kinds[kind] for kind in sorted(_kinds))


def outside_terms() -> tuple[type[Term], ...]:
    """Return the registered term classes from outside planopt, for worker processes."""
    home = f"{own_terms.__name__}."
    return tuple(term for term in registered_terms() if not term.__module__.startswith(home))


def explores(term: Term) -> bool:
    """Return whether a term guides a robot to unmeasured positions."""
    return term.is_measured or term.steers == "variance"


Made = TypeVar("Made")

Part = Derivatives | PathDerivatives
"""Value of a term with derivatives: per stage for sums over stages, else of the whole path."""
LENGTH_ROUNDING_SHARE = 0.01  # Smoothing width of lengths near zero, as a share of the longest step


@dataclass(frozen=True, eq=False)
class SteeringPath:
    """Path from a robot's position to the point to which the robot is steered."""

    turns_m: Floats  # (m, 2), m at least 2: the robot's position, the turns, and the end
    index: ObstacleIndex  # The obstacles
    clearance_m: float  # Minimum distance to obstacles, less the verifier's tolerance
    # (ny, nx) length of the shortest path to the end from each node of the lattice, if known
    lattice_m: Floats | None = None
    # True if positions head no farther than the end of their nearest leg (coverage holes)
    in_order: bool = False

    @property
    def end_m(self) -> Floats:
        """Return the end (2,) of the steering path."""
        return self.turns_m[-1]

    @cached_property
    def rest_m(self) -> Floats:
        """Return the remaining path length (m,) from each turn."""
        legs = np.linalg.norm(np.diff(self.turns_m, axis=0), axis=1)
        return np.concatenate([np.cumsum(legs[::-1])[::-1], [0.0]])

    def next_turns(self, places_m: Floats) -> Indices:
        """Return the index of the next turn of the path for each position (n, 2)."""
        # The last consecutive visible turn from the first one on, else the start of the path.
        found = np.zeros(len(places_m), dtype=np.intp)
        left = np.arange(len(places_m))
        last = self._ends_of_legs(places_m) if self.in_order else None
        for turn in range(1, len(self.turns_m)):
            if last is not None:
                left = left[last[left] >= turn]
            there = np.broadcast_to(self.turns_m[turn], (len(left), 2))
            seen = segments_clear(self.index, places_m[left], there, self.clearance_m)
            found[left[seen]] = turn
            left = left[seen | (found[left] == 0)]
            if not len(left):
                break
        return found

    def _ends_of_legs(self, places_m: Floats) -> Indices:
        """Return, for each position, the index of the turn that ends the nearest leg."""
        starts, legs = self.turns_m[:-1], np.diff(self.turns_m, axis=0)
        offset = places_m[:, None] - starts
        length2 = np.maximum((legs**2).sum(axis=1), np.finfo(float).tiny)
        along = np.clip((offset * legs).sum(axis=2) / length2, 0.0, 1.0)
        away = np.linalg.norm(offset - along[:, :, None] * legs, axis=2)
        return len(legs) - away[:, ::-1].argmin(axis=1)

    def distance_m(self, places_m: Floats) -> Floats:
        """Return the remaining distance from each position (n, 2) to the end as an array (n,)."""
        turns = self.next_turns(places_m)
        return np.linalg.norm(places_m - self.turns_m[turns], axis=1) + self.rest_m[turns]

    def path_m(self, steps: int, longest_m: float) -> Floats:
        """Return positions ``(steps, 2)`` along the path, with a step end at every turn."""
        found: list[Floats] = []
        here = self.turns_m[0]
        for turn in self.turns_m[1:]:
            count = max(math.ceil(float(np.linalg.norm(turn - here)) / longest_m), 1)
            found += [here + (turn - here) * k / count for k in range(1, count + 1)]
            here = turn
            if len(found) >= steps:
                break
        found += [here] * (steps - len(found))
        return np.array(found[:steps])

    def gained_m(self, paths_m: Floats) -> Floats:
        """Return the reduction of the distance to the end, summed over positions (..., N, 2)."""
        distance = self.distance_m(paths_m.reshape(-1, 2)).reshape(paths_m.shape[:-1])
        return (self.rest_m[0] - distance).sum(axis=-1)


@dataclass(frozen=True, eq=False)
class Pending:
    """Positions at which the other robots of a team measure or have measured."""

    # Positions (N, 2) after each step of every other robot's plan
    planned_m: tuple[Floats, ...] = ()
    # (k, 2) the others' positions after each past step of the run
    driven_m: Floats = field(default_factory=lambda: np.zeros((0, 2)))


NOTHING_PENDING = Pending()


@dataclass(frozen=True, eq=False)
class Aim:
    """External inputs of one plan's objective, such as the expected target track."""

    # (N, 2) expected target position at the end of each step; None without a target
    target_m: Floats | None = None
    # (m, 2) two-layer steering: robot's position, turns and end; None without steering
    steering_turns_m: Floats | None = None
    # (4, 4) J_{t|t} of the station's filter at that time; None without a target
    information: Floats | None = None
    pending: Pending = NOTHING_PENDING  # Positions at which the other robots measure
    # The robot's unsent target measurements if packets carry estimates; otherwise None
    held: Held | None = None


class TermContext(Protocol):
    """Step context: the data from which a robot plans one step."""

    @property
    def position_m(self) -> Floats:
        """``(2,)`` position of the robot."""
        ...

    @property
    def state(self) -> Floats:
        """``(s,)`` state of the robot, its position first."""
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
    def law(self) -> ConnectivityLaw:
        """Probability model of connection, with channel posterior and threshold of each station."""
        ...

    @property
    def anticipated(self) -> tuple[ChannelPosterior, ...]:
        """Channel posterior of each station after the other robots' planned measurements."""
        ...

    @property
    def aim(self) -> Aim:
        """External inputs of the objective: target, other robots, unsent measurements."""
        ...

    @property
    def target_motion(self) -> TargetModel:
        """Motion model of the target."""
        ...

    @property
    def steering(self) -> SteeringPath | None:
        """Route along which the robot is steered; None without steering."""
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
        """Rule that selects the positions of a path at which the robot measures."""
        ...

    @property
    def near_measuring(self) -> MeasuringRule:
        """Measuring rule for positions that a plan can reach, which is faster to evaluate."""
        ...

    @property
    def probing(self) -> MeasuringRule:
        """Rule that selects the positions of a path at which the robot probes for a connection."""
        ...

    @property
    def connected_m(self) -> Floats:
        """``(k, 2)`` positions known to be connected."""
        ...

    @property
    def workspace_diagonal_m(self) -> float:
        """Length of the diagonal of the workspace bounds."""
        ...

    def power(self, places_m: Floats) -> Prediction:
        """Return the serving power at positions (n, 2): measured if known, otherwise predicted."""
        ...

    def predicted(self, places_m: Floats) -> Prediction:
        """Return the predicted serving power at positions (n, 2), with unknown multipath."""
        ...

    def chance(self, place_m: Floats) -> float:
        """Return the probability of connection at a position (2,); measured power counts."""
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
    measured: Sequence[LocalPaths]  # Measurements of each anticipated channel
    gates: Gates | None = None  # Gates of the measurements, for gradients

    @property
    def shape(self) -> tuple[int, int]:
        """Number of paths c and of steps N."""
        return self.stations[0].shape

    @cached_property
    def each(self) -> list[Prediction]:
        """Predicted power ``(c N,)`` of each station at every position, path by path."""
        return [batch.power for batch in self.stations]

    @cached_property
    def power(self) -> Prediction:
        """Predicted serving power at every position, path by path as an array ``(c N,)``."""
        return self.at.law.combined(self.each)

    @cached_property
    def chance(self) -> Floats:
        """Probability of connection after every step as an array ``(c, N)``."""
        found = connection_probability(
            self.power.mean_db, self.power.deviation_db, self.at.law.thresholds_dbm[0]
        )
        return found.reshape(self.shape)

    @cached_property
    def legs_m(self) -> Floats:
        """Step lengths of every path, ``(c, N)``."""
        return legs_m(self.at, self.paths_m)


def legs_m(at: TermContext, paths_m: Floats) -> Floats:
    """Return the step lengths ``(c, N)`` of paths (c, N, 2) from the robot's position."""
    ends = np.concatenate([np.broadcast_to(at.position_m, (len(paths_m), 1, 2)), paths_m], axis=1)
    return np.linalg.norm(np.diff(ends, axis=1), axis=2)


@dataclass(frozen=True, eq=False)
class NearPath:
    """Path near an initial guess, with the local models that a solver evaluates."""

    at: TermContext
    places_m: Floats  # (N, 2) positions after each step
    predicted: Callable[[], StagePower]  # Predictor of the serving power
    channels: Sequence[LocalChannel]  # Local channel of each station, if a term couples positions
    # Anticipated local channels, each with the grid of the averaged map, if any
    anticipated: Sequence[tuple[LocalChannel, LocalGrid | None]]
    gates: Gates | None  # Gates of the measurements; None if no term measures
    # (N,) index of the route turn that each position heads for; None without a route
    ahead: Indices | None
    probed: Mask | None  # (N,) True where connection is probed; None if no term probes

    @cached_property
    def stage_power(self) -> StagePower:
        """Predicted serving power at every stage."""
        return self.predicted()

    @cached_property
    def measured(self) -> list[LocalPaths]:
        """Measurements along the path, for each station's anticipated channel."""
        gate = None if self.gates is None else self.gates.value
        return [
            LocalPaths(channel, self.places_m[None], gate, grid)
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


class Nodes:
    """Channel predictions of all stations at the nodes of a lattice."""

    grid_m: Floats  # (ny, nx, 2) positions of the nodes
    stations: Sequence[NodeChannel]  # Predictions of each station's power at the nodes
    window: tuple[slice, slice]  # Rows and columns of the reachable nodes
