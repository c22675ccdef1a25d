"""Terms that count the distance gained along the path that a robot is steered along; ``goal``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.moments import TINY_M, Pull
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
        return paths.at.steering.gained_m(paths.ways_m)

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
        steering, ways = paths.at.steering, paths.ways_m
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
