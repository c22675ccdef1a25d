"""Drive a pursuit by the planner that was asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import get_args

import numpy as np

from planopt.problems.systems import Request, asked_planners
from planopt.pursuit.simulation import Pursuit, simulate_pursuit
from planopt.pursuit.theorems import Inequality, Theorem
from planopt.systems.pursuit.tables import PlannerName, PlannerTable, PursuitProblem


@dataclass(frozen=True, eq=False)
class Driven:
    """A pursuit that was driven, with how."""

    problem: PursuitProblem  # What was asked for, and what happened
    pursuit: Pursuit
    planner: str  # By whom
    horizon: int
    seed: int

    @property
    def alone(self) -> bool:
        """Return whether there is one pursuer and one evader."""
        return len(self.problem.given.pursuers) == len(self.problem.given.evaders) == 1

    @property
    def in_stages(self) -> bool:
        """Return whether the theorems speak of it: stages of driving to the reported place."""
        return self.planner == "drive"


def drive(
    content: PursuitProblem, planner: PlannerTable, seed: int, on_step: Callable[[], None]
) -> Driven:
    """Run a pursuit."""
    generator = np.random.default_rng(seed)
    pursuit = simulate_pursuit(content.scene(planner, generator), generator, on_step)
    return Driven(content, pursuit, planner.name, planner.horizon, seed)


def planners(content: PursuitProblem, request: Request) -> list[PlannerTable]:
    """Return the planner settings asked for; what drives to reports has one horizon."""
    return asked_planners(
        content.given.planner, request, get_args(PlannerName), with_horizon=("receding",)
    )


def unguaranteed(content: PursuitProblem) -> Inequality | None:
    """The first inequality that fails of the theorem that must hold; None if none must or does."""
    rules = content.given.pursuit
    if rules.guarantee is None:
        return None
    for pursuer in range(len(content.given.pursuers)):
        for evader in range(len(content.given.evaders)):
            each = content.guarantees(pursuer, evader)[Theorem(rules.guarantee)]
            for one in (*each.inequalities, each.captures(rules.capture_radius_m)):
                if not one.holds:
                    return one
    return None
