"""What a robot learns on its way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief, update
from planopt.channel.fields.truth import Truth, measure
from planopt.objectives.measuring import MeasuringRule
from planopt.problems.problem import Problem


def learn_here(
    problem: Problem, truths: Sequence[Truth], belief: Belief, position_m: NDArray[np.float64]
) -> Belief:
    """Measure where the robot is, unless a place that near has been measured already.

    Every station is measured, unless the power of each has been measured that near.
    """
    rule = MeasuringRule.of(belief.posteriors, problem.channel.measure_spacing_m)
    if not rule.is_open(position_m[None])[0]:
        return belief
    return update(belief, *(measure(truth, position_m[None]) for truth in truths))
