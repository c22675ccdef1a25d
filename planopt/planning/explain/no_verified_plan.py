"""Changes with which a plan that is not verified would be: the least value of each key.

The least amount that suffices is computed from paths at hand, without solving, and confirmed by
solving again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time

from planopt.channel.prediction import Prediction
from planopt.planning.explain.explanation import Case, Relaxation
from planopt.planning.explain.faults import (
    Fault,
    best_probability,
    faults_of,
    met_nowhere,
)
from planopt.planning.explain.keys import (
    MOST_DB,
    Key,
    blamed_keys,
    moving_keys,
)
from planopt.planning.history import BEGINNING
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.predictions import broad_prediction, certified_prediction
from planopt.planning.proof.rules.rule import PathCase, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, margins_asked_db
from planopt.problems.problem import Problem, problem_of_robot

PlanAgain = Callable[[Problem], Plan | None]
"""Plans for the case's robot in a changed problem, with all robots; None where there is no plan."""

EXPLAINED_S = 6.0
"""No solve begins later than this after the explanation."""


@dataclass(frozen=True)
class Deadline:
    """The end of an explanation, in the process's own time: other programs change nothing."""

    ends_s: float

    @property
    def over(self) -> bool:
        """Return whether no further solve may begin."""
        return process_time() >= self.ends_s


def deadline_from_now() -> Deadline:
    """Return the deadline of an explanation that begins."""
    return Deadline(process_time() + EXPLAINED_S)


DEAR = 1e5
"""Price of a dB of slack beside which nothing else counts."""

SETTLING_HALVINGS = 40
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
    for _ in range(SETTLING_HALVINGS):
        if high - low <= SETTLED * high:
            break
        middle = 0.5 * (low + high)
        low, high = (low, middle) if kept(middle) else (middle, high)
    return high


def _is_kept(case: Case, problem: Problem) -> bool:
    """Return whether the plan's path keeps the rule of a changed problem."""
    plan, rule = case.plan, problem.constraints.rule
    first, broad = case.posteriors[0], None
    power = Prediction(plan.mean_dbm[1:], plan.deviation_db[1:])
    if len(case.posteriors) > 1:
        # The law that replaces several powers depends on thresholds and on p_min.
        broad = broad_prediction(problem, case.posteriors)
        power, _ = certified_prediction(first, plan.positions_m[1:], broad)
    if not rule.by_step:
        result = whole_plan_result(
            PathCase(problem, BEGINNING, first, plan.positions_m, power, broad)
        )
        return result.slack_db > 0.0 or not result.is_missed
    margins = margins_asked_db(problem, power) + (rule.slack_max_db or 0.0)
    blamed = margins[[step - 1 for step in plan.certificate.relaxed_steps]]
    kept = blamed >= -MARGIN_TOLERANCE_DB
    return bool(kept.any() if met_nowhere(case) else kept.all())


EXTRA = (1.01, 1.03, 1.1, 1.5)
"""Factors of the least amount with which it is solved again: planners plan for a little more."""

LOWER = (0.5, 0.75, 0.9)
"""Factors tried where nothing tells that less would not do."""


def explain_no_verified_plan(
    case: Case, plan_again: PlanAgain, deadline: Deadline
) -> tuple[Relaxation, ...]:
    """Return changes that would let everything be kept, each by itself."""
    found: dict[str, Relaxation] = {}
    for fault in faults_of(case):
        cases = [case]
        elastic = elastic_problem(case) if fault.missed == "connection" else None
        plan = None if elastic is None or deadline.over else plan_again(elastic)
        if plan is not None:
            cases.append(replace(case, plan=plan))
        helps = _helper(case, plan_again, deadline)
        for key in blamed_keys(case.problem, fault):
            relaxation = _blamed(fault, key, cases, helps)
            if relaxation is not None:
                found.setdefault(key.name, relaxation)
        for key in moving_keys(case.problem, fault):
            if helps(key, key.limit):
                gone = _about(case, fault, key, key.limit, verified=True)
                found.setdefault(key.name, replace(gone, value=None, relaxed_value=None))
    return tuple(found.values())


_Helps = Callable[[Key, float], bool]
"""From a key and a value to whether solving again with it gives a verified plan."""


def _helper(case: Case, plan_again: PlanAgain, deadline: Deadline) -> _Helps:
    def helps(key: Key, value: float) -> bool:
        if deadline.over:
            return False
        plan = plan_again(key.changed(case.problem, value))
        return plan is not None and plan.verdict is Verdict.VERIFIED

    return helps


def _blamed(fault: Fault, key: Key, cases: list[Case], helps: _Helps) -> Relaxation | None:
    """The least value of a key that helps; not verified where none is found.

    None where that is looser than what is looked at.
    """
    least, is_least = _lacking(fault, key, cases)
    value = next(
        (value for factor in EXTRA if helps(key, value := key.loosened(factor * least))), None
    )
    if value is not None and not is_least:
        for factor in LOWER:
            if helps(key, lower := key.loosened(factor * least)):
                value = lower
                break
    if value is None and least >= key.most:
        return None
    proposed = key.loosened(least) if value is None else value
    return _about(cases[0], fault, key, proposed, verified=value is not None)


def _lacking(fault: Fault, key: Key, cases: list[Case]) -> tuple[float, bool]:
    """Return by how much a key must be loosened, and whether less is known not to do."""
    case = cases[0]
    if fault.missed != "connection":
        return min(fault.shortfall, key.most), False
    if met_nowhere(case):
        least = fault.shortfall
        if key.name == "constraints.p_min":
            least = key.asked - best_probability(case.own, case.posteriors)
        if least > 0.0:
            return min(least, key.most), True
    amounts = [amount for each in cases if (amount := attained_amount(each, key)) is not None]
    return min(amounts, default=key.most), len(cases) > 1


def _about(case: Case, fault: Fault, key: Key, value: float, *, verified: bool) -> Relaxation:
    return Relaxation(
        key.name,
        key.unit,
        key.asked,
        fault.stages,
        fault.shortfall,
        fault.unit,
        value,
        verified,
        case.plan.robot,
    )
