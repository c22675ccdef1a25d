"""The last plan, one step later."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.plan import Plan, Verdict


def shifted_path(warm: Plan | None) -> NDArray[np.float64] | None:
    """Rest of a verified plan after its first step, standing still at its end.

    None without a plan, and for one that was not verified: nothing starts from such a plan.
    """
    if warm is None or warm.verdict is not Verdict.VERIFIED:
        return None
    return np.vstack([warm.positions_m[2:], warm.positions_m[-1:]])
