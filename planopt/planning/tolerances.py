"""Tolerances of planner and verifier with their reasons, and margins of p_min."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db
from planopt.problems.problem import Problem

CLEARANCE_TOLERANCE_M = 1e-6
"""Verifier's tolerance of distances: round-off at coordinates of some hundred metres."""

DYNAMICS_TOLERANCE_M = 1e-5
"""Verifier's tolerance of the dynamics: about the accuracy of IPOPT on steps of metres."""

MARGIN_TOLERANCE_DB = 1e-6
"""Verifier's tolerance of margins: round-off of the exact posterior, 1e-7 in probability."""

CLEARANCE_PAD_M = 1e-3
"""Clearance that planners add, so that the solver's tolerance causes no violation."""

STEP_PAD_M = 1e-6
"""Length by which planners shorten steps, so that the solver's tolerance causes no violation."""

MARGIN_PAD_DB = 0.02
"""Connectivity margin that planners add, so that the solver's tolerance causes no violation."""

STANDSTILL_M = 1e-3
"""Minimum length of a step that counts as motion."""

RULE_TOLERANCE = 1e-7
"""Verifier's tolerance of rules, absolute for probabilities and relative for other values."""


def margins_asked_db(problem: Problem, power: Prediction) -> NDArray[np.float64]:
    """Return the margins (n,) in dB by which predicted powers satisfy p_min."""
    return bound_margin_db(
        power.mean_db,
        power.deviation_db,
        problem.stations[0].threshold_dbm,
        problem.constraints.p_min,
    )
