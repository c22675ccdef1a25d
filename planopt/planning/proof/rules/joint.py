"""The rule that all steps of a plan are connected with probability p_min."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from planopt.channel.joint import JointPrediction
from planopt.channel.path_connectivity import JointConnectivity, joint_connectivity
from planopt.planning.certificate import RuleResult
from planopt.planning.history import History
from planopt.planning.proof.rules.path_draws import (
    drawn_by_slack,
    path_prediction,
    require_shown,
)
from planopt.planning.proof.rules.rule import BySlack, PathCase, Rule
from planopt.problems.problem import Problem

SEED = 0
"""Of the integral's shifts: repeated judgements of a path agree."""

ACCURACY = 4e-3
"""Three standard errors that the integral is refined to. Its value counts less its error."""

INTEGRATED_STEPS = 60
"""Up to so many steps the probability is integrated; beyond, the greatest lower bound serves."""


@dataclass(frozen=True)
class Joint(Rule):
    """The probability that all steps are connected (equation 5.2) is at least p_min."""

    kind: ClassVar[str] = "joint"
    subject: ClassVar[str] = "the probability that all steps of the plan are connected"

    @classmethod
    def check(cls, problem: Problem) -> None:
        """Raise an InputError for a probability that several stations cannot show."""
        if len(problem.stations) > 1:
            words = f"of all steps together with {len(problem.stations)} stations"
            require_shown(problem, words, "leave one entry of stations")

    def achieved(
        self, probability: NDArray[np.float64], history: History
    ) -> float | NDArray[np.float64]:
        """Return Boole's lower bound, which holds for any correlation; it may be negative."""
        return 1.0 - (1.0 - probability).sum(axis=-1)

    def correlates(self, p_min: float) -> bool:
        """Return whether the verified value is a probability of correlated steps."""
        return True

    def by_slack(self, case: PathCase) -> BySlack:
        """Return a lower bound of the probability by the joint law of the steps.

        Of one station an integral; of several the lower end of the interval over drawn channels.
        """
        problem, path_m = case.problem, case.positions_m[1:]
        threshold, p_min = problem.stations[0].threshold_dbm, problem.constraints.p_min
        if len(case.context.posteriors) == 1:
            prediction = path_prediction(case.context.posterior, path_m)
            return lambda slack_db: joint_result(prediction, threshold - slack_db, p_min)
        return drawn_by_slack(self, case, lambda connected: np.all(connected, axis=1))


def joint_result(prediction: JointPrediction, threshold_dbm: float, p_min: float) -> RuleResult:
    """Return the greatest lower bound of the probability that all steps are connected.

    The integral less its error, or the greatest of Boole's, Hunter's and Slepian's bounds.
    """
    found = joint_connectivity(prediction, threshold_dbm)
    # Where the least certain step alone misses the bound, no integral is needed.
    if len(prediction) <= INTEGRATED_STEPS and found.at_each.min() >= p_min:
        generator = np.random.default_rng(SEED)
        found = joint_connectivity(prediction, threshold_dbm, generator, ACCURACY)
    achieved, method = _best_bound(found)
    return RuleResult(Joint.kind, achieved, p_min, Joint.unit, method)


def _best_bound(found: JointConnectivity) -> tuple[float, str]:
    bounds = {
        "Hunter's bound": found.hunter.value,
        "Slepian's product": found.product.value,
        "corrected product": found.corrected_product.value,
        "Boole's bound": found.boole.value,
    }
    if found.exact is not None:
        bounds["integral less three standard errors"] = found.exact.value - found.exact.error
    proven = {method: value for method, value in bounds.items() if value is not None}
    best = max(proven, key=lambda method: proven[method])
    return proven[best], best
