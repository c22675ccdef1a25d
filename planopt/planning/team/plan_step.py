"""Plan one step of all robots: couriers to their goals, or a team for a sum of terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.planning.initial_data import TeamSeeds
from planopt.planning.scene import Scene, build_scenes
from planopt.planning.stepping import Planning, PlanStep
from planopt.planning.team.couriers import Couriers
from planopt.planning.team.team_step import build_team, plan_together
from planopt.planning.values.context import Aim
from planopt.problems.problem import Problem


def planning(
    problem: Problem,
    scenes: Sequence[Scene] | None,
    seeds: TeamSeeds,
    foreseen_m: Sequence[NDArray[np.float64]] | None = None,
) -> Planning:
    """Return what makes of a problem with obstacles what plans a step; as :func:`plan_step`.

    The scenes are those of the obstacles at the start; where others stand they are built.
    """

    def made(now: Problem, states: Sequence[NDArray[np.float64]]) -> PlanStep:
        at_start = now.workspace.obstacles == problem.workspace.obstacles
        places = [state[:2] for state in states]
        known = scenes if at_start else build_scenes(now, places)
        return plan_step(now, known, seeds, foreseen_m)

    return made


def plan_step(
    problem: Problem,
    scenes: Sequence[Scene] | None,
    seeds: TeamSeeds,
    foreseen_m: Sequence[NDArray[np.float64]] | None = None,  # (T, 2)
) -> PlanStep:
    """Return what plans a step: to goals in a scene of each robot, or a team for its terms."""
    if scenes is not None:
        couriers = Couriers(problem, scenes)
        return lambda at: (couriers.plan(at), [Aim() for _ in problem.robots])
    team = build_team(problem, seeds, foreseen_m)
    return lambda at: plan_together(problem, team, at)
