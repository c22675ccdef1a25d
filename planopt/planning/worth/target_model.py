"""How the target of a problem is taken to move, by its filters and by plans."""

from __future__ import annotations

import numpy as np

from planopt.problems.problem import Problem
from planopt.targets.target_model import TargetModel


def target_model(problem: Problem) -> TargetModel:
    """Constant velocity but for white acceleration, alike along both axes; there is a target."""
    deviation = problem.targets[0].acceleration_std_m_s2
    return TargetModel(problem.planner.step_s, deviation**2 * np.eye(2))
