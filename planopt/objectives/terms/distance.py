"""Terms of distances: ``goal`` (gained along the steered path) and ``motion_energy`` (driven)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planopt.objectives.moments import TINY_M, Pull, pull_of_lengths
from planopt.objectives.path_derivatives import PathDerivatives, by_lengths
from planopt.objectives.terms.context import NearPath, Nodes, Part, Paths, TermContext
from planopt.objectives.terms.term import Steers, Structure, Term
from planopt.targets.rounding import Derivatives, rounded_length


@dataclass(frozen=True)
class SteeredTerm(Term):
    """Base of terms whose value is the metres gained by the places of a path, summed."""

    @property
    def structure(self) -> Structure:
        """Distances add up over the steps."""
        return "stagewise"

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return by how much the places of a path are nearer to the end than the robot, summed."""
        return 0.0 if at.steering is None else float(at.steering.gained_m(path_m))

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        if paths.at.steering is None:
            return np.zeros(paths.shape[0])
        return paths.at.steering.gained_m(paths.paths_m)

    def derivatives(self, path: NearPath) -> Part:
        """Return minus the distance of every place to the next turn of the steered path."""
        steering, places = path.at.steering, path.places_m
        if path.ahead is None or steering is None:
            count = len(places)
            return Derivatives(np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3)))
        distance = rounded_length(places - steering.turns_m[path.ahead], path.rounding_m)
        return Derivatives(-distance.value, -distance.gradient, -distance.hessian)

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return derivatives of :meth:`values` by the places of paths."""
        steering, ways = paths.at.steering, paths.paths_m
        if steering is None:
            return Pull()
        turns = steering.next_turns(ways.reshape(-1, 2))
        offset = steering.turns_m[turns].reshape(ways.shape) - ways
        length = np.maximum(np.linalg.norm(offset, axis=2), TINY_M)
        return Pull(by_position=offset / length[:, :, None])

    def node_reward(self, at: TermContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return minus the distance that is left from each node of a lattice; ``(ny, nx)``."""
        shape, steering = nodes.grid_m.shape[:2], at.steering
        if steering is None:
            return np.zeros(shape)
        if steering.lattice_m is not None:
            return -steering.lattice_m
        return -steering.distance_m(nodes.grid_m.reshape(-1, 2)).reshape(shape)


@dataclass(frozen=True)
class GoalTerm(SteeredTerm):
    """Metres by which the end of each step is nearer to the robot's goal (equation 4.20).

    The distance is that of the shortest path that keeps ``p_min`` at every place, or leaves contact
    as little as can be. The run ends once every robot stands within ``goal_radius_m`` of its goal.
    """

    kind: ClassVar[str] = "goal"
    summary: ClassVar[str] = "Come to a goal, while other terms count as well."

    @property
    def steers(self) -> Steers | None:
        """The robot is steered to its goal."""
        return "goal"


@dataclass(frozen=True)
class MotionEnergyTerm(Term):
    """Energy of motion, a cost: k1 a metre and k2 a second while moving, in joules."""

    per_metre_j_m: Annotated[float, Field(ge=0, le=1e9, description="k1 in J/m.")]
    power_w: Annotated[float, Field(ge=0, le=1e9, description="k2 in W while moving.")] = 0.0

    kind: ClassVar[str] = "motion_energy"
    summary: ClassVar[str] = "Spare energy."
    task: ClassVar[str | None] = None

    @property
    def structure(self) -> Structure:
        """A step couples its two ends."""
        return "chain"

    def value(self, at: TermContext, path_m: NDArray[np.float64]) -> float:
        """Return minus the energy of a path."""
        lengths = np.linalg.norm(np.diff(np.vstack([at.position_m, path_m]), axis=0), axis=1)
        return -float(self._spent_j(lengths, at.standstill_m, at.step_s).sum())

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return minus the energy of each path."""
        return -self._spent_j(paths.legs_m, paths.at.standstill_m, paths.at.step_s).sum(axis=1)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return minus the energy of the length; that of moving at all hardly depends on where."""
        offsets = np.diff(np.vstack([path.at.position_m, path.places_m]), axis=0)
        lengths = rounded_length(offsets, path.rounding_m)
        each = np.full(len(offsets), -self.per_metre_j_m)
        return PathDerivatives(float(each @ lengths.value), *by_lengths(lengths, each))

    def slope(self, paths: Paths, number: int) -> Pull:
        """Return derivatives by the lengths of the steps."""
        by_length = np.full(paths.shape, -self.per_metre_j_m)
        return pull_of_lengths(paths.at.position_m, paths.paths_m, by_length)

    def move_reward(self, lengths_m: NDArray[np.float64], step_s: float) -> NDArray[np.float64]:
        """Return minus the energy of each move."""
        return -self._spent_j(lengths_m, 0.0, step_s)

    def _spent_j(
        self, lengths_m: NDArray[np.float64], standstill_m: float, step_s: float
    ) -> NDArray[np.float64]:
        """Return the energy of each step (...) (4.12); at a standstill no power is drawn."""
        moving_s = np.where(lengths_m > standstill_m, step_s, 0.0)
        return self.per_metre_j_m * lengths_m + self.power_w * moving_s
