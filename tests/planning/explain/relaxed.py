"""A problem with what an explanation proposes."""

from dataclasses import replace
from typing import Any

from planopt import Problem


def with_value(problem: Problem, name: str, value: float) -> Problem:
    """`problem` with another value of a key of its file."""
    table, key = name.split(".")
    constraints = problem.constraints
    if table == "constraints":
        if hasattr(constraints, key):
            return replace(problem, constraints=replace(constraints, **{key: value}))
        rule: Any = replace(constraints.rule, **{key: value})
        return replace(problem, constraints=replace(constraints, rule=rule))
    number = int(table.split("[")[1].rstrip("]"))
    stations = list(problem.stations)
    stations[number] = replace(stations[number], threshold_dbm=value)
    return replace(problem, stations=tuple(stations))


def shorter(asked: float, relaxed: float, share: float = 0.05) -> float:
    """What is short of the relaxation by a share of it."""
    return asked + (1.0 - share) * (relaxed - asked)
