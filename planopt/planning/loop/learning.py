"""What a robot learns on its way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planopt.channel.belief import Belief, update
from planopt.channel.fields.truth import Truth, measure
from planopt.problems.problem import Problem


def learn_here(
    problem: Problem, truths: Sequence[Truth], belief: Belief, position_m: NDArray[np.float64]
) -> Belief:
    """Measure where the robot is, unless a place that near has been measured already.

    Every station is measured, unless the power of each has been measured that near.
    """
    known = [posterior.measurements.positions_m for posterior in belief.posteriors]
    if is_known(known, position_m, problem.channel.measure_spacing_m):
        return belief
    return update(belief, *(measure(truth, position_m[None]) for truth in truths))


def is_known(
    known_m: Sequence[NDArray[np.float64]], position_m: NDArray[np.float64], spacing_m: float
) -> bool:
    """Whether every station was measured within `spacing_m`, at places (n, 2) of its own."""
    return all(
        len(places) and np.linalg.norm(places - position_m, axis=1).min() < spacing_m
        for places in known_m
    )
