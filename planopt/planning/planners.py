"""Which planner a problem asks for, all with the same way to ask for a plan."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from planopt.errors import InputError
from planopt.planning.baselines.lawnmower import LawnmowerPlanner
from planopt.planning.baselines.one_step import OneStepPlanner
from planopt.planning.baselines.random_walk import RandomPlanner
from planopt.planning.ground import Ground
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.programme.methods import METHODS
from planopt.planning.worth.situation import Situation
from planopt.problems.problem import Problem


class Planner(Protocol):
    """Plans for one robot of a problem whose objective is a sum of terms."""

    def plan(self, situation: Situation, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is.

        Parameters
        ----------
        situation
            What is known.
        judge
            What candidates are judged by; its objective is the situation's worth.
        warm
            The plan that led here, one step old, or None.
        """
        ...


def planner_for(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """The planner that `problem.planner.name` names.

    Parameters
    ----------
    problem
        With one robot and a sum of terms.
    ground
        Its geometry.
    generator
        For planners that draw; others leave it alone.

    Raises
    ------
    InputError
        The planner is not for the robot's dynamics.
    """
    robot = problem.robots[0]
    if robot.dynamics is not None and problem.planner.name not in (*METHODS, "lattice"):
        raise InputError(
            f"is {problem.planner.name}, which plans for single integrators only; "
            f"{robot.name} is a {robot.dynamics.kind}",
            file=problem.file,
            key="planner.name",
            remedy="use auto, nlp, scp or lattice",
        )
    match problem.planner.name:
        case "auto" | "nlp" | "scp" | "lattice":
            return HorizonPlanner(problem, ground)
        case "one_step":
            return OneStepPlanner(problem, ground)
        case "random":
            return RandomPlanner(problem, ground, generator)
        case "lawnmower":
            return LawnmowerPlanner(problem, ground)
