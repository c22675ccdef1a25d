"""A plan that is to be explained, with all that it was made and judged under."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planopt.channel.posterior import ChannelPosterior
from planopt.planning.plan import Plan
from planopt.planning.robot_problem import problem_of_robot
from planopt.problems.problem import Problem
from planopt.world.moving_discs import MovingDiscs


@dataclass(frozen=True, eq=False)
class Case:
    """One robot's plan from the start of a run.

    Attributes
    ----------
    problem
        With all robots.
    number
        Of the robot.
    posteriors
        What the plan was made from, of each station.
    plan
        The plan.
    moving
        What it must keep from: moving obstacles, and the plans of the other robots where a
        separation is asked for.
    """

    problem: Problem
    number: int
    posteriors: Sequence[ChannelPosterior]
    plan: Plan
    moving: MovingDiscs

    @property
    def own(self) -> Problem:
        """The problem with this robot alone."""
        return problem_of_robot(self.problem, self.number)
