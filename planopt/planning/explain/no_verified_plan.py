"""Explanation why a plan is not verified, and changes that each give one that is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from planopt.channel.prediction import Prediction
from planopt.planning.explain.explanation import Case, Relaxation
from planopt.planning.explain.keys import (
    MOST_DB,
    Fault,
    Key,
    blamed_keys,
    faults_of,
    met_nowhere,
    moving_keys,
    other_keys,
)
from planopt.planning.explain.possible import best_probability, is_possible
from planopt.planning.history import BEGINNING
from planopt.planning.plan import Plan, Verdict
from planopt.planning.proof.predictions import broad_prediction, certified_prediction
from planopt.planning.proof.rules.rule import PathCase, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, margins_asked_db
from planopt.problems.problem import Problem, problem_of_robot

SETTLED_SHARE = 0.02
"""The least amount that helps is found to this share of itself."""

SHORT_SHARE = 0.05
"""An amount that is short by this share is tried at last: planners are not monotone."""

GROWTH = 4.0
"""Of the steps by which an amount grows until it helps, and at first shrinks."""

MOST_SOLVES = 20
"""Of one key."""


def least_relaxation(
    key: Key, helps: Callable[[float], bool], first: float, step: float, floor: float = 0.0
) -> float | None:
    """The value of a key nearest to what is asked that helps; None where none is found."""
    solves = 0

    def look(amount: float) -> tuple[bool, float]:
        nonlocal solves
        solves += 1
        value = key.loosened(amount)
        return helps(value), key.amount_of(value)

    def settled(failing: float, helping: float, close: bool) -> float:
        """The least amount that helps between one that does not and one that does.

        Bisected; at first by small steps from one that may be close to the least.
        """
        step = SETTLED_SHARE * helping
        gap = 1.0 if key.whole else step
        while helping - failing > gap and solves < MOST_SOLVES:
            middle = 0.5 * (failing + helping)
            amount = max(helping - step, middle) if close else middle
            if not failing < key.amount_of(key.loosened(amount)) < helping:
                break
            good, amount = look(amount)
            failing, helping = (failing, amount) if good else (amount, helping)
            step *= GROWTH
        return helping

    amount, failing = first, floor
    good, helping = look(amount)
    close = good and helping < key.most
    while not good:
        if helping >= key.most or solves >= MOST_SOLVES:
            return None
        failing = max(failing, helping)
        good, helping = look(helping + step)
        step *= GROWTH
    helping = settled(failing, helping, close)
    short = (1.0 - SHORT_SHARE) * helping
    if not key.whole and short > floor:
        good, amount = look(short)
        if good and amount < helping:
            helping = settled(floor, amount, close=True)
    return key.loosened(helping)


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


PlanAgain = Callable[[Problem], Plan | None]
"""Plans for the case's robot in a changed problem, with all robots; None where there is no plan."""

FIRST_SHARE = 0.1
"""Of a key's value: the amount that is tried first where nothing tells how much it takes."""

HALVINGS = 7
"""Bisections of the amount up to which what is within reach rules a change out."""


def explain_no_verified_plan(case: Case, plan_again: PlanAgain) -> tuple[Relaxation, ...]:
    """Return changes that would let everything be kept, each by itself."""
    found: dict[str, Relaxation] = {}
    for fault in faults_of(case):
        near = _near_misses(case, plan_again) if fault.missed == "connection" else ()
        helpful = [_blamed(case, fault, key, plan_again, near) for key in blamed_keys(case, fault)]
        helpful += [_other(case, fault, key, plan_again) for key in other_keys(case, fault)]
        helpful += [_without(case, fault, key, plan_again) for key in moving_keys(case, fault)]
        for relaxation in helpful:
            if relaxation is not None:
                found.setdefault(relaxation.constraint, relaxation)
    return tuple(found.values())


def _near_misses(case: Case, plan_again: PlanAgain) -> tuple[Case, ...]:
    """The plan at hand, and the one that misses the rule by the fewest dB."""
    elastic = elastic_problem(case)
    plan = None if elastic is None else plan_again(elastic)
    return (case,) if plan is None else (case, replace(case, plan=plan))


def _blamed(
    case: Case, fault: Fault, key: Key, plan_again: PlanAgain, near: Sequence[Case]
) -> Relaxation | None:
    """The least that helps of a key that is blamed.

    Where none is found, what the plan lacks; None where that is more than is looked at.
    """
    first = _lacking(case, fault, key, near)
    step = SETTLED_SHARE * max(first, SETTLED_SHARE * abs(key.asked))
    # Planners plan for a little more than is asked.
    value = least_relaxation(key, _helps(case, key, plan_again), first + 0.5 * step, step)
    if value is not None:
        return _about(case, fault, key, value, verified=True)
    if first >= key.most:
        return None
    return _about(case, fault, key, key.loosened(first), verified=False)


def _lacking(case: Case, fault: Fault, key: Key, near: Sequence[Case]) -> float:
    """Return by how much a key must be loosened for a plan that there is, or for any."""
    if fault.missed != "connection":
        return min(fault.shortfall, key.most)
    if met_nowhere(case):
        least = fault.shortfall
        if key.name == "constraints.p_min":
            least = key.asked - best_probability(case.own, case.posteriors)
        if least > 0.0:
            return min(least, key.most)
    amounts = (attained_amount(each, key) for each in near)
    return min((amount for amount in amounts if amount is not None), default=key.most)


def _other(case: Case, fault: Fault, key: Key, plan_again: PlanAgain) -> Relaxation | None:
    """The least that helps of a key that may stand in the way; None where none is found."""

    def ruled_out(amount: float) -> bool:
        if fault.missed != "connection":
            return False
        changed = key.changed(case.problem, key.loosened(amount))
        return not is_possible(problem_of_robot(changed, case.number), case.posteriors)

    if ruled_out(key.most):
        return None
    floor = 0.0
    if ruled_out(0.0):
        low, high = 0.0, key.most
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if ruled_out(middle) else (low, middle)
        floor = low
    if key.name in ("constraints.clearance_m", "constraints.separation_m"):
        first = step = key.most
    elif floor > 0.0:
        first, step = floor * (1.0 + SETTLED_SHARE), FIRST_SHARE * floor
    else:
        first = step = FIRST_SHARE * abs(key.asked)
    if key.whole:
        first, step = max(first, 1.0), max(step, 1.0)
    value = least_relaxation(key, _helps(case, key, plan_again), first, step, floor)
    return None if value is None else _about(case, fault, key, value, verified=True)


def _helps(case: Case, key: Key, plan_again: PlanAgain) -> Callable[[float], bool]:
    def helps(value: float) -> bool:
        plan = plan_again(key.changed(case.problem, value))
        return plan is not None and plan.verdict is Verdict.VERIFIED

    return helps


def _without(case: Case, fault: Fault, key: Key, plan_again: PlanAgain) -> Relaxation | None:
    """A thing that is in the way, where there is a verified plan without it."""
    if not _helps(case, key, plan_again)(key.limit):
        return None
    about = _about(case, fault, key, key.limit, verified=True)
    return replace(about, value=None, relaxed_value=None)


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
