"""Why a plan is not verified, and what would give one that is: each change by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from planopt.planning.explain.attained import attained_amount, elastic_problem
from planopt.planning.explain.case import Case
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.fault import Fault, faults_of, met_nowhere
from planopt.planning.explain.key import Key
from planopt.planning.explain.keys import blamed_keys, moving_keys, other_keys
from planopt.planning.explain.least_relaxation import SETTLED_SHARE, least_relaxation
from planopt.planning.explain.possible import is_possible
from planopt.planning.explain.reach_limits import best_probability
from planopt.planning.plan import Plan, Verdict
from planopt.planning.robot_problem import problem_of_robot
from planopt.problems.problem import Problem

PlanAgain = Callable[[Problem], Plan | None]
"""Plans for the case's robot in a changed problem, with all robots; None where there is no plan."""

FIRST_SHARE = 0.1
"""Of a key's value: the amount that is tried first where nothing tells how much it takes."""

HALVINGS = 7
"""Bisections of the amount up to which what is within reach rules a change out."""


def explain_no_verified_plan(case: Case, plan_again: PlanAgain) -> tuple[Relaxation, ...]:
    """What would let everything be kept, each change by itself.

    Parameters
    ----------
    case
        With a plan that is not verified.
    plan_again
        Solves the changed problems.
    """
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
    """By how much a key must be loosened for a plan that there is, or for any."""
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
