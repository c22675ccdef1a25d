"""What a robot learns on its way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief, update
from planopt.channel.fields.truth import Truth, measure
from planopt.problems.problem import Problem


def learn_here(
    problem: Problem, truth: Truth, belief: Belief, position_m: NDArray[np.float64]
) -> Belief:
    """Measure where the robot is, unless a place that near has been measured already."""
    known = belief.posterior.measurements.positions_m
    spacing = problem.channel.measure_spacing_m
    if len(known) and np.linalg.norm(known - position_m, axis=1).min() < spacing:
        return belief
    return update(belief, measure(truth, position_m[None]))
