"""By how much a key must be loosened for a path to keep the rule of connectivity as it is."""

from __future__ import annotations

from dataclasses import replace

from planopt.channel.prediction import Prediction
from planopt.planning.bound_margins import margins_asked_db
from planopt.planning.explain.case import Case
from planopt.planning.explain.fault import met_nowhere
from planopt.planning.explain.key import Key
from planopt.planning.explain.keys import MOST_DB
from planopt.planning.history import BEGINNING
from planopt.planning.proof.broad_prediction import broad_prediction
from planopt.planning.proof.predictions import certified_prediction
from planopt.planning.proof.rules.tolerance import is_missed, margin_missed
from planopt.planning.proof.rules.whole_plan import whole_plan_result
from planopt.planning.robot_problem import problem_of_robot
from planopt.problems.problem import Problem

DEAR = 1e5
"""Price of a dB of slack beside which nothing else counts."""

HALVINGS = 40
SETTLED = 1e-3
"""The amount is found to this share of itself."""


def elastic_problem(case: Case) -> Problem | None:
    """The problem with the rule missed by as little as may be: slack without end, and dear.

    None where slack has no price, or nothing is lacking that it could make up for.
    """
    problem = case.problem
    rule = problem.constraints.rule
    if problem.task == "reach" or (rule.by_step and rule.slack_max_db is None):
        return None
    elastic = replace(rule, slack_max_db=MOST_DB, slack_price=DEAR)
    return replace(problem, constraints=replace(problem.constraints, rule=elastic))


def attained_amount(case: Case, key: Key) -> float | None:
    """The least amount with which the verifier has nothing against the plan's own path.

    None where no amount does.
    """

    def kept(amount: float) -> bool:
        whole = key.changed(case.problem, key.loosened(amount))
        return _is_kept(case, problem_of_robot(whole, case.number))

    low, high = 0.0, key.most
    if not kept(high):
        return None
    for _ in range(HALVINGS):
        if high - low <= SETTLED * high:
            break
        middle = 0.5 * (low + high)
        low, high = (low, middle) if kept(middle) else (middle, high)
    return high


def _is_kept(case: Case, problem: Problem) -> bool:
    """Whether the plan's path keeps the rule of a changed problem."""
    plan, rule = case.plan, problem.constraints.rule
    first, broad = case.posteriors[0], None
    power = Prediction(plan.mean_dbm[1:], plan.deviation_db[1:])
    if len(case.posteriors) > 1 or first.outcomes is not None:
        # What stands for several powers, or a calibrated one, depends on thresholds and on p_min.
        broad = broad_prediction(problem, case.posteriors)
        power, _ = certified_prediction(first, plan.positions_m[1:], broad, keep=False)
    if not rule.by_step:
        result = whole_plan_result(problem, BEGINNING, first, plan.positions_m, power, broad)
        return result.slack_db > 0.0 or not is_missed(result)
    margins = margins_asked_db(problem, power) + (rule.slack_max_db or 0.0)
    blamed = margins[[step - 1 for step in plan.certificate.relaxed_steps]]
    kept = ~margin_missed(blamed)
    return bool(kept.any() if met_nowhere(case) else kept.all())
