"""What a robot learns on its way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief, update
from planopt.channel.fields.truth import Truth, measure
from planopt.channel.measurements import Measurements
from planopt.objectives.measuring import MeasuringRule
from planopt.problems.problem import Problem


def learn_here(
    problem: Problem, truths: Sequence[Truth], belief: Belief, position_m: NDArray[np.float64]
) -> Belief:
    """Measure where the robot is, unless a place that near has been measured already.

    Every station is measured, unless the power of each has been measured that near.
    """
    return learn_measured(problem, belief, [measure(truth, position_m[None]) for truth in truths])


def learn_measured(problem: Problem, belief: Belief, measured: Sequence[Measurements]) -> Belief:
    """Take measurements into a belief, but for those nearer than the spacing to earlier ones.

    Parameters
    ----------
    problem
        Says the spacing.
    belief
        The belief before; returned itself where no measurement is taken in.
    measured
        Of each station, in the order in which they were taken; none where nothing was measured.
    """
    if not measured:
        return belief
    rule = MeasuringRule.of(belief.posteriors, problem.channel.measure_spacing_m)
    taken = [each.take(rule.takes(each.positions_m)) for each in measured]
    return update(belief, *taken) if any(map(len, taken)) else belief
