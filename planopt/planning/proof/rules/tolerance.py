"""When a bound counts as missed: the verifier's tolerances, applied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planopt.planning.rule_result import RuleResult
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, RULE_TOLERANCE


def margin_missed(margin_db: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where margins are below zero by more than rounding."""
    return margin_db < -MARGIN_TOLERANCE_DB


def is_missed(result: RuleResult) -> bool:
    """Whether a rule is missed by more than rounding."""
    return result.missing > RULE_TOLERANCE * max(1.0, abs(result.asked))
