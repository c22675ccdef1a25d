"""What the rule of connectivity needs of other tables of the problem."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.problem import Problem

WHOLE_STEPS = 1e-6
"""A time is a multiple of the step if it is off by no more than this share of a step."""


def check_rule(problem: Problem) -> None:
    """Raise what keeps a problem's rule of connectivity from being planned with.

    Raises
    ------
    InputError
        The task has no price for slack, or a time is none at which a step ends.
    """
    rule, planner = problem.constraints.rule, problem.planner
    if problem.task == "reach" and rule.slack_price > 0.0:
        raise InputError(
            f"is {rule.slack_price:g}, but the objective of task reach has no price for slack",
            file=problem.file,
            key="constraints.slack_price",
            remedy="leave it out: slack_max_db alone bounds the slack",
        )
    for number, time_s in enumerate(rule.connected_times_s):
        steps = time_s / planner.step_s
        if round(steps) < 1 or abs(steps - round(steps)) > WHOLE_STEPS:
            raise InputError(
                f"is {time_s:g}, which is no multiple of planner.step_s {planner.step_s:g}",
                file=problem.file,
                key=f"constraints.connected_times_s[{number}]",
                remedy="state times at which a step ends",
            )
