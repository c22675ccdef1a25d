"""What a path costs that is to reach a goal, the way beyond the horizon included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planopt.objectives.reach import cost_rate_s_m, path_cost_s
from planopt.planning.plan import Pivot
from planopt.problems.problem import Problem
from planopt.robots.drive import Drive


@dataclass(frozen=True)
class ReachCost:
    """The cost of paths of one step of planning.

    Attributes
    ----------
    problem
        A problem that is to reach a goal.
    position_m
        ``(2,)`` where the robot is.
    pivot
        The way beyond the horizon; None if there is none to be had.
    """

    problem: Problem
    position_m: NDArray[np.float64]
    pivot: Pivot | None = None

    @property
    def rate_s_m(self) -> float:
        """Cost of a metre beyond the horizon."""
        return cost_rate_s_m(
            self.problem.reach.effort_weight_s2_m2, self.problem.robots[0].speed_max_m_s
        )

    def __call__(self, path_m: NDArray[np.float64], drive: Drive | None = None) -> float:
        """Cost of a path (N, 2) in seconds, cost to go by the step's pivot included.

        Parameters
        ----------
        path_m
            The places.
        drive
            How the robot drives along them; None for the single integrator. What lies ahead of any
            other is counted from where it would come to stand, and with the time it turns before.
        """
        problem = self.problem
        resting = None if drive is None else resting_places_m(drive)
        cost = path_cost_s(
            np.vstack([self.position_m, path_m]),
            np.asarray(problem.goal_m),
            problem.constraints.goal_radius_m,
            problem.planner.step_s,
            problem.reach.effort_weight_s2_m2,
            resting,
        )
        if self.pivot is None:
            return cost
        end = path_m[-1] if resting is None else resting[-1]
        to_pivot = float(np.linalg.norm(end - self.pivot.position_m))
        if drive is not None:
            x, y = self.pivot.position_m
            cost += float(drive.dynamics.turning_s(tuple(drive.states[-1]), (x, y)))
        return cost + self.rate_s_m * (to_pivot + self.pivot.cost_m)


def resting_places_m(drive: Drive) -> NDArray[np.float64]:
    """Where a robot would come to stand if it braked from each state of a drive; (N + 1, 2)."""
    return np.column_stack(drive.dynamics.resting_place(tuple(drive.states.T)))
