"""Rules over all steps of a plan: what a path achieves, with the slack that it takes."""

from __future__ import annotations

from dataclasses import replace

from planopt.planning.certificate import RuleResult
from planopt.planning.proof.rules.asked import is_missed
from planopt.planning.proof.rules.proven import PathCase, proven_rule
from planopt.problems.problem import Problem

HALVINGS = 22
"""Bisections of the slack: 500 dB to a ten-thousandth."""


def whole_plan_result(case: PathCase) -> RuleResult:
    """Return what a path achieves of a rule over all steps, and by how many dB it misses.

    The slack is the least lowering of the threshold with which the rule holds; where it does not
    within `slack_max_db`, or none is allowed, it is zero and the rule is missed.
    """
    rule = case.problem.constraints.rule
    result_at = proven_rule(rule).by_slack(case)
    hard = result_at(0.0)
    limit = rule.slack_max_db or 0.0
    if limit == 0.0 or not is_missed(hard) or is_missed(result_at(limit)):
        return hard
    low, high = 0.0, limit
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_missed(result_at(middle)) else (low, middle)
    return replace(hard, slack_db=high)


def rule_reasons(problem: Problem, result: RuleResult) -> list[str]:
    """Return why a path does not keep its rule; nothing where it does, within its slack."""
    if not is_missed(result) or result.slack_db > 0.0:
        return []
    rule = problem.constraints.rule
    words, key = proven_rule(rule).missed_words(result)
    unit = "" if result.unit == "probability" else f" {result.unit}"
    limit = rule.slack_max_db
    return [
        f"{words} is {result.achieved:.4g}{unit} "
        f"({result.method}), {key} asks for {result.asked:.4g}{unit}"
        + (f", also with constraints.slack_max_db {limit:g}" if limit else "")
    ]
