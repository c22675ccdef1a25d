"""Changes with which a plan that is not verified would be: the least value of each key.

The least amount that suffices is estimated on paths at hand, without solving, and confirmed by
solving again.
"""

from __future__ import annotations

from dataclasses import replace

from planopt.channel.prediction import Prediction
from planopt.planning.explain.explanation import Relaxation
from planopt.planning.explain.faults import (
    Case,
    Fault,
    best_probability,
    faults_of,
    met_nowhere,
)
from planopt.planning.explain.keys import MOST_DB, Key, Trials, least_amount, violated_keys
from planopt.planning.proof.context import VerifierContext, certified_prediction, stations_law
from planopt.planning.proof.rule import PathCase, whole_plan_result
from planopt.planning.tolerances import MARGIN_TOLERANCE_DB, margins_asked_db
from planopt.problems.problem import problem_of_robot
from planopt.world.clearance import index_obstacles

MOST_MOVING = 3
"""Removing moving obstacles is tried for at most so many."""

DEAR = 1e5
"""Price of a dB of slack that dominates the objective."""


def explain_violated(case: Case, trials: Trials) -> tuple[Relaxation, ...]:
    """Return changes that would let all constraints be satisfied, each by itself."""
    found: dict[str, Relaxation] = {}
    for fault in faults_of(case):
        cases = [case, *_elastic(case, trials)] if fault.missed == "connection" else [case]
        for key in violated_keys(case.problem, fault.missed):
            least = _lacking(fault, key, cases)
            value = trials.first(case.problem, key, least)
            if value is not None or least < key.most:
                proposed = key.loosened(least) if value is None else value
                entry = _entry(case, fault, key, proposed, verified=value is not None)
                found.setdefault(key.name, entry)
        moving = case.problem.workspace.moving
        for obstacle in moving if len(moving) <= MOST_MOVING else ():
            rest = tuple(each for each in moving if each is not obstacle)
            workspace = replace(case.problem.workspace, moving=rest)
            if fault.missed != "separation" and trials.is_verified(
                replace(case.problem, workspace=workspace)
            ):
                key = Key(f"world.moving ({obstacle.name})", "", 0.0, 0.0)
                gone = _entry(case, fault, key, None, verified=True)
                found.setdefault(key.name, replace(gone, value=None))
    return tuple(found.values())


def _entry(
    case: Case, fault: Fault, key: Key, value: float | None, *, verified: bool
) -> Relaxation:
    return key.relaxation(
        case.plan.robot, value, fault.stages, fault.shortfall, fault.unit, verified=verified
    )


def _elastic(case: Case, trials: Trials) -> list[Case]:
    """Return the plan that misses the rule least: with unbounded slack at a high price.

    Empty where slack has no price.
    """
    problem, rule = case.problem, case.problem.constraints.rule
    if problem.task == "reach" or (rule.by_step and rule.slack_max_db is None):
        return []
    elastic = replace(rule, slack_max_db=MOST_DB, slack_price=DEAR)
    constraints = replace(problem.constraints, rule=elastic)
    plan = trials.plan(replace(problem, constraints=constraints))
    return [] if plan is None else [replace(case, plan=plan)]


def _lacking(fault: Fault, key: Key, cases: list[Case]) -> float:
    """Return the estimated amount by which a key must be loosened."""
    case = cases[0]
    if fault.missed != "connection":
        return min(fault.shortfall, key.most)
    if met_nowhere(case):
        least = fault.shortfall
        if key.name == "constraints.p_min":
            least = key.value - best_probability(case.own, case.posteriors)
        if least > 0.0:
            return min(least, key.most)
    amounts = (
        least_amount(lambda amount, each=each: _is_kept(each, key, amount), key.most)
        for each in cases
    )
    return min((amount for amount in amounts if amount is not None), default=key.most)


def _is_kept(case: Case, key: Key, amount: float) -> bool:
    """Return whether the plan's path satisfies the rule with a loosened key."""
    changed = key.changed(case.problem, key.loosened(amount))
    problem, plan = problem_of_robot(changed, case.number), case.plan
    rule = problem.constraints.rule
    power = Prediction(plan.mean_dbm[1:], plan.deviation_db[1:])
    if len(case.posteriors) > 1:
        # The law that replaces several powers depends on thresholds and on p_min.
        law = stations_law(problem, case.posteriors)
        power, _ = certified_prediction(law, plan.positions_m[1:])
    if not rule.by_step:
        index, start = index_obstacles(problem.workspace), plan.positions_m[0]
        context = VerifierContext(problem, index, tuple(case.posteriors), start)
        result = whole_plan_result(PathCase(context, plan.positions_m, power))
        return result.slack_db > 0.0 or not result.is_missed
    margins = margins_asked_db(problem, power) + (rule.slack_max_db or 0.0)
    kept = margins[[step - 1 for step in plan.certificate.relaxed_steps]] >= -MARGIN_TOLERANCE_DB
    return bool(kept.any() if met_nowhere(case) else kept.all())
