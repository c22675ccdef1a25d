"""Connectivity margins as a problem asks for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db
from planopt.problems.problem import Problem


def margins_asked_db(problem: Problem, power: Prediction) -> NDArray[np.float64]:
    """Margin (n,) of p_min at each predicted place; it holds where that is at least 0."""
    return bound_margin_db(
        power.mean_db,
        power.deviation_db,
        problem.stations[0].threshold_dbm,
        problem.constraints.p_min,
    )
