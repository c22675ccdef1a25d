"""Check what the rule of connectivity needs of other tables of the problem."""

from __future__ import annotations

from planopt.errors import InputError
from planopt.problems.problem import Problem

WHOLE_STEPS = 1e-6
"""A time is a multiple of the step if it is off by no more than this share of a step."""


MOST_PROBABLE_DRAWN = 0.9995
"""Greatest probability that the verifier's drawn channels can show."""


def check_rule(problem: Problem) -> None:
    """Raise what keeps a problem's rule of connectivity from being planned with."""
    rule, planner = problem.constraints.rule, problem.planner
    if rule.connectivity == "data":
        _check_data(problem)
    if problem.task == "reach" and rule.slack_price > 0.0:
        raise InputError(
            f"is {rule.slack_price:g}, but the objective of task reach has no price for slack",
            file=problem.file,
            key="constraints.slack_price",
            remedy="leave it out: slack_max_db alone bounds the slack",
        )
    end_s = max(planner.max_steps, planner.horizon) * planner.step_s
    first_s = min(rule.connected_times_s, default=0.0)
    if first_s > end_s * (1.0 + WHOLE_STEPS):
        raise InputError(
            f"begin with {first_s:g}, and a run ends after {end_s:g} s: nothing would be asked",
            file=problem.file,
            key="constraints.connected_times_s",
            remedy="state earlier times, or raise planner.max_steps",
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


def _check_data(problem: Problem) -> None:
    """Data that no plan could be shown to deliver."""
    rule, p_min = problem.constraints.rule, problem.constraints.p_min
    if p_min > MOST_PROBABLE_DRAWN:
        raise InputError(
            f"is {p_min:g}, and more than {MOST_PROBABLE_DRAWN:g} cannot be shown for data",
            file=problem.file,
            key="constraints.p_min",
            remedy="ask for less, or leave it out to ask for the expectation",
        )
    if rule.data_mbit is None or rule.deadline_s is None or rule.rate_mbit_s is None:
        return
    most_mbit = rule.rate_mbit_s * rule.deadline_s
    if rule.data_mbit > most_mbit * (1.0 + WHOLE_STEPS):
        raise InputError(
            f"is {rule.data_mbit:g}, more than the {most_mbit:g} Mbit that rate_mbit_s delivers "
            "by deadline_s when always connected",
            file=problem.file,
            key="constraints.data_mbit",
            remedy="lessen it, or allow more time",
        )
