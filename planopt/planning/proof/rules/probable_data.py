"""The rule on data with a probability: that the plan delivers what keeps pace with the deadline.

How many steps are connected depends on all of them together, so that channels are drawn: as many
each time, from one seed, so that the same path is judged the same again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv  # pyright: ignore[reportUnknownVariableType]

from planopt.channel.joint import JointPrediction
from planopt.channel.semidefinite import semidefinite_factor
from planopt.planning.certificate import RuleResult
from planopt.planning.history import History
from planopt.planning.proof.rules.asked import data_asked_mbit
from planopt.problems.problem import Problem

DRAWS, SEED = 10_000, 0
"""With them the greatest probability that can be shown is 0.9995."""

DOUBT = 0.01
"""The lower end of the interval of this one-sided doubt counts (Clopper and Pearson, 1934)."""


DRAWN = f"{DRAWS} drawn channels, lower end of the {1.0 - DOUBT:.0%} interval"
"""What the method is called."""


def drawn_powers_dbm(prediction: JointPrediction, station: int = 0) -> NDArray[np.float64]:
    """Powers along the path in `DRAWS` channels; ``(DRAWS, N)``.

    Each station's numbers are its own.
    """
    generator = np.random.default_rng([SEED, station] if station else SEED)
    normal = generator.standard_normal((DRAWS, len(prediction)))
    return prediction.mean_db + normal @ semidefinite_factor(prediction.covariance_db2).T


def probable_data_result(
    problem: Problem, history: History, powers_dbm: NDArray[np.float64], slack_db: float = 0.0
) -> RuleResult:
    """A lower bound of the probability that a plan delivers its share by the deadline."""
    # Shapes: powers_dbm (DRAWS, N).
    each, asked_mbit = data_asked_mbit(problem, history, powers_dbm.shape[1])
    achieved = 1.0
    if asked_mbit > 0.0:
        connected = powers_dbm >= problem.stations[0].threshold_dbm - slack_db
        # A sum of whole steps may miss its own value by rounding.
        enough = int((connected @ each >= asked_mbit * (1.0 - 1e-9)).sum())
        achieved = share_at_least(enough, len(powers_dbm))
    return RuleResult("data", achieved, problem.constraints.p_min, "probability", DRAWN)


def share_at_least(count: int, of: int) -> float:
    """Lower end of the one-sided interval of a probability seen `count` times `of` so many."""
    if count == 0:
        return 0.0
    return float(np.asarray(betaincinv(count, of - count + 1, DOUBT), dtype=np.float64))
