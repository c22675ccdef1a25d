"""The planner that a problem asks for, all with the same way to ask for a plan."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from planopt.errors import InputError
from planopt.parts import calling, class_name, part_of
from planopt.planning.baselines.strategies import (
    StrategyPlanner,
    informed_disk,
    path_loss_only,
    unaware,
)
from planopt.planning.baselines.walks import (
    LawnmowerPlanner,
    OneStepPlanner,
    RandomPlanner,
    end_deviation,
)
from planopt.planning.horizon_planner import HorizonPlanner
from planopt.planning.judge import Judge
from planopt.planning.plan import Plan
from planopt.planning.scene import Ground
from planopt.planning.values.context import StepContext
from planopt.problems.planner_kinds import planner_kind
from planopt.problems.problem import Problem

KEY = "planner.name"


class Planner(Protocol):
    """Plans for one robot of a problem whose objective is a sum of terms."""

    def plan(self, situation: StepContext, judge: Judge, warm: Plan | None = None) -> Plan:
        """Plan from where the robot is."""
        ...


def planner_for(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """The planner that `problem.planner.name` names."""
    kind = planner_kind(problem.planner.name)
    if kind.foresees:
        raise InputError(
            f"is {kind.name}, a bound that knows the ground truth of a whole run",
            file=problem.file,
            key="planner.name",
            remedy="simulate or compare with it, or name another planner",
        )
    make = kind.maker()
    with calling(make, "", key=KEY, remedy="take a problem, its geometry and a random generator"):
        made = make(problem, ground, generator)
    if not callable(getattr(made, "plan", None)):
        raise InputError(
            f"is {kind.name}: {class_name(made)} has no method plan",
            key=KEY,
            remedy="define plan(self, situation, judge, warm=None), which returns released(...)",
        )
    return made


def asked_plan(
    planner: Planner, situation: StepContext, judge: Judge, warm: Plan | None = None
) -> Plan:
    """Return what a planner plans; see :meth:`Planner.plan`."""
    remedy = "return released(judge, path_m, begun_s), of a path (N, 2)"
    with calling(planner, "plan", key=KEY, remedy=remedy):
        plan = planner.plan(situation, judge, warm)
    part_of(f"{KEY}: what {class_name(planner)}.plan returned", plan, Plan, remedy)
    return plan


def horizon_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the planner that searches, refines and verifies over a horizon."""
    return HorizonPlanner(problem, ground)


def one_step_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the baseline that looks one step ahead."""
    return OneStepPlanner(problem, ground)


def largest_deviation_planner(
    problem: Problem, ground: Ground, _generator: np.random.Generator
) -> Planner:
    """Make the baseline that goes where power is known least within a step."""
    return OneStepPlanner(problem, ground, end_deviation)


def random_planner(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """Make the baseline that walks full steps in random directions."""
    return RandomPlanner(problem, ground, generator)


def disk_walk_planner(problem: Problem, ground: Ground, generator: np.random.Generator) -> Planner:
    """Make the baseline whose steps are uniform over the disc of one step."""
    return RandomPlanner(problem, ground, generator, "disk")


def persistent_walk_planner(
    problem: Problem, ground: Ground, generator: np.random.Generator
) -> Planner:
    """Make the baseline that walks full steps and turns little."""
    return RandomPlanner(problem, ground, generator, "persistent")


def lawnmower_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the baseline that mows the workspace."""
    return LawnmowerPlanner(problem, ground)


def path_loss_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that knows path loss, and nothing of shadowing."""
    return StrategyPlanner(problem, ground, path_loss_only)


def disk_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that counts on all packets within a disc, and on none beyond."""
    return StrategyPlanner(problem, ground, informed_disk)


def unaware_planner(problem: Problem, ground: Ground, _generator: np.random.Generator) -> Planner:
    """Make the strategy that counts on all packets everywhere."""
    return StrategyPlanner(problem, ground, unaware)
