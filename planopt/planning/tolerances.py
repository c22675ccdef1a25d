"""Tolerances of planning with their reasons, and margins of a problem's bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db
from planopt.problems.problem import Problem

CLEARANCE_TOLERANCE_M = 1e-6
"""Verifier's tolerance: round-off of exact distances at coordinates of some hundred metres."""

DYNAMICS_TOLERANCE_M = 1e-5
"""Verifier's tolerance: about the accuracy of IPOPT on steps of metres."""

MARGIN_TOLERANCE_DB = 1e-6
"""Verifier's tolerance: round-off of an exact posterior; it changes a probability by 1e-7."""

CLEARANCE_PAD_M = 1e-3
"""Clearance that planners add, so that the solver's tolerance causes no violation."""

STEP_PAD_M = 1e-6
"""Length by which planners shorten steps, for the same reason."""

MARGIN_PAD_DB = 0.02
"""Connectivity margin that planners add, for the same reason."""

STANDSTILL_M = 1e-3
"""Minimum length of a step that counts as motion."""

RULE_TOLERANCE = 1e-7
"""Verifier's tolerance: :data:`MARGIN_TOLERANCE_DB` as a probability, or relative to a bound."""


def margins_asked_db(problem: Problem, power: Prediction) -> NDArray[np.float64]:
    """Return the margin (n,) in dB by which each predicted power meets p_min."""
    return bound_margin_db(
        power.mean_db,
        power.deviation_db,
        problem.stations[0].threshold_dbm,
        problem.constraints.p_min,
    )
