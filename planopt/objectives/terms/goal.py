"""The term ``goal``: distance gained towards the robot's goal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.posterior import ChannelPosterior
from planopt.objectives.steered import (
    gained_derivatives,
    gained_m,
    gained_reward,
    gained_slope,
    gains_m,
)
from planopt.objectives.terms.context import NearPath, Nodes, Paths, StepContext
from planopt.objectives.terms.term import Steers, Structure, Term
from planopt.objectives.told_batch import Pull, ToldBatch
from planopt.targets.rounding import Derivatives


@dataclass(frozen=True)
class GoalTerm(Term):
    """Metres by which the end of each step is nearer to the robot's goal (equation 4.20).

    The distance is that of the shortest way that keeps ``p_min`` at every place, or leaves contact
    as little as can be. The run ends once every robot stands within ``goal_radius_m`` of its goal.
    """

    kind: ClassVar[str] = "goal"
    summary: ClassVar[str] = "Come to a goal, while other terms count as well."

    @property
    def structure(self) -> Structure:
        """Distances add up over the steps."""
        return "stagewise"

    @property
    def steers(self) -> Steers | None:
        """The robot is steered to its goal."""
        return "goal"

    def value(self, at: StepContext, path_m: NDArray[np.float64]) -> float:
        """Return the metres gained by the places of one path, summed."""
        return gained_m(at, path_m)

    def values(self, paths: Paths) -> NDArray[np.float64]:
        """Return the same of many paths."""
        return gains_m(paths)

    def derivatives(self, path: NearPath) -> Derivatives:
        """Return minus the distance that is left at every place."""
        return gained_derivatives(path)

    def slope(self, at: StepContext, told: ToldBatch, station: ChannelPosterior) -> Pull:
        """Return derivatives of :meth:`values` by the places of paths."""
        return gained_slope(at, told.batch)

    def node_reward(self, at: StepContext, nodes: Nodes) -> NDArray[np.float64]:
        """Return minus the way that is left from each node."""
        return gained_reward(at, nodes)
