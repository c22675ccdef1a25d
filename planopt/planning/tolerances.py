"""Every tolerance of planning in one place, each with its reason, and margins as a problem asks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.channel.prediction import Prediction, bound_margin_db
from planopt.problems.problem import Problem

CLEARANCE_TOLERANCE_M = 1e-6
"""The verifier's: round-off of exact distances at coordinates of some hundred metres."""

DYNAMICS_TOLERANCE_M = 1e-5
"""The verifier's: IPOPT keeps a step of metres to about this; a hundredth of a millimetre."""

MARGIN_TOLERANCE_DB = 1e-6
"""The verifier's: round-off of an exact posterior; 1e-6 dB moves a probability by 1e-7."""

CLEARANCE_PAD_M = 1e-3
"""Planners keep this much more than asked, so that solver tolerance never eats the clearance."""

STEP_PAD_M = 1e-6
"""Planners plan steps this much shorter, for the same reason."""

MARGIN_PAD_DB = 0.02
"""Planners plan for this much more connectivity margin than asked, for the same reason."""

STANDSTILL_M = 1e-3
"""A step shorter than this does not count as moving."""

RULE_TOLERANCE = 1e-7
"""The verifier's: what :data:`MARGIN_TOLERANCE_DB` is in probability, as a share of what is asked
where that is more than one."""


def margins_asked_db(problem: Problem, power: Prediction) -> NDArray[np.float64]:
    """Margin (n,) of p_min at each predicted place; it holds where that is at least 0."""
    return bound_margin_db(
        power.mean_db,
        power.deviation_db,
        problem.stations[0].threshold_dbm,
        problem.constraints.p_min,
    )
