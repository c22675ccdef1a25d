"""Distance terms: ``goal`` (progress along the steered path) and ``motion_energy``."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from planopt.arrays import Derivatives, Floats, rounded_length
from planopt.objectives.path_derivatives import PathDerivatives, by_lengths, length_jacobian
from planopt.objectives.terms.term import (
    NearPath,
    Nodes,
    Part,
    Paths,
    Steers,
    Structure,
    Term,
    TermContext,
)
from planopt.objectives.upper_bounds import StageBounds, no_reward

TINY_M = 1e-9  # Distance in metres below which the direction between two positions is undefined


@dataclass(frozen=True)
class SteeredTerm(Term):
    """Base class of terms that sum the progress of a path's positions along a route, in metres."""

    @property
    def structure(self) -> Structure:
        """Return ``stagewise``: the value is a sum over steps."""
        return "stagewise"

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return the progress towards the route's end, summed over the positions of one path."""
        return 0.0 if at.steering is None else float(at.steering.gained_m(path_m))

    def values(self, paths: Paths) -> Floats:
        """Return the progress of many paths, each summed over its positions."""
        if paths.at.steering is None:
            return np.zeros(paths.shape[0])
        return paths.at.steering.gained_m(paths.paths_m)

    def derivatives(self, path: NearPath) -> Part:
        """Return minus each position's distance to the next turn of the route, with derivatives."""
        steering, places = path.at.steering, path.places_m
        if path.ahead is None or steering is None:
            count = len(places)
            return Derivatives(np.zeros(count), np.zeros((count, 2)), np.zeros((count, 3)))
        distance = rounded_length(places - steering.turns_m[path.ahead], path.rounding_m)
        return Derivatives(-distance.value, -distance.gradient, -distance.hessian)

    def slope(self, paths: Paths) -> Floats:
        """Return the gradients of :meth:`values` w.r.t. the positions of paths."""
        steering, places = paths.at.steering, paths.paths_m
        if steering is None:
            return np.zeros(places.shape)
        turns = steering.next_turns(places.reshape(-1, 2))
        offset = steering.turns_m[turns].reshape(places.shape) - places
        length = np.maximum(np.linalg.norm(offset, axis=2), TINY_M)
        return offset / length[:, :, None]

    def node_reward(self, at: TermContext, nodes: Nodes) -> Floats:
        """Return minus the remaining distance from each lattice node as an array ``(ny, nx)``."""
        shape, steering = nodes.grid_m.shape[:2], at.steering
        if steering is None:
            return np.zeros(shape)
        if steering.lattice_m is not None:
            return -steering.lattice_m
        return -steering.distance_m(nodes.grid_m.reshape(-1, 2)).reshape(shape)


@dataclass(frozen=True)
class GoalTerm(SteeredTerm):
    """Progress in metres towards the robot's goal at the end of each step (equation 4.20).

    Distances follow the shortest path that keeps ``p_min`` everywhere, or else has the least length
    out of contact. The run ends once all robots rest within ``goal_radius_m`` of their goals.
    """

    kind: ClassVar[str] = "goal"
    summary: ClassVar[str] = "Progress to a goal, next to other terms."

    @property
    def steers(self) -> Steers | None:
        """Return ``goal``: the term steers the robot to its goal."""
        return "goal"


@dataclass(frozen=True)
class MotionEnergyTerm(Term):
    """Energy of motion in joules, a cost: k1 per metre and k2 per second while moving."""

    per_metre_j_m: Annotated[float, Field(ge=0, le=1e9, description="k1 in J/m.")]
    power_w: Annotated[float, Field(ge=0, le=1e9, description="k2 in W while moving.")] = 0.0

    kind: ClassVar[str] = "motion_energy"
    summary: ClassVar[str] = "Energy of motion, a cost."
    task: ClassVar[str | None] = None

    @property
    def structure(self) -> Structure:
        """Return ``chain``: each step couples its two end positions."""
        return "chain"

    def value(self, at: TermContext, path_m: Floats) -> float:
        """Return minus the energy of a path."""
        lengths = np.linalg.norm(np.diff(np.vstack([at.position_m, path_m]), axis=0), axis=1)
        return -float(self._spent_j(lengths, at.standstill_m, at.step_s).sum())

    def values(self, paths: Paths) -> Floats:
        """Return minus the energy of each path."""
        return -self._spent_j(paths.legs_m, paths.at.standstill_m, paths.at.step_s).sum(axis=1)

    def derivatives(self, path: NearPath) -> PathDerivatives:
        """Return minus the length-dependent energy of one path, with derivatives."""
        offsets = np.diff(np.vstack([path.at.position_m, path.places_m]), axis=0)
        lengths = rounded_length(offsets, path.rounding_m)
        each = np.full(len(offsets), -self.per_metre_j_m)
        return PathDerivatives(float(each @ lengths.value), *by_lengths(lengths, each))

    def slope(self, paths: Paths) -> Floats:
        """Return the gradients of minus the length-dependent energy w.r.t. positions."""
        ends = np.insert(paths.paths_m, 0, paths.at.position_m, axis=1)
        lengths = rounded_length(np.diff(ends, axis=1), TINY_M)
        by_place = length_jacobian(lengths).sum(axis=1).reshape(paths.paths_m.shape)
        return -self.per_metre_j_m * by_place

    def stage_bounds(self, at: TermContext) -> StageBounds | str:
        """Return the costs of moves; no stage has a reward."""
        return StageBounds(no_reward, self.per_metre_j_m, self.power_w * at.step_s)

    def move_reward(self, lengths_m: Floats, step_s: float) -> Floats:
        """Return minus the energy of each move."""
        return -self._spent_j(lengths_m, 0.0, step_s)

    def _spent_j(self, lengths_m: Floats, standstill_m: float, step_s: float) -> Floats:
        """Return the energy of each step (equation 4.12); a stationary robot draws no power."""
        moving_s = np.where(lengths_m > standstill_m, step_s, 0.0)
        return self.per_metre_j_m * lengths_m + self.power_w * moving_s
